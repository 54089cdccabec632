"""Steering from moving states: certified and continuous plans, refused goals."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.checks import certify
from hitchopt.hitch.requirements import Requirements
from hitchopt.live.replanner import Retarget
from hitchopt.motion.motion import Phase
from hitchopt.planners.rests import rest_motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import MIN_SPACING
from hitchopt.values import Array
from tests.helpers.plans import planned

TRIANGLE = np.array([[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]) + [1.0, 2.0]
HEXAGON = 1.3 * np.array([[np.cos(a), np.sin(a)] for a in -np.arange(6) * np.pi / 3.0])


LOADS: tuple[dict[str, Any], ...] = ({}, {"load": 0.01, "cable_density": 0.004})


def steered(
    outline: Array = TRIANGLE, length: float = 2.4, limits: ho.Limits | None = None, **team: Any
) -> ho.Replanner:
    """A replanner of a hitch at rest."""
    start = ho.Hitch.spread(ho.Team(len(outline), length, **team), outline, 1.0)
    return ho.Replanner(start.team, start, limits=limits)


def moving(replanner: ho.Replanner) -> float:
    """Set a hitch in motion; return a time at which it moves."""
    first = replanner.retarget(to=[1.5, 2.3, 1.3], at=0.5)
    assert first.accepted
    at = first.start + 0.6
    assert np.max(np.linalg.norm(replanner.motion.drones.at(at, 1), axis=-1)) > 0.2
    return at


def check_answer(old: ho.Motion, answer: Retarget) -> None:
    """The old plan until it is left, no jump there, and all limits at samples."""
    motion, limits = answer.motion, answer.motion.requirements.limits
    before = np.linspace(0.0, answer.start, 40)
    there = np.minimum(before, old.duration)
    np.testing.assert_allclose(motion.drones.at(before), old.drones.at(there), atol=1e-10)
    sides = answer.start + np.array([-1e-7, 1e-7])
    for order, jump in ((0, 1e-6), (1, 2e-6), (2, 2e-5)):
        first, last = motion.drones.at(sides, order)
        np.testing.assert_allclose(first, last, atol=jump)
        if answer.start < old.duration:
            np.testing.assert_allclose(first, old.drones.at(answer.start, order), atol=jump)
    t = np.linspace(0.0, motion.duration, 700)
    rates = [(1, limits.speed), (2, limits.acceleration), (3, limits.jerk)]
    for order, most in rates:
        assert np.max(np.linalg.norm(motion.drones.at(t, order), axis=-1)) <= most * (1 + 1e-9)
    speeds = np.linalg.norm(motion.vertices.at(t, 1), axis=-1)
    assert np.max(speeds) <= limits.vertex_speed * (1.0 + 1e-9)


@pytest.mark.parametrize("kind", ["polygon", "vertex", "pose", "slow_turns"])
def test_every_kind_of_goal_is_reached_from_a_moving_state(kind: str) -> None:
    replanner = steered(limits=ho.Limits(body_rate=0.6) if kind == "slow_turns" else None)
    at, old, own = moving(replanner), replanner.motion, replanner.goal.polygon
    goal, height = own.vertices.copy(), 1.3
    if kind == "polygon":
        goal = TRIANGLE + [[0.1, 0.2], [0.0, 0.0], [0.05, 0.1]]
        answer = replanner.retarget(goal, at=at)
    elif kind == "vertex":
        goal[2] += [0.03, -0.02]
        answer = replanner.retarget(vertex=2, to=goal[2], at=at)
    else:
        place, height, yaw = np.array([1.2, 1.8]), 0.9, -3.6
        c, s = np.cos(yaw), np.sin(yaw)
        goal = (goal - own.centroid) @ np.array([[c, s], [-s, c]]) + place
        answer = replanner.retarget(to=[*place, height], yaw=yaw, at=at)
        ahead = answer.ahead.vertices.at(np.linspace(0.0, answer.ahead.duration, 99))
        turned = np.unwrap(np.angle((ahead[:, 1] - ahead[:, 0])[:, :2] @ [1.0, 1.0j]))
        assert turned[-1] - turned[0] == pytest.approx(yaw, abs=1e-6)  # not the shorter way
    assert answer.accepted, answer.reason
    assert answer.certificate.certified
    assert replanner.motion is answer.motion
    check_answer(old, answer)
    end = answer.motion.vertices.at(answer.motion.duration)
    np.testing.assert_allclose(end, np.column_stack([goal, [height] * 3]), atol=1e-9)


@pytest.mark.parametrize("loads", LOADS)
def test_a_chain_of_goals_stays_certified(loads: dict[str, Any]) -> None:
    replanner, rng, at = steered(**loads), np.random.default_rng(4), 0.2
    for _ in range(6):
        at, old = at + float(rng.uniform(0.1, 0.9)), replanner.motion
        goal = TRIANGLE * rng.uniform(0.95, 1.1) + rng.uniform(-0.3, 0.3, 2)
        answer = replanner.retarget(goal, at=at)
        assert answer.accepted
        check_answer(old, answer)
        at = max(at, answer.start)
    assert replanner.plan.certificate.certified


def test_a_turn_that_has_hardly_begun_is_finished_on_the_way_to_the_next_goal() -> None:
    """Straight lines from where vertices are would lead through one point."""
    replanner = steered(HEXAGON, 2.1)
    assert replanner.retarget(to=[0.0, 0.0, 1.0], yaw=2.8, at=0.2).accepted
    answer = replanner.retarget(vertex=2, to=1.02 * replanner.goal.polygon.vertices[2], at=0.5)
    assert answer.accepted
    times = np.linspace(answer.start, answer.motion.duration, 50)
    radii = np.linalg.norm(answer.motion.vertices.at(times)[..., :2], axis=-1)
    assert np.min(radii) > 1.29


def test_a_leg_that_would_be_too_short_at_the_goal_gets_another_split() -> None:
    outline, team = ho.regular_polygon(3, 1.3).vertices, ho.Team(3, 2.4)
    replanner = ho.Replanner(team, ho.Hitch(team, outline, 1.0, [0.19, 0.55, 0.55]))
    answer = replanner.retarget(1.2 * outline, at=0.5)
    assert answer.accepted, answer.reason
    np.testing.assert_allclose(replanner.goal.q_legs, [0.15, 0.42, 0.42], atol=1e-3)


def test_unsupported_teams_are_refused() -> None:
    start = ho.Hitch.spread(ho.Team(3, 2.4), [[0.0, -0.9], [-0.72, 0.45], [0.72, 0.45]])
    with pytest.raises(ho.InputError, match="hitch"):
        ho.Replanner(start.team, ho.solve(start, ho.Release()))
    rolled, plan = replace(start, roll=np.full(3, 0.3)), planned("form_pentagon")
    for here, why in ((rolled, "legs are rolled"), (plan, "there is no hitch")):
        replanner = ho.Replanner(here.team if here is rolled else plan.motion.team, here)
        for at in (0.0, 1e-7):
            answer = replanner.retarget(to=[0.0, 0.0, 1.0], at=at)
            assert not answer.accepted
            assert why in answer.reason


def test_uncertified_goals_are_refused_and_the_plan_continues() -> None:
    replanner = steered()
    at, old = moving(replanner), replanner.motion
    goal = replanner.goal.polygon.vertices[0] - [0.0, 1.5]
    answer = replanner.retarget(vertex=0, to=goal, at=at)
    assert not answer.accepted
    assert answer.motion is old is replanner.motion
    assert answer.reason[:9] in repr(answer)
    assert replanner.retarget(to=[1.0, 2.0, 1.0], at=at).accepted


@pytest.mark.parametrize("loads", LOADS)
def test_a_plan_in_flight_is_taken_over(loads: dict[str, Any]) -> None:
    start = ho.Hitch.spread(ho.Team(3, 2.4, **loads), TRIANGLE)
    plan = ho.solve(start, ho.MoveVertex(0, by=[0.0, 0.4]))
    answer = ho.Replanner(start.team, plan).retarget(TRIANGLE + [0.2, 0.1], at=0.5 * plan.duration)
    assert answer.accepted
    check_answer(plan.motion, answer)


def test_objects_stay_where_they_were_carried() -> None:
    pole = ho.SolidObject(ho.Section(radius=0.1), 0.0, 1.8, at=[9.0, 0.0, 0.0])
    need = replace(Requirements(), objects={"pole": pole})
    start = ho.Hitch.spread(ho.Team(3, 2.4), TRIANGLE, 1.0)
    rest = rest_motion(start, need, 1.0, Phase("hold", 0, 0.0, 1.0))
    carried = np.array([[5.0, 2.0, 0.0, 1.0, 0.0]])
    motion = replace(rest, poses=PiecewisePolynomial.constant(rest.drones.breaks, carried))
    replanner = ho.Replanner(start.team, ho.Plan(ho.Flight.of(motion), certify(motion)))
    answer = replanner.retarget(to=[1.5, 2.0, 1.0], at=1.0)
    assert answer.accepted, answer.reason
    np.testing.assert_array_equal(answer.motion.poses.at(answer.motion.duration), carried)
    answer = replanner.retarget(to=[5.6, 2.0, 1.0], at=answer.motion.duration)  # into the pole
    assert not answer.accepted
    assert "object_clearance" in answer.reason


@pytest.mark.parametrize(
    ("key", "given"),
    [
        ("polygon", {}),
        ("polygon", {"polygon": TRIANGLE, "to": [0.0, 0.0, 1.0]}),
        ("polygon", {"polygon": TRIANGLE, "vertex": 1}),
        ("polygon", {"polygon": TRIANGLE, "yaw": 0.1}),
        ("polygon", {"vertex": 0, "to": [1.0, 0.9], "yaw": 0.1}),
        ("polygon", {"polygon": TRIANGLE[::-1]}),
        ("vertex", {"vertex": 3, "to": [0.0, 0.0]}),
        ("to", {"vertex": 0, "to": [0.0, 0.0, 1.0]}),
        ("to", {"to": [0.0, 0.0]}),
        ("yaw", {"to": [0.0, 0.0, 1.0], "yaw": np.inf}),
        ("at", {"to": [0.0, 0.0, 1.0], "at": -1.0}),
    ],
)
def test_goals_are_checked(key: str, given: dict[str, Any]) -> None:
    with pytest.raises(ho.InputError, match=f"^{key}"):
        steered().retarget(**({"at": 0.5} | given))


@pytest.mark.parametrize("late", [-1e-7, 1e-7, 9e-4])
def test_plans_can_be_left_just_after_a_break(late: float) -> None:
    """A piece that is hardly flown has derivatives of rounding alone: a little more is flown.

    What flies ahead is bounded less closely than a whole plan is, never beyond its limits.
    """
    replanner = steered()
    moving(replanner)
    at = float(replanner.motion.drones.breaks[3]) + late
    answer = replanner.retarget(to=[0.3, 0.2, 1.1], yaw=0.4, at=at)
    assert answer.accepted, answer.reason
    assert at - 1e-9 <= answer.start <= at + MIN_SPACING
    assert answer.plan.certificate.certified
    for check in certify(answer.ahead.untimed, reports=()).checks:
        rough = answer.certificate[check.name]
        outward = (rough.worst - check.worst) * (1.0 if check.sense == "max" else -1.0)
        size = max(1.0, abs(check.worst))
        assert -1e-4 * size <= outward <= 0.1 * size, check.name
        assert rough.holds
