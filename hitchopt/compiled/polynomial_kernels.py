"""Compiled products, values and enclosures of single polynomials in Bernstein form."""

from __future__ import annotations

from math import comb

import numpy as np

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.values import Array

ENCLOSED = 2.0**-46
"""Rounding in an enclosure's residual: ``ROUNDING`` of ``hitchopt.trajectory.enclosure``."""

Blocks = tuple[Array, Array, Array, Array]
"""Blocks of one cell, (rows, degree + 1), or of all."""

Found = tuple[float, float, float]
"""Bound, value and place of a cell."""

_BINOMIALS = np.array([[comb(n, k) for k in range(65)] for n in range(65)], dtype=np.float64)


@kernel
def product(a: Array, b: Array) -> Array:
    """Return the product of two polynomials."""
    m, n = len(a) - 1, len(b) - 1
    out = np.zeros(m + n + 1)
    for i in range(m + 1):
        c = a[i] * _BINOMIALS[m, i]
        for j in range(n + 1):
            out[i + j] += c * b[j] * _BINOMIALS[n, j]
    for k in range(m + n + 1):
        out[k] /= _BINOMIALS[m + n, k]
    return out


@kernel
def elevated(a: Array, order: int) -> Array:
    """Return a polynomial in a higher degree."""
    return product(a, np.ones(order + 2 - len(a))) if order + 1 > len(a) else a


@kernel
def rows_elevated(a: Array, order: int) -> Array:
    """Return polynomials (rows, degree + 1) in a higher degree."""
    out = np.empty((len(a), order + 1))
    for i in range(len(a)):
        out[i] = elevated(a[i], order)
    return out


@kernel
def value_at(a: Array, x: float) -> float:
    """Return a polynomial's value, by de Casteljau."""
    c = a.copy()
    for r in range(len(c) - 1, 0, -1):
        for i in range(r):
            c[i] = (1.0 - x) * c[i] + x * c[i + 1]
    return float(c[0])


@kernel
def values_at(rows: Array, x: float) -> Array:
    """Return the values (rows,) of polynomials."""
    out = np.empty(len(rows))
    for i in range(len(rows)):
        out[i] = value_at(rows[i], x)
    return out


@kernel
def column_norms(rows: Array) -> Array:
    """Return the norms (columns,) of the columns of an array."""
    out = np.zeros(rows.shape[1])
    for i in range(len(rows)):
        out += rows[i] * rows[i]
    return np.sqrt(out)


@kernel
def inner(a: Array, b: Array) -> float:
    """Return the scalar product of vectors (3,)."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@kernel
def combined(rows: Array, weights: Array) -> Array:
    """Return the product of two matrices, small ones."""
    out = np.zeros((len(rows), weights.shape[1]))
    for i in range(len(rows)):
        for j in range(len(weights)):
            for k in range(weights.shape[1]):
                out[i, k] += rows[i, j] * weights[j, k]
    return out


@kernel
def _inverse_length(y: Array, weights: Array, noise: float) -> tuple[Array, Array, float]:
    """Return a scaled vector, its inverse length and error, as ``enclosure`` does."""
    scale = np.max(np.abs(y))
    y = y / (scale if scale > 0.0 else 1.0)
    count = y.shape[1]
    lengths = column_norms(combined(y, weights[:count]))
    nothing = np.zeros(len(lengths))
    if not (scale > 0.0 and np.min(lengths) > 0.0):
        return y, nothing, 1.0
    w = combined((1.0 / lengths).reshape(1, -1), weights[count:])[0]
    squared = product(y[0], y[0]) + product(y[1], y[1]) + product(y[2], y[2])
    size = np.max(np.abs(w))
    residual = np.max(np.abs(product(squared, product(w, w)) - 1.0))
    residual += ENCLOSED * (1.0 + size * size)
    if not residual < 1.0:
        return y, nothing, 1.0
    least = np.sqrt(1.0 - residual)
    error = residual / (1.0 + least) + 2.0 * noise / scale * size / least
    return (y, w, error) if error < 1.0 else (y, nothing, 1.0)


@kernel
def direction(y: Array, weights: Array, noise: float) -> tuple[Array, float]:
    """Return the direction of a vector and its error, as ``enclosure.direction``."""
    y, w, error = _inverse_length(y, weights, noise)
    unit = np.empty((3, y.shape[1] + len(w) - 1))
    for i in range(3):
        unit[i] = product(y[i], w)
    return unit, error


@kernel
def length(y: Array, weights: Array) -> tuple[Array, float]:
    """Return the length of a vector and its error, as ``enclosure.norm``."""
    scale = np.max(np.abs(y))
    y = y / (scale if scale > 0.0 else 1.0)
    count = y.shape[1]
    lengths = column_norms(combined(y, weights[:count]))
    v = combined(lengths.reshape(1, -1), weights[count:])[0]
    squared = product(y[0], y[0]) + product(y[1], y[1]) + product(y[2], y[2])
    order = max(len(squared), 2 * len(v) - 1) - 1
    residual = elevated(squared, order) - elevated(product(v, v), order)
    least = np.min(v)
    if least > 0.0:
        return v * scale, (np.max(np.abs(residual)) + ENCLOSED) / least * scale
    largest = 0.5 * np.max(column_norms(y)) * (1.0 + ENCLOSED)
    return np.full(len(v), largest * scale), largest * scale
