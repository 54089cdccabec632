"""Polynomials in Bernstein form on [0, 1], coefficients along the last axis.

A polynomial lies in the convex hull of its Bernstein coefficients, and halving the interval brings
the hull closer by a factor of four. Reference: R. T. Farouki, "The Bernstein polynomial basis: a
centennial retrospective", CAGD 29 (2012).
"""

from __future__ import annotations

from functools import lru_cache
from math import comb
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hitchopt.values import Array, Indices

Number = TypeVar("Number", np.float64, np.intp)

MAX_PAIRS = 2**18  # Maximum pairs of coefficients multiplied at a time: they fit into the caches

MAX_PRODUCT = 2**18
"""Maximum multiplications in one matrix product: OpenBLAS splits larger ones between threads, which
takes tens of times as long on a busy machine."""


def degree(coefficients: Array) -> int:
    """Return the degree of polynomials with (…, degree + 1) ``coefficients``."""
    return int(coefficients.shape[-1]) - 1


def basis(x: Array, order: int) -> Array:
    """Return the Bernstein polynomials of degree ``order`` at x (…), as (…, order + 1)."""
    of_x, of_rest = _powers(np.asarray(x, dtype=np.float64), order)
    values: Array = of_x * of_rest[..., ::-1]
    values *= binomials(order)
    return values


def _powers(x: Array, order: int) -> Array:
    """Return the powers 0 … order of x (…) and of 1 - x, as (2, …, order + 1)."""
    powers = np.empty((2, *x.shape, order + 1))
    powers[..., 0] = 1.0
    powers[0, ..., 1:] = x[..., None]
    powers[1, ..., 1:] = 1.0 - x[..., None]
    np.multiply.accumulate(powers, axis=-1, out=powers)  # x**i is ten times as slow
    return powers


def derivative_basis(x: Array, order: int, derivative: int) -> Array:
    """Return a derivative of the basis with respect to x at x (…), as (…, order + 1)."""
    rows = _derivative(order, derivative)
    values: Array = basis(x, degree(rows)) @ rows.T
    return values


def jet_basis(x: Array, order: int, count: int) -> Array:
    """Return the basis and its derivatives of orders 0 … count - 1 at x, (…, order + 1, count)."""
    values: Array = basis(x, order) @ _jets(order, count)
    return values.reshape(*values.shape[:-1], order + 1, count)


def evaluate(coefficients: Array, x: Array | float) -> Array:
    """Return the values at x, which broadcasts against the coefficients' leading axes."""
    weights = basis(np.asarray(x, dtype=np.float64), degree(coefficients))
    values: Array = np.einsum("...i,...i->...", coefficients, weights)
    return values


def differentiate(coefficients: Array) -> Array:
    """Return the derivative with respect to x; that of a constant is a constant zero."""
    order = coefficients.shape[-1] - 1
    if order == 0:
        return np.zeros_like(coefficients)
    slope: Array = coefficients[..., 1:] - coefficients[..., :-1]
    slope *= order
    return slope


def elevate(coefficients: Array, order: int) -> Array:
    """Return the polynomials in degree ``order``, which is at least their own."""
    own = coefficients.shape[-1] - 1
    return coefficients if order == own else transform(coefficients, elevation(own, order))


def same_degree(*parts: Array) -> list[Array]:
    """Return polynomials (…, degree + 1) in the largest of their degrees."""
    order = max([part.shape[-1] for part in parts]) - 1
    return [elevate(part, order) for part in parts]


def transform(coefficients: Array, matrix: Array) -> Array:
    """Return the products (…, k) of a matrix (k, m) and vectors (…, m), MAX_PRODUCT at a time."""
    flat, k = coefficients.reshape(-1, coefficients.shape[-1]), matrix.shape[0]
    if flat.size * k <= MAX_PRODUCT:
        products: Array = flat @ matrix.T
    else:
        products, count = np.empty((len(flat), k)), max(1, MAX_PRODUCT // matrix.size)
        for first in range(0, len(flat), count):
            part = slice(first, first + count)
            np.matmul(flat[part], matrix.T, out=products[part])
    return products.reshape(*coefficients.shape[:-1], k)


def multiply(a: Array, b: Array) -> Array:
    """Return the product, of degree deg a + deg b; leading axes broadcast."""
    return a * b if a.shape[-1] == 1 or b.shape[-1] == 1 else _multiply(a, b, 1)


def dot(a: Array, b: Array) -> Array:
    """Return the scalar product of vector polynomials (…, d, degree + 1)."""
    return _multiply(a, b, 2)


def _multiply(a: Array, b: Array, axes: int) -> Array:
    """Return the product, or for two ``axes`` the scalar product, in batches of MAX_PAIRS pairs.

    The last ``axes`` axes of both arrays do not broadcast; the last one holds the coefficients.
    """
    m, n = a.shape[-1], b.shape[-1]
    pairs = max(a.size * n, b.size * m)
    if pairs <= MAX_PAIRS:
        return _product(a, b, axes)
    shape = np.broadcast_shapes(a.shape[:-axes], b.shape[:-axes])
    a, b = (np.broadcast_to(each, (*shape, *each.shape[-axes:])) for each in (a, b))
    step = max(1, (shape or (1,))[0] * MAX_PAIRS // pairs)
    if not shape or step >= shape[0]:
        return _product(a, b, axes)
    parts = [slice(first, first + step) for first in range(0, shape[0], step)]
    return np.concatenate([_product(a[part], b[part], axes) for part in parts])


def _product(a: Array, b: Array, axes: int) -> Array:
    """Return the product as ``_multiply``; small ones are matrix products."""
    m, n = a.shape[-1], b.shape[-1]
    pairs = max(a.size * n, b.size * m) // (1 if axes == 1 else a.shape[-2])
    if pairs * (m + n - 1) > MAX_PRODUCT:
        return _convolved(a, b, axes)
    each = a[..., None] @ b[..., None, :] if axes == 1 else a.mT @ b
    product = each.reshape(-1, m * n) @ _product_matrix(m - 1, n - 1)
    return product.reshape(*each.shape[:-2], m + n - 1)


def _convolved(a: Array, b: Array, axes: int) -> Array:
    """Return the product as ``_multiply``, convolved with the axes of the polynomials last."""
    dims = max(a.ndim, b.ndim)
    x, y = (
        np.multiply(c[(None,) * (dims - c.ndim)].T, _binomial_column(degree(c), dims), order="C")
        for c in (a, b)
    )
    if len(x) < len(y):
        x, y = y, x
    m, n = len(x), len(y)
    product = np.zeros((m + n - 1, *np.broadcast_shapes(x.shape[axes:], y.shape[axes:])))
    for j in range(n):
        product[j : j + m] += x * y[j] if axes == 1 else np.einsum("id...,d...->i...", x, y[j])
    product /= _binomial_column(m + n - 2, dims - axes + 1)
    return np.ascontiguousarray(product.T)


def _binomial_column(order: int, dims: int) -> Array:
    """Return row ``order`` of Pascal's triangle along the first of ``dims`` axes."""
    return binomials(order).reshape(-1, *(1,) * (dims - 1))


def halve(coefficients: Array) -> tuple[Array, Array]:
    """Return the coefficients on [0, ½] and on [½, 1]."""
    left, right = _halving(degree(coefficients))
    return transform(coefficients, left), transform(coefficients, right)


def restrict(coefficients: Array, lower: Array | float, upper: Array | float) -> Array:
    """Return the coefficients on [lower, upper] ⊂ [0, 1].

    Ends broadcast against the coefficients' leading axes, and have no more of them.
    """
    lower, upper = (np.array(end, ndmin=coefficients.ndim - 1).T for end in (lower, upper))
    shape = 0.0 * (lower + upper)
    c = np.add(coefficients.T, shape, order="C")  # long rows take a third of the time
    order, rest = c.shape[0] - 1, 1.0 - upper
    for r in range(1, order + 1):  # de Casteljau: restrict to [0, upper]
        c[r:] = rest * c[r - 1 : -1] + upper * c[r:]
    start = lower / np.where(upper > 0.0, upper, 1.0)
    rest = 1.0 - start
    if np.logical_or.reduce(start, axis=None):  # then [lower / upper, 1] of that
        for r in range(1, order + 1):
            c[: order + 1 - r] = rest * c[: order + 1 - r] + start * c[1 : order + 2 - r]
    return np.ascontiguousarray(c.T)


def restrictions(lower: Array, upper: Array, order: int) -> Array:
    """Return the matrices (spans, order + 1, order + 1) of ``restrict`` to [lower, upper] (spans,).

    A row of coefficients times a matrix is the row of coefficients on its span.
    """
    start = lower / np.where(upper > 0.0, upper, 1.0)
    to_upper, backward = _leading_parts(np.array([upper, 1.0 - start]), order)
    from_start = np.ascontiguousarray(backward[:, ::-1, ::-1])
    matrices: Array = to_upper @ from_start
    return matrices


def _leading_parts(x: Array, order: int) -> Array:
    """Return the matrices (…, order + 1, order + 1) that restrict to [0, x] for x (…)."""
    exponents, weights = _leading_weights(order)
    of_x, of_rest = _powers(x, order)
    matrices: Array = of_x[..., None] * of_rest[..., exponents]
    matrices *= weights
    return matrices


def interpolate(values: Array) -> Array:
    """Return the coefficients of the polynomials through (…, m + 1) ``values`` at ``nodes(m)``."""
    return transform(values, _interpolation(int(values.shape[-1]) - 1))


@lru_cache
def nodes(order: int) -> Array:
    """Return Chebyshev points of the second kind (order + 1,) on [0, 1], ends included."""
    if order == 0:
        return _frozen(np.array([0.5]))
    return _frozen(0.5 - 0.5 * np.cos(np.pi * np.arange(order + 1) / order))


@lru_cache
def at_nodes(order: int, degree: int) -> Array:
    """Return the basis (order + 1, degree + 1) at ``nodes(order)``, the middle for order 0."""
    return _frozen(basis(nodes(order), degree))


@lru_cache
def lowering(degree: int, order: int) -> Array:
    """Return the matrix (order + 1, degree + 1) that interpolates at ``nodes(order)``."""
    return _frozen(_interpolation(order) @ at_nodes(order, degree))


@lru_cache
def binomials(order: int) -> Array:
    """Return row ``order`` of Pascal's triangle (order + 1,)."""
    return _frozen(np.array([comb(order, i) for i in range(order + 1)], dtype=np.float64))


@lru_cache
def _leading_weights(order: int) -> tuple[Indices, Array]:
    """Return exponents of 1 - x, and factors, of ``_leading_parts`` (order + 1, order + 1)."""
    index = np.arange(order + 1)
    exponents = np.maximum(index - index[:, None], 0)
    columns = [np.pad(binomials(i), (0, order - i)) for i in range(order + 1)]
    return _frozen(exponents), _frozen(np.stack(columns, axis=-1))


@lru_cache
def elevation(order: int, target: int) -> Array:
    """Return the matrix (target + 1, order + 1) that raises degree ``order`` to ``target``."""
    if target < order:
        raise ValueError(f"cannot elevate degree {order} to the lower degree {target}")
    matrix = np.zeros((target + 1, order + 1))
    for j in range(target + 1):
        for i in range(max(0, j - target + order), min(order, j) + 1):
            matrix[j, i] = comb(order, i) * comb(target - order, j - i) / comb(target, j)
    return _frozen(matrix)


@lru_cache
def _derivative(order: int, derivative: int) -> Array:
    """(order + 1, order - derivative + 1): coefficients of the derivatives of the basis."""
    rows = np.eye(order + 1)
    for _ in range(derivative):
        rows = differentiate(rows)
    return _frozen(rows)


@lru_cache
def _jets(order: int, count: int) -> Array:
    """(order + 1, (order + 1) count): coefficients of ``jet_basis``, all in degree ``order``."""
    derivatives = [elevate(_derivative(order, k), order) for k in range(count)]
    return _frozen(np.stack(derivatives, axis=-1).swapaxes(0, 1).reshape(order + 1, -1))


@lru_cache
def _product_matrix(m: int, n: int) -> Array:
    """((m + 1)(n + 1), m + n + 1): weights of pairs of coefficients in their product."""
    weights = np.zeros((m + 1, n + 1, m + n + 1))
    for i in range(m + 1):
        for j in range(n + 1):
            weights[i, j, i + j] = comb(m, i) * comb(n, j) / comb(m + n, i + j)
    return _frozen(weights.reshape(-1, m + n + 1))


@lru_cache
def _halving(order: int) -> tuple[Array, Array]:
    left = np.zeros((order + 1, order + 1))
    for j in range(order + 1):
        left[j, : j + 1] = binomials(j) / 2.0**j
    return _frozen(left), _frozen(left[::-1, ::-1].copy())


@lru_cache
def _interpolation(order: int) -> Array:
    inverse = np.linalg.inv(at_nodes(order, order))
    return _frozen(inverse.astype(np.float64))


def _frozen(array: NDArray[Number]) -> NDArray[Number]:
    array.setflags(write=False)
    return array
