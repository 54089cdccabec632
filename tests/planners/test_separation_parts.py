"""The separation planner's parts, each against another route to compute the same."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from ruckig import InputParameter, Result, Ruckig, Trajectory

from hitchopt.errors import InfeasibleError
from hitchopt.hitch.leg_program import QuadraticProgram
from hitchopt.hitch.requirements import Arena, Limits, Prism, Requirements, Separation
from hitchopt.planners.separation import SeparationTask
from hitchopt.planners.separation.planes import hull_points
from hitchopt.planners.separation.routes import routes_around
from hitchopt.planners.timing.ramps import fastest_ramps

PILLAR = Prism([[-0.3, -0.4], [-0.3, 0.4], [0.5, 0.4], [0.5, -0.4]], 0.0, 9.0)


@given(st.floats(1e-3, 50.0), st.floats(0.1, 5.0), st.floats(0.2, 9.0), st.floats(0.5, 90.0))
@settings(max_examples=60)
def test_fastest_ramps_are_those_of_another_library(d: float, v: float, a: float, j: float) -> None:
    asked = InputParameter(1)
    asked.target_position = [d]
    asked.max_velocity, asked.max_acceleration, asked.max_jerk = [v], [a], [j]
    found = Trajectory(1)
    assert Ruckig(1).calculate(asked, found) == Result.Working
    ramps = fastest_ramps(np.array([d]), v, a, j)
    assert ramps.duration[0] == pytest.approx(found.duration, rel=1e-6)
    assert ramps.peak[0] <= v
    assert 2.0 * ramps.rise[0] <= ramps.duration[0] * (1.0 + 1e-12)


def test_mistakes_that_osqp_keeps_silent_about_are_refused() -> None:
    P, A = sp.csc_array(np.eye(2)), sp.csc_array(np.ones((1, 2)))
    one, two = np.ones(1), np.ones(2)
    for arguments, words in (
        ((P, np.ones(3), A, -one, one), "objective"),
        ((P, two, A, -two, one), "bounds"),
        ((P, two, A, one, -one), "crossed"),
        ((P, two * np.nan, A, -one, one), "nan"),
    ):
        with pytest.raises(ValueError, match=words):
            QuadraticProgram(*arguments)


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 3.0))
@settings(max_examples=40)
def test_no_point_of_a_hull_is_nearer_than_the_one_that_is_found(seed: int, away: float) -> None:
    points = np.random.default_rng(seed).normal(size=(1, 3, 6)) + away * np.ones((3, 1))
    (nearest,) = hull_points(points)
    if np.any(nearest):  # a plane through it has all of the hull on its far side
        assert np.min(nearest @ points[0]) == pytest.approx(nearest @ nearest, rel=1e-3)
    else:  # the origin is a mean of the points, which no plane cuts off
        normals = np.random.default_rng(1).normal(size=(4000, 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        assert np.max(np.min(normals @ points[0], axis=1)) < 0.05


def test_the_way_around_a_pillar_is_the_shortest_and_stays_out() -> None:
    start, goal = np.array([[-2.0, 0.1, 1.0]]), np.array([[2.0, 0.0, 1.0]])
    task = SeparationTask(start, goal, Requirements(Limits(), Separation(), keep_out=(PILLAR,)))
    routes = routes_around(task)
    off = 1.25 * task.requirements.separation.radius
    corners = [[-0.3 - off, 0.4 + off], [0.5 + off, 0.4 + off]]
    by_hand = np.vstack([start[0, :2], corners, goal[0, :2]])
    length = float(np.sum(np.linalg.norm(np.diff(by_hand, axis=0), axis=1)))
    assert routes.lengths[0] == pytest.approx(length, rel=1e-6)
    points = routes.points(np.linspace(0.0, 1.0, 500)[None])[0]
    assert np.min(PILLAR.clearance(points).distance) > task.requirements.separation.radius
    np.testing.assert_allclose(points[[0, -1]], [start[0], goal[0]], atol=1e-12)


def test_a_low_prism_is_flown_over_where_that_is_shorter() -> None:
    low = Prism(PILLAR.polygon, 0.0, 0.9)
    start, goal = np.array([[-2.0, 0.1, 0.8]]), np.array([[2.0, 0.0, 0.8]])
    routes = routes_around(
        SeparationTask(start, goal, Requirements(Limits(), Separation(), keep_out=(low,)))
    )
    assert np.max(routes.points(np.linspace(0.0, 1.0, 99)[None])[..., 2]) > 1.0
    assert routes.lengths[0] < 4.2


def test_a_slit_is_told_with_the_drone() -> None:
    walls = tuple(
        Prism([[-0.1, low], [-0.1, high], [0.1, high], [0.1, low]], 0.0, 3.0)
        for low, high in ((0.08, 5.0), (-5.0, -0.08))
    )
    start, goal = np.array([[-1.0, 0.3, 1.0]]), np.array([[1.0, 0.2, 1.0]])
    room = Arena([-2, -4, 0], [2, 4, 3])
    task = SeparationTask(
        start, goal, Requirements(Limits(), Separation(), arena=room, keep_out=walls)
    )
    with pytest.raises(InfeasibleError, match="keep_out") as caught:
        routes_around(task)
    assert caught.value.violations[0].where == ("d0",)
