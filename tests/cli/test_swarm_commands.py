"""Problems of single drones through the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from baseline import SWARMS as PLANNED
from baseline import differences
from click.testing import CliRunner, Result
from problem_files import ROOT

from hitchopt.cli import main
from hitchopt.planning import solve

SWARMS = ROOT / "problems" / "swarms"


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty current directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def test_a_swarm_is_solved_checked_and_looked_at_closely(place: Path) -> None:
    result = run("solve", SWARMS / "head_on.yaml", "--rate", "10")
    assert result.exit_code == 0, result.output
    assert "give way to the right" in " ".join(result.stdout.split())
    assert result.stdout.splitlines()[-1] == "certified; the plan is in head_on"
    out = place / "head_on"
    assert {path.name for path in out.iterdir()} == {
        "plan.npz",
        "setpoints.csv",
        "certificate.json",
        "summary.png",
    }
    certificate = json.loads((out / "certificate.json").read_text(encoding="utf-8"))
    assert certificate["certified"] is True
    result = run("check", "head_on", "--closest", "--picture", "closest.png")
    assert result.exit_code == 0, result.output
    assert "Closest neighbours" in result.stdout
    assert "d0, d1" in result.stdout
    assert (place / "closest.png").read_bytes()[:4] == b"\x89PNG"


def test_what_cannot_be_ends_with_three_and_a_diagnosis(place: Path) -> None:
    result = run("solve", SWARMS / "infeasible" / "goals_too_close.yaml")
    assert result.exit_code == 3
    assert "d0, d1" in result.stderr
    diagnosis = json.loads((place / "goals_too_close" / "diagnosis.json").read_text())
    assert diagnosis["violations"][0]["constraint"] == "separation"


def test_mistakes_end_with_two() -> None:
    result = run("solve", SWARMS / "bad" / "goal_missing.yaml")
    assert result.exit_code == 2
    assert "2 points" in result.stderr
    result = run("solve", SWARMS / "head_on.yaml", "--rate", "1e9")
    assert result.exit_code == 2


@pytest.mark.slow
@pytest.mark.parametrize("path", PLANNED, ids=lambda path: path.stem)
def test_swarms_are_planned_as_before(path: Path) -> None:
    assert not differences(solve(path).certificate.to_dict(), path)
