"""Holds near their limits: feasible plans, and messages of refusals."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.carrying.moves import SmoothLaw
from hitchopt.objects.placing import footing
from tests.helpers import carried_plans as plans


def hold(
    body: dict[str, Any], robots: int, length: float, *, radius: float = 0.45, **keys: Any
) -> dict[str, Any]:
    """Return the problem of moving a body with cables of a length [m]; keys of team and step."""
    edge = 2.0 * radius * np.sin(np.pi / robots)
    polygon = ho.regular_polygon(robots, edge, 0.3).translated([0.4, -0.3]).vertices
    step = {name: keys.pop(name) for name in ("tension", "yaw_deg") if name in keys}
    team = {"robots": robots, "cable_length": length, "tension": 1.0, "cable_density": 0.01}
    return {
        "team": team | keys,
        "limits": {"tilt_deg": 60},
        "objects": {"body": {"at": [0.4, -0.3, 0.0], **body}},
        "start": {"hitch": {"polygon": polygon.tolist(), "altitude": 1.0}},
        "mission": [{"transport_object": {"object": "body", "to": [0.4, 0.7, 0.0], **step}}],
    }


def tray(robots: int, mass: float, length: float, **keys: Any) -> dict[str, Any]:
    rim = {"circle": 0.3, "at": keys.pop("at", 0.25)}
    return hold({"circle": 0.08, "to": 0.3, "mass": mass, "rim": rim}, robots, length, **keys)


def solved(problem: dict[str, Any]) -> ho.Plan:
    return ho.solve(ho.problem_from_dict(problem))


DRUM = {"circle": 0.2, "mass": 0.114, "friction": 0.5}
TILTED = tray(3, 0.3, 2.04, radius=0.5) | {"limits": {"tilt_deg": 45}}
TILTED["team"] |= {"tension": 1.29, "cable_density": 0.0}
PLANNED: dict[str, tuple[dict[str, Any], str, float, float]] = {
    "inertia does not bring legs together": (tray(5, 0.4, 2.2), "crossing", 0.05, 1.0),
    "clasps rise as slowly as tilt needs": (TILTED, "tilt", 44.8, 45.0),
    "cables keep off the ground": (tray(4, 0.2, 2.2, at=0.08), "object_clearance", 0.035, 1.0),
    "a grip that hardly holds is moved gently": (
        hold(DRUM, 3, 1.6, radius=0.56, tension=1.3, cable_friction=0.15, cable_density=0.0),
        "grip", 1.5, 1.52,
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANNED)
def test_holds_near_a_limit_are_planned(name: str) -> None:
    problem, check, least, most = PLANNED[name]
    worst = solved(problem).certificate[check].worst
    assert least <= worst <= most


def steps_of(problem: dict[str, Any], *steps: dict[str, Any]) -> dict[str, Any]:
    return {**problem, "mission": list(steps)}


ENCLOSED, LEFT = {"enclose": {"object": "tray"}}, {"leave": {"object": "tray"}}
ENCLOSED_DRUM = {"enclose": {"object": "drum"}}
ON_TOP = plans.tray()
ON_TOP["objects"]["cup"] = {"circle": 0.03, "to": 0.1, "mass": 0.02, "at": [1.1, 0.2, 0.3]}
TENSE = plans.tray() | {"limits": {}}
TENSE["mission"][0]["transport_object"]["tension"] = 1.6
# Six straight parts with 1.3 N each lift 7.8 N at most, were they upright.
LOADED = plans.drum(mass=0.82, friction=3.0)
LOADED["limits"]["tilt_deg"] = 70
LOADED["team"] |= {"cable_length": 2.15, "cable_friction": 0.0, "cable_density": 0.0}
PX4_DRUM = plans.drum() | {"limits": {"tilt_deg": 60, "tracking": 0.001}}
PX4_DRUM["team"]["quadrotor"] = {"mass": 0.132, "max_thrust": 2.6, "controller": "px4"}
LOW = plans.tray() | {"arena": {"lower": [-3, -3, 0], "upper": [3, 3, 0.53]}}
LOW["start"]["hitch"]["altitude"] = 0.5
SMALL = plans.drum()
SMALL["start"]["hitch"]["polygon"] = [[1.7, 0.2], [1.1, -0.1464], [1.1, 0.5464]]
SMALL["team"] |= {"cable_friction": 0.15, "cable_density": 0.0}
EDGE = tray(4, 0.2, 2.2)
EDGE["objects"]["table"] = {"circle": 0.3, "to": 0.1, "fixed": True, "at": [0.685, 0.7, 0.0]}
EDGE["mission"][0]["transport_object"]["to"] = [0.4, 0.7, 0.1]
CRATE, TRAY = ([[-half, -half], [half, -half], [half, half], [-half, half]] for half in (0.25, 0.3))
NARROW = {"outline": CRATE, "rim": {"outline": TRAY, "at": 0.2}}
REFUSED: list[tuple[dict[str, Any], str, str]] = [
    (plans.tray(mass=0.6), "load", r"lower objects.tray.mass"),
    (plans.tray(rim={"circle": 0.12, "at": 0.25}), "support", "widen the rim of objects.tray"),
    (hold(NARROW, 6, 2.2), "support", "hitchopt fit"),
    (tray(4, 0.2, 2.2, at=0.07), "object_clearance", "or raise its support"),
    (TENSE, "tilt", "limits.tilt_deg"),
    (plans.tray(rim={"outline": [[1, 1], [2, 1], [1, 2]], "at": 0.25}), "objects.tray.rim", "rim"),
    (plans.tray(friction=0.0), "objects.tray.friction", "only friction moves it along"),
    (ON_TOP, "objects.cup.at", "carry objects.cup away"),
    (EDGE, "mission[0]", "farther from the edge"),
    (steps_of(LOW, ENCLOSED), "arena", r"at the end of step 0 \(enclose\)"),
    (steps_of(SMALL, ENCLOSED_DRUM), "equilibrium", r"objects\.drum \(0\.5\d? m in radius\)"),
    (steps_of(plans.tray(), {"lift": {"by": 0.2}}), "mission[0].lift",
     "lift needs a grasped object, and there is"),
    (steps_of(plans.tray(), ENCLOSED, LEFT, {"move_vertex": {"vertex": 0, "by": [0.1, 0]}}),
     "mission[2].move_vertex", "morph first"),
    (steps_of(plans.tray(), {"enclose": {"object": "table"}}), "objects.table.fixed",
     "false if it is lifted"),
    ({**plans.drum(), "limits": {}}, "tilt", "need limits.tilt_deg of 51, above 45.*1.29 N or"),
    (PX4_DRUM, "tilt", "of 1.3 N need a tilt of 45.1°, but the controllers tilt by at most 45°; or "
     "grasp with a tension of 1.29 N or less"),
    (plans.drum(mass=0.13), "grip", r"lower objects.drum.mass, or "),
    (steps_of(plans.drum(), ENCLOSED_DRUM, {"grasp": {"object": "drum"}}), "objects.drum.rim",
     "grasp it by: grip"),
    (LOADED, "load", "lower objects.drum.mass"),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("problem", "name", "words"), REFUSED)
def test_infeasible_holds_are_refused(problem: dict[str, Any], name: str, words: str) -> None:
    """By the key of the file, or by the limit that binds; with what to change."""
    with pytest.raises(ho.HitchoptError, match=words) as caught:
        solved(problem)
    told = {getattr(caught.value, "key", "")}
    if isinstance(caught.value, ho.InfeasibleError):
        told = {violation.constraint for violation in caught.value.violations}
    assert name in told


IN_THE_AIR = plans.tray()
IN_THE_AIR["mission"][0]["transport_object"]["to"] = [0.5, -1.5, 0.6]


@pytest.mark.parametrize(
    ("problem", "words"),
    [
        (
            plans.tray(mass=5.0),
            r"load: 5 kg is above .* these drones lift 0\.798 kg",
        ),
        (IN_THE_AIR, r"to = \[0\.5, -1\.5, 0\.6\]: must be on what is below it, at 0 m; write"),
    ],
)
def test_what_no_hold_can_change_is_refused_at_once(problem: dict[str, Any], words: str) -> None:
    with pytest.raises(ho.HitchoptError, match=words):
        solved(problem)


@pytest.mark.slow
def test_holds_with_a_reserve_are_preferred_and_carried_without_slowing() -> None:
    """Other holds of this tray keep drones just apart at rest: slowed down, they take 230 s."""
    rim = {"circle": 0.248, "at": 0.44}
    body = {"circle": 0.063, "to": 0.49, "mass": 0.3037, "rim": rim}
    team = {"tension": 0.91, "cable_density": 0.003}
    plan = solved(hold(body, 5, 0.91, **team))
    assert plan.certificate.certified
    assert not any("slowed down" in phase.remark for phase in plan.phases)


@pytest.mark.slow
def test_hitches_rise_above_what_they_pass_alone() -> None:
    """A tall post far from the way changes nothing."""
    problem = steps_of(plans.tray(), ENCLOSED, LEFT)
    low = solved(problem)
    post = {"circle": 0.05, "to": 3.0, "at": [-4.0, -4.0, 0.0], "fixed": True}
    far = solved({**problem, "objects": {**problem["objects"], "post": post}})
    assert far.duration == pytest.approx(low.duration, rel=1e-6)


def test_bends_of_edges_below_the_ground_count() -> None:
    motion = plans.plan("drum").motion
    lowered = motion.contacts.coefficients.copy()
    lowered[:, 1, 0, 2] = -0.3
    below = replace(motion, contacts=motion.contacts.replaced(lowered))
    found = plans.check(below, "object_clearance")
    assert (found.worst, found.where) == (0.0, ("cable 1", "ground"))


@pytest.mark.filterwarnings("ignore::hitchopt.UnitWarning")
@pytest.mark.parametrize("away", [0.0, -300.0])
def test_footings_do_not_depend_on_origins(away: float) -> None:
    square = 0.1 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) + away
    post = ho.SolidObject(ho.Section(radius=0.06), 0.0, 0.5, fixed=True)
    box = ho.SolidObject(ho.Section(square), at=[-away, -away, 0.5])
    assert footing({"post": post, "box": box}, "box") == pytest.approx(0.06, abs=0.003)
    thin = ho.SolidObject(ho.Section(radius=1e-4), 0.0, 0.5, at=[1e-3, 5e-4, 0.0], fixed=True)
    assert footing({"post": thin, "box": box}, "box") <= 0.002
    assert footing({"box": box}, "box") == np.inf


@pytest.mark.parametrize("cruise", [0.0, 1e-8, 1e-4, 1.0])
def test_no_piece_is_so_short_that_its_accelerations_are_rounding(cruise: float) -> None:
    law = SmoothLaw(0.6, cruise)
    breaks = law.breaks(0.5)
    assert np.min(np.diff(breaks)) > 1e-3
    assert breaks[[0, -1]].tolist() == [0.0, law.duration]
