"""What stands around a plan in the live view: ground, arena and keep-outs."""

from __future__ import annotations

from typing import Any

import numpy as np

from hitchopt.view.scene import Scene
from hitchopt.view.viser_arrays import single

ARENA_COLOUR, KEEP_OUT_COLOUR = (154, 154, 154), (179, 38, 30)

EDGE = 0.006
"""Thickness of the arena's edges [m]."""


def add_surroundings(api: Any, name: str, scene: Scene) -> None:
    """Add ground, arena and keep-outs to a viser scene.

    Parameters
    ----------
    api: the server's scene.
    name: beginning of all names, ending in a slash.
    scene: what stands in them.
    """
    requirements, drones = scene.motion.requirements, scene.drones
    size = 2.0 * float(np.max(np.ptp(drones, axis=(0, 1)))) + 2.0
    middle = 0.5 * (np.min(drones, axis=(0, 1)) + np.max(drones, axis=(0, 1)))
    cell = 10.0 ** np.round(np.log10(size / 10.0))
    api.add_grid(
        f"{name}ground", size, size, plane="xy", cell_size=cell, section_size=5.0 * cell,
        position=(middle[0], middle[1], requirements.floor), cell_color=(205, 209, 213),
        section_color=(175, 180, 186),
    )  # fmt: skip
    arena = requirements.arena
    if arena is not None:
        corners = np.array([arena.lower, arena.upper])
        ends = [[0, 0, 0], [1, 1, 0], [0, 1, 1], [1, 0, 1]]
        picked = np.array([[a, [*a[:i], 1 - a[i], *a[i + 1 :]]] for a in ends for i in range(3)])
        box = corners[picked, np.arange(3)]
        shades = np.tile(np.array(ARENA_COLOUR, np.uint8), (len(box), 2, 1))
        api.add_line_segments(f"{name}arena", single(box), shades, thickness=EDGE)
    for i, prism in enumerate(requirements.keep_out):
        m = len(prism.polygon)
        k, following = np.arange(m), (np.arange(m) + 1) % m
        sides = [
            np.column_stack([k, following, m + k]),
            np.column_stack([following, m + following, m + k]),
        ]
        caps = [np.column_stack([0 * k[2:], k[1:-1], k[2:]]) + shift for shift in (0, m)]
        api.add_mesh_simple(
            f"{name}keep_out/{i}", prism.corners.astype(np.float32),
            np.vstack([*sides, *caps]).astype(np.uint32), color=KEEP_OUT_COLOUR, opacity=0.25,
            side="double", cast_shadow=False,
        )  # fmt: skip
