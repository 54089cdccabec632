"""Contacts of drones with each other and with cables, all of which are failures.

MuJoCo lets them pass through each other, such that a flight can be simulated to its end.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hitchopt.simulation.mujoco_world import World
from hitchopt.simulation.mujoco_xml import BODY_HALF_HEIGHT, BODY_RADIUS

Index = NDArray[np.intp]

OWN = 2.0
"""Part of its own cable that a drone cannot touch, next to the drone, over the drone's radius."""

LANDED = 0.2
"""Height above the ground [m] below which a drone may stand beside its own cable."""


def touching(world: World) -> list[tuple[str, str]]:
    """Return all pairs in contact by name: ``q0`` and ``r2``, or ``q0`` and ``cable 2``.

    Drones are ellipsoids, cables the chains of their nodes. Nodes are closer to each other than
    half of a drone's radius; a cable between two of them is at most 2 mm closer than they are.
    """
    scale = 1.0 / np.array([BODY_RADIUS, BODY_RADIUS, BODY_HALF_HEIGHT])
    drones = world.drones * scale
    near: Any = cKDTree(world.nodes * scale).query_ball_point(drones, 1.0)  # a list per drone
    drone = np.repeat(np.arange(len(drones)), [len(entry) for entry in near])
    node = np.array([i for entry in near for i in entry], dtype=np.intp)
    cable = np.searchsorted(world.cable_vertices, node, side="right") - 1
    others = _foreign(world, drone, node, cable)
    pairs = np.unique(np.column_stack([drone, cable])[others], axis=0)
    return [
        *((_name(i), _name(j)) for i, j in sorted(cKDTree(drones).query_pairs(2.0))),  # ellipsoids
        *((_name(i), f"cable {k}") for i, k in pairs),
    ]


def _foreign(world: World, drone: Index, node: Index, cable: Index) -> NDArray[np.bool_]:
    """Return which nodes are on other cables, or on the own cable but far along it."""
    rank = node - world.cable_vertices[cable]
    from_end = np.where(drone % 2 == 0, rank, world.ropes.segments[cable] - rank)
    far = from_end * world.ropes.segment_lengths[cable] > OWN * BODY_RADIUS
    far &= world.drones[drone, 2] > world.ground + LANDED
    foreign: NDArray[np.bool_] = (drone // 2 != cable) | far
    return foreign


def _name(drone: int) -> str:
    return f"{'qr'[drone % 2]}{drone // 2}"
