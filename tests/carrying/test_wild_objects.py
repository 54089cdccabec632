"""An object whose rim legs cut with even splits and rolls, and one that is taken beside a table."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import hitchopt as ho
from hitchopt.carrying.enclosing import enclosing_planners
from hitchopt.planners.task import RestState, StepTask

FOLDER = Path(__file__).parent / "wild"


@pytest.mark.slow
def test_legs_that_would_roll_through_a_rim_are_searched_over_all_clasps(tmp_path: Path) -> None:
    """Legs without roll bring drones too close under the load, and evenly rolled ones cut the rim.

    With 1.6 times the mass no hold is found; the refusal names the object that is taken.
    """
    assert ho.solve(FOLDER / "carry_16.yaml").certificate.certified
    text = (FOLDER / "carry_16.yaml").read_text()
    assert "mass: 0.399\n" in text
    heavier = tmp_path / "heavier.yaml"
    heavier.write_text(text.replace("mass: 0.399\n", "mass: 0.638\n"))
    with pytest.raises(ho.InfeasibleError, match=r"as the clasps take objects\.thing"):
        ho.solve(heavier)


def test_a_tray_beside_a_table_is_taken_in_another_orientation() -> None:
    problem = ho.load_problem(FOLDER / "beside_a_table.yaml")
    (mission,) = problem.teams.values()
    requirements = mission.requirements.with_reserve
    hitch = ho.Hitch.spread(problem.team, problem.start.polygon, problem.start.altitude)
    task = StepTask(RestState(problem.team, hitch.drones, hitch), 0, requirements)
    first, *others = enclosing_planners(task, "thing")
    with pytest.raises(ho.InfeasibleError, match="table"):
        first(task)
    assert len(others) == 11
    assert ho.Enclose("thing").plan(task).certificate.certified
    (unhindered,) = ho.load_problem(FOLDER / "carry_16.yaml").teams.values()
    alone = replace(task, requirements=unhindered.requirements)
    assert len(enclosing_planners(alone, "thing")) == 1  # nothing is in its way
