"""Shortest connections of points and segments, many pairs at once.

Two bodies are given by the *differences* of their ends, in one of three forms: point and point
``[a - b]``; point and segment ``[a - b0, a - b1]``; segments ``[a0 - b0, a0 - b1, a1 - b0,
a1 - b1]``. All vectors from one body to the other make the hull of these, so the shortest is the
hull's point nearest to the origin.
"""

from __future__ import annotations

import numpy as np

from hitchopt.geometry.vectors import dot
from hitchopt.values import Array


def shortest_offset(differences: Array) -> Array:
    """Return the shortest of all vectors (…, d) [m] from the second body to the first.

    Of differences (…, 1, 2 or 4, d) [m], as the module says; d = 2 or 3. Bodies may touch, cross,
    be parallel or shrink to points.
    """
    count = differences.shape[-2]
    if count == 1:
        return differences[..., 0, :]
    if count == 2:
        return _nearest(differences[..., 0, :], differences[..., 1, :])
    return _of_segments(differences)


def differences(a: Array, b: Array) -> Array:
    """Return the differences (…, k · m, d) of ends (…, k, d) and (…, m, d)."""
    each = a[..., :, None, :] - b[..., None, :, :]
    count = a.shape[-2] * b.shape[-2]
    return each.reshape(*each.shape[:-3], count, each.shape[-1])


def _of_segments(differences: Array) -> Array:
    """Return the shortest vector between segments.

    Their closest points are either both inside, or one is an end: of the five candidates the
    nearest is taken, which needs no case for parallel or zero-length segments. After C. Ericson,
    Real-Time Collision Detection (2005), section 5.1.9.
    """
    first, last = differences.take([0, 2, 0, 1], axis=-2), differences.take([1, 3, 2, 3], axis=-2)
    start = differences[..., 0, :]
    inner = _inner(start, differences[..., 2, :] - start, start - differences[..., 1, :])
    offsets = np.concatenate([_nearest(first, last), inner[..., None, :]], axis=-2)
    best = np.argmin(dot(offsets, offsets), axis=-1)
    chosen: Array = np.take_along_axis(offsets, best[..., None, None], axis=-2)[..., 0, :]
    return chosen


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
