"""Triangles of a drawn quadrotor: two arms and a hub, four rotors, and the rims of these."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.values import Array

SPAN = 0.8
"""Reach of a drone's rotors as a share of its ellipsoid's radius."""

SEGMENTS = 16
"""Corners of a rotor; an even number."""


@dataclass(frozen=True, eq=False)
class Triangles:
    """A mesh.

    Attributes
    ----------
    vertices: (v, 3) [m], about the drone's centre, its thrust along z.
    faces: (f, 3), indices of vertices; of a drone's parts, every two in a row are the halves of a
        flat quadrangle.
    """

    vertices: Array
    faces: NDArray[np.int32]

    @property
    def quads(self) -> NDArray[np.int32]:
        """Return the quadrangles (f / 2, 4) that a drone's faces are halves of."""
        return np.column_stack([self.faces[0::2], self.faces[1::2, 2]])


@dataclass(frozen=True, eq=False)
class DroneShape:
    """The parts of a drone that differ in colour."""

    frame: Triangles
    rotors: Triangles
    rims: Triangles


def drone_shape(radius: float, segments: int = SEGMENTS) -> DroneShape:
    """Return the shape of a drone whose ellipsoid has that radius [m], of ``segments`` a rotor."""
    size = SPAN * radius
    arm, rotor, above = 0.62 * size, 0.38 * size, 0.08 * size
    quarter = np.radians([45.0, 135.0, 225.0, 315.0])
    centres = np.column_stack([arm * np.cos(quarter), arm * np.sin(quarter), np.full(4, above)])
    boxes = [_box((arm, 0.05 * size, 0.04 * size), angle) for angle in quarter[:2]]
    hub = _box((0.22 * size, 0.22 * size, 0.12 * size), 0.0)
    turn = np.linspace(0.0, 2.0 * np.pi, segments, endpoint=False)
    circle = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(segments)])
    k = np.arange(segments)
    nxt = (k + 1) % segments
    disc = Triangles(
        np.vstack([np.zeros(3), rotor * circle]),
        np.column_stack([0 * k, 1 + k, 1 + nxt]).astype(np.int32),
    )
    ring = Triangles(
        np.vstack([rotor * circle, 1.18 * rotor * circle]),
        _halves(np.column_stack([k, nxt, segments + nxt, segments + k])),
    )
    return DroneShape(
        _joined([*boxes, hub]),
        _joined([_moved(disc, centre) for centre in centres]),
        _joined([_moved(ring, centre) for centre in centres]),
    )


def _box(half: tuple[float, float, float], angle: float) -> Triangles:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    c, s = np.cos(angle), np.sin(angle)
    sides = np.array(
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    )
    turned = corners @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return Triangles(turned, _halves(sides))


def _halves(quads: NDArray[np.int_]) -> NDArray[np.int32]:
    """Return the triangles (2 f, 3) of quadrangles (f, 4)."""
    return quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.int32)


def _moved(part: Triangles, by: Array) -> Triangles:
    return Triangles(part.vertices + by, part.faces)


def _joined(parts: list[Triangles]) -> Triangles:
    before = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    faces = [part.faces + start for part, start in zip(parts, before, strict=True)]
    vertices = np.vstack([part.vertices for part in parts])
    return Triangles(vertices, np.vstack(faces).astype(np.int32))
