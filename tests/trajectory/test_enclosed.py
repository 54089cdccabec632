"""The arithmetic of enclosed values: enclosures hold everywhere, and are tight."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.trajectory import bernstein
from hitchopt.trajectory.enclosed import Enclosed, Interval, largest_of, vector

Array = np.ndarray
Formula = Callable[[Enclosed, Enclosed], Enclosed]

X = np.linspace(0.0, 1.0, 61)


def _norm(v: Array) -> Array:
    sizes: Array = np.linalg.norm(v, axis=-1, keepdims=True)
    return sizes


OPERATIONS: dict[str, tuple[Formula, Callable[[Array, Array], Array]]] = {
    "sum": (lambda a, b: a + b, lambda a, b: a + b),
    "difference": (lambda a, b: a - b, lambda a, b: a - b),
    "constant": (
        lambda a, _: 2.0 - a * 3.0 + [1.0, 2.0, 3.0],
        lambda a, _: np.array([3.0, 4.0, 5.0]) - 3.0 * a,
    ),
    "product": (lambda a, b: a * b, lambda a, b: a * b),
    "scalar": (lambda a, b: a * b[2], lambda a, b: a * b[..., 2:]),
    "dot": (lambda a, b: a.dot(b), lambda a, b: np.sum(a * b, axis=-1, keepdims=True)),
    "along": (
        lambda a, _: a.dot([0.6, 0.0, 0.8]),
        lambda a, _: a[..., :1] * 0.6 + a[..., 2:] * 0.8,
    ),
    "cross": (lambda a, b: a.cross(b), np.cross),
    "level cross": (
        lambda a, b: a.xy.cross(b.xy),
        lambda a, b: a[..., :1] * b[..., 1:2] - a[..., 1:2] * b[..., :1],
    ),
    "norm": (lambda a, _: a.norm, lambda a, _: _norm(a)),
    "direction": (lambda a, _: a.direction, lambda a, _: a / _norm(a)),
    "inverse norm": (lambda a, _: a.norm.inverse, lambda a, _: 1.0 / _norm(a)),
    "reduced": (lambda a, b: a.cross(b).reduced(4), np.cross),
    "vector": (
        lambda a, b: vector(a[2], b.xy),
        lambda a, b: np.concatenate([a[..., 2:], b[..., :2]], -1),
    ),
    "upward": (
        lambda a, b: a.dot(b).along_z(),
        lambda a, b: np.sum(a * b, -1, keepdims=True) * [0, 0, 1],
    ),
    "formula": (
        lambda a, b: (a * b[0] - b.direction * 0.5).cross(b) * a.norm.inverse,
        lambda a, b: np.cross(a * b[..., :1] - 0.5 * b / _norm(b), b) / _norm(a),
    ),
}


def values(c: Array) -> Array:
    """Return values (len(X), spans, components) of coefficients (spans, components, degree + 1)."""
    return np.stack([bernstein.evaluate(c, float(x)) for x in X])


def balls(
    seed: int, order: int, spread: float, scale: float, noise: float
) -> tuple[Enclosed, Array]:
    """Return five vectors about some direction, their balls, and values inside these."""
    rng = np.random.default_rng(seed)
    mean = rng.normal(size=(5, 3, 1))
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    c = scale * (mean + spread * rng.normal(size=(5, 3, order + 1)))
    off = rng.normal(size=(len(X), 5, 3))
    off *= noise * scale / np.linalg.norm(off, axis=-1, keepdims=True)
    return Enclosed(c, np.full(5, noise * scale)), values(c) + off


drawn = given(
    seed=st.integers(0, 10_000),
    order=st.integers(0, 8),
    spread=st.sampled_from([0.0, 0.02, 0.2, 2.0]),
    scale=st.sampled_from([1e-6, 0.3, 1.0, 1e5]),
    noise=st.sampled_from([0.0, 1e-9, 1e-3, 1e9]),
)


@pytest.mark.parametrize("name", OPERATIONS)
@settings(max_examples=25)
@drawn
def test_values_lie_in_their_enclosures(
    name: str, seed: int, order: int, spread: float, scale: float, noise: float
) -> None:
    """Also for values at the surface of their balls."""
    formula, exact = OPERATIONS[name]
    (a, u), (b, v) = (balls(seed + i, order, spread, scale, noise) for i in range(2))
    result = formula(a, b)
    with np.errstate(all="ignore"):
        expected = exact(u, v)
    off = np.linalg.norm(values(result.c) - expected, axis=-1)
    rounding = 1e-13 * np.max(np.linalg.norm(expected, axis=-1), axis=0)
    assert np.all((np.max(off, axis=0) <= result.r + rounding) | ~np.isfinite(result.r))
    for bound, sign in ((result.norm_upper, 1.0), (result.norm_lower, -1.0)):
        sizes = np.max(sign * np.linalg.norm(expected, axis=-1), axis=0)
        assert np.all((sizes <= sign * bound.value + rounding) | ~np.isfinite(result.r))
    if expected.shape[-1] == 1:
        assert np.all((expected[..., 0] <= result.upper.value + rounding) | ~np.isfinite(result.r))
        assert np.all((expected[..., 0] >= result.lower.value - rounding) | ~np.isfinite(result.r))


@pytest.mark.parametrize("name", OPERATIONS)
def test_a_point_is_its_value_and_halving_narrows(name: str) -> None:
    formula, exact = OPERATIONS[name]
    (a, u), (b, v) = (balls(seed, 6, 0.05, 1.0, 0.0) for seed in (3, 4))
    point = formula(Enclosed(a.c[..., :1]), Enclosed(b.c[..., :1]))
    assert point.degree == 0
    np.testing.assert_allclose(point.c[..., 0], exact(u[0], v[0]), atol=1e-13)
    assert np.all(point.r < 1e-11)
    radii = [np.max(formula(a, b).r)]
    parts = [(a.c, b.c)]
    for _ in range(2):
        parts = [
            half
            for x, y in parts
            for half in zip(bernstein.halve(x), bernstein.halve(y), strict=True)
        ]
        radii.append(max(np.max(formula(Enclosed(x), Enclosed(y)).r) for x, y in parts))
    assert radii[0] < 0.1
    assert radii[2] < 0.1 * radii[0] or radii[0] < 1e-11


@pytest.mark.parametrize("order", [0, 3, 8])
@pytest.mark.parametrize("size", [0.0, 3e-21, 3e-16, 1e-12, 1e-9])
def test_the_error_of_a_norm_is_at_most_the_length_of_its_vectors(order: int, size: float) -> None:
    """Vectors may be far smaller than their rounding, as legs of a drone at its vertex."""
    y, _ = balls(5, order, 0.3, size, 0.0)
    result = y.widened(1e-12).norm
    assert np.all(result.r <= 0.51 * (y.size + 1e-12))
    assert np.all(result.upper.value <= 2.0 * (y.size + 1e-12))


def test_vectors_that_may_vanish_have_any_direction_and_a_bounded_norm() -> None:
    y = Enclosed(np.array([[[-1.0, 1.0], [0.0, 0.0], [0.0, 0.0]], [[0.0, 0.0]] * 3]))
    assert np.all(y.direction.r == 1.0)
    assert np.all(y.direction.c == 0.0)
    assert np.all(np.isinf(y.norm.inverse.r))
    off = np.abs(bernstein.evaluate(y.norm.c[0, 0], X) - np.abs(2.0 * X - 1.0))
    assert np.max(off) <= np.asarray(y.norm.r)[0] <= 1.0
    assert np.all((y * 0.0 * y.norm.inverse).r == 0.0)


@settings(max_examples=50)
@given(st.lists(st.floats(-3.0, 3.0), min_size=4, max_size=4), st.floats(0, 1), st.floats(0, 1))
def test_intervals_hold_products_sums_and_inverses(ends: list[float], x: float, y: float) -> None:
    a = Interval(*(np.array([each]) for each in sorted(ends[:2])))
    b = Interval(*(np.array([each]) for each in sorted(ends[2:])))
    u, v = a.low + x * (a.high - a.low), b.low + y * (b.high - b.low)
    for result, value in ((a * b, u * v), (a + b, u + v)):
        assert result.low - 1e-12 <= value <= result.high + 1e-12
    assert np.abs(a.enclosed.c[..., 0] - u) <= a.enclosed.r + 1e-12
    positive = Interval(a.low + 4.0, a.high + 4.0)
    assert positive.inverse.low - 1e-12 <= 1.0 / (u + 4.0) <= positive.inverse.high + 1e-12


def test_the_largest_of_bounds_has_its_own_location() -> None:
    a = Enclosed(np.array([[[0.0, 1.0, 0.0]], [[0.0, 0.0, 9.0]]])).upper
    b = Enclosed(np.array([[[4.0, 0.0]], [[5.0, 0.0]]])).upper
    result = largest_of([a, b], 4.5)
    assert result.value.tolist() == [4.5, 9.0]
    assert result.x.tolist() == [0.0, 1.0]


def test_a_product_of_errors_is_enclosed() -> None:
    """A value enclosed by a ball about zero may be as large as the ball's radius."""
    ball = Enclosed(np.zeros((1, 3, 2)), np.array([0.5]))
    for result in (ball.dot(ball), ball * ball[0], ball[0] * ball[0]):
        assert np.all(result.r >= 0.25)
