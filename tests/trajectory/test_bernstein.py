"""Bernstein polynomials against numpy's polynomials in powers."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from hitchopt.trajectory import bernstein

X = np.linspace(0.0, 1.0, 41)


def in_powers(coefficients: np.ndarray) -> Polynomial:
    """The same polynomial from the definition, sum of c_i C(m, i) x^i (1 - x)^(m - i)."""
    m = len(coefficients) - 1
    total = Polynomial([0.0])
    for i, c in enumerate(coefficients):
        total = total + c * math.comb(m, i) * Polynomial([0.0, 1.0]) ** i * Polynomial(
            [1.0, -1.0]
        ) ** (m - i)
    return total


def some(order: int, seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.3, 1.0, (*shape, order + 1))


orders = st.integers(0, 9)
seeds = st.integers(0, 10_000)
few = settings(max_examples=25)


@few
@given(orders, seeds)
def test_evaluate_is_the_definition(order: int, seed: int) -> None:
    c = some(order, seed)
    np.testing.assert_allclose(bernstein.evaluate(c, X), in_powers(c)(X), atol=1e-11)


@few
@given(orders, seeds)
def test_differentiate(order: int, seed: int) -> None:
    c = some(order, seed)
    derivative = bernstein.evaluate(bernstein.differentiate(c), X)
    np.testing.assert_allclose(derivative, in_powers(c).deriv()(X), atol=1e-10)


@few
@given(orders, st.integers(0, 5), seeds)
def test_elevation_changes_the_form_only(order: int, more: int, seed: int) -> None:
    c = some(order, seed, 2)
    higher = bernstein.elevate(c, order + more)
    assert higher.shape == (2, order + more + 1)
    np.testing.assert_allclose(
        bernstein.evaluate(higher, X[:, None]), bernstein.evaluate(c, X[:, None]), atol=1e-12
    )


def test_no_polynomial_is_written_in_a_lower_degree() -> None:
    with pytest.raises(ValueError, match="cannot write degree 3 in the lower degree 2"):
        bernstein.elevate(some(3, 0), 2)


@few
@given(orders, orders, seeds)
def test_products(first: int, second: int, seed: int) -> None:
    a, b = some(first, seed), some(second, seed + 1)
    product = bernstein.multiply(a, b)
    assert bernstein.degree(product) == first + second
    np.testing.assert_allclose(
        bernstein.evaluate(product, X),
        bernstein.evaluate(a, X) * bernstein.evaluate(b, X),
        atol=1e-11,
    )
    np.testing.assert_allclose(product, bernstein.multiply(b, a), atol=1e-13)


def test_scalar_products_of_vectors_broadcast() -> None:
    a, b = some(3, 1, 5, 1, 3), some(4, 2, 6, 3)
    product = bernstein.dot(a, b)
    assert product.shape == (5, 6, 8)
    x = 0.37
    values = np.sum(bernstein.evaluate(a, x) * bernstein.evaluate(b, x), axis=-1)
    np.testing.assert_allclose(bernstein.evaluate(product, x), values, atol=1e-12)


@few
@given(orders, seeds)
def test_halves_are_the_same_curve(order: int, seed: int) -> None:
    c = some(order, seed)
    left, right = bernstein.halve(c)
    np.testing.assert_allclose(
        bernstein.evaluate(left, X), bernstein.evaluate(c, 0.5 * X), atol=1e-12
    )
    np.testing.assert_allclose(
        bernstein.evaluate(right, X), bernstein.evaluate(c, 0.5 + 0.5 * X), atol=1e-12
    )
    assert left[-1] == pytest.approx(right[0], abs=1e-15)


@few
@given(orders, seeds, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_restriction(order: int, seed: int, one: float, other: float) -> None:
    lower, upper = min(one, other), max(one, other)
    c = some(order, seed)
    part = bernstein.restrict(c, lower, upper)
    np.testing.assert_allclose(
        bernstein.evaluate(part, X),
        bernstein.evaluate(c, lower + (upper - lower) * X),
        atol=1e-10,
    )


@pytest.mark.parametrize("share", [0.0, 1e-3, 0.4, 1.0])
@pytest.mark.parametrize("order", [0, 1, 4, 7])
def test_the_beginning_is_a_restriction(order: int, share: float) -> None:
    c = np.random.default_rng(order).normal(size=(3, order + 1))
    expected = bernstein.restrict(c, 0.0, share)
    np.testing.assert_allclose(c @ bernstein.beginning(order, share), expected, atol=1e-14)


def test_restriction_takes_its_own_span_for_each() -> None:
    c = some(4, 3, 2, 3)
    lower, upper = np.array([[0.1], [0.5]]), np.array([[0.4], [1.0]])
    part = bernstein.restrict(c, lower, upper)
    for i in range(2):
        one = bernstein.restrict(c[i], float(lower[i, 0]), float(upper[i, 0]))
        np.testing.assert_allclose(part[i], one, atol=1e-14)


@few
@given(orders, seeds)
def test_interpolation_gives_back_what_was_sampled(order: int, seed: int) -> None:
    c = some(order, seed)
    again = bernstein.interpolate(bernstein.evaluate(c, bernstein.nodes(order)))
    np.testing.assert_allclose(again, c, atol=1e-9)


@few
@given(orders, seeds)
def test_a_curve_stays_within_its_coefficients(order: int, seed: int) -> None:
    c = some(order, seed)
    values = bernstein.evaluate(c, X)
    assert np.min(c) - 1e-12 <= np.min(values)
    assert np.max(values) <= np.max(c) + 1e-12


def test_halving_brings_the_hull_closer_by_four() -> None:
    c = some(6, 4)
    dense = np.linspace(0.0, 1.0, 20_001)
    top = float(np.max(bernstein.evaluate(c, dense)))
    gaps = []
    cells = c[None]
    for _ in range(7):
        gaps.append(float(np.max(cells)) - top)
        cells = np.concatenate(bernstein.halve(cells))
    order = math.log2(gaps[3] / gaps[6]) / 3.0
    assert order > 1.6


def test_shared_tables_cannot_be_spoilt() -> None:
    for table in (bernstein.nodes(3), bernstein.binomials(3), bernstein.elevation(2, 4)):
        with pytest.raises(ValueError, match="read-only"):
            table[..., 0] = 7.0


def test_products_made_in_batches_are_those_of_single_polynomials(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(7, 5, 3, 6)), rng.normal(size=(5, 1, 4))
    vectors = rng.normal(size=(1, 5, 3, 4))
    product, inner = bernstein.multiply(a, b), bernstein.dot(a, vectors)
    x = rng.uniform(size=(7, 5))
    for found, there in (
        (product, bernstein.evaluate(a, x[..., None]) * bernstein.evaluate(b, x[..., None])),
        (
            inner,
            np.sum(
                bernstein.evaluate(a, x[..., None]) * bernstein.evaluate(vectors, x[..., None]),
                axis=-1,
            ),
        ),
    ):
        at = x[..., None] if found.ndim == 4 else x
        np.testing.assert_allclose(bernstein.evaluate(found, at), there, atol=1e-12)
    for most, alone in ((1, 2**18), (600, 2**18), (2**18, 0), (600, 0)):
        monkeypatch.setattr(bernstein, "MOST_PAIRS", most)
        monkeypatch.setattr(bernstein, "MOST_ALONE", alone)
        np.testing.assert_allclose(bernstein.multiply(a, b), product, atol=1e-14)
        np.testing.assert_allclose(bernstein.dot(a, vectors), inner, atol=1e-14)
