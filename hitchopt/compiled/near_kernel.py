"""Compiled choice of the pairs that ``proximity`` searches, on every piece of few bodies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.compiled.distance_kernel import shortest_offset
from hitchopt.compiled.kernel_switch import kernel
from hitchopt.compiled.polynomial_kernels import basis_at, inner
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
    return np.sqrt(out)


@kernel
def _apart(a: Array, b: Array, half: Array) -> float:
    """Return the distance of two bodies (ends, 3, m) in the middle."""
    offsets = np.zeros((len(a) * len(b), 3))
    for first in range(len(a)):
        for second in range(len(b)):
            for axis in range(3):
                for k in range(len(half)):
                    x = a[first, axis, k] - b[second, axis, k]
                    offsets[first * len(b) + second, axis] += half[k] * x
    offset = shortest_offset(offsets)
    return np.sqrt(inner(offset, offset))


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
    half = basis_at(a.shape[4] - 1, 0.5)
    for piece in range(len(a)):
        drift = np.zeros((3, a.shape[4]))
        for i in range(a.shape[1]):
            for end in range(a.shape[2]):
                drift += a[piece, i, end]
        drift /= a.shape[1] * a.shape[2]
        lower, upper = _boxes(a[piece], drift), _boxes(b[piece], drift)
        for pair in range(len(first)):
            gaps[piece, pair] = _gap(lower, first[pair], upper, second[pair])
        for pair in np.argsort(gaps[piece])[:count]:
            attained = min(attained, _apart(a[piece, first[pair]], b[piece, second[pair]], half))
    return ~(gaps > (attained + margin) * (1.0 + slack))
