"""Compiled enclosures and derivatives say what those in numpy say, and hold at samples."""

from __future__ import annotations

import numpy as np
import pytest

from hitchopt.checks.cable_length import _bound
from hitchopt.compiled.kernel_switch import kernels
from hitchopt.trajectory import PiecewisePolynomial, bernstein, enclosure
from hitchopt.trajectory.compiled_search import interpolation_weights
from hitchopt.trajectory.enclosure import DIRECTION_ORDER, NORM_ORDER
from hitchopt.values import Array

X = np.linspace(0.0, 1.0, 301)


@pytest.fixture(autouse=True)
def _needs_numba() -> None:
    pytest.importorskip("numba")


def vectors(degree: int) -> Array:
    """Return random ones (60, 3, degree + 1): steady, turning, and one that is zero somewhere."""
    rng = np.random.default_rng(degree)
    steady = rng.normal(size=(60, 3, 1)) + 0.3 * rng.normal(size=(60, 3, degree + 1))
    steady[30:] *= 10.0 ** rng.uniform(-3.0, 3.0, (30, 1, 1))
    steady[40:50] = rng.normal(size=(10, 3, degree + 1))
    steady[-1] = np.linspace(-1.0, 1.0, degree + 1)
    return steady


def values(coefficients: Array) -> Array:
    """Return the values (…, samples)."""
    return bernstein.evaluate(coefficients[..., None, :], X)


@pytest.mark.parametrize("degree", [1, 2, 5, 7, 11])
def test_directions(degree: int) -> None:
    from hitchopt.compiled.enclosure_kernels import directions

    y = vectors(degree)
    found, radius = directions(y, interpolation_weights(degree, DIRECTION_ORDER), 1e-9)
    plain = enclosure.direction(y, 1e-9)
    np.testing.assert_allclose(found, plain.coefficients, atol=1e-11)
    np.testing.assert_allclose(radius, plain.radius, rtol=1e-6, atol=1e-12)
    there = values(y[:-1])
    off = np.linalg.norm(
        values(found[:-1]) - there / np.linalg.norm(there, axis=1, keepdims=True), axis=1
    )
    assert np.all(off <= radius[:-1, None] + 1e-13)
    assert radius[-1] == 1.0


@pytest.mark.parametrize("degree", [1, 2, 5, 7, 11])
def test_lengths(degree: int) -> None:
    from hitchopt.compiled.enclosure_kernels import length, work_space

    y = vectors(degree)
    plain = enclosure.norm(y)
    for i, each in enumerate(y):
        found = np.empty(NORM_ORDER + 1)
        radius = length(found, each, interpolation_weights(degree, NORM_ORDER), work_space())
        scale = float(np.max(np.abs(each)))
        np.testing.assert_allclose(found, plain.coefficients[i], atol=1e-11 * scale)
        np.testing.assert_allclose(radius, plain.radius[i], rtol=1e-6, atol=1e-12 * scale)
        off = np.abs(values(found) - np.linalg.norm(values(each), axis=0))
        assert np.all(off <= radius + 1e-13 * scale)


@pytest.mark.parametrize("degree", [1, 2, 5, 7])
@pytest.mark.parametrize("off", [0.0, 0.03])
def test_bounds_of_cables(degree: int, off: float) -> None:
    """Cell by cell, the errors of all enclosures among them."""
    from hitchopt.compiled.cable_kernels import lengths
    from hitchopt.compiled.enclosure_kernels import work_space

    turning = vectors(degree)[:30]  # errors of enclosures are about as large as what they enclose
    rows = 0.3 * turning.reshape(10, 9, degree + 1)
    stored = enclosure.norm(rows.reshape(10, 3, 3, -1)).coefficients[:, :2]
    stored = stored + off * np.linspace(-1.0, 1.0, stored.shape[-1])
    plain = _bound((rows, stored))
    weights = interpolation_weights(degree, NORM_ORDER)
    found = [lengths(*each, weights, work_space(), -1.0) for each in zip(rows, stored, strict=True)]
    bounds, sums, _ = np.transpose(found)
    np.testing.assert_allclose(bounds, plain.bound, rtol=1e-9)
    assert np.all(sums <= bounds)


@pytest.mark.parametrize("degree", [0, 1, 3, 7])
def test_derivatives(degree: int) -> None:
    rng = np.random.default_rng(degree)
    breaks, c = np.array([0.0, 0.3, 1.1]), rng.normal(size=(2, 4, 3, degree + 1))
    plain, compiled = (PiecewisePolynomial(breaks, c) for _ in range(2))
    for order in range(1, 7):
        expected = plain.differentiated(order)
        with kernels():
            found = compiled.differentiated(order)
        np.testing.assert_array_equal(found.coefficients, expected.coefficients)
        assert found.breaks is compiled.breaks
