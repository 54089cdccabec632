"""Compiled products and values of single polynomials in Bernstein form."""

from __future__ import annotations

from math import comb

import numpy as np

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.values import Array, Indices

Blocks = tuple[Array, Array, Array, Array]
"""Blocks of one cell, (rows, degree + 1), or of all."""

Found = tuple[float, float, float]
"""Bound, value and place of a cell."""

Known = tuple[Array, Array, Indices]
"""Directions (m, 3, degree + 1), their errors (m,), and the places (cells, k) of each cell's."""

BINOMIALS = np.array([[comb(n, k) for k in range(65)] for n in range(65)], dtype=np.float64)

INVERSES = 1.0 / np.maximum(BINOMIALS, 1.0)


@kernel
def convolve(out: Array, a: Array, b: Array) -> None:
    """Add the products of coefficients times their binomials."""
    for i in range(len(a)):
        c, onward = a[i], out[i : i + len(b)]
        for j in range(len(b)):
            onward[j] += c * b[j]


@kernel
def add_product(out: Array, factor: float, a: Array, b: Array) -> None:
    """Add a product of two polynomials, times a factor, to one of its degree."""
    if len(b) == 1:
        for k in range(len(a)):
            out[k] += factor * (a[k] * b[0])
        return
    m, n = len(a) - 1, len(b) - 1
    for i in range(m + 1):
        c, onward, inverses = factor * a[i] * BINOMIALS[m, i], out[i:], INVERSES[m + n, i:]
        for j in range(n + 1):
            onward[j] += c * (b[j] * BINOMIALS[n, j]) * inverses[j]


@kernel
def _elevate(out: Array, a: Array) -> None:
    """Fill in a polynomial written in the degree of the other array."""
    m, order = len(a) - 1, len(out) - 1
    if order == m:
        out[:] = a
        return
    out[:] = 0.0
    for i in range(m + 1):
        c = a[i] * BINOMIALS[m, i]
        for j in range(order - m + 1):
            out[i + j] += c * BINOMIALS[order - m, j]
    for k in range(order + 1):
        out[k] *= INVERSES[order, k]


@kernel
def elevated(a: Array, order: int) -> Array:
    """Return a polynomial in a higher degree."""
    if order + 1 == len(a):
        return a
    out = np.empty(order + 1)
    _elevate(out, a)
    return out


@kernel
def rows_elevated(a: Array, order: int) -> Array:
    """Return polynomials (rows, degree + 1) in a higher degree."""
    out = np.empty((len(a), order + 1))
    for i in range(len(a)):
        _elevate(out[i], a[i])
    return out


@kernel
def fill_basis(out: Array, x: float) -> None:
    """Fill in the Bernstein polynomials of a degree at x."""
    order, rising, falling = len(out) - 1, 1.0, 1.0
    for k in range(order + 1):
        out[k] = BINOMIALS[order, k] * rising
        rising *= x
    for k in range(order, -1, -1):
        out[k] *= falling
        falling *= 1.0 - x


@kernel
def value_at(a: Array, x: float) -> float:
    """Return a polynomial's value."""
    n, y, power = len(a) - 1, 1.0 - x, 1.0
    if n == 0:
        return float(a[0])
    out = a[0] * y
    for k in range(1, n):
        power *= x
        out = (out + BINOMIALS[n, k] * power * a[k]) * y
    return float(out + power * x * a[n])


@kernel
def middle_of(a: Array) -> float:
    """Return a polynomial's value in the middle."""
    n, out = len(a) - 1, 0.0
    for k in range(n + 1):
        out += BINOMIALS[n, k] * a[k]
    return out * 0.5**n


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
    for k in range(rows.shape[1]):
        for i in range(len(rows)):
            out[k] += rows[i, k] * rows[i, k]
        out[k] = np.sqrt(out[k])
    return out


@kernel
def largest_column(rows: Array) -> tuple[float, float]:
    """Return the largest norm of the columns of an array, and its place from 0 to 1."""
    found, place = 0.0, 0
    for k in range(rows.shape[1]):
        square = 0.0
        for i in range(len(rows)):
            square += rows[i, k] * rows[i, k]
        if not (square <= found or np.isnan(found)):
            found, place = square, k
    return float(np.sqrt(found)), place / max(1, rows.shape[1] - 1)


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
