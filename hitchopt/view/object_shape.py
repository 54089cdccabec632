"""Triangles of drawn objects: the body, and the rim as a plate of some thickness."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.vectors import unit
from hitchopt.objects import Section, SolidObject
from hitchopt.values import Array
from hitchopt.view.drone_shape import Triangles

ROUND = 32
"""Corners of a drawn circle."""

PLATE = 0.012
"""Thickness of a drawn rim [m], below its height."""


def object_shape(body: SolidObject) -> Triangles:
    """Return the triangles of an object about its base, seen from outside counter-clockwise."""
    parts = [
        _prism(slab.section, min(slab.lower, slab.upper - PLATE), slab.upper) for slab in body.slabs
    ]
    corners = np.concatenate(parts)
    return Triangles(
        corners.reshape(-1, 3), np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
    )


def split(corners: Array, times: int) -> Array:
    """Return triangles (m, 3, 3) cut at the middles of their sides, 4**times of each."""
    for _ in range(times):
        middles = 0.5 * (corners + np.roll(corners, -1, axis=1))
        whole = np.concatenate([corners, middles], axis=1)
        corners = whole[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]].reshape(-1, 3, 3)
    return corners


def normals(corners: Array) -> Array:
    """Return the unit normals (…, 3) of triangles (…, 3, 3)."""
    first, second = corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]
    return unit(np.cross(first, second))


def _prism(section: Section, lower: float, upper: float) -> Array:
    """Return the triangles (m, 3, 3) [m] of a section between two heights."""
    outline = _outline(section)
    count = len(outline)
    floor, ceiling = (np.column_stack([outline, np.full(count, z)]) for z in (lower, upper))
    k = np.arange(count)
    following = (k + 1) % count
    sides = [
        np.stack([floor[k], floor[following], ceiling[following]], axis=1),
        np.stack([floor[k], ceiling[following], ceiling[k]], axis=1),
    ]
    fan: NDArray[np.intp] = np.column_stack([0 * k[2:], k[1:-1], k[2:]])
    return np.concatenate([*sides, ceiling[fan], floor[fan[:, ::-1]]])


def _outline(section: Section) -> Array:
    """Return corners (m, 2) [m], counter-clockwise."""
    if section.outline is not None:
        return np.asarray(section.outline[::-1])
    angle = 2.0 * np.pi * np.arange(ROUND) / ROUND
    return section.rounding * np.column_stack([np.cos(angle), np.sin(angle)])
