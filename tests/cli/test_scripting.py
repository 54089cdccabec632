"""What scripts and new users see: JSON, silence, standard input, examples, tables, progress."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path
from typing import Any

import pytest
from commands import TRIANGLE, run, started, strict
from plans import BAD, ROOT

from hitchopt.checks.certificate import GROUPS, Certificate, Check
from hitchopt.checks.registry import REPORTS, RULES
from hitchopt.cli.output import (
    ProgressBar,
    certificate_table,
    done_of,
    phase_table,
)
from hitchopt.cli.planning import MODELINE, SCHEMA, example_files
from hitchopt.exports.options import HOMES
from hitchopt.mission.loading import read_problem
from hitchopt.motion.motion import Phase

pytestmark = pytest.mark.usefixtures("place")

IMPOSSIBLE = ROOT / "problems" / "infeasible" / "edge_longer_than_cable.yaml"


@pytest.mark.slow
def test_results_are_one_object_and_what_may_take_long_reports_progress() -> None:
    def object_of(words: str) -> Any:
        done = run(*words.split(), "--json", "-v")
        assert " s  " in done.stderr, words
        return json.loads(done.stdout)

    def written(name: str) -> Any:
        return json.loads(Path(name).read_text())

    solved = object_of(f"solve {TRIANGLE} -o out --rate 100")
    assert (solved["command"], solved["exit_code"], solved["directory"]) == ("solve", 0, "out")
    assert solved["certificate"] == written("out/certificate.json")
    assert [phase["name"] for phase in solved["phases"]] == ["morph", "hold"]
    assert object_of("check out --closest")["certificate"] == solved["certificate"]
    assert {row["verdict"] for row in object_of("verify out")["verified"]} == {"proven"}
    exported = object_of("export out --format csv --rate 5")
    assert exported["parts"][0]["files"] == ["setpoints_enu.csv"]
    assert object_of("lint out-csv")["reports"][0]["sound"] is True
    assert object_of("report out")["file"] == "out/report.html"
    assert object_of("view out --save plan.png")["file"] == "plan.png"
    aborts = object_of("abort out --how hold")
    assert (aborts["how"], aborts["missing"], aborts["directory"]) == ("hold", [], "out")
    assert len(aborts["entries"]) == len(written("out/aborts.json")["entries"])
    fitted = object_of("fit circle:0.15 --robots 3 -o fit")
    assert fitted["fit"] == written("fit/fit.json")
    assert object_of("statics out --samples 1")["statics"] == written("out/statics.json")
    flown, saved = object_of("simulate out --seed 3"), written("out/simulation/simulation.json")
    assert flown["simulation"]["succeeded"] is saved["succeeded"]
    assert len(object_of("calibrate out/simulation --plan out")["lengths"]) == 3


def test_refusals_are_objects_too(place: Path) -> None:
    told = strict("solve", IMPOSSIBLE, "-o", "out", "--no-repair")
    assert told["exit_code"] == 3
    assert told["diagnosis"] == json.loads(Path("out/diagnosis.json").read_text())
    assert told["errors"][0]["message"] in told["diagnosis"]["message"]
    assert "previous" not in told
    told = strict("solve", next(path for path in BAD if path.stem == "several_faults"))
    assert told["exit_code"] == 2
    assert told["errors"][1]["key"] == "limits.jerk"
    assert (told["errors"][1]["line"], told["errors"][1]["column"]) == (8, 23)
    assert sorted(path.name for path in place.iterdir()) == ["out"]


@pytest.mark.slow
def test_standard_input_is_a_file_and_a_quiet_command_says_nothing_but_errors() -> None:
    given = TRIANGLE.read_text(encoding="utf-8")
    assert run("solve", "-", "--rate", "5", "-q", given=given, code=0).output == ""
    assert run("check", "stdin", "-q", code=0).output == ""
    assert run("check", "nowhere", "-q").stderr.startswith("error: nowhere/plan.npz: ")
    faulty = run("solve", "-", given="team: {robots: 3,\n  cable_length: -2}\n", code=2)
    assert "error: <stdin>:2:3: team.cable_length = -2: must be" in faulty.stderr
    assert run("solve", "-", given="").stderr.startswith("error: <stdin>: is empty")


def test_every_example_is_listed_and_written() -> None:
    listed = strict("init", "--list")["examples"]
    assert [entry["name"] for entry in listed] == [path.stem for path in example_files()]
    assert len({entry["name"] for entry in listed}) == len(listed) > 30
    for path, entry in zip(example_files(), listed, strict=True):
        first = path.read_text(encoding="utf-8").splitlines()[0]
        assert first.startswith(MODELINE)
        assert (path.parent / first.removeprefix(MODELINE)).resolve() == SCHEMA
        run("init", "--example", path.stem, code=0)
        written = Path(f"{path.stem}.yaml")
        assert written.read_text(encoding="utf-8").splitlines()[0] == f"{MODELINE}{SCHEMA}"
        assert read_problem(written).title == entry["title"]
    run("init", "mine", "--example", "triangle", code=0)
    assert read_problem("mine.yaml").title == read_problem(TRIANGLE).title


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
    count = str(len(words.split(" ")) - 1)
    asked = {"_HITCHOPT_COMPLETE": "bash_complete", "COMP_WORDS": words, "COMP_CWORD": count}
    done = started("-c", "from hitchopt.__main__ import run; run()", **asked)
    assert [line.split(",")[1] for line in done.stdout.splitlines()] == expected, done.stderr


CERTIFICATE = Certificate(
    12.5,
    (
        Check.of("speed", 0.95, 1.0, "max", "m/s", 1.0, ("q0",)),
        Check.of("thrust", 1.3, 2.6, "max", "N", 1.0, ("q0",)),
        Check.of("separation", 1.0625, 1.0, "min", "ratio", 3.25, ("q11", "r3")),
        Check.of("cable_clearance", 0.0875, 0.1, "min", "m", 4.5, ("q11", "cable 10")),
        Check.of("crossing", float("inf"), 0.05, "min", "m", 0.0, ()),
        Check.of("tracking_radius", 0.0125, None, "min", "m", 3.5, ("q0", "r1"), gamma=1.5),
        Check.of("span", 0.9, 1.0, "max", "ratio", 1.5, tuple(f"cable {k}" for k in range(99))),
        Check.of("interlacing", 0, 0, "max", "1", 1.5, ()),
        Check.of("wobble", 1.0, 9.0, "max", "1", 1.5, ()),
    ),
)


def cells(text: str) -> list[str]:
    return ["|".join(re.split(r"  +", line.strip())) for line in text.splitlines()]


def test_phases_and_checks_are_shown_and_the_closest_three_are_marked() -> None:
    rows = cells(phase_table((Phase("morph", 0, 0.0, 1.25), Phase("hold [b]", 1, 1.25, 12.5))))
    assert rows[-2:] == [
        "morph|0|0.000 s|1.250 s|1.250 s",
        "hold [b]|1|1.250 s|12.500 s|11.250 s",
    ]
    shown = certificate_table(CERTIFICATE)
    rows = cells(shown)
    for row in (
        "check|worst|limit|unit|where|when|holds",
        "separation|1.0625|≥ 1|ratio|q11, r3|3.250 s|yes|◂",
        "cable_clearance|0.0875|≥ 0.1|m|q11, cable 10|4.500 s|NO|◂",
        "crossing|–|≥ 0.05|m|yes",
        "tracking_radius|0.0125|γ = 1.5|m|q0, r1|3.500 s|yes",
    ):
        assert row in rows
    assert "and 95 more" in shown
    checks = {check.name for check in CERTIFICATE.checks}
    named = [row.split("|")[0] for row in rows[4:]]
    assert " ".join(name for name in named if name.endswith(":") or name in checks) == (
        "distances: separation cable_clearance crossing tracking_radius motion: speed "
        "forces: thrust cables: span interlacing other: wobble"
    )
    marked = [row.split("|")[0] for row in rows if row.endswith("|◂")]
    assert marked == ["separation", "cable_clearance", "speed"]  # 6 %, broken, 5 % of the limit
    # A pipe gets neither colours nor cuts.
    assert not {"\x1b", "…"} & set(shown)
    assert all(len(line) <= 100 and line == line.rstrip() for line in shown.splitlines())


def test_every_check_has_a_heading() -> None:
    grouped = [name for names in GROUPS.values() for name in names]
    assert sorted(grouped) == sorted({*(r.name for r in (*RULES, *REPORTS)), "survivable"})


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_terminal_sees_a_bar_filled_by_counts_and_a_file_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for stream in (Terminal(), io.StringIO()):
        monkeypatch.setattr("sys.stderr", stream)
        with ProgressBar("planning", 600.0) as progress:
            progress("timing [step 1]")
        for words in ("timing [step 1]", "of at most 600 s"):
            assert (words in stream.getvalue()) is stream.isatty()
    for message, done in (
        ("speed, 3 of 22", (3.0, 22.0)),
        ("flying, 1.5 of 12.0 s", (1.5, 12.0)),
        ("writing setpoints, 40%", (40.0, 100.0)),
        ("splitting the slack", (None, None)),
        ("0 of 0 done", (None, None)),
    ):
        assert done_of(message) == done
