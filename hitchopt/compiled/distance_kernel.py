"""Compiled bound of the distance of points and segments, one pair at a time."""

from __future__ import annotations

import numpy as np

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.compiled.polynomial_kernels import Found, elevated, middle_of, rows_elevated
from hitchopt.values import Array

Vector = tuple[float, float, float]
"""A vector in space."""

TIE = 1e-12
"""Share by which a distance in a cell's middle is smaller: ``TIE`` of
``hitchopt.trajectory.distance``."""


@kernel
def _dot(a: Vector, b: Vector) -> float:
    """Return a scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def _moved(a: Vector, share: float, b: Vector) -> Vector:
    """Return ``a + share b``."""
    return a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]


@kernel
def _nearest(a: Vector, b: Vector) -> Vector:
    """Return the point of a segment that is nearest to the origin."""
    along = _moved(a, -1.0, b)
    squared = _dot(along, along)
    share = min(max(_dot(a, along) / squared, 0.0), 1.0) if squared > 0.0 else 0.0
    return _moved(a, -share, along)


@kernel
def _between(d: tuple[Vector, Vector, Vector, Vector]) -> Vector:
    """Return the shortest vector between segments with differences of their ends."""
    best = _nearest(d[0], d[1])
    least = _dot(best, best)
    for i, j in ((2, 3), (0, 2), (1, 3)):
        other = _nearest(d[i], d[j])
        size = _dot(other, other)
        if size < least:
            best, least = other, size
    w, u, v = d[0], _moved(d[2], -1.0, d[0]), _moved(d[0], -1.0, d[1])
    uu, uv, vv, uw, vw = _dot(u, u), _dot(u, v), _dot(v, v), _dot(u, w), _dot(v, w)
    det = uu * vv - uv * uv
    if det > 1e-14 * uu * vv:
        s, t = (uv * vw - vv * uw) / det, (uu * vw - uv * uw) / det
        if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
            other = _moved(_moved(w, s, u), -t, v)
            if _dot(other, other) < least:
                best = other
    return best


@kernel
def _column(rows: Array, i: int, k: int) -> Vector:
    """Return a coefficient of a difference."""
    return rows[3 * i, k], rows[3 * i + 1, k], rows[3 * i + 2, k]


@kernel
def shortest_offset(rows: Array, k: int) -> Vector:
    """Return the shortest offset of differences in a column of rows (3 · 1, 2 or 4, columns)."""
    first = _column(rows, 0, k)
    if len(rows) == 3:
        return first
    if len(rows) == 6:
        return _nearest(first, _column(rows, 1, k))
    return _between((first, _column(rows, 1, k), _column(rows, 2, k), _column(rows, 3, k)))


@kernel
def _unit(a: Vector, size: float) -> Vector:
    """Return a direction, zero of a vector without length."""
    return (a[0] / size, a[1] / size, a[2] / size) if size > 0.0 else (0.0, 0.0, 0.0)


@kernel
def _squares(first: Vector, middle: Vector, last: Vector, order: int) -> Array:
    """Return the square of a quadratic with three coefficients, in a degree of at least 4."""
    square = np.empty(5)
    square[0], square[4] = _dot(first, first), _dot(last, last)
    square[1], square[3] = _dot(first, middle), _dot(middle, last)
    square[2] = (_dot(first, last) + 2.0 * _dot(middle, middle)) / 3.0
    return elevated(square, order)


@kernel
def distance(rows: Array, there: Array) -> Found:
    """Return bound, value and place as ``distance_bound``.

    ``there`` (12, 1) is memory for the middle.
    """
    if rows.shape[1] < 3:
        rows = rows_elevated(rows, 2)
    order = rows.shape[1] + 1
    there = there[: len(rows)]
    for i in range(len(rows)):
        there[i, 0] = middle_of(rows[i])
    first, last = shortest_offset(rows, 0), shortest_offset(rows, order - 2)
    between = shortest_offset(there, 0)
    begin, end = np.sqrt(_dot(first, first)), np.sqrt(_dot(last, last))
    middle = np.sqrt(_dot(between, between))
    u, n, v = _unit(first, begin), _unit(between, middle), _unit(last, end)
    n = _moved(_moved(_moved(n, 1.0, n), -0.5, u), -0.5, v)
    squares, least = _squares(u, n, v, order), np.inf
    for i in range(len(rows) // 3):
        by_n, by_v, before = 0.0, 0.0, 0.0
        for k in range(order + 1):
            here = _column(rows, i, k) if k < order - 1 else (0.0, 0.0, 0.0)
            along = (order - k) * (order - k - 1) * _dot(u, here)
            along += 2 * k * (order - k) * by_n + k * (k - 1) * before
            along /= order * (order - 1)
            least = min(least, along / (0.5 + 0.5 * max(squares[k], 0.0)))
            by_n, before, by_v = _dot(n, here), by_v, _dot(v, here)
    value, x = begin, 0.0
    if end < value:
        value, x = end, 1.0
    if middle < (1.0 - TIE) * value:
        value, x = middle, 0.5
    return max(least, 0.0), value, x
