"""Morphs on the routes of earlier plans, moved to other ends."""

from __future__ import annotations

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.planners.morph.retargeting import EarlierRoute

TEAM = ho.Team(robots=4, cable_length=2.4)
SQUARE = ho.regular_polygon(4, 0.9)
START = ho.Hitch.spread(TEAM, SQUARE.translated([0.4, -0.2]))
GOAL = SQUARE.rotated(1.5).translated([0.5, 0.1])


@pytest.fixture(scope="module")
def turned() -> ho.Plan:
    """A quarter turn, whose straight path is blocked."""
    plan = ho.morph(START, GOAL)
    assert "optimised route" in plan.phases[0].remark
    return plan


def test_a_nearby_goal_is_reached_on_the_route_of_an_earlier_plan(turned: ho.Plan) -> None:
    other = GOAL.translated([0.03, -0.02])
    plan = ho.morph(START, other, like=turned)
    assert plan.certificate.certified
    assert plan.phases[0].remark == "on the route of an earlier plan"
    np.testing.assert_allclose(plan.end.polygon.vertices, other.vertices, atol=1e-9)
    start = ho.Hitch.spread(TEAM, SQUARE.translated([0.37, -0.21]))
    moved = ho.morph(start, other, like=turned)
    assert moved.phases[0].remark == plan.phases[0].remark
    np.testing.assert_allclose(moved.at(0.0).positions, start.drones, atol=1e-9)
    assert plan.duration == pytest.approx(turned.duration, rel=0.05)


def test_between_its_own_ends_the_route_is_the_earlier_one(turned: ho.Plan) -> None:
    motion = turned.motion
    path = EarlierRoute.of(motion).path(START, turned.end)
    along = path.vertices.at(np.linspace(0.0, 1.0, 200))
    flown = motion.vertices.at(np.linspace(motion.drones.breaks[0], motion.drones.breaks[-1], 2000))
    apart = np.linalg.norm(along[:, None] - flown[None], axis=-1)  # (200, 2000, points)
    assert np.max(np.min(np.max(apart, axis=-1), axis=1)) < 3e-3


def test_other_routes_follow_if_the_earlier_one_is_refused(turned: ho.Plan) -> None:
    shrunk = ho.regular_polygon(4, 0.7).translated([-0.6, 0.3])
    plan = ho.morph(START, shrunk, like=turned)
    assert plan.certificate.certified
    assert plan.duration <= ho.morph(START, shrunk).duration * 3.0


@pytest.mark.parametrize(("robots", "size"), [(3, 0.8), (5, 1.1)])
def test_straight_morphs_take_over_the_clock(robots: int, size: float) -> None:
    start = ho.Hitch.spread(ho.Team(robots, 2.4), ho.regular_polygon(robots, size))
    goal = 0.9 * start.polygon.vertices + [0.3, 0.1]
    first = ho.morph(start, goal)
    rng = np.random.default_rng(robots)
    other = goal + rng.uniform(-0.02, 0.02, goal.shape)
    plan = ho.morph(start, other, like=first)
    assert plan.phases[0].remark == "by the clock of an earlier plan"
    np.testing.assert_allclose(plan.end.polygon.vertices, other, atol=1e-9)
    # Nothing that its certificate states depends on the earlier plan
    anew = ho.certify(plan.motion)
    assert anew.certified
    assert [check.worst for check in anew.limited] == [
        check.worst for check in plan.certificate.limited
    ]
    fastest = ho.morph(start, other).duration
    assert (1.0 - 1e-6) * fastest <= plan.duration <= 1.08 * fastest


def test_between_its_own_ends_a_straight_morph_is_the_earlier_one() -> None:
    start = ho.Hitch.spread(ho.Team(3, 2.4), ho.regular_polygon(3, 0.8))
    goal = 0.9 * start.polygon.vertices + [0.3, 0.1]
    first = ho.morph(start, goal)
    again = ho.morph(start, goal, like=first)
    assert again.duration == pytest.approx(first.duration, rel=1e-6)
    t = np.linspace(0.0, first.duration, 50)
    np.testing.assert_allclose(again.at(t).positions, first.at(t).positions, atol=1e-6)


def test_straight_morphs_are_timed_anew_where_the_clock_does_not_suit() -> None:
    start = ho.Hitch.spread(ho.Team(3, 2.4), ho.regular_polygon(3, 0.8))
    near, far = ([[0.05, 0.0]], [[0.9, -0.7]])
    first = ho.morph(start, start.polygon.vertices + near)
    plan = ho.morph(start, start.polygon.vertices + far, like=first)
    assert not plan.phases[0].remark
    assert plan.duration == ho.morph(start, start.polygon.vertices + far).duration
    timed = ho.morph(start, start.polygon.vertices + near, duration=2.0, like=first)
    assert timed.duration == 2.0


def test_plans_of_other_teams_are_refused(turned: ho.Plan) -> None:
    three = ho.Hitch.spread(ho.Team(robots=3, cable_length=2.4), ho.regular_polygon(3, 1.0))
    with pytest.raises(ho.InputError, match=r"like = .* a plan of a hitch of 3 robots"):
        ho.morph(three, ho.regular_polygon(3, 0.9), like=turned)


def test_goals_that_no_drone_can_hover_at_are_refused_as_without_an_earlier_plan() -> None:
    first = ho.morph(START, START.polygon.translated([0.4, 0.0]))
    limits = ho.Limits(tilt_deg=5.0)
    errors = list[ho.InfeasibleError]()
    for like in (None, first):
        with pytest.raises(ho.InfeasibleError, match="tilt") as caught:
            ho.morph(START, START.polygon.translated([0.4, 0.01]), limits=limits, like=like)
        errors.append(caught.value)
    assert errors[0].violations == errors[1].violations
