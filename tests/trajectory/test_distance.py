"""Bounds of distances between moving points and segments."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.geometry import differences, shortest_offset
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.distance import distance_bound
from hitchopt.trajectory.extremum import Cells, smallest

GRID = np.linspace(0.0, 1.0, 201)


def on_a_grid(a: np.ndarray, b: np.ndarray) -> float:
    """Smallest distance between 201 points of each body."""
    s = GRID[:, None]
    first = a[0] + s * (a[-1] - a[0])
    second = b[0] + s * (b[-1] - b[0])
    return float(np.min(np.linalg.norm(first[:, None] - second[None], axis=-1)))


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


@settings(max_examples=60)
@given(
    seed=st.integers(0, 10_000),
    ends=st.sampled_from([(1, 1), (1, 2), (2, 2)]),
    kind=st.sampled_from(["any", "level", "parallel", "point"]),
)
def test_the_shortest_offset_against_a_grid(seed: int, ends: tuple[int, int], kind: str) -> None:
    a, b = bodies(seed, ends, kind)
    length = float(np.linalg.norm(shortest_offset(differences(a, b))))
    grid = on_a_grid(a, b)
    assert length <= grid + 1e-12
    assert length >= grid - 1e-2 * math.sqrt(3.0)


def test_segments_that_cross_touch() -> None:
    a = np.array([[5.0, 1.0, 2.0], [7.0, 3.0, 2.0]])
    b = np.array([[5.0, 3.0, 2.0], [6.5, 1.5, 2.0]])
    assert np.linalg.norm(shortest_offset(differences(a, b))) == pytest.approx(0.0, abs=1e-12)


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
    estimate = distance_bound((rows[0],))
    x = np.linspace(0.0, 1.0, 2001)
    at = np.stack([bernstein.evaluate(rows[0, 0], float(value)) for value in x])
    lengths = np.linalg.norm(shortest_offset(at.reshape(len(x), -1, 3)), axis=-1)
    assert estimate.bound[0] <= np.min(lengths) + 1e-12
    assert estimate.value[0] >= np.min(lengths) - 1e-12
    found = smallest(Cells.over(np.array([0.0, 1.0]), [rows]), distance_bound)
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
    rows = np.concatenate([bernstein.interpolate(offset) for offset in ends])[None]
    distance = float(np.hypot(0.7, 0.4))
    gaps = []
    for _ in range(6):
        gaps.append(distance - float(np.min(distance_bound((rows,)).bound)))
        rows = np.concatenate(bernstein.halve(rows.reshape(-1, 16))).reshape(-1, 6, 16)
    assert gaps[-1] > 1e-7
    assert gaps[-1] < gaps[-4] / 250.0  # three halvings: a factor of 512 in the end


def test_of_bodies_at_rest_the_first_place_is_told() -> None:
    """Rounding differs from place to place; a rest may follow the motion that led to it."""
    rng = np.random.default_rng(4)
    rows = rng.uniform(-1.0, 1.0, (500, 6, 1)).repeat(6, axis=-1)
    found = distance_bound((rows,))
    np.testing.assert_array_equal(found.x, 0.0)
    rows[:, :, [2, 3]] = 0.5 * rows[:, :, [2, 3]]
    np.testing.assert_array_equal(distance_bound((rows,)).x, 0.5)


def test_one_body_seen_from_both_sides() -> None:
    a, b = bodies(3, (2, 2), "any")
    forth = shortest_offset(differences(a, b))
    back = shortest_offset(differences(b, a))
    np.testing.assert_allclose(forth, -back, atol=1e-12)
