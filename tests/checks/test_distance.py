"""Bounds of distances between moving points and segments."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.checks.distances import Moving, distance, smallest
from hitchopt.geometry import shortest_offset
from hitchopt.trajectory import bernstein


def bodies(seed: int, ends: tuple[int, int], kind: str) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    a = rng.uniform(-1.0, 1.0, (ends[0], 3))
    b = rng.uniform(-1.0, 1.0, (ends[1], 3)) + np.array([2.0, 1.0, 0.0])
    if kind == "level":
        a[:, 2] = b[:, 2] = 1.0
    if kind == "parallel" and ends == (2, 2):
        b[1] = b[0] + 0.7 * (a[1] - a[0])
    if kind == "point":
        b[-1] = b[0]
    return a, b


@pytest.mark.slow
@settings(max_examples=30)
@given(
    seed=st.integers(0, 10_000),
    ends=st.sampled_from([(1, 1), (1, 2), (2, 2)]),
    wide=st.sampled_from([0.05, 0.5, 2.0]),
)
def test_moving_bodies_against_samples(seed: int, ends: tuple[int, int], wide: float) -> None:
    rng = np.random.default_rng(seed)
    base_a, base_b = bodies(seed, ends, "any")
    a = base_a[..., None] + wide * rng.normal(size=(*base_a.shape, 6))
    b = base_b[..., None] + wide * rng.normal(size=(*base_b.shape, 6))
    rows = (a[:, None] - b[None]).reshape(1, 1, -1, 6)
    estimate = distance(a[None], b[None])
    x = np.linspace(0.0, 1.0, 2001)
    at = np.stack([bernstein.evaluate(rows[0, 0], float(value)) for value in x])
    lengths = np.linalg.norm(shortest_offset(at.reshape(len(x), -1, 3)), axis=-1)
    assert estimate.value[0] <= np.min(lengths) + 1e-12
    one, other = ((c @ bernstein.basis(estimate.x[0], 5))[None, ..., None] for c in (a, b))
    assert distance(one, other).value[0] >= np.min(lengths) - 1e-12
    found = smallest(Moving(np.array([0.0, 1.0]), a[None, None], b[None, None]))
    assert found.worst <= np.min(lengths) + 1e-12
    assert found.worst >= np.min(lengths) * (1.0 - 1e-2) - 2e-2 * wide  # of sampling


@pytest.mark.parametrize("power", [1, 2, 3])
def test_the_bound_closes_with_the_third_power_of_the_span(power: int) -> None:
    """Point and segment turn together, so that the distance stays: a direction has to turn too."""
    t = 1.2 * bernstein.nodes(15) ** power
    c, s, zero = np.cos(t), np.sin(t), 0.0 * t
    turn = np.array([[c, -s, zero], [s, c, zero], [zero, zero, zero + 1.0]])
    point, end = np.array([0.2, 0.7, 0.4]), np.array([1.0, 0.0, 0.0])
    ends = [np.einsum("ijt,j->it", turn, point + sign * end) for sign in (-1.0, 1.0)]
    segment = np.stack([bernstein.interpolate(offset) for offset in ends])[None]
    apart = float(np.hypot(0.7, 0.4))
    gaps = []
    for _ in range(6):
        gaps.append(apart - float(np.min(distance(segment, np.zeros((1, 1, 3, 1))).value)))
        segment = np.concatenate(bernstein.halve(segment))
    assert gaps[-1] > 1e-7
    assert gaps[-1] < gaps[-4] / 250.0  # three halvings: a factor of 512 in the end


def test_of_bodies_at_rest_the_first_place_is_told() -> None:
    """A rest may follow the motion that led to it."""
    segments = np.random.default_rng(4).uniform(-1.0, 1.0, (500, 2, 3, 1)).repeat(6, axis=-1)
    np.testing.assert_array_equal(distance(segments[:, :1], segments[:, 1:]).x, 0.0)
