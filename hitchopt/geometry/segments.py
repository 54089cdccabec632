"""Closest points of segments, many pairs at once; a point is a segment of no length."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def closest_offsets(a0: Array, a1: Array, b0: Array, b1: Array) -> Array:
    """Return the shortest vectors from segments b to segments a.

    The closest points of two segments are either both inside, or one is an end: of the five
    candidates the nearest is taken, which needs no case for parallel or zero-length segments.
    After C. Ericson, Real-Time Collision Detection (2005), section 5.1.9.

    Parameters
    ----------
    a0, a1, b0, b1: (…, d) [m], the segments' ends; d = 2 or 3.

    Returns
    -------
    (…, d) [m]; zero where they meet.
    """
    candidates = [
        a0 - _nearest(a0, b0, b1),
        a1 - _nearest(a1, b0, b1),
        _nearest(b0, a0, a1) - b0,
        _nearest(b1, a0, a1) - b1,
        _inner_offsets(a0, a1, b0, b1),
    ]
    offsets = np.stack(np.broadcast_arrays(*candidates))
    squared = np.sum(offsets * offsets, axis=-1)
    best = np.argmin(squared, axis=0)
    chosen: Array = np.take_along_axis(offsets, best[None, ..., None], axis=0)[0]
    return chosen


def _nearest(point: Array, b0: Array, b1: Array) -> Array:
    """Return the points of segments b nearest to ``point``."""
    along = b1 - b0
    squared = np.sum(along * along, axis=-1)
    share = np.sum((point - b0) * along, axis=-1)
    share = np.divide(share, squared, out=np.zeros(np.shape(share)), where=squared > 0.0)
    nearest: Array = b0 + np.clip(share, 0.0, 1.0)[..., None] * along
    return nearest


def _inner_offsets(a0: Array, a1: Array, b0: Array, b1: Array) -> Array:
    """Return the offset between the lines' closest points where both lie inside; else infinity."""
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    uu, uv, vv = (np.sum(x * y, axis=-1) for x, y in ((u, u), (u, v), (v, v)))
    uw, vw = np.sum(u * w, axis=-1), np.sum(v * w, axis=-1)
    det = uu * vv - uv * uv
    skew = det > 1e-14 * uu * vv
    safe = np.where(skew, det, 1.0)
    s, t = (uv * vw - vv * uw) / safe, (uu * vw - uv * uw) / safe
    inside = skew & (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    offset = w + s[..., None] * u - t[..., None] * v
    return np.where(inside[..., None], offset, np.inf)
