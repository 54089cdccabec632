"""Faults of searches, pictures and notes, played: they hide no plan and no diagnosis."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from commands import TRIANGLE, run
from plans import planned
from refusing_steps import NEEDED_SPEED, brittle_problem

import hitchopt as ho
from hitchopt.errors import FaultWarning

pytestmark = pytest.mark.filterwarnings("always::hitchopt.errors.FaultWarning")

WEAK = """team: {robots: 3, cable_length: 2.4, quadrotor: {mass: 0.132, max_thrust: 1.0}}
start: {hitch: {polygon: [[0, -1], [-0.4, 0.5], [0.4, 0.5]]}}
mission: [{morph: {polygon: [[0, -0.5], [-0.4, 0.5], [0.4, 0.5]]}}]
"""
"""Drones that cannot carry their own weight."""


class FaultError(Exception):
    """What a fault raises."""


def failing(*_: object, **__: object) -> None:
    raise FaultError("on\ntwo lines")


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


def test_drones_that_do_not_lift_themselves_are_told_so(weak: Path) -> None:
    result = run("solve", weak, code=3)
    assert "thrust: 1.35529 N is above the limit of 1 N" in result.stderr
    assert "failed" not in result.stderr
    assert diagnosis() == ["thrust"]


@pytest.mark.parametrize("part", ["_Search._fitted", "_smallest_changes", "solve_problem"])
def test_a_fault_of_the_search_hides_no_diagnosis(
    part: str, weak: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(f"hitchopt.mission.repair.{part}", failing)
    result = run("solve", weak, code=3)
    assert "thrust: 1.35529 N is above the limit of 1 N" in result.stderr
    fault = "warning: the search for changes failed: FaultError: on two lines"
    assert result.stderr.splitlines().count(fault) == 1
    assert diagnosis() == ["thrust"]
    with pytest.warns(FaultWarning, match="on two lines"):
        ho.suggestions(weak)
    with (
        pytest.warns(FaultWarning, match="on two lines"),
        pytest.raises(ho.InfeasibleError, match=r"thrust: 1\.35529 N"),
    ):
        ho.repair(weak)


def test_a_fault_leaves_the_changes_that_were_found() -> None:
    with pytest.warns(FaultWarning, match="on two lines"):
        (found,) = ho.suggestions(brittle_problem(FaultError("on\ntwo lines")))
    assert found.change.key == "limits.speed"
    assert float(found.change.new) > 1.05 * NEEDED_SPEED  # it is not narrowed down


DRAWING, NOTES = "hitchopt.view.pictures.draw_summary", "hitchopt.plan.weightless_notes"
SOLVE = ("solve", TRIANGLE, "-o", "out", "--rate", "5")


@pytest.mark.parametrize(
    ("part", "arguments", "words"),
    [
        (DRAWING, SOLVE, "summary.png failed: FaultError: on two lines"),
        (NOTES, SOLVE, "a note failed: FaultError: on two lines"),
        (NOTES, ("check", "out"), "a note failed: FaultError: on two lines"),
        (
            "hitchopt.exports.exporting.tracking_notes",
            ("export", "out", "--format", "csv"),
            "a note failed: FaultError: on two lines",
        ),
    ],
)
def test_faults_of_pictures_and_notes_hide_no_result(
    part: str,
    arguments: tuple[str | Path, ...],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    run(*SOLVE, "--no-picture", code=0)
    monkeypatch.setattr(part, failing)
    assert f"warning: {words}\n" in run(*arguments, code=0).stderr


def test_a_plan_is_saved_without_its_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(DRAWING, failing)
    with pytest.warns(FaultWarning, match="on two lines"):
        planned("triangle").save(tmp_path / "out", rate=5.0)
    assert ho.load(tmp_path / "out").certificate.certified
