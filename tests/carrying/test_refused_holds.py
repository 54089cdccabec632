"""Trays that were once refused, and what refusals of others say."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from typing import Any

import carried_plans as plans
import numpy as np
import pytest
from problem_edits import edited

import hitchopt as ho
from hitchopt.checks.certify import certify
from hitchopt.checks.clearance import OBJECT_CLEARANCE
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion
from hitchopt.objects.placing import footing
from hitchopt.planners.carrying.grip_polygon import grip_polygons
from hitchopt.planners.carrying.rest import rest_polygons


def tray(robots: int, mass: float, length: float, radius: float = 0.45) -> dict[str, Any]:
    """Return the problem of moving a tray of a mass [kg] with cables of a length [m]."""
    angles = 0.3 - 2.0 * np.pi * np.arange(robots) / robots
    polygon = np.array([0.4, -0.3]) + radius * np.column_stack([np.cos(angles), np.sin(angles)])
    body = {"circle": 0.08, "to": 0.3, "mass": mass, "rim": {"circle": 0.3, "at": 0.25}}
    return {
        "team": {"robots": robots, "cable_length": length, "tension": 1.0, "cable_density": 0.01},
        "limits": {"tilt_deg": 60},
        "objects": {"tray": {**body, "at": [0.4, -0.3, 0.0]}},
        "start": {"hitch": {"polygon": polygon.tolist(), "altitude": 1.0}},
        "mission": [{"transport_object": {"object": "tray", "to": [0.4, 0.7, 0.0]}}],
    }


@cache
def tray_of_four() -> Motion:
    return solved(tray(4, 0.2, 2.2)).motion


def solved(problem: dict[str, Any]) -> ho.Plan:
    return ho.solve(ho.problem_from_dict(problem))


def refusal(problem: dict[str, Any]) -> ho.InfeasibleError:
    with pytest.raises(ho.InfeasibleError) as caught:
        solved(problem)
    return caught.value


@pytest.mark.slow
def test_legs_are_rolled_before_a_hitch_gets_small() -> None:
    plan = solved(tray(6, 0.2, 1.8, radius=0.5))
    assert plan.certificate.certified


@pytest.mark.slow
def test_weight_passes_as_slowly_as_drones_need() -> None:
    plan = solved(tray(4, 0.5, 2.2))
    lift = next(phase for phase in plan.motion.phases if phase.name == "lift")
    t = np.linspace(lift.start, lift.end, 2000)
    fastest = np.max(np.linalg.norm(plan.motion.drones.at(t, 2), axis=-1))
    limit = plan.motion.requirements.limits.acceleration
    assert 0.6 * limit < fastest <= limit


@pytest.mark.slow
def test_inertia_does_not_bring_legs_together() -> None:
    plan = solved(tray(5, 0.4, 2.2))
    worst = plan.certificate["crossing"].worst
    assert worst is not None
    assert worst >= 0.05


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robots", "mass", "length", "binding"),
    [(3, 0.35, 2.2, "load"), (5, 0.8, 2.2, "load"), (6, 0.8, 2.2, "equilibrium")],
)
def test_a_refused_hold_names_what_statics_allow(
    robots: int, mass: float, length: float, binding: str
) -> None:
    given = tray(robots, mass, length)
    given["mission"][0]["transport_object"]["tension"] = 1.0
    violation = refusal(given).violations[0]
    assert violation.constraint == binding
    told = re.search(r"mass to ([\d.]+) kg", violation.remedy)
    assert told
    assert float(told[1]) < mass
    assert "more robots" in violation.remedy


@pytest.mark.slow
def test_what_is_suggested_for_a_refused_hold_is_planned() -> None:
    given = tray(3, 0.35, 2.2)
    given["mission"][0]["transport_object"]["tension"] = 1.0
    found = ho.suggestions(ho.problem_from_dict(given), 600.0)
    assert "objects.tray.mass" in {suggestion.change.key for suggestion in found}
    for suggestion in found:
        solved(edited(given, suggestion.change.edits))


@pytest.mark.slow
def test_a_tension_that_tilts_drones_too_far_is_named_as_the_steps() -> None:
    given = tray(3, 0.2, 2.2)
    given["limits"] = {}
    given["mission"][0]["transport_object"]["tension"] = 1.6
    violation = refusal(given).violations[0]
    assert violation.constraint == "tilt"
    assert "limits.tilt_deg" in violation.remedy
    suggested = re.search(r"tension of ([\d.]+) N", violation.remedy)
    assert suggested
    given["mission"][0]["transport_object"]["tension"] = float(suggested[1])
    solved(given)


def steps_of(problem: dict[str, Any], *steps: dict[str, Any]) -> dict[str, Any]:
    return {**problem, "mission": list(steps)}


ENCLOSED, LEFT = {"enclose": {"object": "tray"}}, {"leave": {"object": "tray"}}
CUP = {"circle": 0.03, "to": 0.1, "mass": 0.02, "at": [1.1, 0.2, 0.3]}
NO_RIM = {"outline": [[1, 1], [1.5, 1], [1, 1.5]], "at": 0.25}
ON_TOP = plans.tray()
ON_TOP["objects"]["cup"] = CUP
HIGH = plans.tray()
HIGH["mission"][0]["transport_object"]["by"] = 0.6
DRUM = {"enclose": {"object": "drum"}}
RIMMED = plans.drum(circle=0.1, rim={"circle": 0.25, "at": 0.25})
SLIPPERY = {"cable_friction": 0.0, "cable_density": 0.0}
LOADED = plans.drum(mass=0.82, friction=20.0)
LOADED["limits"]["tilt_deg"] = 70
LOADED["team"] |= {"cable_length": 2.15, **SLIPPERY}
LOW = plans.tray() | {"arena": {"lower": [-3, -3, 0], "upper": [3, 3, 0.53]}}
LOW["start"]["hitch"]["altitude"] = 0.5
SMALL = plans.drum()
SMALL["start"]["hitch"]["polygon"] = [[1.7, 0.2], [1.1, -0.1464], [1.1, 0.5464]]
SMALL["team"] |= {"cable_friction": 0.15, "cable_density": 0.0}
REFUSED: list[tuple[dict[str, Any], list[str]]] = [
    (plans.tray(mass=0.6), ["load: ", r"lower objects.tray.mass to 0\."]),
    (plans.tray(rim={"circle": 0.12, "at": 0.25}), ["give objects.tray a wider rim"]),
    (plans.tray(rim=NO_RIM), [r"^objects\.tray\.rim = "]),
    (plans.tray(friction=0.0), [r"^objects\.tray\.friction = "]),
    (ON_TOP, [r"^objects\.cup\.at = "]),
    (HIGH, [r"a height belongs to lift: 0\.6"]),
    (steps_of(LOW, ENCLOSED), [r"at the end of step 0 \(enclose\)"]),
    (steps_of(SMALL, DRUM), [r"as large as around objects\.drum, 0\.5\d? m"]),
    (steps_of(plans.tray(), {"lift": {"by": 0.2}}), ["must be one holding an object that stands"]),
    (
        steps_of(plans.tray(), {"enclose": {"object": "tr"}}),
        ["must be one of objects: tray, table"],
    ),
    (
        steps_of(plans.tray(), ENCLOSED, LEFT, {"move_vertex": {"vertex": 0, "by": [0.1, 0]}}),
        ["morph before"],
    ),
    (steps_of(plans.tray(), {"enclose": {"object": "table"}}), ["false where it is held"]),
    (steps_of(plans.tray(), {"grasp": {"object": "tray", "tension": -1}}), ["greater than"]),
    ({**plans.drum(), "limits": {}}, ["need limits.tilt_deg of 51, above 45", "1.29 N or less"]),
    (plans.drum(mass=0.13), [r"objects.drum.mass to 0\.1", r"a tension of 1\."]),
    (
        steps_of(RIMMED, DRUM, {"grasp": {"object": "drum", "by": "grip"}}),
        ["rest where the object has a rim"],
    ),
    (steps_of(plans.drum(), DRUM, {"grasp": {"object": "drum"}}), ["grasp it by: grip"]),
    # Six straight parts with 1.3 N each lift 7.8 N at most, were they upright.
    (LOADED, [r"equilibrium.*objects.drum.mass to"]),
]


@pytest.mark.slow
@pytest.mark.parametrize(("problem", "texts"), REFUSED, ids=[texts[-1] for _, texts in REFUSED])
def test_what_cannot_be_held_is_refused_with_what_to_change(
    problem: dict[str, Any], texts: list[str]
) -> None:
    with pytest.raises(ho.HitchoptError) as caught:
        solved(problem)
    for text in texts:
        assert re.search(text, str(caught.value)), str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("inside", [0.015, 0.025])
def test_nothing_is_set_down_at_an_edge(inside: float) -> None:
    given = tray(4, 0.2, 2.2)
    table = {"circle": 0.3, "to": 0.1, "fixed": True, "at": [0.4 + 0.3 - inside, 0.7, 0.0]}
    given["objects"]["table"] = table
    given["mission"][0]["transport_object"]["to"] = [0.4, 0.7, 0.1]
    if inside < 0.02:
        with pytest.raises(ho.InputError, match="farther in") as caught:
            solved(given)
        assert caught.value.key == "mission[0]"
    else:
        assert solved(given).certificate.certified


@pytest.mark.slow
def test_a_grip_that_hardly_holds_is_moved_more_gently() -> None:
    angles = -2.0 * np.pi * np.arange(3) / 3.0
    polygon = 0.56 * np.column_stack([np.cos(angles), np.sin(angles)])
    drum = {"circle": 0.2, "mass": 0.114, "friction": 0.5, "at": [0.0, 0.0, 0.0]}
    given = {
        "team": {"robots": 3, "cable_length": 1.6, "tension": 1.0, "cable_friction": 0.15},
        "limits": {"tilt_deg": 60},
        "objects": {"drum": drum},
        "start": {"hitch": {"polygon": polygon.tolist(), "altitude": 1.0}},
        "mission": [{"transport_object": {"object": "drum", "to": [0, 1, 0], "tension": 1.3}}],
    }
    heavy = solved(given)
    worst = heavy.certificate["grip"].worst
    assert worst is not None
    assert 1.5 <= worst < 1.52
    drum["mass"] = 0.1
    light = solved(given)
    assert heavy.duration > light.duration + 1.0


@pytest.mark.slow
def test_clasps_rise_to_a_rim_as_slowly_as_tilt_needs() -> None:
    given = tray(3, 0.3, 2.04, radius=0.5)
    given["limits"] = {"tilt_deg": 45}
    given["team"] |= {"tension": 1.29, "cable_density": 0.0}
    tilt = solved(given).certificate["tilt"].worst
    assert tilt is not None
    assert 44.8 < tilt <= 45.0


@pytest.mark.slow
@pytest.mark.parametrize("height", [0.07, 0.08, 0.085])
def test_cables_around_an_object_keep_off_the_ground(height: float) -> None:
    given = tray(4, 0.2, 2.2)
    given["objects"]["tray"]["rim"]["at"] = height
    if height < 0.08:
        (violation,) = refusal(given).violations
        assert violation.constraint == "object_clearance"
        assert violation.value == pytest.approx(height - 0.045)
    else:
        motion = solved(given).motion
        lowest = np.min(motion.vertices.coefficients[:, :, 2])
        assert lowest == pytest.approx(height - 0.045, abs=1e-6)


@pytest.mark.slow
def test_a_plan_below_the_ground_is_not_certified() -> None:
    motion = tray_of_four()
    bodies = motion.requirements.objects
    requirements = replace(
        motion.requirements,
        arena=ho.Arena([-9.0, -9.0, 0.22], [9.0, 9.0, 9.0]),
        objects={name: replace(each, fixed=True) for name, each in bodies.items()},
    )
    found = certify(replace(motion, requirements=requirements))["object_clearance"]
    assert found.worst == 0.0
    assert found.where[1] == "ground"
    assert np.min(motion.vertices.at(found.time)[..., 2]) < 0.22
    higher = replace(requirements, arena=ho.Arena([-9.0, -9.0, 0.2], [9.0, 9.0, 9.0]))
    kept = certify(replace(motion, requirements=higher))["object_clearance"]
    assert kept.where == ("tray", "ground")  # not a cable


@pytest.mark.parametrize("away", [0.0, 1.0, 5.0, -300.0])
def test_how_wide_an_object_stands_does_not_depend_on_its_origin(away: float) -> None:
    square = 0.1 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) + away
    post = ho.SolidObject(ho.Section(radius=0.06), 0.0, 0.5, fixed=True)
    box = ho.SolidObject(ho.Section(square), at=[-away, -away, 0.5])
    assert footing({"post": post, "box": box}, "box") == pytest.approx(0.06, abs=0.003)
    thin = ho.SolidObject(ho.Section(radius=1e-4), 0.0, 0.5, at=[1e-3, 5e-4, 0.0], fixed=True)
    assert footing({"post": thin, "box": box}, "box") <= 0.002
    assert footing({"box": box}, "box") == np.inf


@pytest.mark.slow
def test_lifts_near_the_largest_load_are_balanced() -> None:
    angles = -0.5 * np.pi * np.arange(4)
    polygon = 0.386 * np.column_stack([np.cos(angles), np.sin(angles)])
    body = {"circle": 0.0875, "to": 0.239, "mass": 0.225, "rim": {"circle": 0.3055, "at": 0.192}}
    given = {
        "team": {"robots": 4, "cable_length": 1.3, "tension": 0.51, "cable_density": 0.01},
        "objects": {"tray": {**body, "at": [1.2, 0.3, 0.0], "yaw_deg": 30.0}},
        "start": {"hitch": {"polygon": polygon.tolist(), "altitude": 1.3}},
        "mission": [{"transport_object": {"object": "tray", "to": [0.2, 1.5, 0], "yaw_deg": 45}}],
    }
    worst = solved(given).certificate["equilibrium"].worst
    assert worst is not None
    assert 0.002 < worst <= 0.005


def test_bends_of_edges_below_the_ground_count() -> None:
    motion = tray_of_four()
    kept = OBJECT_CLEARANCE.check(motion)
    assert kept is not None
    assert kept.holds
    bends = np.ones((motion.drones.pieces, 4, 2, 3, 1))
    bends[:, 1, 0, 2] = -0.3
    found = OBJECT_CLEARANCE.check(replace(motion, contacts=motion.drones.alike(bends)))
    assert found is not None
    assert (found.worst, found.where) == (0.0, ("cable 1", "ground"))


def test_grips_of_four_cables_are_polygons_that_turn_once_around() -> None:
    """The search has returned squares listed the wrong way round, which nothing can take."""
    for radius, length, tension, mass, friction in (
        (0.1174, 1.4968, 0.7192, 0.1989, 0.6969),
        (0.0703, 2.5027, 1.4468, 0.0281, 1.0131),
    ):
        team = ho.Team(4, length, tension=tension, cable_density=0.01, cable_friction=0.15)
        drum = ho.SolidObject(ho.Section(radius=radius), mass=mass, friction=friction)
        limits = Requirements(ho.Limits(tilt_deg=60))
        with pytest.raises(ho.InfeasibleError, match="use three cables"):
            grip_polygons("drum", drum, team, limits, 0.08)


def test_a_rim_with_too_little_room_points_at_fit() -> None:
    crate = ho.SolidObject(
        ho.Section([[-0.25, -0.25], [0.25, -0.25], [0.25, 0.25], [-0.25, 0.25]]),
        rim=ho.Rim(ho.Section([[-0.3, -0.3], [0.3, -0.3], [0.3, 0.3], [-0.3, 0.3]]), 0.2),
    )
    with pytest.raises(ho.InfeasibleError, match="hitchopt fit") as caught:
        rest_polygons("crate", crate, 6, 0.08)
    assert caught.value.violations[0].constraint == "support"
