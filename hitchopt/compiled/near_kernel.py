"""Compiled choice of the pairs that ``proximity`` searches, on every piece of few bodies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.compiled.distance_kernel import shortest_offset
from hitchopt.compiled.kernel_switch import kernel
from hitchopt.compiled.polynomial_kernels import fill_basis
from hitchopt.values import Array, Indices

Flags = NDArray[np.bool_]


@kernel
def _boxes(corners: Array, drift: Array) -> Array:
    """Return the boxes (2, bodies, 3), lower and upper, of bodies (bodies, ends, 3, m)."""
    out = np.empty((2, len(corners), 3))
    for i in range(len(corners)):
        for axis in range(3):
            low, high = np.inf, -np.inf
            for end in range(corners.shape[1]):
                for k in range(corners.shape[3]):
                    x = corners[i, end, axis, k] - drift[axis, k]
                    low, high = min(low, x), max(high, x)
            out[0, i, axis], out[1, i, axis] = low, high
    return out


@kernel
def _gap(a: Array, i: int, b: Array, j: int) -> float:
    """Return how far two boxes are apart."""
    out = 0.0
    for axis in range(3):
        apart = max(a[0, i, axis] - b[1, j, axis], b[0, j, axis] - a[1, i, axis], 0.0)
        out += apart * apart
    return float(np.sqrt(out))


@kernel
def _apart(a: Array, b: Array, half: Array) -> float:
    """Return the distance of two bodies (ends, 3, m) in the middle."""
    offsets = np.zeros((3 * len(a) * len(b), 1))
    for first in range(len(a)):
        for second in range(len(b)):
            for axis in range(3):
                row = 3 * (first * len(b) + second) + axis
                for k in range(len(half)):
                    offsets[row, 0] += half[k] * (a[first, axis, k] - b[second, axis, k])
    x, y, z = shortest_offset(offsets, 0)
    return float(np.sqrt(x * x + y * y + z * z))


@kernel
def _smallest(values: Array, count: int) -> Indices:
    """Return the indices of the smallest values, the first ones where some are equal."""
    found, kept = np.empty(count, dtype=np.intp), 0
    for i in range(len(values)):
        if kept == count and not values[i] < values[found[kept - 1]]:
            continue
        k = min(kept, count - 1)
        while k > 0 and values[i] < values[found[k - 1]]:
            found[k] = found[k - 1]
            k -= 1
        found[k], kept = i, min(kept + 1, count)
    return found


@kernel
def near_pairs(
    a: Array, b: Array, first: Indices, second: Indices, margin: float, count: int, slack: float
) -> Flags:
    """Return (pieces, pairs) whether a pair may come closest, as ``_near`` does it.

    Parameters
    ----------
    a, b: (pieces, bodies, 1 or 2, 3, m), their ends.
    first, second: (pairs,)
    margin: added to the distance of the nearest pair [m].
    count: number of pairs that are measured, those whose boxes come closest.
    slack: relative, for rounding.
    """
    gaps, attained = np.empty((len(a), len(first))), np.inf
    half = np.empty(a.shape[4])
    fill_basis(half, 0.5)
    for piece in range(len(a)):
        drift = np.zeros((3, a.shape[4]))
        for i in range(a.shape[1]):
            for end in range(a.shape[2]):
                drift += a[piece, i, end]
        drift /= a.shape[1] * a.shape[2]
        lower, upper = _boxes(a[piece], drift), _boxes(b[piece], drift)
        for pair in range(len(first)):
            gaps[piece, pair] = _gap(lower, first[pair], upper, second[pair])
        for pair in _smallest(gaps[piece], count):
            attained = min(attained, _apart(a[piece, first[pair]], b[piece, second[pair]], half))
    return ~(gaps > (attained + margin) * (1.0 + slack))


@kernel
def near_cells(
    a: Array,
    b: Array,
    first: Indices,
    second: Indices,
    times: Array,
    margin: float,
    count: int,
    slack: float,
) -> tuple[Array, Indices, Array, Array]:
    """Return the cells of ``near_pairs``: differences of ends, items, starts and ends [s].

    Parameters
    ----------
    times: (pieces + 1,) [s], of the pieces.
    """
    kept = near_pairs(a, b, first, second, margin, count, slack)
    cells, ends, others = int(np.sum(kept)), a.shape[2], b.shape[2]
    rows = np.empty((cells, 3 * ends * others, a.shape[4]))
    item, start, end = np.empty(cells, dtype=np.intp), np.empty(cells), np.empty(cells)
    c = 0
    for piece in range(len(a)):
        for pair in range(len(first)):
            if not kept[piece, pair]:
                continue
            i, j, row = first[pair], second[pair], 0
            for one in range(ends):
                for other in range(others):
                    for axis in range(3):
                        here, there = a[piece, i, one, axis], b[piece, j, other, axis]
                        for k in range(len(here)):
                            rows[c, row, k] = here[k] - there[k]
                        row += 1
            item[c], start[c], end[c] = i * b.shape[1] + j, times[piece], times[piece + 1]
            c += 1
    return rows, item, start, end
