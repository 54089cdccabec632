"""Random families of problems: what is drawn, and what their table counts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hitchopt as ho
from benchmarks.families import (
    FAMILIES,
    Outcome,
    add_rows,
    lower_bound,
    outcome,
    wild_carry,
    wild_form,
)
from benchmarks.measuring import Table
from problems.random_morph import is_certified


@pytest.mark.parametrize(
    "family",
    [
        pytest.param("form", marks=pytest.mark.slow),
        pytest.param("scattered_form", marks=pytest.mark.slow),
        "carry",
        pytest.param("curves", marks=pytest.mark.slow),
        pytest.param("blends", marks=pytest.mark.slow),
        pytest.param("timed_blends", marks=pytest.mark.slow),
        "corridor",
    ],
)
def test_problems_are_seeded_and_valid(family: str) -> None:
    draw = FAMILIES[family]
    first = draw(3)
    assert first == draw(3)
    assert first != draw(4)
    ho.problem_from_dict(first)


@pytest.mark.parametrize("seed", range(2))
def test_ends_of_formed_hitches_are_certified(seed: int) -> None:
    data = wild_form(seed)
    form, team = data["mission"][0]["form"], data["team"]
    assert is_certified(team, data["start"])
    cables = np.broadcast_to(team["cable_length"], team["robots"])
    if np.ptp(cables) == 0.0 or form.get("assign") == "fixed":
        hitch = {key: form[key] for key in ("polygon", "altitude")}
        assert is_certified(team, {"hitch": {**hitch, "legs": "spread"}})


def test_objects_to_carry_are_those_of_every_version() -> None:
    """Rates of versions compare only if planner and certificate draw nothing."""
    stated = [(0, 2.33, 0.176, [-0.954, 0.103]), (17, 1.76, 0.119, [0.039, 0.702])]
    for seed, cable_length, mass, corner in stated:
        data = wild_carry(seed)
        assert data["team"]["cable_length"] == cable_length
        assert data["objects"]["thing"]["mass"] == mass
        assert data["start"]["hitch"]["polygon"][0] == corner


@pytest.mark.parametrize("seed", range(4))
def test_hitches_that_carry_are_certified_at_the_start(seed: int) -> None:
    data = wild_carry(seed)
    options = {key: data[key] for key in ("limits", "objects")}
    assert is_certified(data["team"], data["start"], options)


def test_tables_stand_beside_objects_and_apart_from_goals() -> None:
    problems = [wild_carry(seed)["objects"] for seed in range(8)]
    tables = [objects for objects in problems if "table" in objects]
    assert tables
    for objects in tables:
        places = (np.array(objects[name]["at"][:2]) for name in ("thing", "table"))
        assert np.linalg.norm(np.subtract(*places)) > 1.0


def test_a_planned_problem_is_proven_and_a_refused_one_names_its_limit() -> None:
    planned = outcome(FAMILIES["corridor"](0), 0)
    assert planned.proven == (planned.duration is not None)
    data = wild_form(0)
    data["limits"] = {"duration": 1.0}
    refused = outcome(data, 0)
    assert (refused.duration, refused.refusal) == (None, "duration")


def test_the_bound_is_that_of_the_slowest_point_from_rest_to_rest() -> None:
    step = {"transport": {"to": [1.5, 0.0, 1.0]}}
    polygon = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]
    problem = {
        "team": {"robots": 3, "cable_length": 2.4},
        "limits": {"speed": 1.0, "vertex_speed": 0.5, "acceleration": 2.0},
        "start": {"hitch": {"polygon": polygon, "altitude": 1.0}},
        "mission": [step, {"hold": {"seconds": 1.0}}],
    }
    plan = ho.solve(ho.problem_from_dict(problem))
    assert lower_bound(plan) == pytest.approx(1.5 / 0.5 + 0.5 / 2.0, abs=1e-6)


def test_rates_count_all_problems(tmp_path: Path) -> None:
    table = Table(tmp_path / "families.md", "Families", "none")
    refused = Outcome(7, 3, 2.0, None, proven=False, refusal="span")
    planned = [
        Outcome(k, n, 1.0, 9.0, proven=True, refusal="", over_bound=1.0 + k)
        for k, n in ((1, 3), (2, 4), (3, 4))
    ]
    add_rows(table, "form", [refused, *planned])
    rows = [line for line in table.path.read_text().splitlines() if line.startswith("| form")]
    assert rows == [
        "| form | 3 | 2 | 1 | 1 | 50 % | 7 (span) | 1.5 | 2 | 2 | 2 |",
        "| form | 4 | 2 | 2 | 2 | 100 % |  | 1 | 1 | 3.5 | 4 |",
        "| form | all | 4 | 3 | 3 | 75 % | 7 (span) | 1 | 2 | 3 | 4 |",
    ]
