"""Compiled enclosures of lengths and directions of polynomial vectors, one after the other."""

from __future__ import annotations

import numpy as np

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.compiled.polynomial_kernels import BINOMIALS, INVERSES, column_norms, convolve
from hitchopt.values import Array

ENCLOSED = 2.0**-46
"""Rounding in an enclosure's residual: ``ROUNDING`` of ``hitchopt.trajectory.enclosure``."""


@kernel
def work_space() -> Array:
    """Return memory that enclosures of one polynomial after the other use."""
    return np.empty((12, len(BINOMIALS)))


@kernel
def _scaled(out: Array, y: Array) -> float:
    """Fill in a vector with the largest coefficient one; return by what it was divided."""
    scale = 0.0
    for i in range(3):
        for k in range(y.shape[1]):
            scale = max(scale, abs(y[i, k]))
    for i in range(3):
        for k in range(y.shape[1]):
            out[i, k] = y[i, k] / scale if scale > 0.0 else 0.0
    return scale


@kernel
def _lengths(out: Array, own: Array, y: Array, weights: Array) -> None:
    """Fill in the lengths of a vector at nodes."""
    count = len(weights) - len(out)
    out[:] = 0.0
    for i in range(3):
        own[:] = 0.0
        for k in range(count):
            c, onward = y[i, k], weights[k]
            for node in range(len(out)):
                own[node] += c * onward[node]
        for node in range(len(out)):
            out[node] += own[node] * own[node]
    for node in range(len(out)):
        out[node] = np.sqrt(out[node])


@kernel
def _through(out: Array, values: Array, weights: Array) -> None:
    """Fill in the polynomial through values at nodes."""
    first = len(weights) - len(values)
    out[:] = 0.0
    for node in range(len(values)):
        c, onward = values[node], weights[first + node]
        for k in range(len(out)):
            out[k] += c * onward[k]


@kernel
def _squared(out: Array, y: Array) -> None:
    """Fill in the square of a polynomial times its binomials."""
    out[:] = 0.0
    convolve(out, y, y)


@kernel
def _residual(y: Array, w: Array, squared: Array, inverse: Array, whole: Array) -> float:
    """Return a bound of ``|y|² w² - 1`` for coefficients times their binomials."""
    found = 0.0
    squared[:] = whole[:] = 0.0
    for i in range(3):
        convolve(squared, y[i], y[i])
    _squared(inverse, w)
    convolve(whole, squared, inverse)
    for k in range(len(whole)):
        found = max(found, abs(whole[k] * INVERSES[len(whole) - 1, k] - 1.0))
    return found


@kernel
def _direction(unit: Array, vector: Array, weights: Array, noise: float, space: Array) -> float:
    """Fill in the direction of a vector, and return its error, as ``enclosure.direction``."""
    m, n, size = vector.shape[1] - 1, weights.shape[1] - 1, 0.0
    y, w, lengths = space[:3, : m + 1], space[3, : n + 1], space[4, : n + 1]
    unit[:] = 0.0
    scale = _scaled(y, vector)
    _lengths(lengths, w, y, weights)
    if not np.min(lengths) > 0.0:
        return 1.0
    for node in range(n + 1):
        lengths[node] = 1.0 / lengths[node]
    _through(w, lengths, weights)
    for k in range(n + 1):
        size = max(size, abs(w[k]))
        w[k] *= BINOMIALS[n, k]
    for i in range(3):
        for k in range(m + 1):
            y[i, k] *= BINOMIALS[m, k]
    squares = space[4, : 2 * m + 1], space[5, : 2 * n + 1], space[6, : 2 * (m + n) + 1]
    residual = _residual(y, w, squares[0], squares[1], squares[2]) + ENCLOSED * (1.0 + size * size)
    if not (size > 0.0 and residual < 1.0):
        return 1.0
    least = np.sqrt(1.0 - residual)
    error = residual / (1.0 + least) + 2.0 * noise / scale * size / least
    if not error < 1.0:
        return 1.0
    for i in range(3):
        convolve(unit[i], y[i], w)
        for k in range(m + n + 1):
            unit[i, k] *= INVERSES[m + n, k]
    return float(error)


@kernel
def directions(vectors: Array, weights: Array, noise: float) -> tuple[Array, Array]:
    """Return the directions (m, 3, ·) and errors (m,) of vectors (m, 3, ·)."""
    count, space = len(vectors), work_space()
    out, errors = np.empty((count, 3, vectors.shape[2] + weights.shape[1] - 1)), np.empty(count)
    for i in range(count):
        errors[i] = _direction(out[i], vectors[i], weights, noise, space)
    return out, errors


@kernel
def _lost(y: Array, v: Array, space: Array) -> float:
    """Return a bound of ``|y|² - v²`` for a vector and a polynomial; changes both."""
    m, n = y.shape[1] - 1, len(v) - 1
    order = 2 * max(m, n)
    both, squared, left = space[0, : 2 * m + 1], space[1, : 2 * n + 1], space[2, : order + 1]
    found = 0.0
    both[:] = left[:] = 0.0
    for i in range(3):
        for k in range(m + 1):
            y[i, k] *= BINOMIALS[m, k]
        convolve(both, y[i], y[i])
    for k in range(n + 1):
        v[k] *= BINOMIALS[n, k]
    _squared(squared, v)
    for k in range(2 * n + 1):
        squared[k] = -squared[k]
    convolve(left, both, BINOMIALS[order - 2 * m, : order - 2 * m + 1])
    convolve(left, squared, BINOMIALS[order - 2 * n, : order - 2 * n + 1])
    for k in range(order + 1):
        found = max(found, abs(left[k] * INVERSES[order, k]))
    return found


@kernel
def length(out: Array, vector: Array, weights: Array, space: Array) -> float:
    """Fill in the length of a vector, and return its error, as ``enclosure.norm``."""
    y, own, lengths, least = (
        space[:3, : vector.shape[1]],
        space[3, : len(out)],
        space[4, : len(out)],
        np.inf,
    )
    scale = _scaled(y, vector)
    _lengths(lengths, own, y, weights)
    _through(out, lengths, weights)
    for k in range(len(out)):
        least = min(least, out[k])
    if least > 0.0:
        own[:] = out
        for k in range(len(out)):
            out[k] *= scale
        return float((_lost(y, own, space[4:]) + ENCLOSED) / least * scale)
    largest = 0.5 * np.max(column_norms(y)) * (1.0 + ENCLOSED)
    out[:] = largest * scale
    return float(largest * scale)
