"""Faults of searches, pictures and notes, played: they hide no plan and no diagnosis."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

import hitchopt as ho
from hitchopt.errors import FaultWarning
from hitchopt.planners.task import StepPlan, StepTask
from hitchopt.steps.moving import Hold
from tests.helpers.commands import TRIANGLE, run
from tests.helpers.plans import planned
from tests.helpers.refusing_steps import NEEDED_SPEED, brittle_problem, problem_of, refusal

pytestmark = pytest.mark.filterwarnings("always::hitchopt.errors.FaultWarning")

WEAK = """team: {robots: 3, cable_length: 2.4, quadrotor: {mass: 0.132, max_thrust: 1.3}}
start: {hitch: {polygon: [[0, -1], [-0.4, 0.5], [0.4, 0.5]]}}
mission: [{morph: {polygon: [[0, -0.5], [-0.4, 0.5], [0.4, 0.5]]}}]
"""
"""Drones that hover, but cannot hold the tension of their cables."""


class FaultError(Exception):
    """What a fault raises."""


@pytest.fixture
def weak(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "weak.yaml"
    path.write_text(WEAK, "utf-8")
    return path


def diagnosis() -> list[str]:
    """Return the constraints in the diagnosis that a refused solve has left."""
    content = json.loads(Path("weak/diagnosis.json").read_text("utf-8"))
    return [each["constraint"] for each in content["violations"]]


def test_drones_that_only_lift_themselves_are_told_so(weak: Path) -> None:
    result = run("solve", weak, code=3)
    assert "thrust: 1.35529 N is above the limit of 1.3 N" in result.stderr
    assert "failed" not in result.stderr
    assert diagnosis() == ["thrust"]


class Faulty(Hold):
    """A step that is refused at a speed limit of 1 m/s, and fails with any other one."""

    def plan(self, task: StepTask) -> StepPlan:
        """Refuse or fail."""
        if task.requirements.limits.speed == 1.0:
            raise refusal("speed", 1.0)
        raise FaultError("on\ntwo lines")


def test_a_fault_of_the_search_hides_no_refusal() -> None:
    problem, fault = problem_of(Faulty(1.0)), "the search for changes failed: FaultError: on two"
    with pytest.warns(FaultWarning, match=fault):
        assert ho.suggestions(problem) == ()
    with pytest.warns(FaultWarning, match=fault), pytest.raises(ho.InfeasibleError, match="2 is"):
        ho.repair(problem)


def test_a_fault_leaves_the_changes_that_were_found() -> None:
    with pytest.warns(FaultWarning, match="on two lines"):
        (found,) = ho.suggestions(brittle_problem(FaultError("on\ntwo lines")))
    assert found.change.key == "limits.speed"
    assert float(found.change.new) > 1.05 * NEEDED_SPEED  # it is not narrowed down


def test_a_plan_is_saved_without_its_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No picture is drawn where matplotlib is missing."""
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.warns(FaultWarning, match=r"summary\.png failed"):
        planned("triangle").save(tmp_path / "out", rate=5.0, picture=True)
    assert ho.load(tmp_path / "out").certificate.certified
    monkeypatch.chdir(tmp_path)
    done = run("solve", TRIANGLE, "-o", "other", "--rate", "5", code=0)
    assert "warning: summary.png failed: " in done.stderr
