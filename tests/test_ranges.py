"""Values at the ends of the ranges that are read lead to plans, or to our errors, in time."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable, Iterator
from functools import cache
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


EXTREMES = (0.0, 1e-300, 1e-12, 1e3, 1e9, 1e300, -1e-12, -1.0, -1e300, np.nan, np.inf)
TRIANGLE = np.array([[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]])
SQUARE = np.array([[0.2, 0.2], [-0.2, 0.2], [-0.2, -0.2], [0.2, -0.2]])


@cache
def started() -> ho.Hitch:
    team = ho.Team(3, 2.4, cable_friction=0.1, cable_density=0.003)
    return ho.Hitch.spread(team, TRIANGLE, altitude=1.2)


@cache
def moved() -> ho.Plan:
    return ho.solve(started(), ho.Transport(to=[0.3, 0.0, 1.2]))


def player() -> ho.Player:
    return ho.Player(moved(), 0.4)


def linted(row: Callable[[int], str], folder: Path) -> object:
    """Lint a table of a drone's path with twenty rows ``t,x``."""
    rows = "".join(f"{row(i)},0,1\n" for i in range(20))
    (folder / "flight.csv").write_text(f"t,x,y,z\n{rows}")
    return ho.lint(folder / "flight.csv")


CALLS: dict[str, Callable[[Any, Path], object]] = {
    "at": lambda x, _: moved().at(x),
    "at some": lambda x, _: moved().at([0.1, x]),
    "abort": lambda x, _: moved().abort(x, "hold"),
    "after_loss": lambda x, _: moved().after_loss(0, x),
    "step": lambda x, _: player().step(x),
    "rate": lambda x, _: player().rate(x),
    "seek": lambda x, _: player().seek(x),
    "Player": lambda x, _: ho.Player(moved(), x),
    "Player at a rate": lambda x, _: ho.Player(moved(), 0.1, x),
    "certify": lambda x, _: ho.certify(moved().flight, gamma=x, reports=()),
    "combine": lambda x, _: ho.combine(moved(), moved(), at=x),
    "regular_polygon": lambda x, _: ho.regular_polygon(3, x),
    "regular_polygon at an angle": lambda x, _: ho.regular_polygon(3, 1.0, x),
    "spread": lambda x, _: ho.Hitch.spread(started().team, TRIANGLE, x),
    "spread of another size": lambda x, _: ho.Hitch.spread(started().team, x * TRIANGLE, 1.2),
    "spread elsewhere": lambda x, _: ho.Hitch.spread(started().team, x + TRIANGLE, 1.2),
    "time": lambda x, _: ho.time(ho.route(started(), 0.95 * TRIANGLE), duration=x),
    "lint": lambda x, folder: linted(lambda i: f"{0.01 * i},{x * i}", folder),
    "lint of times": lambda x, folder: linted(lambda i: f"{x * i},{0.01 * i}", folder),
    "equilibrium with lengths": lambda x, _: ho.equilibrium(moved(), 0.5, cable_length=x),
    "equilibrium with weight": lambda x, _: ho.equilibrium(moved(), 0.5, cable_density=x),
    "equilibrium with loads": lambda x, _: ho.equilibrium(moved(), 0.5, load=x),
    "equilibrium with forces": lambda x, _: ho.equilibrium(moved(), 0.5, forces=x),
    "equilibrium with friction": lambda x, _: ho.equilibrium(moved(), 0.5, friction=x),
}
"""Public calls with a number and a folder, none of which takes long."""


@pytest.mark.parametrize("name", CALLS)
def test_extreme_arguments_raise_only_our_errors(name: str, tmp_path: Path) -> None:
    refusals = list[str]()
    for value in EXTREMES:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                CALLS[name](value, tmp_path)
            except ho.HitchoptError as error:
                refusals.append(str(error))
    assert not [words for words in refusals if "please report" in words]


def test_grips_without_friction_hold_nothing_and_fits_stay_in_reach() -> None:
    found = ho.fit(SQUARE, 3, friction=0.0, cable_length=2.4, compared=())
    assert found.capacities("grip")[3].mass == 0.0
    with (
        pytest.warns(ho.UnitWarning, match="clearance"),
        pytest.raises(ho.InputError, match=r"clearance = 300\.0"),
    ):
        ho.fit(SQUARE, 3, clearance=300.0, compared=())


def test_jumps_of_plans_for_centuries_are_rounding_of_times() -> None:
    with pytest.warns(ho.UnitWarning, match="duration"), pytest.raises(ho.InfeasibleError) as found:
        ho.morph(started(), 0.95 * TRIANGLE, duration=1e9)
    assert "shorten durations" in str(found.value)


def test_what_takes_too_many_samples_names_the_step(tmp_path: Path) -> None:
    with pytest.warns(ho.UnitWarning, match="seconds"):
        problem = problem_from_dict(problem_with(("mission", 0, "hold", "seconds"), 1e6))
    with pytest.raises(ho.InputError, match=r"rate = 100.*; shorten step 0 \(hold\), .* 1e\+06 s"):
        ho.solve(problem).save(tmp_path)


def test_singular_samples_have_no_solution_and_leave_others_alone() -> None:
    matrices = np.array([np.eye(3), np.zeros((3, 3)), 2.0 * np.eye(3)])
    solutions = solutions_of(matrices, np.ones((3, 3, 2)))
    np.testing.assert_array_equal(solutions[:, 0, 0], [1.0, np.nan, 0.5])
