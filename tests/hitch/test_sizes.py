"""The ellipsoids of drones: stated, of their models, or the default, from problem to export."""

from __future__ import annotations

import json
import pickle
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import hitchopt as ho
from hitchopt.drones.quadrotor import MODELS, usual_ellipsoid
from hitchopt.exports.exporting import export_flight
from hitchopt.exports.options import ExportOptions
from hitchopt.mission.loading import problem_from_dict
from hitchopt.motion.plan_file import read_saved_plan

LARGE = MODELS["x260_bolt"].separation
TRIANGLE = [[0, -1.6], [-1.3, 0.8], [1.3, 0.8]]


def team_of(*kinds: Any) -> ho.Team:
    return ho.Team(len(kinds), 4.4, quadrotor=list(kinds))


def problem_of(quadrotor: Any, **more: Any) -> dict[str, Any]:
    return {
        "team": {"robots": 3, "cable_length": 4.4, "tension": 0.4, "quadrotor": quadrotor},
        "start": {"hitch": {"polygon": TRIANGLE, "altitude": 3}},
        "mission": [{"hold": {"seconds": 1}}],
        **more,
    }


HEAVY: dict[str, Any] = {"mass": 2.0, "max_thrust": 40}
STATED: list[tuple[dict[str, float], tuple[float, float]]] = [
    ({}, LARGE),
    ({"cable": 0.15}, LARGE),
    ({"radius": 0.12}, (0.12, LARGE[1])),
    ({"radius": 0.12, "height": 0.30}, (0.12, 0.30)),
    ({"radius": 0.4, "height": 0.5}, (0.4, 0.5)),
]


@pytest.mark.parametrize(("stated", "expected"), STATED)
def test_a_model_brings_its_ellipsoid_unless_one_is_stated(
    stated: dict[str, float], expected: tuple[float, float]
) -> None:
    """In problem files as in Python, for one team as for one of several."""
    section = {"separation": stated} if stated else {}
    whole = problem_of("x260_bolt", **section)
    ones = [problem_from_dict(whole).requirements]
    ones += [
        problem_from_dict(
            {
                "teams": {"a": whole["team"], "b": {"drones": 1}},
                "start": {"a": whole["start"], "b": [[4, 0, 1]]},
                "mission": [{"a": whole["mission"][0], "b": {"fly": {"goal": [[4, 0, 2]]}}}],
                **section,
            }
        )
        .teams["a"]
        .requirements
    ]
    team = team_of(*["x260_bolt"] * 3)
    ones += [
        ho.Problem(
            team,
            ho.Hitch.spread(team, TRIANGLE, 3.0),
            [ho.Hold(1.0)],
            separation=ho.Separation(**stated),
        ).requirements
    ]
    for requirements in ones:
        found = requirements.separation
        assert (found.radius, found.height) == expected
        assert found.cable == stated.get("cable", 0.10)


def test_of_several_models_the_largest_counts_and_others_keep_the_default() -> None:
    default = ho.Separation()
    assert (default.radius, default.height) == (0.12, 0.30)
    for kinds in (["paper_132g"] * 3, ["crazyflie_2.1", ho.Quadrotor(**HEAVY), "paper_132g"]):
        assert default.for_drones(team_of(*kinds)) is default
    mixed = default.for_drones(team_of("crazyflie_2.1", "x260_bolt", ho.Quadrotor()))
    assert (mixed.radius, mixed.height) == LARGE
    assert mixed.for_drones(team_of(*["x260_bolt"] * 3)) is mixed
    swarm = default.for_drones(ho.Swarm(2, quadrotor="x260_bolt"))
    assert swarm == mixed == ho.Separation(*LARGE)


def test_copies_remember_what_is_stated() -> None:
    for stated, expected in STATED:
        x = ho.Separation(**stated)
        for copy in (pickle.loads(pickle.dumps(x)), deepcopy(x), replace(x)):
            found = copy.for_drones(team_of(*["x260_bolt"] * 3))
            assert (found.radius, found.height) == expected
            assert copy == x
            assert hash(copy) == hash(x)
    wide = replace(ho.Separation(), radius=0.2).for_drones(team_of(*["x260_bolt"] * 3))
    assert wide == ho.Separation(0.2, LARGE[1])


def test_the_figure_for_a_mass_has_the_proportions_of_the_largest_model() -> None:
    assert usual_ellipsoid(0.32) == LARGE
    assert usual_ellipsoid(8 * 0.32) == (2 * LARGE[0], 2 * LARGE[1])
    assert usual_ellipsoid(2.0) == (0.46, 1.1)


NOTED: list[tuple[Any, dict[str, Any], str]] = [
    (HEAVY, {}, "0.46 m and 1.1 m"),
    ({"mass": 0.35, "max_thrust": 9.0}, {"separation": {"cable": 0.1}}, "0.26 m and 0.62 m"),
    ({"model": "crazyflie_2.1", **HEAVY}, {}, "0.46 m and 1.1 m"),
    (["paper_132g", HEAVY, "x260_bolt"], {}, "0.46 m and 1.1 m"),
    ({"mass": 0.3, "max_thrust": 9.0}, {}, ""),
    (HEAVY, {"separation": {"radius": 0.12}}, ""),
    (HEAVY, {"separation": {"radius": 0.12, "height": 0.3}}, ""),
    ("x260_bolt", {}, ""),
]


@pytest.mark.parametrize(("quadrotor", "more", "words"), NOTED)
def test_heavy_drones_without_a_stated_ellipsoid_are_noted(
    quadrotor: Any, more: dict[str, Any], words: str, tmp_path: Path
) -> None:
    """At solve and at export, which reads the plan back."""
    (tmp_path / "problem.yaml").write_text(json.dumps(problem_of(quadrotor, **more)), "utf-8")
    plan = ho.solve(tmp_path / "problem.yaml")
    plan.save(tmp_path / "plan")
    saved = read_saved_plan(tmp_path / "plan" / "plan.npz")
    (part,) = export_flight(saved, ExportOptions("csv"), tmp_path / "out")
    for notes in (plan.notes, ho.load(tmp_path / "plan").notes, part.notes):
        found = [note for note in notes if "ellipsoid" in note]
        assert len(found) == bool(words)
        assert all(words in note for note in found)
