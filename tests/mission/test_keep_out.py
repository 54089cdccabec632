"""Prisms beside hitches: fixed objects that the plan, its certificate and ``verify`` know."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import verify
from hitchopt.mission.loading import parse_problem, problem_from_dict

OUTLINE = [[-0.15, 1.0], [-0.05, 1.2], [0.1, 1.0]]
PROBLEM = """
team: {robots: 3, cable_length: 2.4}
start: {hitch: {polygon: [[-1.4, -0.1], [-1.1, 0.5], [-0.8, 0.0]], altitude: 1.4}}
keep_out: [{polygon: [[-0.15, 1.0], [-0.05, 1.2], [0.1, 1.0]], lower: 0.5, upper: 3.0}]
mission: [{transport: {to: [1.0, 1.0, 1.4]}}]
"""


@cache
def planned() -> ho.Plan:
    return ho.solve(parse_problem(PROBLEM))


def test_a_prism_is_a_fixed_object_to_a_hitch() -> None:
    problem = parse_problem(PROBLEM)
    (body,) = problem.objects.values()
    corners = body.section.core + body.at[:2]
    np.testing.assert_allclose(corners, OUTLINE, atol=1e-12)
    assert (body.at[2] + body.lower, body.at[2] + body.upper) == (0.5, 3.0)
    assert body.fixed
    assert not problem.keep_out
    again = replace(problem, keep_out=())
    assert again == problem


def test_hitches_pass_prisms_as_they_pass_objects(tmp_path: Path) -> None:
    plan = planned()
    assert plan.certificate["keep_out"].holds
    assert plan.certificate["object_clearance"].holds
    assert plan.certificate["object_clearance"].where[-1] == "prism_0"
    section = ho.Section(OUTLINE)
    body = ho.SolidObject(section, lower=0.5, upper=3.0, fixed=True)
    problem = replace(parse_problem(PROBLEM), objects={"post": body})
    assert ho.solve(problem).duration == pytest.approx(plan.duration, rel=1e-3)
    replace(plan, problem=PROBLEM).save(tmp_path)
    assert all(row.verdict in verify.PASSING for row in verify.verify(tmp_path))


@pytest.mark.parametrize(
    ("stated", "lie"),
    [("upper: 3.0", "upper: 3.1"), ("[0.1, 1.0]", "[0.12, 1.0]"), ("lower: 0.5", "lower: 0.4")],
)
def test_verify_refuses_plans_with_other_prisms(stated: str, lie: str, tmp_path: Path) -> None:
    assert stated in PROBLEM
    replace(planned(), problem=PROBLEM.replace(stated, lie)).save(tmp_path)
    (row,) = (row for row in verify.verify(tmp_path) if row.name == "request")
    assert row.verdict not in verify.PASSING


def test_prisms_are_obstacles_to_all_teams() -> None:
    hitch = {"polygon": [[-1.4, -3.1], [-1.1, -2.5], [-0.8, -3.0]], "altitude": 1.4}
    problem: dict[str, Any] = {
        "teams": {"a": {"robots": 3, "cable_length": 2.4}, "b": {"drones": 1}},
        "start": {"a": {"hitch": hitch}, "b": [[-0.6, 1.3, 1.0]]},
        "mission": [{"a": {"hold": {"seconds": 1.0}}, "b": {"fly": {"goal": [[0.6, 1.0, 1.0]]}}}],
        "keep_out": [{"polygon": OUTLINE, "lower": 0.5, "upper": 3.0}],
    }
    missions = problem_from_dict(problem).teams
    assert all([*each.requirements.objects] == ["prism_0"] for each in missions.values())
    check = ho.solve(problem_from_dict(problem)).certificate["keep_out"]
    assert set(check.where) == {"b.d0", "prism_0"}
    assert check.worst >= 0.12


def test_objects_cannot_have_the_names_of_prisms() -> None:
    body = ho.SolidObject(ho.Section(OUTLINE), fixed=True)
    prism = ho.Prism(OUTLINE, 0.0, 1.0)
    problem = parse_problem(PROBLEM)
    with pytest.raises(ho.InputError, match=r"prism_0.: must be another name .* of keep_out"):
        replace(problem, objects={"prism_0": body}, keep_out=(prism,))
