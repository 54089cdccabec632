"""What scripts and new users see: JSON, silence, standard input, examples, next steps."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from problem_files import BAD, GOOD, ROOT

from hitchopt.cli import main
from hitchopt.cli.problem_templates import MODELINE, SCHEMA, example_files
from hitchopt.cli.progress import done_of
from hitchopt.exports.formats.known_formats import HOMES
from hitchopt.mission.loading import read_problem

TRIANGLE = next(path for path in GOOD if path.stem == "triangle")
IMPOSSIBLE = ROOT / "problems" / "infeasible" / "edge_longer_than_cable.yaml"


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty current directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*arguments: str | Path, given: str | None = None) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments], input=given)


def strict(text: str) -> Any:
    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)


@pytest.mark.slow
def test_results_are_one_object() -> None:
    solved = strict(run("solve", TRIANGLE, "-o", "out", "--rate", "5", "--json").stdout)
    assert (solved["command"], solved["exit_code"], solved["directory"]) == ("solve", 0, "out")
    certificate = json.loads(Path("out/certificate.json").read_text())
    assert solved["certificate"] == certificate
    assert [phase["name"] for phase in solved["phases"]] == ["morph", "hold"]
    checked = strict(run("check", "out", "--json").stdout)
    assert (checked["command"], checked["certificate"]) == ("check", certificate)
    exported = strict(run("export", "out", "--format", "csv", "--rate", "5", "--json").stdout)
    assert exported["parts"][0]["files"] == ["setpoints_enu.csv"]
    linted = strict(run("lint", "out-csv", "--json").stdout)
    assert linted["reports"][0]["sound"] is True
    assert strict(run("report", "out", "--json").stdout)["file"] == "out/report.html"
    saved = strict(run("view", "out", "--save", "plan.png", "--json").stdout)
    assert saved["file"] == "plan.png"
    aborts = strict(run("abort", "out", "--how", "hold", "--json").stdout)
    assert (aborts["how"], aborts["missing"], aborts["directory"]) == ("hold", [], "out")
    assert len(aborts["entries"]) == len(json.loads(Path("out/aborts.json").read_text())["entries"])
    fitted = strict(run("fit", "circle:0.15", "--robots", "3", "-o", "fit", "--json").stdout)
    assert fitted["fit"] == json.loads(Path("fit/fit.json").read_text())
    settled = strict(run("statics", "out", "--samples", "1", "--json").stdout)
    assert settled["statics"] == json.loads(Path("out/statics.json").read_text())


def test_refusals_are_objects_too(place: Path) -> None:
    result = run("solve", IMPOSSIBLE, "-o", "out", "--no-repair", "--json")
    told = strict(result.stdout)
    assert told["exit_code"] == result.exit_code == 3
    assert told["diagnosis"] == json.loads(Path("out/diagnosis.json").read_text())
    assert told["errors"][0]["message"] in result.stderr
    assert "previous" not in told
    bad = next(path for path in BAD if path.stem == "several_faults")
    result = run("solve", bad, "--json")
    told = strict(result.stdout)
    assert told["exit_code"] == result.exit_code == 2
    assert told["errors"][1]["key"] == "limits.jerk"
    assert (told["errors"][1]["line"], told["errors"][1]["column"]) == (8, 23)
    assert sorted(path.name for path in place.iterdir()) == ["out"]


def test_quiet_and_verbose_calls() -> None:
    quiet = run("solve", TRIANGLE, "-o", "out", "--rate", "5", "-q")
    assert (quiet.exit_code, quiet.output) == (0, "")
    assert run("check", "nowhere", "-q").stderr.startswith("error: nowhere/plan.npz: ")
    verbose = run("check", "out", "-v")
    assert verbose.stdout == run("check", "out").stdout
    assert " s  separation, 0 of " in verbose.stderr


def test_a_solve_says_what_to_do_next() -> None:
    result = run("solve", TRIANGLE, "-o", "my out", "--rate", "5")
    assert result.stderr.splitlines() == [
        "next: look at my out/summary.png",
        "      hitchopt simulate 'my out'",
        "      hitchopt export 'my out' --format crazyswarm2 --stretch 1.01",
    ]


def test_what_bends_around_an_object_is_exported_in_full() -> None:
    result = run("solve", TRIANGLE.with_name("grip_drum.yaml"), "-o", "out", "--rate", "5")
    assert result.stderr.splitlines()[-1] == "      hitchopt export out --format csv"


def test_standard_input_is_a_file() -> None:
    result = run("solve", "-", "--rate", "5", given=TRIANGLE.read_text(encoding="utf-8"))
    assert result.exit_code == 0, result.output
    assert Path("stdin/plan.npz").exists()
    faulty = run("solve", "-", given="team: {robots: 3,\n  cable_length: -2}\n")
    assert faulty.exit_code == 2
    assert "error: <stdin>:2:3: team.cable_length = -2: must be" in faulty.stderr
    assert run("solve", "-", given="").stderr.startswith("error: <stdin>: is empty")


def test_a_refusal_keeps_the_last_plan_and_says_so() -> None:
    run("solve", TRIANGLE, "-o", "out", "--rate", "5", "-q")
    for _ in range(2):
        refused = run("solve", IMPOSSIBLE, "-o", "out", "--no-repair")
        last = refused.stderr.splitlines()[-1]
        assert last.endswith("; the last certified plan is in out/previous")
        assert sorted(os.listdir("out")) == ["diagnosis.json", "previous"]
        assert run("check", "out/previous").exit_code == 0
    run("solve", TRIANGLE, "-o", "out", "--rate", "5", "-q")
    assert "previous" not in os.listdir("out")


def test_faults_have_a_line_and_a_column() -> None:
    for path in BAD:
        for line in run("solve", path).stderr.splitlines():
            if " = " in line:  # a fault of a value
                assert line.startswith(f"error: {path}:"), line
                number, column = line.removeprefix(f"error: {path}:").split(":")[:2]
                text = path.read_text(encoding="utf-8").splitlines()[int(number) - 1]
                assert 1 <= int(column) <= len(text) + 1


def test_every_example_is_listed_and_written() -> None:
    listed = strict(run("init", "--list", "--json").stdout)["examples"]
    assert [entry["name"] for entry in listed] == [path.stem for path in example_files()]
    assert len({entry["name"] for entry in listed}) == len(listed) > 30
    for path, entry in zip(example_files(), listed, strict=True):
        first = path.read_text(encoding="utf-8").splitlines()[0]
        assert first.startswith(MODELINE)
        assert (path.parent / first.removeprefix(MODELINE)).resolve() == SCHEMA
        result = run("init", "--example", path.stem)
        assert result.exit_code == 0, result.output
        written = Path(f"{path.stem}.yaml")
        assert written.read_text(encoding="utf-8").splitlines()[0] == f"{MODELINE}{SCHEMA}"
        assert read_problem(written).title == entry["title"]


def test_an_example_gets_another_name_and_a_wrong_one_is_refused() -> None:
    assert run("init", "mine", "--example", "triangle").exit_code == 0
    assert read_problem("mine.yaml").title == read_problem(TRIANGLE).title
    refused = run("init", "--example", "triangl")
    assert refused.exit_code == 2
    assert "did you mean triangle?" in refused.stderr


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("hitchopt export out --format ", list(HOMES)),
        ("hitchopt export out --format sky", ["skybrush", "skybrush_csv"]),
        ("hitchopt init --example tie_", ["tie_carry_untie"]),
        ("hitchopt sim", ["simulate"]),
    ],
)
def test_names_complete_in_the_shell(words: str, expected: list[str]) -> None:
    environment = {
        **os.environ,
        "_HITCHOPT_COMPLETE": "bash_complete",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split(" ")) - 1),
    }
    done = subprocess.run(
        [sys.executable, "-c", "from hitchopt.__main__ import run; run()"],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    assert [line.split(",")[1] for line in done.stdout.splitlines()] == expected, done.stderr


@pytest.mark.parametrize(
    ("message", "done"),
    [
        ("speed, 3 of 22", (3.0, 22.0)),
        ("flying, 1.5 of 12.0 s", (1.5, 12.0)),
        ("writing setpoints, 40%", (40.0, 100.0)),
        ("2 of 10 flown, 1 succeeded", (2.0, 10.0)),
        ("splitting the slack", (None, None)),
        ("0 of 0 done", (None, None)),
    ],
)
def test_counts_fill_the_bar(message: str, done: tuple[float | None, float | None]) -> None:
    assert done_of(message) == done
