"""A vertex that follows timed points: met at their times, smoothly, from rest to rest."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hitchopt as ho
from hitchopt.planners.morph.actions import vertex_track

START = ho.Hitch(
    ho.Team(5, [2.0, 2.05, 2.1, 2.0, 2.02]),
    ho.regular_polygon(5, 1.3, angle=1.2).translated([-2.0, 0.7]),
    1.4,
    [0.33, 0.36, 0.37, 0.34, 0.35],
)
K = 3
HERE = START.vertices[K, :2]
OFFSETS = [
    (2.0, 0.08, 0.05),
    (3.5, 0.15, -0.02),
    (5.0, 0.15, -0.02),
    (6.25, 0.05, -0.04),
    (9.0, 0.0, 0.03),
]
POINTS = [[t, *(HERE + [dx, dy])] for t, dx, dy in OFFSETS]


def test_points_are_met_at_their_times_and_standing_stands() -> None:
    plan = ho.follow_vertex(START, K, POINTS)
    assert plan.duration == 9.0
    for t, x, y in POINTS:
        np.testing.assert_allclose(plan.at(t).vertices[K], [x, y, 1.4], atol=1e-9)
    for t in (3.5, 4.2, 5.0):
        np.testing.assert_allclose(plan.at(t).velocities, 0.0, atol=1e-9)
    for t in (0.0, 3.5, 5.0, 9.0):
        np.testing.assert_allclose(plan.at(t).accelerations, 0.0, atol=1e-8)
    assert np.max(np.abs(plan.at(2.0).velocities)) > 0.01  # passed, not stopped at
    others = np.delete(plan.at(np.linspace(0.0, 9.0, 200)).vertices, K, axis=1)
    np.testing.assert_allclose(others, np.broadcast_to(others[0], others.shape), atol=1e-12)


def test_two_points_are_the_minimum_jerk_polynomial() -> None:
    plan = ho.follow_vertex(START, K, [[4.0, *(HERE + [0.1, -0.05])]])
    x = np.linspace(0.0, 1.0, 101)
    progress = 10.0 * x**3 - 15.0 * x**4 + 6.0 * x**5
    expected = HERE + progress[:, None] * [0.1, -0.05]
    np.testing.assert_allclose(plan.at(4.0 * x).vertices[:, K, :2], expected, atol=1e-9)


@given(st.integers(0, 2**32 - 1), st.integers(2, 8))
@settings(max_examples=30)
def test_between_rests_no_wiggle_of_the_track_has_less_jerk(seed: int, count: int) -> None:
    """Adding what vanishes at the points, and with two derivatives at the ends, only adds jerk."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.5, 1.5, count))
    places = rng.normal(size=(count, 2))
    track = vertex_track(times, places)
    np.testing.assert_allclose(track.at(times), places, atol=1e-9)
    t = np.linspace(times[0], times[-1], 4001)
    x = (t - times[0]) / (times[-1] - times[0])
    rest = np.poly1d([1.0, -1.0, 0.0]) ** 3  # x³(x-1)³
    inner = np.poly1d((times[1:-1] - times[0]) / (times[-1] - times[0]), r=True)
    wiggle = rest * inner
    scale = np.max(np.abs(wiggle(x)))
    jerk = track.at(t, 3)
    bump = wiggle.deriv(3)(x) / (scale * (times[-1] - times[0]) ** 3)
    least = np.trapezoid(np.sum(jerk**2, axis=1), t)
    for size in (-0.1, 0.01, 0.1):
        wiggled = np.trapezoid((jerk[:, 0] + size * bump) ** 2 + jerk[:, 1] ** 2, t)
        assert wiggled > least


def test_a_point_at_no_time_has_to_be_where_the_vertex_is() -> None:
    plan = ho.follow_vertex(START, K, [[0.0, *HERE], [3.0, *(HERE + [0.1, 0.0])]])
    assert plan.duration == 3.0
    with pytest.raises(ho.InfeasibleError, match=r"p3 at t = 0.*begin there, or later"):
        ho.follow_vertex(START, K, [[0.0, *(HERE + [0.01, 0.0])], [3.0, *HERE]])


def test_too_fast_points_name_the_check_and_the_time() -> None:
    with pytest.raises(ho.InfeasibleError) as caught:
        ho.follow_vertex(START, K, [[0.4, *(HERE + [0.2, 0.0])]])
    fast = next(v for v in caught.value.violations if v.constraint == "vertex_speed")
    assert fast.value == pytest.approx(15.0 / 8.0 * 0.2 / 0.4, rel=1e-3)
    found = re.fullmatch(r"at t = (\S+) s, in step 0 \(follow_vertex\)", fast.when)
    assert found is not None
    assert float(found[1]) == pytest.approx(0.2, abs=0.002)  # a flat maximum
    assert fast.remedy.endswith("or give the points more time")
