"""Products, lengths and directions of many vectors, shortest connections, choices among ties."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.values import Array

TIE = 1e-9
"""Relative difference of values that tie: far above rounding, far below what matters."""

GOLDEN = 0.6180339887498949
"""Fractional part of the golden ratio: sums of a few multiples and powers do not tie again."""

EAST = np.array([1.0, 0.0, 0.0])
"""Direction that stands for that of vectors that have none."""


def dot(a: Array, b: Array) -> Array:
    """Return the scalar products (…) of vectors (…, d); leading axes broadcast."""
    products: Array = np.einsum("...i,...i->...", a, b)
    return products


def length(a: Array) -> Array:
    """Return the lengths (…) of vectors (…, d)."""
    lengths: Array = np.sqrt(dot(a, a))
    return lengths


def column_lengths(a: Array) -> Array:
    """Return the lengths (…, k) of vectors in columns (…, d, k)."""
    lengths: Array = np.sqrt(np.einsum("...dk,...dk->...k", a, a))
    return lengths


def unit(a: Array, fallback: ArrayLike = 0.0, least: ArrayLike = 0.0) -> Array:
    """Return the directions (…, d) of vectors (…, d), or ``fallback`` where they have none.

    That is where they are no longer than ``least``, one or (…, 1).
    """
    size = length(a)[..., None]
    long = size > np.asarray(least)
    directions: Array = np.where(long, a / np.where(long, size, 1.0), fallback)
    return directions


def shortest_offset(differences: Array) -> Array:
    """Return the shortest of all vectors (…, d) [m] from the second body to the first.

    Bodies are points or segments, given by the ``differences`` (…, 1, 2 or 4, d) [m] of their ends,
    d = 2 or 3: all vectors between them make the hull of these, so the shortest is the hull's point
    nearest to the origin. Bodies may touch, cross, be parallel or shrink to points.

    The closest points of segments are either both inside, or one is an end: of the five candidates
    the nearest is taken, which needs no case for parallel or zero-length segments. After C.
    Ericson, Real-Time Collision Detection (2005), section 5.1.9.
    """
    count = differences.shape[-2]
    if count == 1:
        return differences[..., 0, :]
    if count == 2:
        return _nearest(differences[..., 0, :], differences[..., 1, :])
    first, last = differences.take([0, 2, 0, 1], axis=-2), differences.take([1, 3, 2, 3], axis=-2)
    start = differences[..., 0, :]
    inner = _inner(start, differences[..., 2, :] - start, start - differences[..., 1, :])
    offsets = np.concatenate([_nearest(first, last), inner[..., None, :]], axis=-2)
    best = np.argmin(dot(offsets, offsets), axis=-1)
    chosen: Array = np.take_along_axis(offsets, best[..., None, None], axis=-2)[..., 0, :]
    return chosen


def differences(a: Array, b: Array) -> Array:
    """Return all differences (…, k · m, d) of ends (…, k, d) and (…, m, d), a's first end first."""
    each = a[..., :, None, :] - b[..., None, :, :]
    return each.reshape(*each.shape[:-3], a.shape[-2] * b.shape[-2], each.shape[-1])


def _nearest(first: Array, second: Array) -> Array:
    """Return the point nearest to the origin of the segment from ``first`` to ``second``."""
    along = first - second
    squared = dot(along, along)
    share = dot(first, along)
    share = np.divide(share, squared, out=np.zeros_like(share), where=squared > 0.0)
    nearest: Array = first - np.clip(share, 0.0, 1.0)[..., None] * along
    return nearest


def _inner(w: Array, u: Array, v: Array) -> Array:
    """Return the offset ``w + s u - t v`` of two lines' closest points where both lie inside.

    Elsewhere infinity. ``w`` joins the segments' first ends, u and v lead from first to last.
    """
    uu, uv, vv = (dot(x, y) for x, y in ((u, u), (u, v), (v, v)))
    uw, vw = dot(u, w), dot(v, w)
    det = uu * vv - uv * uv
    skew = det > 1e-14 * uu * vv
    safe = np.where(skew, det, 1.0)
    s, t = (uv * vw - vv * uw) / safe, (uu * vw - uv * uw) / safe
    inside = skew & (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    offset = w + s[..., None] * u - t[..., None] * v
    return np.where(inside[..., None], offset, np.inf)


def first_smallest(values: Array, scale: Array | float) -> NDArray[np.intp]:
    """Return the indices (…) of the smallest of values (…, k), the first one in a tie.

    Values tie that differ by less than rounding makes of equal ones computed of numbers of a size
    ``scale`` (…).
    """
    smallest = np.min(values, axis=-1, keepdims=True)
    near = values <= smallest + TIE * np.asarray(scale)[..., None]
    first: NDArray[np.intp] = np.argmax(near, axis=-1)
    return first
