"""Every field of a team survives what copies or stores teams; a new field fails until it does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from hitchopt import Hitch, Limits, Quadrotor, Separation, Team
from hitchopt.hitch.assignment import Assignment
from hitchopt.mission import repair
from hitchopt.mission.problem import HitchStart, Problem
from hitchopt.steps import Hold

ORDER = (2, 0, 3, 1)

VALUES: dict[str, Any] = {
    "robots": 4,
    "cable_length": [2.4, 2.5, 2.6, 2.7],
    "topology": "open",
    "cable_density": 0.003,
    "cable_friction": 0.05,
    "tension": [0.41, 0.42, 0.43, 0.44],
    "quadrotor": tuple(
        Quadrotor(0.1 + 0.01 * k, 2.0 + 0.1 * k, 4.0 + k if k else None, k == 1, k != 2)
        for k in range(4)
    ),
    "load": [0.001, 0.002, 0.003],
}
"""One value for every field of a team, none its default; those per robot or clasp all differ."""

AT_PLACES = "load"
"""The field of what hangs at the hitch's inner points, whichever robots hold them."""

ARC = [[-1.0, 0.0], [-0.5, 0.9], [0.5, 1.1], [1.4, 0.7], [1.7, -0.3]]


def team() -> Team:
    return Team(**VALUES)


def per_robot(name: str) -> bool:
    return isinstance(VALUES[name], list | tuple) and name != AT_PLACES


def assert_fields(found: Team, expected: Team, *, but: tuple[str, ...] = ()) -> None:
    for field in fields(Team):
        if field.name in but:
            continue
        value = getattr(found, field.name)
        np.testing.assert_array_equal(value, getattr(expected, field.name), err_msg=field.name)
        assert type(value) is type(getattr(expected, field.name)), field.name


def test_values_are_given_for_every_field_and_none_is_a_default() -> None:
    assert set(VALUES) == {field.name for field in fields(Team)}
    plain = Team(3, 1.0)
    for field in fields(Team):
        value, default = getattr(team(), field.name), getattr(plain, field.name)
        assert not np.array_equal(value, default), field.name
        if per_robot(field.name):
            assert len(value) == len(set(value)) == 4, field.name
    assert len(set(VALUES[AT_PLACES])) == 3


def test_a_renumbered_team_has_every_field() -> None:
    found = Assignment(ORDER, (False, True, False, True)).team(team())
    for field in fields(Team):
        value = VALUES[field.name]
        expected = [value[i] for i in ORDER] if per_robot(field.name) else value
        np.testing.assert_array_equal(getattr(found, field.name), expected, err_msg=field.name)


@pytest.mark.parametrize(
    ("edit", "changed"),
    [
        (
            lambda p: (repair.team_edit(p, "cable_length", p.team.cable_length * 1.1),),
            "cable_length",
        ),
        (lambda p: (repair.team_edit(p, "tension", p.team.tension * 1.1),), "tension"),
        (
            lambda p: (repair.team_edit(p, "max_thrust", 1.1 * p.team.max_thrust[::2]),),
            "quadrotor",
        ),
        (lambda _: (repair.Edit("limits.tilt_deg", 50.0),), ""),
        (lambda p: repair.outlines_scaled(p, 0.9), ""),
    ],
)
def test_a_repaired_problem_has_every_field(edit: Callable[[Problem], Any], changed: str) -> None:
    hitch = Hitch.balanced(team(), ARC, 1.1)
    start = HitchStart(hitch.polygon, 1.1, "balanced")
    problem = Problem(team(), start, (Hold(2.0),), Limits(), Separation(), None, "")
    found = repair.with_edits(problem, edit(problem))
    assert found is not problem
    assert_fields(found.team, team(), but=(changed,))
    if changed:
        value = getattr(found.team, changed)
        assert not np.array_equal(value, getattr(team(), changed))
