"""Compiled bound of the distance of points and segments, one pair at a time."""

from __future__ import annotations

import numpy as np

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.compiled.polynomial_kernels import Found, inner
from hitchopt.values import Array


@kernel
def _nearest(a: Array, b: Array) -> Array:
    """Return the point of a segment that is nearest to the origin."""
    along = a - b
    squared = inner(along, along)
    share = min(max(inner(a, along) / squared, 0.0), 1.0) if squared > 0.0 else 0.0
    return a - share * along


@kernel
def _between(d: Array) -> Array:
    """Return the shortest vector between segments with differences (4, 3) of their ends."""
    best = _nearest(d[0], d[1])
    least = inner(best, best)
    for i, j in ((2, 3), (0, 2), (1, 3)):
        other = _nearest(d[i], d[j])
        size = inner(other, other)
        if size < least:
            best, least = other, size
    w, u, v = d[0], d[2] - d[0], d[0] - d[1]
    uu, uv, vv, uw, vw = inner(u, u), inner(u, v), inner(v, v), inner(u, w), inner(v, w)
    det = uu * vv - uv * uv
    if det > 1e-14 * uu * vv:
        s, t = (uv * vw - vv * uw) / det, (uu * vw - uv * uw) / det
        if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
            other = w + s * u - t * v
            if inner(other, other) < least:
                best = other
    return best


@kernel
def shortest_offset(d: Array) -> Array:
    """Return the shortest offset of differences (1, 2 or 4, 3)."""
    if len(d) == 1:
        return d[0].copy()
    return _nearest(d[0], d[1]) if len(d) == 2 else _between(d)


@kernel
def distance(rows: Array) -> Found:
    """Return bound, value and place as ``distance_bound``."""
    count, degree = len(rows) // 3, rows.shape[1] - 1
    first = shortest_offset(rows[:, 0].copy().reshape(count, 3))
    last = shortest_offset(rows[:, degree].copy().reshape(count, 3))
    begin, end = np.sqrt(inner(first, first)), np.sqrt(inner(last, last))
    u = first / begin if begin > 0.0 else np.zeros(3)
    v = last / end if end > 0.0 else np.zeros(3)
    least = np.inf
    for i in range(count):
        d = rows[3 * i : 3 * i + 3]
        for k in range(degree + 2):
            w, found = k / (degree + 1), 0.0
            if k <= degree:
                found += (1.0 - w) * (u[0] * d[0, k] + u[1] * d[1, k] + u[2] * d[2, k])
            if k > 0:
                found += w * (v[0] * d[0, k - 1] + v[1] * d[1, k - 1] + v[2] * d[2, k - 1])
            least = min(least, found)
    return max(least, 0.0), min(begin, end), 1.0 if end < begin else 0.0
