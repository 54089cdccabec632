"""Values at the ends of the ranges that are read lead to plans, or to our errors, in time."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.hitch.energy import solutions_of
from hitchopt.mission.loading import problem_from_dict, problem_schema

SECONDS = 4.0  # Time limit of planning; a plan without a result by then is refused

BASE: dict[str, Any] = {
    "team": {
        "robots": 3,
        "cable_length": 2.4,
        "tension": 0.5,
        "cable_friction": 0.1,
        "cable_density": 0.002,
        "quadrotor": {"mass": 0.132, "max_thrust": 2.6},
    },
    "start": {"hitch": {"polygon": [[1, 0.75], [1.65, -0.375], [0.35, -0.375]], "altitude": 1.2}},
    "mission": [{"move_vertex": {"vertex": 0, "by": [0.05, 0.1], "settle": False}}],
}
STEPS: dict[str, dict[str, Any]] = {
    "hold": {"seconds": 1.0},
    "move_vertex": {"vertex": 0, "by": [0.05, 0.1], "settle": False},
    "transport": {"to": [1.1, 0.1, 1.3]},
}
"""Missions of one step each; keys of other steps are of the same kinds."""

SECTIONS = {"team": "Team", "limits": "Limits", "separation": "Separation"}
"""Sections of a problem, and the names of their records in the schema."""

FAST = {"seconds", "tension", "mass", "max_thrust", "latency", "tilt_deg", "body_rate_deg"}
"""Keys whose values are refused, or planned, in less than a second."""

Place = tuple[str | int, ...]
Value = float | list[float]


def ends(schema: dict[str, Any]) -> Iterator[Value]:
    """Yield the ends of the ranges of a number, or of a range of numbers, in a schema."""
    for option in schema.get("anyOf", schema.get("oneOf", ())):
        yield from ends(option)
    if schema.get("type") == "number":
        yield from (float(schema[end]) for end in ("minimum", "maximum") if end in schema)


def cases() -> Iterator[tuple[Place, Value]]:
    """Yield the places of keys of a problem, with the ends of their ranges."""
    records = problem_schema()["$defs"]
    places: list[tuple[Place, str]] = [((key,), name) for key, name in SECTIONS.items()]
    places += [(("team", "quadrotor"), "Quadrotor"), (("team", "errors"), "Errors")]
    names = {"hold": "Hold", "move_vertex": "MoveVertex", "transport": "Transport"}
    places += [(("mission", 0, step), names[step]) for step in STEPS]
    for place, name in places:
        for key, schema in records[name]["properties"].items():
            yield from (((*place, key), value) for value in ends(schema))


def problem_with(place: Place, value: Value) -> dict[str, Any]:
    """Return a problem with a value at a place."""
    data = copy.deepcopy(BASE)
    if place[0] == "mission":
        data["mission"] = [{place[2]: copy.deepcopy(STEPS[str(place[2])])}]
    section: Any = data
    for key in place[:-1]:
        section = section[key] if isinstance(key, int) else section.setdefault(key, {})
    section[place[-1]] = value
    return data


def outcome(place: Place, value: Value) -> ho.Plan | ho.HitchoptError:
    """Return how planning a problem ends: with a plan, or with our error."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ho.UnitWarning)
        try:
            return ho.solve(problem_from_dict(problem_with(place, value)), limit=SECONDS)
        except ho.HitchoptError as error:
            return error


FRICTION: Place = "team", "cable_friction"
CASES = [*cases(), *((FRICTION, value) for value in (50.0, 1e3, 1e9, [0.0, 1e9]))]


@pytest.mark.parametrize(
    ("place", "value"),
    [pytest.param(*case, marks=() if case[0][-1] in FAST else pytest.mark.slow) for case in CASES],
)
def test_ends_of_ranges_lead_to_plans_or_our_errors(place: Place, value: Value) -> None:
    assert "please report" not in str(outcome(place, value))


def test_what_takes_too_many_samples_names_the_step(tmp_path: Path) -> None:
    with pytest.warns(ho.UnitWarning, match="seconds"):
        problem = problem_from_dict(problem_with(("mission", 0, "hold", "seconds"), 1e6))
    with pytest.raises(ho.InputError, match=r"rate = 100.*; shorten step 0 \(hold\), .* 1e\+06 s"):
        ho.solve(problem).save(tmp_path)


def test_singular_samples_have_no_solution_and_leave_others_alone() -> None:
    matrices = np.array([np.eye(3), np.zeros((3, 3)), 2.0 * np.eye(3)])
    solutions = solutions_of(matrices, np.ones((3, 3, 2)))
    np.testing.assert_array_equal(solutions[:, 0, 0], [1.0, np.nan, 0.5])
