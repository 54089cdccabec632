"""Objects that are held by rolled or uneven legs, and taken beside a table."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import verify
from hitchopt.steps.carrying import Enclose
from hitchopt.steps.step import RestState, StepTask

FOLDER = Path(__file__).parent / "wild"


def is_proven(plan: ho.Plan, folder: Path) -> bool:
    plan.save(folder, picture=False)
    return all(row.verdict in verify.PASSING for row in verify.verify(folder))


@pytest.mark.parametrize("name", ["carry_16", pytest.param("carry_11", marks=pytest.mark.slow)])
def test_legs_roll_where_a_load_brings_drones_too_close(name: str, tmp_path: Path) -> None:
    """Legs without roll keep all distances without the object, and not with it."""
    plan = ho.solve(FOLDER / f"{name}.yaml")
    assert plan.certificate.certified
    grasped = next(phase for phase in plan.phases if phase.name == "grasp")
    heights = plan.at(grasped.end).positions[:, 2] - np.mean(plan.at(grasped.end).vertices[:, 2])
    assert np.min(heights[0::2]) > 0.05  # q up
    assert np.max(heights[1::2]) < 0.05  # r down, or not as far up
    assert is_proven(plan, tmp_path)


def test_a_tray_beside_a_table_is_taken_in_another_orientation() -> None:
    problem = ho.load_problem(FOLDER / "beside_a_table.yaml")
    plan = ho.solve(problem)
    assert plan.certificate.certified
    (mission,) = problem.teams.values()
    requirements = mission.requirements.with_reserve
    hitch = ho.Hitch.spread(problem.team, problem.start.polygon, problem.start.altitude)
    task = StepTask(RestState(problem.team, hitch.drones, hitch), 0, requirements)
    first, *others = Enclose("thing").orientations(task)
    with pytest.raises(ho.InfeasibleError, match="table"):
        first(task)
    assert len(others) == 11
    (unhindered,) = ho.load_problem(FOLDER / "carry_16.yaml").teams.values()
    alone = replace(task, requirements=unhindered.requirements)
    assert len(Enclose("thing").orientations(alone)) == 1  # nothing is in its way
