"""Every field of a team survives what copies or stores teams; a new field fails until it does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from hitchopt import Hitch, Quadrotor, Team
from hitchopt.hitch.team import Assignment
from hitchopt.mission.problem import HitchStart, Problem
from hitchopt.mission.repair import Edit, outlines_scaled, team_edit, with_edits
from hitchopt.steps import Hold

ORDER = (2, 0, 3, 1)
KINDS = [
    Quadrotor(0.1 + 0.01 * k, 2.0 + 0.1 * k, 4.0 + k if k else None, k == 1, k != 2)
    for k in range(4)
]
VALUES: dict[str, Any] = {
    "robots": 4,
    "cable_length": [2.4, 2.5, 2.6, 2.7],
    "topology": "open",
    "cable_density": 0.003,
    "cable_friction": 0.05,
    "tension": [0.41, 0.42, 0.43, 0.44],
    "quadrotor": tuple(KINDS),
    "load": [0.001, 0.002, 0.003],
}
"""One value for every field of a team, none its default; those per robot all differ."""

PER_ROBOT = {"cable_length", "tension", "quadrotor"}
ARC = [[-1.0, 0.0], [-0.5, 0.9], [0.5, 1.1], [1.4, 0.7], [1.7, -0.3]]
TEAM = Team(**VALUES)


def test_a_renumbered_team_has_every_field_and_none_here_is_a_default() -> None:
    assert set(VALUES) == {field.name for field in fields(Team)}
    found, plain = Assignment(ORDER, (False, True, False, True)).team(TEAM), Team(3, 1.0)
    for name, value in VALUES.items():
        assert not np.array_equal(getattr(TEAM, name), getattr(plain, name)), name
        expected = [value[i] for i in ORDER] if name in PER_ROBOT else value
        np.testing.assert_array_equal(getattr(found, name), expected, err_msg=name)


@pytest.mark.parametrize(
    ("edit", "changed"),
    [
        (lambda p: (team_edit(p, "cable_length", 1.1 * p.team.cable_length),), "cable_length"),
        (lambda p: (team_edit(p, "tension", 1.1 * p.team.tension),), "tension"),
        (lambda p: (team_edit(p, "max_thrust", 1.1 * p.team.max_thrust[::2]),), "quadrotor"),
        (lambda _: (Edit("limits.tilt_deg", 50.0),), ""),
        (lambda p: outlines_scaled(p, 0.9), ""),
    ],
)
def test_a_repaired_problem_has_every_field(edit: Callable[[Problem], Any], changed: str) -> None:
    start = HitchStart(Hitch.balanced(TEAM, ARC, 1.1).polygon, 1.1, "balanced")
    problem = Problem(TEAM, start, (Hold(2.0),))
    found = with_edits(problem, edit(problem))
    assert found is not problem
    for field in fields(Team):
        values = [getattr(each, field.name) for each in (found.team, TEAM)]
        assert np.array_equal(*values) is (field.name != changed), field.name
        assert type(values[0]) is type(values[1]), field.name
