"""Taut edges around a convex section: tangent, arc, tangent between two vertices outside of it.

A section is its core of clockwise corners with discs of one radius about them. Edges run clockwise
around it and keep it on their right. Arrays carry any leading axes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.vectors import first_smallest, length, unit
from hitchopt.objects import Section
from hitchopt.values import Array, Indices


@dataclass(frozen=True, eq=False)
class Bends:
    """The corners of a section's core about which edges turn.

    Attributes
    ----------
    touching: (…, n), whether they turn at all.
    corners: (…, n, 2), the first and the last corner; of straight ones twice the first to touch.
    """

    touching: NDArray[np.bool_]
    corners: Indices

    def differ(self, other: Bends) -> NDArray[np.bool_]:
        """Return (…) whether any edge turns about other corners."""
        moved = np.any(self.corners != other.corners, axis=-1) & self.touching
        found: NDArray[np.bool_] = np.any(moved | (self.touching != other.touching), axis=-1)
        return found

    def __getitem__(self, item: Any) -> Bends:
        return Bends(self.touching[item], self.corners[item])


@dataclass(frozen=True, eq=False)
class Wraps:
    """Edges k from vertex k to vertex k+1, around a section where they touch it.

    Attributes
    ----------
    leaving, arriving: (…, n, 2) unit vectors ``a_k``, ``b_k`` of the edge at ``p_k`` and at
        ``p_{k+1}``; alike where the edge is straight.
    tangents: (…, n, 2) [m], lengths of both straight parts; halves of a straight edge.
    arcs: (…, n) [m], lengths on the section.
    angles: (…, n) [rad], wraps ``θ_k``; 0 of a straight edge.
    contacts: (…, n, 2, 2) [m], where the arc begins and ends; the middle of a straight edge.
    bends: about what edges turn.
    """

    leaving: Array
    arriving: Array
    tangents: Array
    arcs: Array
    angles: Array
    contacts: Array
    bends: Bends

    @property
    def lengths(self) -> Array:
        """(…, n) [m]: lengths of cable between the clasps."""
        lengths: Array = np.sum(self.tangents, axis=-1) + self.arcs
        return lengths

    @property
    def clasp_angles(self) -> Array:
        """(…, n) [rad]: angles ``β_k`` between the two edges at every clasp."""
        behind = np.roll(self.arriving, 1, axis=-2)
        return math.pi - np.abs(_turn(behind, self.leaving))


def wraps_around(section: Section, vertices: Array, bends: Bends | None = None) -> Wraps:
    """Return the taut edges of a clockwise polygon around a section.

    Parameters
    ----------
    vertices: (…, n, 2) [m], outside of the section.
    bends: (…, n), about what edges are to turn, so that curves continue smoothly beyond the last
        place at which they do; None for what they do.
    """
    onward = np.roll(vertices, -1, axis=-2)
    given = (None, None) if bends is None else np.moveaxis(bends.corners, -1, 0)
    a, first, corner = _tangents(section, vertices, 1.0, given[0])
    b, last, corner_after = _tangents(section, onward, -1.0, given[1])
    b = -b
    right = -_turn(a, b)
    touching = right > 0.0 if bends is None else np.broadcast_to(bends.touching, right.shape)
    ring = np.append(0.0, np.cumsum(length(np.roll(section.core, -1, 0) - section.core)))
    sides = (ring[corner_after] - ring[corner]) % ring[-1] if ring[-1] > 0.0 else 0.0
    chord = onward - vertices
    straight, size = unit(chord), length(chord)
    touches = touching[..., None]
    if bends is None:
        left = np.stack([-straight[..., 1], straight[..., 0]], axis=-1)
        corners = np.stack([corner, corner_after], axis=-1)
        first_to_touch = np.argmax(left @ section.core.T, axis=-1)[..., None]
        bends = Bends(touching, np.where(touches, corners, first_to_touch))
    contacts = np.stack([vertices + first[..., None] * a, onward - last[..., None] * b], axis=-2)
    half, middle = 0.5 * size[..., None], 0.5 * (vertices + onward)
    return Wraps(
        np.where(touches, a, straight),
        np.where(touches, b, straight),
        np.where(touches, np.stack([first, last], axis=-1), half),
        np.where(touching, sides + section.rounding * right, 0.0),
        np.where(touching, right, 0.0),
        np.where(touches[..., None], contacts, middle[..., None, :]),
        bends,
    )


def _tangents(
    section: Section, points: Array, side: float, about: Indices | None
) -> tuple[Array, Array, Indices]:
    """Return tangents from points (…, 2): directions, lengths [m], and the corners touched.

    The section is on the right of them with side 1, on the left with -1. They touch the corners
    ``about`` (…), or else those with all of the section on that side.
    """
    to_corners = section.core - points[..., None, :]
    to_middle = np.mean(section.core, axis=0) - points
    far = length(to_corners)
    lean = np.arcsin(np.minimum(section.rounding / np.where(far > 0.0, far, 1.0), 1.0))
    angles = side * _turn(to_middle[..., None, :], to_corners) + lean
    if about is None:
        corner = first_smallest(-angles, 1.0)  # of two corners on one side, either is right
    else:
        corner = np.broadcast_to(about, points.shape[:-1])
    chosen = np.take_along_axis(angles, corner[..., None], axis=-1)[..., 0]
    reach = np.take_along_axis(far, corner[..., None], axis=-1)[..., 0]
    lengths = np.sqrt(np.maximum(reach**2 - section.rounding**2, 0.0))
    return _turned(unit(to_middle), side * chosen), lengths, corner


def _turn(first: Array, second: Array) -> Array:
    """Return the angles (…) [rad] from vectors (…, 2) to others, positive to the left."""
    cross = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    angles: Array = np.arctan2(cross, np.sum(first * second, axis=-1))
    return angles


def _turned(vectors: Array, angles: Array) -> Array:
    """Return vectors (…, 2) turned to the left by angles (…) [rad]."""
    c, s = np.cos(angles), np.sin(angles)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)
