"""Steering from moving states: certified, continuous, and the old plan where it is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.checks import certify
from hitchopt.errors import HitchoptError, InputError, UnsupportedError
from hitchopt.hitch.cable_slack import cable_slack, fitting_polygon
from hitchopt.motion.motion import Phase
from hitchopt.motion.phases import Hold, HoldBy
from hitchopt.plan import Plan
from hitchopt.requirements import Requirements
from hitchopt.steering import replanner
from hitchopt.steering.goal_distances import clearly_too_close
from hitchopt.steering.retarget import Refusal, Retarget, certified_retarget
from hitchopt.steps.certified_motions import resting as rest_of
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

TRIANGLE = np.array([[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]) + [1.0, 2.0]
HEXAGON = 1.3 * np.array([[np.cos(a), np.sin(a)] for a in -np.arange(6) * np.pi / 3.0])

ROOT = Path(__file__).parents[2]

START = ho.Hitch.spread(ho.Team(6, 2.4), HEXAGON, 1.0)


def steered(outline: Array = TRIANGLE, length: float = 2.4) -> ho.Replanner:
    """A replanner of a hitch at rest."""
    start = ho.Hitch.spread(ho.Team(len(outline), length), outline, 1.0)
    return ho.Replanner(start.team, start)


def moving(replanner: ho.Replanner) -> float:
    """Set a hitch in motion; return a time at which it moves."""
    first = replanner.retarget(to=[1.5, 2.3, 1.3], at=0.5)
    assert first.accepted
    return first.start + 0.6


def check_splice(old: ho.Motion, answer: ho.Retarget) -> None:
    """The new plan is the old one until it leaves it, and goes on from there without a jump."""
    before = np.linspace(0.0, answer.start, 40)
    there = np.minimum(before, old.duration)
    np.testing.assert_allclose(answer.motion.drones.at(before), old.drones.at(there), atol=1e-10)
    sides = answer.start + np.array([-1e-7, 1e-7])
    for order, jump in ((0, 1e-6), (1, 2e-6), (2, 2e-5)):
        first, last = answer.motion.drones.at(sides, order)
        np.testing.assert_allclose(first, last, atol=jump)
        if answer.start < old.duration:
            np.testing.assert_allclose(first, old.drones.at(answer.start, order), atol=jump)


def check_limits(motion: ho.Motion, begin: float) -> None:
    """Limits hold at samples."""
    limits, t = motion.requirements.limits, np.linspace(begin, motion.duration, 700)
    for order, most in ((1, limits.speed), (2, limits.acceleration), (3, limits.jerk)):
        norms = np.linalg.norm(motion.drones.at(t, order), axis=-1)
        assert np.max(norms) <= most * (1.0 + 1e-9)
    speeds = np.linalg.norm(motion.vertices.at(t, 1), axis=-1)
    assert np.max(speeds) <= limits.vertex_speed * (1.0 + 1e-9)


def test_a_polygon_is_reached_from_a_moving_state() -> None:
    replanner = steered()
    at, old = moving(replanner), replanner.motion
    goal = TRIANGLE + [[0.1, 0.2], [0.0, 0.0], [0.05, 0.1]]
    speed = np.max(np.linalg.norm(old.drones.at(at, 1), axis=-1))
    assert speed > 0.2
    answer = replanner.retarget(goal, at=at)
    assert answer.accepted
    assert answer.certificate.certified
    check_splice(old, answer)
    check_limits(answer.motion, 0.0)
    end = answer.motion.vertices.at(answer.motion.duration)
    np.testing.assert_allclose(end[:, :2], goal, atol=1e-9)
    np.testing.assert_allclose(end[:, 2], 1.3, atol=1e-9)
    assert replanner.motion is answer.motion


def test_a_vertex_goes_elsewhere_and_the_others_to_the_present_goal() -> None:
    replanner = steered(HEXAGON, 2.1)
    at, old = moving(replanner), replanner.motion
    goal = replanner.goal.polygon.vertices.copy()
    goal[2] += [0.03, -0.02]
    answer = replanner.retarget(vertex=2, to=goal[2], at=at)
    assert answer.accepted
    check_splice(old, answer)
    check_limits(answer.motion, 0.0)
    end = answer.motion.vertices.at(answer.motion.duration)
    np.testing.assert_allclose(end[:, :2], goal, atol=1e-9)


def test_a_pose_turns_the_present_goal() -> None:
    replanner = steered()
    at, old = moving(replanner), replanner.motion
    before = replanner.goal.polygon
    answer = replanner.retarget(to=[1.2, 1.8, 0.9], yaw=-0.7, at=at)
    assert answer.accepted
    check_splice(old, answer)
    check_limits(answer.motion, 0.0)
    turn = np.array([[np.cos(0.7), np.sin(0.7)], [-np.sin(0.7), np.cos(0.7)]])
    expected = (before.vertices - before.centroid) @ turn.T + [1.2, 1.8]
    end = answer.motion.vertices.at(answer.motion.duration)
    np.testing.assert_allclose(end[:, :2], expected, atol=1e-9)
    np.testing.assert_allclose(end[:, 2], 0.9, atol=1e-9)


def test_a_turn_that_has_hardly_begun_is_finished_on_the_way_to_the_next_goal() -> None:
    """Straight lines from where vertices are would lead through one point."""
    replanner = steered(HEXAGON, 2.1)
    first = replanner.retarget(to=[0.0, 0.0, 1.0], yaw=2.8, at=0.2)
    assert first.accepted
    goal = replanner.goal.polygon.vertices.copy()
    goal[2] *= 1.02
    answer = replanner.retarget(vertex=2, to=goal[2], at=0.5)
    assert answer.accepted
    times = np.linspace(answer.start, answer.motion.duration, 50)
    radii = np.linalg.norm(answer.motion.vertices.at(times)[..., :2], axis=-1)
    assert np.min(radii) > 1.29
    end = answer.motion.vertices.at(answer.motion.duration)
    np.testing.assert_allclose(end[:, :2], goal, atol=1e-9)


def test_long_shifts_have_few_pieces_and_true_cable_lengths() -> None:
    replanner = steered()
    moving(replanner)
    answer = replanner.retarget(to=[9.0, 2.3, 1.3], yaw=0.4, at=1.1)
    assert answer.accepted
    assert answer.motion.duration - answer.start > 8.0
    assert answer.ahead.drones.pieces < 20
    assert answer.certificate["cable_length"].bound < 1e-6


def test_a_path_that_no_slack_split_changes_is_certified_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The goal keeps all limits at rest with the present split: the nearest one is the same."""
    replanner = steered()
    wall = ho.Prism([[5.0, -9.0], [5.0, 9.0], [5.2, 9.0], [5.2, -9.0]], 0.0, 9.0)
    replanner.requirements = replace(replanner.requirements, keep_out=(wall,))
    replanner.motion = replace(replanner.motion, requirements=replanner.requirements)
    tried = []

    def counted(*given: Any) -> Retarget | Refusal:
        tried.append(given)
        return certified_retarget(*given)

    monkeypatch.setattr("hitchopt.steering.retarget.certified_retarget", counted)
    answer = replanner.retarget(to=[9.0, 2.0, 1.0], at=0.5)
    assert "keep_out" in answer.reason
    assert len(tried) == 1


def test_the_whole_plan_is_certified_and_comes_back_from_its_file(tmp_path: Path) -> None:
    replanner = steered()
    answer = replanner.retarget(TRIANGLE * 0.98, at=moving(replanner))
    plan = answer.plan
    assert plan.certificate.certified
    assert replanner.plan.certificate.certified
    again = ho.load(plan.save(tmp_path / "steered"))
    certificate = ho.certify(again.motion)
    assert certificate.certified
    for check in certificate.checks:
        assert check.bound == pytest.approx(plan.certificate[check.name].bound, abs=1e-9)
    for check in answer.certificate.checks:  # of a part: the whole can only be worse
        whole = plan.certificate[check.name]
        slack = 2e-4 * max(1.0, abs(whole.bound))
        if check.sense == "min":
            assert whole.bound <= check.bound + slack
        elif check.name != "stoppable":
            assert whole.bound >= check.bound - slack


def test_what_cannot_be_certified_is_refused_and_the_old_plan_stays() -> None:
    replanner = steered()
    at, old = moving(replanner), replanner.motion
    goal = replanner.goal.polygon.vertices[0] - [0.0, 1.5]
    answer = replanner.retarget(vertex=0, to=goal, at=at)
    assert not answer.accepted
    assert answer.motion is old is replanner.motion
    assert answer.reason
    assert "refused" in repr(answer)
    assert replanner.retarget(to=[1.0, 2.0, 1.0], at=at).accepted


def test_a_chain_of_goals_stays_certified() -> None:
    replanner, rng, at = steered(), np.random.default_rng(4), 0.2
    for _ in range(8):
        at += float(rng.uniform(0.1, 0.9))
        goal = TRIANGLE * rng.uniform(0.95, 1.1) + rng.uniform(-0.3, 0.3, 2)
        old = replanner.motion
        answer = replanner.retarget(goal, at=at)
        assert answer.accepted
        check_splice(old, answer)
        at = max(at, answer.start)
    assert replanner.plan.certificate.certified


def test_after_its_end_a_plan_rests_until_it_is_given_a_new_goal() -> None:
    replanner = steered()
    late = replanner.motion.duration + 2.0
    answer = replanner.retarget(to=[1.2, 2.0, 1.1], at=late)
    assert answer.accepted
    assert answer.start == pytest.approx(late)
    np.testing.assert_allclose(answer.motion.drones.at(late - 0.5, 1), 0.0, atol=1e-9)
    assert answer.plan.certificate.certified


def test_a_plan_in_flight_is_taken_over_and_lasts_the_same_anywhere() -> None:
    durations = []
    for shift in ([0.0, 0.0], [3.0, -2.0]):
        start = ho.Hitch.spread(ho.Team(3, 2.4), TRIANGLE + shift)
        plan = ho.move_vertex(start, 0, by=[0.0, 0.4])
        replanner = ho.Replanner(start.team, plan)
        answer = replanner.retarget(TRIANGLE + shift + [0.2, 0.1], at=0.5 * plan.duration)
        assert answer.accepted
        check_splice(plan.motion, answer)
        durations.append(answer.motion.duration)
    assert durations[0] == pytest.approx(durations[1], rel=1e-6)


def test_before_the_hitch_is_tied_nothing_is_accepted() -> None:
    plan = ho.solve(ROOT / "problems" / "form_triangle.yaml")
    replanner = ho.Replanner(plan.motion.team, plan)
    for at in (0.0, 1e-7):
        answer = replanner.retarget(to=[0.0, 0.0, 1.0], at=at)
        assert not answer.accepted
        assert "there is no hitch" in answer.reason
    assert replanner.motion.duration == plan.duration


def test_objects_stay_where_they_were_carried() -> None:
    pole = ho.SolidObject(ho.Section(radius=0.1), 0.0, 1.8, at=[9.0, 0.0, 0.0])
    need = replace(Requirements(), objects={"pole": pole})
    start = ho.Hitch.spread(ho.Team(3, 2.4), TRIANGLE, 1.0)
    rest = rest_of(start, need, 1.0, Phase("hold", 0, 0.0, 1.0))
    carried = np.array([[5.0, 2.0, 0.0, 1.0, 0.0]])
    poses = PiecewisePolynomial.constant(rest.drones.breaks, carried)
    motion = replace(rest, poses=poses)
    replanner = ho.Replanner(start.team, Plan(motion, certify(motion)))
    answer = replanner.retarget(to=[1.5, 2.0, 1.0], at=1.0)
    assert answer.accepted, answer.reason
    np.testing.assert_array_equal(answer.motion.object_poses.at(answer.motion.duration), carried)
    answer = replanner.retarget(to=[5.6, 2.0, 1.0], at=answer.motion.duration)  # into the pole
    assert not answer.accepted
    assert "object_clearance" in answer.reason


def test_while_an_object_is_held_nothing_is_accepted() -> None:
    replanner = steered()
    (phase,) = replanner.motion.phases
    held = replace(phase, hold=Hold("box", HoldBy.REST, (0, 1, 2)))
    replanner.motion = replace(replanner.motion, phases=(held,))
    answer = replanner.retarget(to=[1.0, 2.0, 1.2], at=0.5)
    assert not answer.accepted
    assert "held" in answer.reason


def test_slow_drones_turn_slowly_enough() -> None:
    start = ho.Hitch.spread(ho.Team(3, 2.4), TRIANGLE, 1.0)
    replanner = ho.Replanner(start.team, start, limits=ho.Limits(body_rate=0.6))
    at = 0.5
    for to in ([1.5, 2.3, 1.3], [0.8, 2.0, 1.2], [1.6, 1.5, 1.0]):
        answer = replanner.retarget(to=to, at=at)
        assert answer.accepted, answer.reason
        assert answer.certificate["body_rate"].holds
        at = answer.start + 0.5


def test_no_hitch_no_retarget() -> None:
    outline = [[0.0, -0.9], [-0.72, 0.45], [0.72, 0.45]]
    start = ho.Hitch.spread(ho.Team(3, 2.4), outline)
    with pytest.raises(InputError, match="hitch"):
        ho.Replanner(start.team, ho.release(start))


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"polygon": TRIANGLE, "to": [0.0, 0.0, 1.0]},
        {"polygon": TRIANGLE, "vertex": 1},
        {"polygon": TRIANGLE, "yaw": 0.1},
        {"vertex": 0, "to": [1.0, 0.9], "yaw": 0.1},
        {"polygon": TRIANGLE[::-1]},
        {"vertex": 3, "to": [0.0, 0.0]},
        {"vertex": 0, "to": [0.0, 0.0, 1.0]},
        {"to": [0.0, 0.0]},
        {"to": [0.0, 0.0, 1.0], "yaw": np.inf},
        {"to": [0.0, 0.0, 1.0], "at": -1.0},
    ],
)
def test_goals_are_checked(given: dict[str, object]) -> None:
    with pytest.raises(InputError):
        steered().retarget(**({"at": 0.5} | given))  # type: ignore[arg-type]


def test_cables_with_weight_are_not_steered() -> None:
    start = ho.Hitch.spread(ho.Team(3, 2.4, cable_density=0.005), TRIANGLE)
    with pytest.raises(UnsupportedError, match="weight"):
        ho.Replanner(start.team, start)


def test_goals_that_are_too_close_are_not_planned_to_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """A goal at which the given split is too close gets the same answer with and without a look."""
    random, asked = np.random.default_rng(5), []
    for _ in range(400):
        goal = HEXAGON * random.uniform(0.8, 1.15) + random.uniform(-0.15, 0.15, (6, 2))
        try:
            outline = fitting_polygon(START.team, goal)
            slack = cable_slack(START.team, outline)
            end = ho.Hitch(START.team, outline, 1.0, START.fractions * slack)
        except HitchoptError:
            continue
        if clearly_too_close(end, Requirements().separation):
            asked.append((goal, end))
    assert len(asked) >= 3
    accepted = 0
    for goal, end in asked[:4]:
        still = rest_of(end, Requirements(), 1.0, Phase("hold", 0, 0.0, 1.0))
        found = {check.name for check in certify(still).violated}
        assert found & {"separation", "cable_clearance"}
        looked, planned = ho.Replanner(START.team, START), ho.Replanner(START.team, START)
        answer = looked.retarget(goal, at=0.5)
        with monkeypatch.context() as patched:
            patched.setattr(replanner, "clearly_too_close", lambda *_: False)
            other = planned.retarget(goal, at=0.5)
        assert answer.accepted == other.accepted
        if not answer.accepted:
            assert "at the goal" in answer.reason
            assert all(name in answer.reason for name in found)
            assert any(name in other.reason for name in found)
        flown, again = answer.motion.drones, other.motion.drones
        np.testing.assert_array_equal(flown.coefficients, again.coefficients)
        accepted += answer.accepted
    assert accepted


@pytest.mark.parametrize("late", [-1e-7, 0.0, 1e-10, 1e-7, 1e-5, 9e-4])
def test_plans_can_be_left_just_after_a_break(late: float) -> None:
    """A piece that is hardly flown has derivatives of rounding alone: a little more is flown."""
    replanner = steered()
    moving(replanner)
    at = float(replanner.motion.drones.breaks[3]) + late
    answer = replanner.retarget(to=[0.3, 0.2, 1.1], at=at)
    assert answer.accepted, answer.reason
    assert at - 1e-9 <= answer.start <= at + 1e-3
    assert answer.plan.certificate.certified


def test_quick_bounds_of_answers_are_close() -> None:
    """What flies ahead is bounded a little less closely than a whole plan is, and never below."""
    replanner = steered()
    answer = replanner.retarget(to=[1.5, 2.3, 1.3], yaw=0.4, at=moving(replanner))
    assert answer.accepted
    whole = certify(answer.ahead.untimed, reports=())
    for check in whole.checks:
        gap = answer.certificate[check.name].bound - check.bound
        near = 0.02 * 5e-3 if check.name == "equilibrium" else 1e-12 * max(1.0, abs(check.bound))
        assert abs(gap) <= near, check.name
    assert answer.certificate["equilibrium"].bound >= whole["equilibrium"].bound - 2e-7
