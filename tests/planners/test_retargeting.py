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


def test_plans_of_other_teams_are_refused(turned: ho.Plan) -> None:
    three = ho.Hitch.spread(ho.Team(robots=3, cable_length=2.4), ho.regular_polygon(3, 1.0))
    with pytest.raises(ho.InputError, match=r"like = .* a plan of a hitch of 3 robots"):
        ho.morph(three, ho.regular_polygon(3, 0.9), like=turned)
