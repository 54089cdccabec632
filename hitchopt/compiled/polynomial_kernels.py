"""Compiled products, values and enclosures of single polynomials in Bernstein form."""

from __future__ import annotations

from math import comb

import numpy as np

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.values import Array, Indices

ENCLOSED = 2.0**-46
"""Rounding in an enclosure's residual: ``ROUNDING`` of ``hitchopt.trajectory.enclosure``."""

Blocks = tuple[Array, Array, Array, Array]
"""Blocks of one cell, (rows, degree + 1), or of all."""

Found = tuple[float, float, float]
"""Bound, value and place of a cell."""

Known = tuple[Array, Array, Indices]
"""Directions (m, 3, degree + 1), their errors (m,), and the places (cells, k) of each cell's."""

_BINOMIALS = np.array([[comb(n, k) for k in range(65)] for n in range(65)], dtype=np.float64)

_INVERSES = 1.0 / np.maximum(_BINOMIALS, 1.0)


@kernel
def _convolve(out: Array, a: Array, b: Array) -> None:
    """Add the products of coefficients times their binomials."""
    for i in range(len(a)):
        c, onward = a[i], out[i : i + len(b)]
        for j in range(len(b)):
            onward[j] += c * b[j]


@kernel
def product(a: Array, b: Array) -> Array:
    """Return the product of two polynomials."""
    m, n = len(a) - 1, len(b) - 1
    if n == 0:
        constant: Array = a * b[0]
        return constant
    out = np.zeros(m + n + 1)
    for i in range(m + 1):
        c, onward = a[i] * _BINOMIALS[m, i], out[i : i + n + 1]
        for j in range(n + 1):
            onward[j] += c * (b[j] * _BINOMIALS[n, j])
    for k in range(m + n + 1):
        out[k] *= _INVERSES[m + n, k]
    return out


@kernel
def add_product(out: Array, factor: float, a: Array, b: Array) -> None:
    """Add a product of two polynomials, times a factor, to one of its degree."""
    if len(b) == 1:
        for k in range(len(out)):
            out[k] += factor * (a[k] * b[0])
        return
    found = product(a, b)
    for k in range(len(out)):
        out[k] += factor * found[k]


@kernel
def _elevate(out: Array, a: Array) -> None:
    """Fill in a polynomial written in the degree of the other array."""
    m, order = len(a) - 1, len(out) - 1
    if order == m:
        out[:] = a
        return
    out[:] = 0.0
    for i in range(m + 1):
        c = a[i] * _BINOMIALS[m, i]
        for j in range(order - m + 1):
            out[i + j] += c * _BINOMIALS[order - m, j]
    for k in range(order + 1):
        out[k] *= _INVERSES[order, k]


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
def basis_at(order: int, x: float) -> Array:
    """Return the Bernstein polynomials of a degree at x."""
    out = np.zeros(order + 1)
    out[0] = 1.0
    for r in range(1, order + 1):
        for k in range(r, 0, -1):
            out[k] = out[k] * (1.0 - x) + out[k - 1] * x
        out[0] *= 1.0 - x
    return out


@kernel
def value_at(a: Array, x: float) -> float:
    """Return a polynomial's value."""
    weights, out = basis_at(len(a) - 1, x), 0.0
    for k in range(len(a)):
        out += weights[k] * a[k]
    return out


@kernel
def values_at(rows: Array, x: float) -> Array:
    """Return the values (rows,) of polynomials."""
    weights, out = basis_at(rows.shape[1] - 1, x), np.zeros(len(rows))
    for i in range(len(rows)):
        for k in range(rows.shape[1]):
            out[i] += weights[k] * rows[i, k]
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
def _scaled(y: Array) -> tuple[Array, float]:
    """Return a vector whose largest coefficient is one, and by what it was divided."""
    scale, out = 0.0, y.copy()
    for i in range(len(y)):
        for k in range(y.shape[1]):
            scale = max(scale, abs(y[i, k]))
    if scale > 0.0:
        for i in range(len(y)):
            for k in range(y.shape[1]):
                out[i, k] /= scale
    return out, scale


@kernel
def _inverse(y: Array, weights: Array) -> Array:
    """Return the inverse length of a vector as a polynomial; zero where that is not known.

    Its coefficients times their binomials, as those of the vector are.
    """
    count, nodes = y.shape[1], weights.shape[1]
    lengths, w = np.zeros(nodes), np.zeros(nodes)
    for i in range(3):
        for node in range(nodes):
            value = 0.0
            for k in range(count):
                value += y[i, k] * _INVERSES[count - 1, k] * weights[k, node]
            lengths[node] += value * value
    if not np.min(lengths) > 0.0:
        return w
    for k in range(nodes):
        for node in range(nodes):
            w[k] += weights[count + node, k] / np.sqrt(lengths[node])
        w[k] *= _BINOMIALS[nodes - 1, k]
    return w


@kernel
def _residual(y: Array, w: Array) -> float:
    """Return a bound of ``|y|² w² - 1`` for coefficients times their binomials."""
    m, n = y.shape[1] - 1, len(w) - 1
    squared, inverse = np.zeros(2 * m + 1), np.zeros(2 * n + 1)
    whole, found = np.zeros(2 * (m + n) + 1), 0.0
    for i in range(3):
        _convolve(squared, y[i], y[i])
    _convolve(inverse, w, w)
    _convolve(whole, squared, inverse)
    for k in range(len(whole)):
        found = max(found, abs(whole[k] * _INVERSES[len(whole) - 1, k] - 1.0))
    return found


@kernel
def direction(y: Array, weights: Array, noise: float) -> tuple[Array, float]:
    """Return the direction of a vector and its error, as ``enclosure.direction``."""
    y, scale = _scaled(y)
    m, n, size = y.shape[1] - 1, weights.shape[1] - 1, 0.0
    unit = np.zeros((3, m + n + 1))
    for i in range(3):
        for k in range(m + 1):
            y[i, k] *= _BINOMIALS[m, k]
    w = _inverse(y, weights)
    for k in range(n + 1):
        size = max(size, abs(w[k] * _INVERSES[n, k]))
    residual = _residual(y, w) + ENCLOSED * (1.0 + size * size)
    if not (size > 0.0 and residual < 1.0):
        return unit, 1.0
    least = np.sqrt(1.0 - residual)
    error = residual / (1.0 + least) + 2.0 * noise / scale * size / least
    if not error < 1.0:
        return unit, 1.0
    for i in range(3):
        _convolve(unit[i], y[i], w)
        for k in range(m + n + 1):
            unit[i, k] *= _INVERSES[m + n, k]
    return unit, error


@kernel
def directions(vectors: Array, weights: Array, noise: float) -> tuple[Array, Array]:
    """Return the directions (m, 3, ·) and errors (m,) of vectors (m, 3, ·)."""
    count = len(vectors)
    out, errors = np.empty((count, 3, vectors.shape[2] + weights.shape[1] - 1)), np.empty(count)
    for i in range(count):
        out[i], errors[i] = direction(vectors[i], weights, noise)
    return out, errors


@kernel
def _lost(y: Array, v: Array) -> float:
    """Return a bound of ``|y|² - v²`` for a vector and a polynomial."""
    m, n = y.shape[1] - 1, len(v) - 1
    order = 2 * max(m, n)
    left, squared, own = np.zeros(order + 1), np.zeros(2 * n + 1), np.empty(max(m, n) + 1)
    both, found = np.zeros(2 * m + 1), 0.0
    for i in range(3):
        for k in range(m + 1):
            own[k] = y[i, k] * _BINOMIALS[m, k]
        _convolve(both, own[: m + 1], own[: m + 1])
    for k in range(n + 1):
        own[k] = v[k] * _BINOMIALS[n, k]
    _convolve(squared, own[: n + 1], own[: n + 1])
    _convolve(left, both, _BINOMIALS[order - 2 * m, : order - 2 * m + 1])
    for k in range(2 * n + 1):
        squared[k] = -squared[k]
    _convolve(left, squared, _BINOMIALS[order - 2 * n, : order - 2 * n + 1])
    for k in range(order + 1):
        found = max(found, abs(left[k] * _INVERSES[order, k]))
    return found


@kernel
def length(y: Array, weights: Array) -> tuple[Array, float]:
    """Return the length of a vector and its error, as ``enclosure.norm``."""
    y, scale = _scaled(y)
    count, nodes = y.shape[1], weights.shape[1]
    lengths, v, least = np.zeros(nodes), np.zeros(nodes), np.inf
    for i in range(3):
        for node in range(nodes):
            value = 0.0
            for k in range(count):
                value += y[i, k] * weights[k, node]
            lengths[node] += value * value
    for node in range(nodes):
        value = np.sqrt(lengths[node])
        for k in range(nodes):
            v[k] += value * weights[count + node, k]
    for k in range(nodes):
        least = min(least, v[k])
    if least > 0.0:
        return v * scale, (_lost(y, v) + ENCLOSED) / least * scale
    largest = 0.5 * np.max(column_norms(y)) * (1.0 + ENCLOSED)
    return np.full(len(v), largest * scale), largest * scale
