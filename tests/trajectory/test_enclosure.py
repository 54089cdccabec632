"""Enclosures of norms and directions hold everywhere, and are narrow where that is possible."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.trajectory import bernstein, enclosure

X = np.linspace(0.0, 1.0, 301)


def vectors(seed: int, order: int, spread: float, scale: float) -> np.ndarray:
    """(5, 3, order + 1): about one direction, with coefficients that vary by ``spread``."""
    rng = np.random.default_rng(seed)
    mean = rng.normal(size=(5, 3, 1))
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    return scale * (mean + spread * rng.normal(size=(5, 3, order + 1)))


def values(c: np.ndarray) -> np.ndarray:
    """(len(X), …) from (…, degree + 1)."""
    return np.stack([bernstein.evaluate(c, float(x)) for x in X])


cases = given(
    seed=st.integers(0, 10_000),
    order=st.integers(0, 8),
    spread=st.sampled_from([0.0, 0.02, 0.2, 2.0]),
    scale=st.sampled_from([1e-6, 0.3, 1.0, 1e5]),
)
few = settings(max_examples=40)


@few
@cases
def test_directions_are_enclosed(seed: int, order: int, spread: float, scale: float) -> None:
    y = vectors(seed, order, spread, scale)
    found = enclosure.direction(y)
    at = values(y)
    unit = at / np.linalg.norm(at, axis=-1)[..., None]
    error = np.linalg.norm(values(found.coefficients) - unit, axis=-1)
    assert np.all(np.max(error, axis=0) <= found.radius * (1.0 + 1e-12))
    assert np.all(found.radius <= 1.0)


@few
@cases
def test_norms_are_enclosed(seed: int, order: int, spread: float, scale: float) -> None:
    y = vectors(seed, order, spread, scale)
    found = enclosure.norm(y)
    error = np.abs(values(found.coefficients) - np.linalg.norm(values(y), axis=-1))
    assert np.all(np.max(error, axis=0) <= found.radius)


def test_noise_of_the_vectors_is_covered() -> None:
    y, noise = vectors(1, 5, 0.1, 0.4), 1e-5
    found = enclosure.direction(y, noise)
    rng = np.random.default_rng(2)
    off = rng.normal(size=(len(X), 5, 3))
    off *= noise / np.linalg.norm(off, axis=-1)[..., None]
    at = values(y) + off
    unit = at / np.linalg.norm(at, axis=-1)[..., None]
    error = np.linalg.norm(values(found.coefficients) - unit, axis=-1)
    assert np.all(np.max(error, axis=0) <= found.radius)
    without = enclosure.direction(y).radius
    assert np.all(found.radius > without + 0.5 * noise / 0.4)
    assert np.all(found.radius < without + 10.0 * noise / 0.4)


def test_halving_narrows_by_far_more_than_two() -> None:
    y = vectors(4, 6, 0.1, 1.0)
    radii: dict[str, list[float]] = {"direction": [], "norm": []}
    for _ in range(6):
        radii["direction"].append(float(np.max(enclosure.direction(y).radius)))
        radii["norm"].append(float(np.max(enclosure.norm(y).radius)))
        y = np.concatenate(bernstein.halve(y))
    for name, found in radii.items():
        assert np.all(np.diff(found) < 0.0), name
        assert found[-1] < found[-3] / 100.0, name  # of five halvings: the order of w and v


def test_a_constant_vector_is_known_to_rounding() -> None:
    y = np.array([[3.0], [-4.0], [12.0]])
    assert enclosure.norm(y).radius < 1e-12
    np.testing.assert_allclose(enclosure.norm(y).coefficients, 13.0, rtol=1e-12)
    found = enclosure.direction(y)
    assert found.radius < 1e-12
    np.testing.assert_allclose(found.coefficients, y / 13.0 * np.ones(5), rtol=1e-12)


def test_a_zero_vector_may_point_anywhere() -> None:
    zero = np.zeros((3, 4))
    found = enclosure.direction(zero)
    assert found.radius == 1.0
    assert np.all(found.coefficients == 0.0)
    assert enclosure.norm(zero).radius == 0.0


def test_a_vector_through_zero_has_every_direction_and_a_bounded_norm() -> None:
    y = np.array([[-1.0, 1.0], [0.0, 0.0], [0.0, 0.0]])
    assert enclosure.direction(y).radius == 1.0
    found = enclosure.norm(y)
    error = np.abs(bernstein.evaluate(found.coefficients, X) - np.abs(2.0 * X - 1.0))
    assert np.max(error) <= found.radius <= 1.0


def test_scale_does_not_matter() -> None:
    y = vectors(7, 5, 0.1, 1.0)
    small = enclosure.direction(1e-9 * y)
    np.testing.assert_allclose(small.coefficients, enclosure.direction(y).coefficients, rtol=1e-9)
    assert math.isclose(
        float(np.max(enclosure.norm(1e-9 * y).radius)),
        1e-9 * float(np.max(enclosure.norm(y).radius)),
        rel_tol=1e-3,
    )
