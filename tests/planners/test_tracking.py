"""Plans with tracking errors: every planner keeps distances for them, or names what binds."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hitchopt as ho
from hitchopt.checks import certify
from hitchopt.checks.tracking import TRACKING_RADIUS
from hitchopt.errors import InfeasibleError
from hitchopt.exports.lint import lint
from hitchopt.hitch.requirements import Arena, Limits, Requirements, Separation
from hitchopt.live.abort import Aborts
from hitchopt.repairs.alternatives import retuning_changes
from hitchopt.repairs.repair import find_suggestions
from hitchopt.steps.moving import Hold
from hitchopt.verify import verify
from tests.helpers.plans import PROBLEMS, planned

RETUNED = ho.Quadrotor(controller="mellinger", gains={"kp": 4.75, "kd": 1.32, "ki": 0})
PID = ho.Quadrotor(controller="pid")


@given(
    st.floats(0.05, 0.4),
    st.floats(0.05, 0.6),
    st.floats(0.001, 0.4),
    st.sampled_from([1.0, 1.5, 4.0]),
    st.integers(0, 999),
)
def test_widened_ellipsoids_contain_the_sum_with_the_tube(
    radius: float, height: float, off: float, ratio: float, seed: int
) -> None:
    """The widened ellipsoid supports the sum of ellipsoid and tube in all directions."""
    axes = np.array([radius, radius, height])
    wider = Separation(radius, height).widened(off, ratio)
    n = np.random.default_rng(seed).normal(size=(50, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    reach = np.linalg.norm(n * axes, axis=1) + off * np.linalg.norm(n * [1, 1, ratio], axis=1)
    assert np.all(
        np.linalg.norm(n * [wider.radius, wider.radius, wider.height], axis=1) >= reach - 1e-12
    )
    assert wider.radius == pytest.approx(radius + off)
    bound = height * np.sqrt(1.0 + off / radius) + ratio * np.sqrt(off * (radius + off))
    assert wider.height <= bound * (1.0 + 1e-12)


def test_controllers_define_tracking_and_tilt_unless_the_problem_does() -> None:
    start = ho.HitchStart(ho.regular_polygon(3, 1.0), 1.0)
    cases: list[tuple[ho.Quadrotor, dict[str, Any], float | None, float]] = [
        (RETUNED, {}, 0.06, 45.0),
        (RETUNED, {"tracking": 0.02}, 0.02, 45.0),
        (RETUNED, {"tracking": 0.0}, 0.0, 45.0),
        (PID, {"tilt_deg": 30.0}, PID.loop.tracking, 20.0),
        (ho.Quadrotor(stiffness=3.0), {}, None, 45.0),
    ]
    for kind, stated, off, tilt in cases:
        team = ho.Team(3, 2.4, quadrotor=kind)
        need = ho.Problem(team, start, (Hold(1.0),), Limits(**stated)).requirements
        assert (need.limits.tracking, round(math.degrees(need.limits.tilt), 9)) == (off, tilt)


def test_tubes_of_problem_and_drones_take_precedence() -> None:
    start, wide = ho.HitchStart(ho.regular_polygon(3, 1.0), 1.0), ho.Tube(0.08, 0.2)
    calibrated = {"controller": "mellinger", "gains": RETUNED.gains, "r1": {"tracking": vars(wide)}}
    for kinds, stated, off in (
        (RETUNED, wide, wide),
        (calibrated, None, wide),
        (calibrated, 0.03, 0.03),
        ({"q0": {"tracking": 0.3}, "r2": {"tracking": vars(wide)}}, None, 0.3),
        (RETUNED, ho.Tube(0.07, 0.07), ho.Tube(0.07, 0.07)),
    ):
        problem = ho.Problem(
            ho.Team(3, 2.4, quadrotor=kinds), start, (Hold(1.0),), Limits(tracking=stated)
        )
        assert problem.requirements.limits.tracking == off, kinds


def test_planners_keep_wider_distances_and_drones_may_stand_on_the_floor() -> None:
    """Heights are divided where errors are larger upright."""
    limits, separation = Limits(tracking=ho.Tube(0.08, 0.2)), Separation(0.12, 0.3)
    need = Requirements(limits, separation, Arena([-2, -1, 0.2], [2, 1, 3])).with_reserve
    found = need.separation
    distances = [found.radius, found.height, found.cable, need.limits.leg, need.height_ratio]
    np.testing.assert_allclose(distances, [0.2, 0.5, 0.26, 0.31, 2.5], atol=1e-8)
    np.testing.assert_allclose([found.crossing, found.object], [0.21, 0.115], atol=1e-8)
    assert need.arena is not None
    np.testing.assert_allclose(need.arena.lower, [-1.92, -0.92, 0.2], atol=1e-8)
    np.testing.assert_allclose(need.arena.upper, [1.92, 0.92, 2.8], atol=1e-8)
    assert need.flown_by(ho.Team(3, 2.4, quadrotor=RETUNED)) is need  # not twice
    exact = Requirements(Limits(tracking=0.0), separation)
    assert exact.with_reserve.separation == separation
    as_number = Requirements(Limits(tracking=ho.Tube(0.05, 0.05)), separation).with_reserve
    number = Requirements(Limits(tracking=0.05), separation).with_reserve
    assert vars(as_number.separation) == vars(number.separation)
    assert (as_number.position_error, as_number.height_ratio) == (number.position_error, 1.0)
    low = Requirements(Limits(tracking=ho.Tube(0.05, 0.01)), separation).with_reserve
    assert vars(low.separation) == vars(number.separation)  # a height below the level counts as it


def test_spread_legs_include_the_tracking_error() -> None:
    team, outline = ho.Team(6, 1.8, quadrotor=RETUNED), ho.regular_polygon(6, 0.9)
    exact = replace(team, quadrotor=(ho.Quadrotor(),) * 6)
    need = Requirements(Limits(tracking=0.06)).with_reserve
    wider = ho.Hitch.spread(exact, outline, 1.2, limits=need.limits, separation=need.separation)
    found = ho.Hitch.spread(team, outline, 1.2).q_legs
    np.testing.assert_allclose(found, wider.q_legs, atol=1e-9)
    assert np.max(np.abs(found - ho.Hitch.spread(exact, outline, 1.2).q_legs)) > 1e-3


SQUARE = [[0.5, 0.5], [0.5, -0.5], [-0.5, -0.5], [-0.5, 0.5]]


def turned() -> ho.Plan:
    team = ho.Team(4, [2.4, 2.4, 2.5, 2.5], quadrotor=RETUNED)
    start = ho.Hitch.spread(team, SQUARE, altitude=1.2)
    return ho.solve(start, ho.Transport([0.3, -0.2, 1.4], yaw=0.7))


def swapped() -> ho.Plan:
    places = np.array([[-1.0, 0.1, 1.0], [1.0, -0.1, 1.1], [0.0, 1.0, 1.0]])
    team = ho.Swarm(3, quadrotor=ho.Quadrotor(controller="px4"))
    return ho.separate(ho.Problem(team, places, [ho.Fly(places[[1, 0, 2]])]))


def soft(mass: float, kp: float, kd: float, **values: Any) -> dict[str, Any]:
    """Kind of drones with gains that hold the height less stiffly."""
    gains = {"kp": [kp, 0.27 * kp], "kd": [kd, 0.3 * kd], "ki": 0}
    return {"mass": mass, "controller": "mellinger", "gains": gains, **values}


TUBE = {"level": 0.08, "height": 0.20}
WIDE_START = {
    "q": [[-2.4, -1.6, 0.0], [0.0, 2.4, 0.0], [2.4, -1.6, 0.0]],
    "r": [[-1.4, -1.6, 0.0], [1.0, 2.4, 0.0], [3.4, -1.6, 0.0]],
}
TRIANGLE = {"polygon": [[0.0, -1.0], [-0.9, 0.6], [0.9, 0.6]], "altitude": 1.8}


def triangle_in_tubes(**team: Any) -> dict[str, Any]:
    """A triangle tied from the ground; tubes need more space than 5 cm do."""
    return {
        "team": {"robots": 3, "cable_length": 3.6, **team},
        "limits": {"tracking": TUBE},
        "start": {"drones": WIDE_START},
        "mission": [{"form": TRIANGLE}],
    }


def table(y: float, height: float) -> dict[str, Any]:
    outline = [[-0.4, -0.3], [0.4, -0.3], [0.4, 0.3], [-0.4, 0.3]]
    return {"outline": outline, "to": height, "at": [5, y, 0], "fixed": True}


BOX_IN_TUBES: dict[str, Any] = {
    "team": {"robots": 4, "cable_length": 3.2, "cable_density": 0.01, "tension": 1.0},
    "limits": {"tilt_deg": 50, "tracking": TUBE},
    "objects": {
        "table": table(0, 0.5),
        "shelf": table(3, 0.4),
        "box": {
            "outline": [[-0.15, -0.1], [0.15, -0.1], [0.15, 0.1], [-0.15, 0.1]],
            "to": 0.6,
            "mass": 0.15,
            "at": [5, 0, 0.5],
            "rim": {
                "outline": [[-0.25, -0.2], [0.25, -0.2], [0.25, 0.2], [-0.25, 0.2]],
                "at": 0.55,
            },
        },
    },
    "start": {
        "drones": {
            "q": [[-1.7, -0.7, 0], [-0.7, 1.7, 0], [1.7, 0.7, 0], [0.7, -1.7, 0]],
            "r": [[-1.7, 0.7, 0], [0.7, 1.7, 0], [1.7, -0.7, 0], [-0.7, -1.7, 0]],
        }
    },
    "mission": [
        {
            "form": {
                "polygon": [[-0.7, -0.7], [-0.7, 0.7], [0.7, 0.7], [0.7, -0.7]],
                "altitude": 2.2,
            }
        },
        {"transport_object": {"object": "box", "to": [5, 3, 0.4]}},
    ],
}
IN_TUBES: dict[str, dict[str, Any]] = {
    "triangle": triangle_in_tubes(quadrotor=soft(0.132, 4.75, 1.32)),
    "crazyflies": triangle_in_tubes(
        cable_density=0.0015, tension=0.12, quadrotor=soft(0.0393, 1.41, 0.39, max_thrust=0.8)
    ),
    "box": BOX_IN_TUBES | {"team": {**BOX_IN_TUBES["team"], "quadrotor": soft(0.132, 4.75, 1.32)}},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", IN_TUBES)
def test_hitches_are_tied_and_carry_in_tubes_that_recorded_drones_reach(
    name: str, tmp_path: Path
) -> None:
    """With drones that are off by as much, simulated, all of these hold."""
    plan = ho.solve(ho.problem_from_dict(IN_TUBES[name]))
    check = plan.certificate["tracking_radius"]
    assert check.limit == 0.08
    assert check.holds
    assert plan.certificate.certified
    plan.save(tmp_path)
    assert {row.verdict for row in verify(tmp_path)} == {"proven"}


SLOW = [
    pytest.param(name, marks=pytest.mark.slow)
    for name in ("retuned_triangle", "crazyflie_triangle")
]


@pytest.mark.parametrize("name", ["turned", "swapped", *SLOW])
def test_plans_keep_every_distance_with_tracking_errors(name: str, tmp_path: Path) -> None:
    plan: ho.Plan = globals()[name]() if name in globals() else planned(name)
    check, off = plan.certificate["tracking_radius"], plan.motion.team.tracking
    assert check.limit == off
    assert check.holds
    assert plan.certificate.certified
    replace(plan, problem="").save(tmp_path)  # which states another radius below
    assert ho.load(tmp_path).motion.requirements.limits.tracking == off
    rows = list(verify(tmp_path))
    assert {row.verdict for row in rows} == {"proven"}
    exact = replace(
        plan.motion.requirements, limits=replace(plan.motion.requirements.limits, tracking=None)
    )
    report = certify(replace(plan.motion, requirements=exact))["tracking_radius"]
    assert (report.limit, report.holds) == (None, True)

    with np.load(tmp_path / "plan.npz") as file:
        arrays = dict(file)
    settings = json.loads(str(arrays["settings"]))
    limits = settings["groups"][0]["records"]["requirements"]["limits"]
    for wider in (2.0 * check.worst, {"level": 1.5 * check.worst, "height": 4.0 * check.worst}):
        limits["tracking"] = wider
        arrays["settings"] = np.array(json.dumps(settings))
        np.savez(tmp_path / "plan.npz", **arrays)
        assert not ho.load(tmp_path).certificate["tracking_radius"].holds
        assert {row.verdict for row in verify(tmp_path)} != {"proven"}


def test_certificate_and_verify_agree_on_the_largest_tube(tmp_path: Path) -> None:
    """Drones fly 0.9 m over a prism, which upright errors bring nearer."""
    prism = ho.Prism([[-2.0, -2.0], [-2.0, 2.0], [2.0, 2.0], [2.0, -2.0]], 0.0, 1.0)
    places = np.array([[-0.5, 0.0, 1.9], [0.5, 0.0, 1.9]])
    steps = [ho.Fly(places + [0.0, 0.3, 0.0])]
    ho.separate(ho.Problem(ho.Swarm(2), places, steps, keep_out=(prism,))).save(tmp_path)
    with np.load(tmp_path / "plan.npz") as file:
        arrays = dict(file)
    settings = json.loads(str(arrays["settings"]))
    limits = settings["groups"][0]["records"]["requirements"]["limits"]
    largest = 0.9 / 3.0 - 0.12
    for share, holds in ((0.99, True), (1.01, False)):
        limits["tracking"] = {"level": share * largest, "height": 3.0 * share * largest}
        arrays["settings"] = np.array(json.dumps(settings))
        np.savez(tmp_path / "plan.npz", **arrays)
        assert ho.load(tmp_path).certificate["tracking_radius"].holds is holds
        assert ({row.verdict for row in verify(tmp_path)} <= {"proven", "warning"}) is holds


def test_a_specified_tracking_that_is_too_large_is_suggested_as_that_of_retuned_drones() -> None:
    problem: Any = ho.load_problem(PROBLEMS / "form_triangle.yaml")
    wide = replace(problem, limits=replace(problem.limits, tracking=0.5))
    with pytest.raises(InfeasibleError, match="but only to measured errors") as caught:
        ho.solve(wide)
    (first, *_) = find_suggestions(wide, caught.value, 600.0)
    assert (first.change.key, first.change.new) == ("limits.tracking", 0.06)
    assert first.change.relative == pytest.approx(-0.88)


@pytest.mark.parametrize(("ceiling", "advised"), [(1.5, True), (0.5, False)])
def test_smaller_errors_are_advised_only_where_distances_lack_no_more(
    ceiling: float, advised: bool
) -> None:
    """A hitch at 1.5 m lacks 5 cm of tracking below a ceiling at 1.5 m, and a metre more at 0.5."""
    data: Any = {
        "team": {"robots": 3, "cable_length": 2.4, "quadrotor": "paper_132g"},
        "limits": {"tracking": 0.05},
        "arena": {"lower": [-4, -4, 0], "upper": [4, 4, ceiling]},
        "start": {"hitch": {"polygon": [[0, 0.6], [0.5, -0.3], [-0.5, -0.3]], "altitude": 1.5}},
        "mission": [{"hold": {"seconds": 1}}],
    }
    with pytest.raises(InfeasibleError, match="arena") as refused:
        ho.solve(ho.problem_from_dict(data))
    words = "lower limits.tracking, but only to measured errors"  # gains are the stiffest
    assert (words in str(refused.value)) is advised


SOFT = ho.Quadrotor(0.25, 5.5, controller="px4", gains={"kp": 2.5, "kd": 1.25})


@pytest.mark.parametrize(
    ("stated", "kind", "warned"),
    [
        (0.06, SOFT, True),
        (0.0, SOFT, True),
        ({"level": 0.2, "height": 0.06}, SOFT, False),  # a height below the level is the level
        (0.14, SOFT, False),
        (None, SOFT, False),
        (0.06, replace(SOFT, tracking=0.05), False),  # calibrated
        (0.01, ho.Quadrotor(0.25, 5.5), False),  # without a controller nothing is known
    ],
)
def test_a_stated_error_below_that_of_the_gains_is_warned_of(
    stated: Any, kind: ho.Quadrotor, *, warned: bool, tmp_path: Path
) -> None:
    """By every command, also of files, with both figures; it is kept: it may have been measured."""
    team = ho.Team(3, 2.4, tension=0.8, cable_density=0.005, quadrotor=kind)
    tracking = ho.Tube(**stated) if isinstance(stated, dict) else stated
    hitch = ho.Hitch.spread(team, ho.regular_polygon(3, 0.9), altitude=1.5)
    plan = ho.solve(hitch, ho.Hold(1.0), limits=ho.Limits(tracking=tracking))
    notes = [note for note in plan.notes if "is certified: raise limits.tracking" in note]
    assert len(notes) == warned
    plan.export("csv", tmp_path / "show")
    (linted,) = lint(tmp_path / "show")
    found = [each for each in linted.findings if each.rule == "tracking"]
    assert [each.level for each in found] == ["warning"] * warned
    if warned:
        assert notes[0] in str(found[0])
        assert (
            f"expect drones 0.135 m off with the gains of px4; only {tracking:.3g} m is certified"
            in notes[0]
        )
        assert plan.motion.requirements.limits.tracking == tracking


def test_remedies_lower_tracking_only_to_measured_errors() -> None:
    words = TRACKING_RADIUS.remedy
    assert "lower" not in words
    assert "limits.tracking to a smaller measured error" in words


def test_no_suggestion_understates_the_errors_of_gains() -> None:
    problem: Any = ho.load_problem(PROBLEMS / "form_triangle.yaml")
    team = replace(problem.team, quadrotor=replace(SOFT, mass=0.132, max_thrust=2.6))
    wide = replace(problem, team=team, limits=replace(problem.limits, tracking=0.5))
    changes = [each for each in retuning_changes(wide) if each.key == "limits.tracking"]
    own = ho.Tube.of(team.tracking).largest
    assert [each.new for each in changes] == [own]
    assert own > 0.05


def test_aborts_keep_what_the_plan_keeps() -> None:
    motion = planned("retuned_triangle").motion
    for time in (1.0, motion.duration):
        found = Aborts(ho.Flight.of(motion)).plan(time, "land")
        assert found.certificate["tracking_radius"].limit == 0.06
        assert found.certificate.certified


@cache
def refusal(controller: str) -> tuple[ho.Problem, InfeasibleError]:
    problem = ho.load_problem(PROBLEMS / "retuned_triangle.yaml")
    assert isinstance(problem, ho.Problem)
    kinds = (ho.Quadrotor(controller=controller),) * 3
    other = replace(problem, team=replace(problem.team, quadrotor=kinds))
    with pytest.raises(InfeasibleError) as caught:
        ho.solve(other)
    return other, caught.value


@pytest.mark.parametrize(
    ("controller", "constraint", "words"),
    [
        ("pid", "feed_forward", "to one of mellinger, lee"),
        ("lee", "cable_clearance", "tracking errors of 0.214 m add to this distance"),
    ],
)
def test_infeasible_tracking_is_refused_by_name(
    controller: str, constraint: str, words: str
) -> None:
    _, error = refusal(controller)
    (told,) = [each for each in error.violations if each.constraint == constraint]
    assert words in str(told)


@pytest.mark.parametrize("controller", ["pid", pytest.param("lee", marks=pytest.mark.slow)])
def test_stiffer_gains_are_suggested(controller: str) -> None:
    problem, error = refusal(controller)
    first = find_suggestions(problem, error, 600.0)[0]
    assert first.change.key == "team.quadrotor.controller"
    assert all(
        kind == replace(RETUNED, gains=kind.gains) for kind in first.change.problem.team.quadrotor
    )
    (edit,) = first.change.edits
    assert edit.value == {"mass": 0.132, "max_thrust": 2.6, "controller": "mellinger",
                          "gains": {"kp": 4.75, "kd": 1.32, "ki": 0.0}}  # fmt: skip


@pytest.mark.slow
def test_objects_count_toward_a_specified_limit() -> None:
    """Cables and a held object reduce the tracking radius by their own clearance."""
    motion = planned("carry_tray").motion
    alone = certify(motion)
    near = alone["object_clearance"].worst - 0.5 * alone["tracking_radius"].worst
    separation = replace(motion.requirements.separation, object=near)  # nearer than drones
    need, bounds = replace(motion.requirements, separation=separation), []
    for off in (None, 0.01):
        limits = replace(need.limits, tracking=off)
        found = certify(replace(motion, requirements=replace(need, limits=limits)))
        bounds.append(found["tracking_radius"].worst)
    left = found["object_clearance"].worst - need.separation.object
    assert bounds[1] == pytest.approx(min(bounds[0], left), rel=1e-6)
    assert bounds[1] < bounds[0]
