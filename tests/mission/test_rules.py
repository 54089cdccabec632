"""Plans are refused where they violate a custom rule."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

import hitchopt as ho
from hitchopt.mission.loading import problem_from_dict
from tests.helpers.custom_rules import leg_angle

TEAM = ho.Team(robots=3, cable_length=[2.4, 2.5, 2.3])
START = ho.Hitch.spread(TEAM, [[2.0, -1.5], [1.6, -0.5], [2.4, -0.5]])
NEAR = [[2.0, -1.7], [1.6, -0.5], [2.4, -0.5]]
FAR = [[2.0, -2.0], [1.6, -0.5], [2.4, -0.5]]


def ceiling(limit: float) -> ho.Rule[ho.DroneSpans]:
    """Return an upper limit of the height of drones."""
    return ho.Rule("ceiling", "m", "max", limit, ho.DroneSpans, lambda drone: drone.position[2])


def test_missions_keep_their_rules_or_are_refused() -> None:
    rules = [leg_angle(35.0)]
    plan = ho.solve(START, ho.Morph(NEAR), rules=rules)
    assert plan.certificate["leg_angle"].custom
    assert plan.certificate["leg_angle"].holds
    with pytest.raises(ho.InfeasibleError) as caught:
        ho.solve(START, [ho.Hold(1.0), ho.Morph(FAR)], rules=rules)
    (violation,) = caught.value.violations
    assert (violation.constraint, violation.limit, violation.where) == ("leg_angle", 35.0, ("p0",))
    assert "in step 1 (morph)" in violation.moment
    assert violation.remedy == "keep vertices apart"


def test_rules_change_no_motion() -> None:
    bare = ho.solve(START, ho.Morph(NEAR))
    ruled = ho.solve(START, ho.Morph(NEAR), rules=[leg_angle(35.0)])
    assert ruled.motion.drones.coefficients.tobytes() == bare.motion.drones.coefficients.tobytes()
    assert ruled.certificate.limited[:-1] == bare.certificate.limited


def test_solve_adds_rules_to_those_of_a_problem() -> None:
    mission = ho.Problem(TEAM, START, [ho.Hold(1.0)], rules=[leg_angle(35.0)])
    plan = ho.solve(mission, rules=[ceiling(1.5)])
    assert [x.name for x in plan.certificate.limited if x.custom] == ["leg_angle", "ceiling"]
    with pytest.raises(ho.InfeasibleError, match=r"ceiling: 1 m is above the limit of 0\.5 m"):
        ho.solve(mission, rules=[ceiling(0.5)])


def test_suggested_changes_keep_rules() -> None:
    """Lower drones break the rule, so that the only remedy of the arena is not suggested."""
    arena = ho.Arena([0, -4, 0.0], [4, 4, 1.0])
    stated: dict[str, Any] = {"start": ho.HitchStart(START.polygon, 1.05), "arena": arena}
    high = ho.Rule("high", "m", "min", 1.04, ho.DroneSpans, lambda drone: drone.position[2])
    problem = ho.Problem(TEAM, mission=[ho.Hold(1.0)], **stated)
    assert ho.suggestions(problem)
    ruled = replace(problem, rules=[high])
    changes = [str(each) for each in ho.suggestions(ruled)]
    assert not any("altitude" in each for each in changes)


def test_rules_hold_for_every_team() -> None:
    ring = {"polygon": [[0, -1], [-0.4, 0.5], [0.4, 0.5]], "altitude": 1.0}
    far = {**ring, "polygon": [[6, -1], [5.6, 0.5], [6.4, 0.5]], "altitude": 1.4}
    problem = problem_from_dict(
        {
            "teams": {name: {"robots": 3, "cable_length": 2.4} for name in "ab"},
            "start": {"a": {"hitch": ring}, "b": {"hitch": far}},
            "mission": [{"a": {"hold": {"seconds": 1.0}}, "b": {"hold": {"seconds": 1.0}}}],
        }
    )
    assert ho.solve(problem, rules=[ceiling(1.5)]).certificate["ceiling"].where[0][:2] == "b."
    with pytest.raises(ho.InfeasibleError, match=r"ceiling: 1\.4 m is above .* at b\."):
        ho.solve(problem, rules=[ceiling(1.2)])


def test_problems_refuse_rules_with_names_of_checks() -> None:
    rule = ho.Rule("speed", "m/s", "max", 1.0, ho.DroneSpans, lambda drone: drone.velocity.norm)
    with pytest.raises(ho.InputError, match=r"rules\[0\].name = 'speed'"):
        ho.Problem(TEAM, START, [ho.Hold(1.0)], rules=[rule])
    with pytest.raises(ho.InputError, match="rules = 3: must be a list"):
        ho.solve(ho.Problem(TEAM, START, [ho.Hold(1.0)]), rules=3)  # type: ignore[arg-type]
