"""Accuracy of the refitted formats on the library's problems, those that are planned in no time."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import pytest
from exported_plans import exported

from hitchopt.mission.loading import load_problem
from hitchopt.mission.solving import solve_problem
from hitchopt.model.motion import Flying

PROBLEMS = Path(__file__).parents[2] / "problems"

STEMS = ("open_chain", "open_pair", "paper_experiment_3", "unequal_cables", "transport")


@lru_cache
def planned(stem: str) -> Flying:
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
