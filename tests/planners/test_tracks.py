"""Tracks through timed points: met exactly, and eased where drones would exceed their limits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.planners.morph.tracks import eased, vertex_track
from hitchopt.planners.path import LegLaw
from hitchopt.trajectory import PiecewisePolynomial

WILD = Path(__file__).parent / "wild"

TEAM = ho.Team(4, 2.1)
START = ho.Hitch.balanced(TEAM, ho.regular_polygon(4, 1.1), 1.3)
K = 2
HERE = START.polygon.vertices[K]


TIGHT = np.linspace(0.05, 0.65, 13)


def jagged(times: Any, seed: int, size: float) -> Any:
    """Return points at times that are off a smooth arc by up to a size [m], from the vertex."""
    rng = np.random.default_rng(seed)
    share = np.asarray(times) / times[-1]
    progress = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    arc = HERE + 0.25 * progress[:, None] * [0.6, 0.8]
    arc[1:-1] += rng.uniform(-size, size, (len(times) - 2, 2))
    return arc


def path_of(times: Any, points: Any) -> ho.Path:
    """Return the path of a hitch whose vertex K is on the track of least jerk, over s."""
    track = vertex_track(np.asarray(times), points)
    breaks = track.breaks / times[-1]
    vertices = np.repeat(START.vertices[None, ..., None], track.pieces, axis=0)
    coefficients = np.repeat(vertices, 6, axis=-1)
    coefficients[:, K, :2] = track.coefficients
    halves = PiecewisePolynomial.constant([0.0, 1.0], np.full(4, 0.5))
    law = LegLaw.of_fractions(halves)
    return ho.Path(TEAM, PiecewisePolynomial(breaks, coefficients), law, duration=times[-1])


def largest_jerk(path: ho.Path) -> float:
    """Return the largest jerk of a drone at samples [m/s³]."""
    t = np.linspace(0.0, path.duration or 0.0, 2001)
    return float(np.max(np.linalg.norm(ho.time(path).drones.at(t, 3), axis=-1)))


@pytest.mark.parametrize("seed", range(3))
def test_eased_tracks_meet_the_same_points_with_less_jerk(seed: int) -> None:
    times = np.linspace(0.0, 2.6, 14)
    points = jagged(times, seed, 2e-3)
    path = path_of(times, points)
    gentle = eased(path, ho.Limits(jerk=6.0), 2.6)
    assert largest_jerk(gentle) < 0.9 * largest_jerk(path)
    np.testing.assert_allclose(gentle.vertices.at(times / 2.6)[:, K, :2], points, atol=1e-12)
    others = np.delete(gentle.vertices.at(np.linspace(0.0, 1.0, 101)), K, axis=1)
    np.testing.assert_allclose(others, np.broadcast_to(others[0], others.shape), atol=0.0)
    for order in (1, 2):
        np.testing.assert_allclose(gentle.vertices.at([0.0, 1.0], order), 0.0, atol=1e-9)


def test_points_are_met_at_their_times_within_the_limits_of_drones() -> None:
    """The track of least jerk of the vertex exceeds the drones' jerk, here by 30 %."""
    problem = ho.load_problem(WILD / "writes_at_times.yaml")
    step = problem.mission[0]
    plan = ho.solve(problem)
    times, places = step.path[:, 0], step.path[:, 1:]
    assert plan.duration == times[-1]
    np.testing.assert_allclose(
        plan.motion.vertices.at(times)[:, step.vertex, :2], places, atol=1e-9
    )


def test_a_vertex_rests_between_equal_points_of_an_eased_track() -> None:
    times = np.array([0.0, 0.3, 0.6, 0.9, 1.2, 2.2, 2.5, 2.8, 3.1, 3.4])
    points = jagged(times, 5, 2e-3)
    points[5] = points[4]
    gentle = eased(path_of(times, points), ho.Limits(jerk=6.0), 3.4)
    t = np.linspace(1.2, 2.2, 51)
    rest = gentle.vertices.at(t / 3.4)[:, K, :2]
    np.testing.assert_allclose(rest, np.broadcast_to(points[4], rest.shape), atol=1e-12)
    np.testing.assert_allclose(gentle.vertices.at(times / 3.4)[:, K, :2], points, atol=1e-12)


def test_times_that_drones_cannot_meet_are_refused() -> None:
    step = [[t, *point] for t, point in zip(TIGHT, jagged(TIGHT, 1, 2e-3), strict=True)]
    with pytest.raises(ho.InfeasibleError, match=r"allow more time for the points"):
        ho.solve(START, ho.FollowVertex(K, step))


@pytest.mark.slow
def test_refusals_name_the_smallest_time_that_drones_need() -> None:
    problem = ho.load_problem(WILD / "writes_at_times.yaml")
    step = problem.mission[0]

    def stretched(factor: float) -> ho.Problem:
        path = np.column_stack([factor * step.path[:, 0], step.path[:, 1:]])
        return replace(problem, mission=(replace(step, path=path),))

    with pytest.raises(ho.InfeasibleError) as caught:
        ho.solve(stretched(0.8))
    (late,) = caught.value.violations
    assert late.constraint == "duration"
    assert late.value == pytest.approx(0.8 * step.path[-1, 0])
    plan = ho.solve(stretched(0.8 * 1.002 * late.limit / late.value))
    assert plan.duration == pytest.approx(1.002 * late.limit)
