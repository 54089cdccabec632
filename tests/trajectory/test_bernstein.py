"""Bernstein polynomials against numpy's polynomials in powers: one table of operations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.trajectory import bernstein
from tests.helpers.powers import in_powers

Array = np.ndarray

X = np.linspace(0.0, 1.0, 41)


def some(order: int, seed: int, *shape: int) -> Array:
    return np.random.default_rng(seed).normal(0.3, 1.0, (*shape, order + 1))


Pair = tuple[Array, Array, float, float]
"""Coefficients of two polynomials, and two numbers on [0, 1], the first one smaller."""

OPERATIONS: dict[str, tuple[Callable[[Pair], Array], Callable[[Pair], Array]]] = {
    "evaluate": (lambda p: p[0], lambda p: in_powers(p[0])(X)),
    "differentiate": (
        lambda p: bernstein.differentiate(p[0]),
        lambda p: in_powers(p[0]).deriv()(X),
    ),
    "elevate": (lambda p: bernstein.elevate(p[0], len(p[0]) + 2), lambda p: in_powers(p[0])(X)),
    "multiply": (
        lambda p: bernstein.multiply(p[0], p[1]),
        lambda p: in_powers(p[0])(X) * in_powers(p[1])(X),
    ),
    "dot": (
        lambda p: bernstein.dot(np.stack([p[0], 2.0 * p[0]]), np.stack([p[1], p[1]])),
        lambda p: 3.0 * in_powers(p[0])(X) * in_powers(p[1])(X),
    ),
    "first half": (lambda p: bernstein.halve(p[0])[0], lambda p: in_powers(p[0])(0.5 * X)),
    "second half": (lambda p: bernstein.halve(p[0])[1], lambda p: in_powers(p[0])(0.5 + 0.5 * X)),
    "restrict": (
        lambda p: bernstein.restrict(p[0], p[2], p[3]),
        lambda p: in_powers(p[0])(p[2] + (p[3] - p[2]) * X),
    ),
    "interpolate": (
        lambda p: bernstein.interpolate(in_powers(p[0])(bernstein.nodes(len(p[0]) - 1))),
        lambda p: in_powers(p[0])(X),
    ),
}


@pytest.mark.parametrize("name", OPERATIONS)
@settings(max_examples=20)
@given(
    orders=st.tuples(st.integers(0, 9), st.integers(0, 9)),
    seed=st.integers(0, 10_000),
    ends=st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)),
)
def test_operations_match_the_power_basis(
    name: str, orders: tuple[int, int], seed: int, ends: tuple[float, float]
) -> None:
    operation, exact = OPERATIONS[name]
    pair = some(orders[0], seed), some(orders[1], seed + 1), min(ends), max(ends)
    result = operation(pair)
    np.testing.assert_allclose(bernstein.evaluate(result, X), exact(pair), atol=1e-9)
    values = bernstein.evaluate(result, X)  # a curve stays within its coefficients
    assert np.min(result) - 1e-12 <= np.min(values)
    assert np.max(values) <= np.max(result) + 1e-12


def test_elevation_to_a_lower_degree_is_refused() -> None:
    with pytest.raises(ValueError, match="cannot elevate degree 3 to the lower degree 2"):
        bernstein.elevate(some(3, 0), 2)


def test_restriction_broadcasts_over_spans() -> None:
    c = some(4, 3, 2, 3)
    lower, upper = np.array([[0.1], [0.5]]), np.array([[0.4], [1.0]])
    part = bernstein.restrict(c, lower, upper)
    for i in range(2):
        one = bernstein.restrict(c[i], float(lower[i, 0]), float(upper[i, 0]))
        np.testing.assert_allclose(part[i], one, atol=1e-14)
    every = bernstein.restrict(c[:, :1], lower[:, 0], upper[:, 0])  # on all spans
    for i in range(2):
        np.testing.assert_allclose(
            every[:, i], bernstein.restrict(c[:, 0], 0.1 + 0.4 * i, upper[i, 0])
        )


def test_shared_tables_are_read_only() -> None:
    for table in (bernstein.nodes(3), bernstein.binomials(3), bernstein.elevation(2, 4)):
        with pytest.raises(ValueError, match="read-only"):
            table[..., 0] = 7.0


@pytest.mark.parametrize("rows", [7, 500, 4000])
def test_products_broadcast_in_one_matrix_product_convolved_or_in_batches(rows: int) -> None:
    """Of arrays of up to 1.4 million pairs of coefficients."""
    rng = np.random.default_rng(2)
    a, b, v = (rng.normal(size=size) for size in ((rows, 5, 3, 6), (5, 1, 4), (1, 5, 3, 4)))
    x = rng.uniform(size=(rows, 5))
    values = bernstein.evaluate(a, x[..., None])
    product, inner = bernstein.multiply(a, b), bernstein.dot(a, v)
    expected = values * bernstein.evaluate(b, x[..., None])
    np.testing.assert_allclose(bernstein.evaluate(product, x[..., None]), expected, atol=1e-12)
    expected = np.sum(values * bernstein.evaluate(v, x[..., None]), axis=-1)
    np.testing.assert_allclose(bernstein.evaluate(inner, x), expected, atol=1e-12)
