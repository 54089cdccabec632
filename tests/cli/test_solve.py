"""The problems of this repository, through the command line."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from baseline import differences
from click.testing import CliRunner, Result
from problem_files import GOOD, INFEASIBLE, header

from hitchopt.checks import Certificate
from hitchopt.checks.certificate import Check
from hitchopt.cli import main
from hitchopt.plan import Plan
from hitchopt.planning import solve
from hitchopt.storage.yaml_file import read_yaml

TRIANGLE = next(path for path in GOOD if path.stem == "triangle")


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty current directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def least_duration(path: Path) -> float:
    """How long the vertices need at their speed limit, from the file alone [s]."""
    if "# Lasts: " in path.read_text(encoding="utf-8"):
        return float(header(path, "Lasts"))
    data: Any = read_yaml(path)
    speed = data.get("limits", {}).get("vertex_speed", 0.5)
    polygon = np.array(data["start"]["hitch"]["polygon"])
    total = 0.0
    for step in data["mission"]:
        if "hold" in step:
            total += step["hold"]["seconds"]
        elif "follow_vertex" in step:
            total += step["follow_vertex"]["path"][-1][0]
        else:
            end = np.array(step["morph"]["polygon"])
            way = np.max(np.linalg.norm(end - polygon, axis=1))
            total += max(way / speed, step["morph"].get("duration", 0.0))
            polygon = end
    return float(total)


@pytest.mark.parametrize("path", GOOD, ids=lambda path: path.stem)
def test_good_problems_are_certified(path: Path, place: Path) -> None:
    result = run("solve", path, "--rate", "5")
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines()[-1] == f"certified; the plan is in {path.stem}"
    certificate = json.loads((place / path.stem / "certificate.json").read_text())
    assert certificate["certified"] is True
    assert all(check["name"] in result.stdout for check in certificate["checks"])
    least = least_duration(path)
    assert least <= certificate["duration"] < 3.0 * least + 1.0
    assert not differences(certificate, path)


def test_check_repeats_the_certificate_from_the_plan_alone(place: Path) -> None:
    solved = run("solve", TRIANGLE, "-o", "out", "--rate", "5")
    for name in ("setpoints.csv", "certificate.json", "vertices.csv"):
        (place / "out" / name).unlink()
    checked = run("check", "out")
    assert checked.exit_code == 0, checked.output
    assert checked.stdout.splitlines()[-1] == "certified; recomputed from out/plan.npz"
    tables = solved.stdout[solved.stdout.index("Phases") : solved.stdout.index("certified;")]
    assert tables in checked.stdout
    assert sorted(path.name for path in (place / "out").iterdir() if path.name[0] != ".") == [
        "plan.npz",
        "summary.png",
    ]


def test_a_plan_is_found_by_its_file_too(place: Path) -> None:
    assert run("solve", TRIANGLE, "-o", "out", "--rate", "5").exit_code == 0
    checked = run("check", "out/plan.npz")
    assert checked.exit_code == 0, checked.output
    assert checked.stdout.splitlines()[-1] == "certified; recomputed from out/plan.npz"
    (place / "mine.npz").write_bytes((place / "out" / "plan.npz").read_bytes())
    wider = run("check", "mine.npz", "--gamma", "2.5")
    assert wider.exit_code == 0
    assert re.search(r"tracking_radius +[0-9.e-]+ +γ = 2.5 ", wider.stdout)
    assert re.search(r"tracking_radius +[0-9.e-]+ +γ = 1 ", checked.stdout)
    refused = run("check", "mine.npz", "--gamma", "-1")
    assert refused.exit_code == 2
    assert "gamma = -1" in refused.stderr
    exported = run("export", "out/plan.npz", "--format", "csv")
    assert exported.exit_code == 0, exported.output
    assert (place / "out-csv").is_dir()
    assert "error: nowhere/plan.npz: " in run("check", "nowhere/plan.npz").stderr


def test_an_overstretched_start_is_refused_before_any_search(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def searched(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr("hitchopt.planners.forming.assigning.assigned", searched)
    monkeypatch.setattr("hitchopt.steps.form.Form.plan", searched)
    path = next(path for path in INFEASIBLE if path.stem == "overstretched_start")
    result = run("solve", path, "-o", "out", "--no-repair")
    assert result.exit_code == 3, result.output
    assert result.stderr.splitlines()[0] == (
        "error: span: 1.125 is above the limit of 1 at robot 0, q0, r0 (2.7 m apart on a cable of "
        "2.4 m) at the start (t = 0); move q0 and r0 of start.drones closer together, or use a "
        "longer cable"
    )
    assert (place / "out" / "diagnosis.json").exists()


def test_a_limit_ends_the_solve_with_a_diagnosis(place: Path) -> None:
    result = run("solve", TRIANGLE, "-o", "out", "--limit", "1e-9")
    assert result.exit_code == 3, result.output
    assert "s is above the limit of 1e-09 s (last: " in result.stderr
    found = json.loads((place / "out" / "diagnosis.json").read_text())
    assert found["violations"][0]["constraint"] == "time limit"
    assert found["violations"][0]["limit"] == 1e-9
    assert [file.name for file in (place / "out").iterdir()] == ["diagnosis.json"]


def test_a_limit_ends_the_search_for_changes_too(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hitchopt.cli.commands.MIN_SEARCH_TIME", 1e-9)
    reads = iter([0.0])  # then the time is up
    monkeypatch.setattr(
        "hitchopt.cli.commands.time", SimpleNamespace(monotonic=lambda: next(reads, 1e9))
    )
    path = next(path for path in INFEASIBLE if path.stem == "drones_too_close")
    result = run("solve", path, "-o", "out", "--limit", "60")
    assert result.exit_code == 3, result.output
    note = "the search for changes ended at the time limit (--limit)"
    assert note in result.stderr.splitlines()
    found = json.loads((place / "out" / "diagnosis.json").read_text())
    assert note in found["message"]
    assert found["violations"][0]["constraint"] == "separation"


def test_the_file_of_init_solves_as_it_is(place: Path) -> None:
    assert run("init", "mine").exit_code == 0
    result = run("solve", "mine.yaml", "--rate", "5")
    assert result.exit_code == 0, result.output
    assert (place / "mine" / "setpoints.csv").exists()


@pytest.mark.parametrize("path", INFEASIBLE, ids=lambda path: path.stem)
def test_infeasible_problems_end_with_3_and_say_what_binds(path: Path, place: Path) -> None:
    result = run("solve", path, "-o", "out", "--no-repair")
    assert result.exit_code == 3, result.output
    binds = header(path, "Binds")
    told = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert any(line.startswith(f"error: {binds}") for line in told)
    reasons = [line for line in told if not line.startswith("error: the optimiser")]
    assert all("; " in line for line in reasons)
    assert result.stderr.splitlines()[-1] == "no plan; the diagnosis is in out/diagnosis.json"
    assert [file.name for file in (place / "out").iterdir()] == ["diagnosis.json"]
    found = json.loads((place / "out" / "diagnosis.json").read_text())
    assert found["message"] == "\n".join(line.removeprefix("error: ") for line in told)
    assert binds in {violation["constraint"] for violation in found["violations"]}


def test_a_refusal_says_what_would_mend_it(place: Path) -> None:
    path = next(path for path in INFEASIBLE if path.stem == "drones_too_close")
    result = run("solve", path, "-o", "out")
    assert result.exit_code == 3, result.output
    told = [line for line in result.stderr.splitlines() if line.startswith("suggested change: ")]
    found = json.loads((place / "out" / "diagnosis.json").read_text())
    assert [entry["message"] for entry in found["suggestions"]] == told
    best = found["suggestions"][0]
    assert (best["key"], best["old"], best["unit"]) == ("team.cable_length", 1.2, "m")
    assert best["edits"] == [{"key": "team.cable_length", "value": best["new"]}]
    assert best["relative"] == pytest.approx(best["new"] / 1.2 - 1.0)
    assert "(0.141 m apart, 0.0986 m too close)" in result.stderr  # 0.1 m times the root of 2
    text = path.read_text().replace("cable_length: 1.2", f"cable_length: {best['new']}")
    (place / "mended.yaml").write_text(text)
    assert run("solve", "mended.yaml", "--rate", "5").exit_code == 0


def test_a_refusal_that_nothing_mends_says_so(place: Path) -> None:
    path = next(path for path in INFEASIBLE if path.stem == "points_begin_elsewhere")
    result = run("solve", path, "-o", "out")
    assert result.exit_code == 3, result.output
    assert "no single change was found that makes it feasible" in result.stderr.splitlines()
    assert json.loads((place / "out" / "diagnosis.json").read_text())["suggestions"] == []


def test_the_diagnosis_is_there_when_the_search_is_interrupted(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("hitchopt.mission.repair.suggest.find_suggestions", interrupted)
    path = next(path for path in INFEASIBLE if path.stem == "drones_too_close")
    assert run("solve", path, "-o", "out").exit_code == 130
    found = json.loads((place / "out" / "diagnosis.json").read_text())
    assert found["violations"][0]["constraint"] == "separation"
    assert found["suggestions"] == []


def test_the_directory_tells_the_last_solve(place: Path) -> None:
    assert run("solve", TRIANGLE, "-o", "out", "--rate", "5").exit_code == 0
    (place / "out" / "mine.txt").write_text("precious")
    infeasible = next(path for path in INFEASIBLE if path.stem == "too_little_thrust")
    assert run("solve", infeasible, "-o", "out", "--no-repair").exit_code == 3
    left = {file.name for file in (place / "out").iterdir()}
    assert left == {"diagnosis.json", "mine.txt", "previous"}
    assert run("solve", TRIANGLE, "-o", "out", "--rate", "5").exit_code == 0
    names = {file.name for file in (place / "out").iterdir()}
    assert names >= {"plan.npz", "setpoints.csv", "mine.txt"}
    assert not names & {"diagnosis.json", "previous"}


def test_a_bad_file_leaves_an_earlier_plan_alone(place: Path) -> None:
    assert run("solve", TRIANGLE, "-o", "out", "--rate", "5").exit_code == 0
    before = {file.name: file.read_bytes() for file in (place / "out").iterdir()}
    (place / "bad.yaml").write_text("team: 3\n")
    assert run("solve", "bad.yaml", "-o", "out").exit_code == 2
    assert {file.name: file.read_bytes() for file in (place / "out").iterdir()} == before


def test_a_certificate_that_fails_ends_with_3_and_a_diagnosis(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = solve(TRIANGLE)
    broken = Check.of("speed", 1.5, 1.0, "max", "m/s", 0.75, ("q1",))
    failed = Plan(plan.motion, Certificate(plan.duration, (broken,)), "Too fast")
    monkeypatch.setattr("hitchopt.planning.solve", lambda *_, **__: failed)
    result = run("solve", TRIANGLE, "-o", "out")
    assert result.exit_code == 3
    assert "error: speed: 1.5 m/s is above the limit of 1 m/s at q1, t = 0.75 s" in result.stderr
    assert "NO" in result.stdout
    assert "certified" not in result.stdout
    assert [file.name for file in (place / "out").iterdir()] == ["diagnosis.json"]


def test_an_interrupt_is_quiet(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("hitchopt.planning.solve", interrupted)
    result = run("solve", TRIANGLE)
    assert result.exit_code == 130
    assert result.output == ""
    assert list(place.iterdir()) == []


def test_rows_are_counted_again_when_the_duration_is_known(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hitchopt.cli.commands.MAX_ROWS", 1.1 * 100 * 6)  # above the hold's 1 s
    result = run("solve", TRIANGLE)
    assert result.exit_code == 2
    assert "error: --rate = 100.0: must be at most" in result.stderr
    assert list(place.iterdir()) == []


def test_a_directory_that_cannot_be_made_is_told(place: Path) -> None:
    (place / "file").write_text("")
    result = run("solve", TRIANGLE, "-o", "file/out", "--rate", "5")
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("error: file/out: ")
