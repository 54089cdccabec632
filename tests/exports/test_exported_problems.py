"""Accuracy of the refitted formats on the library's problems, those that are planned in no time."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import pytest
from exported_plans import exported

from hitchopt.errors import InfeasibleError
from hitchopt.mission.loading import any_problem_from_dict, load_problem
from hitchopt.mission.solving import solve_problem
from hitchopt.mission.swarm_problem import SwarmProblem
from hitchopt.mission.swarm_solving import solve_swarm
from hitchopt.motion.motion import Motion
from problems.swarm import reversed_stack

PROBLEMS = Path(__file__).parents[2] / "problems"

STEMS = ("open_chain", "open_pair", "paper_experiment_3", "unequal_cables", "transport")


@lru_cache
def planned(stem: str) -> Motion:
    return solve_problem(load_problem(PROBLEMS / f"{stem}.yaml")).motion


@pytest.mark.parametrize(
    ("name", "accuracy"), [("crazyswarm2", 1e-3), ("compressed", 2e-3), ("skybrush", 2e-3)]
)
@pytest.mark.parametrize("stem", STEMS)
def test_exported_within_its_accuracy(
    stem: str, name: str, accuracy: float, tmp_path: Path
) -> None:
    (part,) = exported(planned(stem), name, tmp_path)
    assert part.verdict.lost == ()
    assert part.verdict.position.worst <= accuracy


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "accuracy", "cut"), [("crazyswarm2", 1e-3, True), ("compressed", 2e-3, False)]
)
def test_a_whole_mission_is_cut_where_it_loses_a_limit_as_one(
    name: str, accuracy: float, cut: bool, tmp_path: Path
) -> None:
    parts = exported(planned("tie_carry_untie"), name, tmp_path)
    assert (len(parts) > 1) is cut
    for part in parts:
        assert part.verdict.lost == ()
        assert part.verdict.position.worst <= accuracy
        checks = {check.name for check in part.verdict.checks}
        assert {"separation", "cable_clearance"} <= checks
    assert any("span" in {check.name for check in part.verdict.checks} for part in parts)


def test_an_export_that_enters_a_prism_is_refused(tmp_path: Path) -> None:
    """The way keeps 0.12009 m; in whole millimetres it begins at 0.1196 m."""
    y = 0.12049
    prism = [[-3.0, -1.0], [-3.0, 0.0004], [3.0, 0.0004], [3.0, -1.0]]
    problem = any_problem_from_dict(
        {
            "team": {"drones": 1},
            "start": [[-1.5, y, 1.0]],
            "goal": [[1.5, y, 1.0]],
            "keep_out": [{"polygon": prism, "lower": 0.0, "upper": 3.0}],
        }
    )
    assert isinstance(problem, SwarmProblem)
    motion = solve_swarm(None, problem).motion
    exported(motion, "csv", tmp_path / "csv")
    with pytest.raises(InfeasibleError, match="keep_out"):
        exported(motion, "compressed", tmp_path / "compressed")


def test_drones_that_start_below_one_another_are_told_of(tmp_path: Path) -> None:
    problem = any_problem_from_dict(reversed_stack(3))
    assert isinstance(problem, SwarmProblem)
    (part,) = exported(solve_swarm(None, problem).motion, "crazyswarm2", tmp_path)
    assert any("would take off from one place" in note for note in part.notes)
