"""Usage, errors, signals, JSON, examples, tables and progress of the command line."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import signal
import subprocess
import sys
from importlib import metadata
from itertools import product
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt.checks import CertificateError
from hitchopt.checks.certificate import GROUPS
from hitchopt.checks.registry import QUANTITIES
from hitchopt.cli.failures import SafeGroup
from hitchopt.cli.output import ProgressBar, echo, phase_table, progress_in, say
from hitchopt.cli.planning import MODELINE, PACKAGE, example_files, problem_text
from hitchopt.drones.quadrotor import MODELS
from hitchopt.errors import FileError, UnsupportedError, Violation
from hitchopt.exports.options import registered_formats
from hitchopt.mission.loading import parse_problem, problem_schema
from hitchopt.mission.template import for_team
from hitchopt.motion.motion import Phase
from hitchopt.storage import interrupts
from hitchopt.storage.yaml_file import with_value
from hitchopt.tables import table
from tests.helpers.clocks import Clock
from tests.helpers.commands import TRIANGLE, refused, run, started, strict
from tests.helpers.plans import BAD, ROOT

pytestmark = pytest.mark.usefixtures("place")

IMPOSSIBLE = ROOT / "problems" / "infeasible" / "edge_longer_than_cable.yaml"
SOLVE = f"solve {TRIANGLE}"
FAULTY = next(path for path in BAD if path.stem == "several_faults")
RATE = "error: --rate = {}: must be above 0 and at most 10000 Hz"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        *((words, "Usage: ") for words in ("fly", "solve", "solve a b", "check", "-x")),
        ("solve a --rate often", "error: --rate = 'often': must be a number; write it without"),
        ("fit a --robots four", "error: --robots = 'four': must be an integer; use a whole number"),
        ("view a --width 3.5in", "error: --width = '3.5in': must be a number; write it without"),
        ("view a --save a.mp4 --ghost b", "--ghost = 'b': must be omitted"),
        *((f"{SOLVE} --rate {x}", RATE.format(x)) for x in ("0.0", "1e+300")),
        (f"{SOLVE} --rate nan", "error: --rate = nan: must be finite"),
        (f"{SOLVE} --limit inf", "error: --limit = inf: "),
        (f"{SOLVE} -o ''", "error: --output = '': must be a path that is not empty; name one"),
        ("solve ''", "error: FILE = '': must be a path that is not empty"),
        ("check ''", "error: DIR = '': must be a path that is not empty"),
        (f"{SOLVE} -o /", "error: --output = '/': must be a separate directory"),
        (
            f"solve {FAULTY}",
            f"\nerror: {FAULTY}:8:23: limits.jerk = 0: must be greater than 0; use",
        ),
        ("solve nowhere.yaml", "error: nowhere.yaml: no such file"),
        ("solve .", ".: is a directory; name the YAML file of a problem"),
        ("check nowhere", 'error: No plan in "nowhere": name a directory that hitchopt solve -o'),
        ("simulate .", 'error: No plan in ".": name a'),
        ("init --example triangl", "must be an example's name; did you mean triangle?"),
        ("init --example xyz", "hitchopt init --list names them"),
        ("sovle x.yaml", "error: No such command 'sovle'. Did you mean 'solve'?"),
        ("solve x.yaml --repot", "'--report'"),
        ("export", "\nskybrush           A Skybrush show of cubic"),
        ("export out", "error: missing --format; choose one, such as"),
        ("fly out", "error: Missing option '--over'. Choose from:"),
        ("view .", 'error: No plan in ".": name a directory that hitchopt solve -o wrote.'),
        ("fit none.csv --robots 3", "error: none.csv: there is no such file"),
        ("init --drone crazyfly", "error: --drone = 'crazyfly': must be crazyflie_2.1"),
        *((f"init --robots {n}", f"error: --robots = {n}: must be at ") for n in (0, 2, 13)),
        ("init --robots 4 --kind carry", "error: --robots = 4: must be omitted with --kind"),
        (
            "init --drone x260_bolt --example triangle",
            "error: --drone = 'x260_bolt': must be omitt",
        ),
        ("fit circle:-1 --robots 3", "error: OUTLINE = -1.0: must be greater than 0"),
        (f"{SOLVE} --repair-to {TRIANGLE}", "triangle.yaml: exists already; use another name"),
        (f"{SOLVE} --take 4 --repair-to own", "error: --take = 4: must be"),
        (f"{SOLVE} --take 2", "error: --take = 2: must be used with --repair-to"),
        (f"calibrate {ROOT}/problems/show", "must be a flight, not its plan; name the file"),
        *((f"init {name}", "error: ") for name in ("''", ".", "/", "missing/x", "x" * 300)),
    ],
)
def test_invalid_usage_ends_with_2(words: str, told: str, place: Path) -> None:
    assert told in refused(*(word.strip("'") for word in words.split()))
    assert list(place.iterdir()) == []


def test_files_in_the_way_are_reported(place: Path) -> None:
    (place / "triangle").write_text("mine")
    for words in ([], ["-o", "triangle/out"]):
        assert "triangle is not a writable directory" in refused("solve", TRIANGLE, *words)
    assert (place / "triangle").read_text() == "mine"
    (place / "out").mkdir()
    for content in (b"", b"PK\x03\x04 no archive", b"\x93NUMPY"):
        (place / "out" / "plan.npz").write_bytes(content)
        for command in ("check", "view"):  # nothing is served
            assert "error: out/plan.npz: " in refused(command, "out")


@pytest.mark.slow
def test_a_bad_file_in_a_process_of_its_own() -> None:
    done = started("-m", "hitchopt", "solve", "größe.yaml", PYTHONIOENCODING="ascii:strict")
    assert (done.returncode, done.stderr[:31]) == (2, "error: gr??e.yaml: no such file")


def test_help_is_light_and_names_every_command() -> None:
    heavy = "casadi matplotlib toppra scipy osqp numpy ruamel rich"
    code = (
        "import sys\nfrom hitchopt.cli import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit as end:\n    assert end.code == 0\n"
        f"print([name for name in {heavy.split()!r} if name in sys.modules])\n"
    )
    done = started("-c", code)
    *shown, loaded = done.stdout.splitlines()
    assert (done.returncode, loaded) == (0, "[]"), done.stderr
    assert shown[0].startswith("Usage:")
    assert {"solve", "check", "init"} <= {line.split()[0] for line in shown if line.strip()}
    assert run("solve", "-h", code=0).stdout.startswith("Usage: main solve")
    assert run("--version", code=0).stdout.split()[-1] == metadata.version("hitchopt")


def test_a_checkout_that_is_not_installed_has_no_version(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> str:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "version", missing)
    assert "version unknown: this checkout is not installed" in run("--version", code=0).stdout


def test_the_help_says_why_it_has_no_descriptions() -> None:
    assert "python -OO strips all descriptions" in started("-OO", "-m", "hitchopt", "-h").stdout
    assert "strips all descriptions" not in run("--help", code=0).stdout


MORPH_IN_PYTHON = """
import hitchopt as ho
polygon, goal = [[0, -1], [-0.4, 0.5], [0.4, 0.5]], [[0, -0.6], [-0.4, 0.5], [0.4, 0.5]]
start = ho.Hitch.spread(ho.Team(robots=3, cable_length=2.4), polygon)
try:
    ho.morph(start, goal)
except ho.InputError as error:
    print(error)
"""


BACKEND = "backend_of_another_environment"


@pytest.mark.slow
def test_the_backend_of_a_notebook_is_not_needed() -> None:
    """Jupyter sets it for the commands of a cell, also where it is not installed."""
    solve = ("-m", "hitchopt", "solve", str(TRIANGLE), "-o", "out")
    done = started(*solve, MPLBACKEND=BACKEND)
    assert (done.returncode, "warning" in done.stderr) == (0, False), done.stderr
    assert Path("out", "summary.png").is_file()


@pytest.mark.slow
def test_in_python_a_missing_backend_is_named() -> None:
    done = started("-c", MORPH_IN_PYTHON, MPLBACKEND=BACKEND)
    assert done.stdout.startswith(f"MPLBACKEND = '{BACKEND}': must be installed here; unset this")
    assert "or set it to Agg" in done.stdout


DISTURBED = """
import builtins, os, signal, sys
{needs}
real = {place}

def disturbed(*arguments, **options):
    if {within!r} and not arguments[0].startswith({within!r}):
        return real(*arguments, **options)
    {place} = real
    open("seen", "w").write(repr(os.listdir()))
    try:
        os.kill(os.getpid(), signal.{name})
        for _ in range(1000):
            pass
    except BaseException:
        if {within!r}:  # as compiled modules do
            raise ImportError("failed to import") from None
        raise
    return real(*arguments, **options)

{place} = disturbed
sys.argv = ["hitchopt", *{words!r}]
from hitchopt.__main__ import run
run()
"""

SLOW = [pytest.mark.slow]


@pytest.mark.parametrize(
    ("target", "within", "name", "words"),
    [
        pytest.param("builtins.__import__", "click", "SIGINT", f"{SOLVE} -o out", marks=SLOW),
        pytest.param("builtins.__import__", "numpy", "SIGTERM", f"{SOLVE} -o out", marks=SLOW),
        ("click.Context.__init__", "", "SIGINT", "init x"),
        ("click.Context.close", "", "SIGTERM", "init -h"),
        pytest.param(
            *("hitchopt.directory.write_setpoints", "", "SIGTERM", f"{SOLVE} -o out"),
            marks=SLOW,
        ),
    ],
)
def test_signals_end_quietly_wherever_they_come(
    target: str, within: str, name: str, words: str, place: Path
) -> None:
    needs = "" if within else "import click, hitchopt.directory"
    told = {"place": target, "within": within, "name": name, "words": words.split(), "needs": needs}
    done = started("-c", DISTURBED.format(**told))
    assert (done.returncode, done.stderr) == ({"SIGINT": 130, "SIGTERM": 143}[name], "")
    assert [path.name for path in place.iterdir()] == ["seen"]
    written = ".hitchopt-" in (place / "seen").read_text()
    assert written is target.endswith("write_setpoints")


def test_commands_say_how_they_end() -> None:
    """Also in processes that were started with SIGINT ignored, where Ctrl-C does nothing."""
    assert interrupts.how_to_end() == "Ctrl-C ends this"
    usual = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        assert f"`kill {os.getpid()}` ends this" in interrupts.how_to_end()
    finally:
        signal.signal(signal.SIGINT, usual)


VIOLATION = Violation("speed", 2.0, 1.0, "max", "m/s", ("q1",), "at t = 3 s", "slow down")


@pytest.mark.parametrize(
    ("error", "code", "told"),
    [
        (ho.InputError("a.b", 1, "2", "write 2"), 2, "error: a.b = 1: must be 2; write 2\n"),
        (FileError("x: no such file"), 2, "error: x: no such file\n"),
        (ho.InfeasibleError([VIOLATION] * 2), 3, f"error: {VIOLATION}\nerror: {VIOLATION}\n"),
        (UnsupportedError("not yet"), 3, "error: not yet\n"),
        (CertificateError("speed: 2"), 3, "error: speed: 2\n"),
        (ho.HitchoptError(), 3, "error: HitchoptError\n"),
        (KeyboardInterrupt(), 130, ""),
        (OSError(28, "No space left on device", "x"), 2, "error: x: No space left on device; che"),
        (ZeroDivisionError(), 1, ""),  # a bug stays a bug
        (None, 130, ""),  # an interrupt that compiled code made an error of stays one
    ],
    ids=lambda x: type(x).__name__,
)
def test_errors_become_exit_codes(error: BaseException | None, code: int, told: str) -> None:
    @click.group(cls=SafeGroup)
    def group() -> None: ...

    @group.command()
    def fail() -> None:
        if error is not None:
            raise error
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise SystemError("returned a result with an exception set") from None

    result = CliRunner().invoke(group, ["fail"])
    assert result.exit_code == code
    assert isinstance(result.exception, ZeroDivisionError if code == 1 else SystemExit)
    assert result.stderr.startswith(told)
    assert result.stderr.count("error: ") == told.count("error: ")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_init_writes_a_problem_that_loads_and_never_overwrites(place: Path) -> None:
    said = run("init", code=0).stdout
    assert said.splitlines() == ["wrote problem.yaml; try: hitchopt solve problem.yaml"]
    assert ho.load_problem("problem.yaml").team.robots == 3
    run("init", "--schema", code=0)
    schema = Path(MODELINE.partition("=")[2].strip())  # which the written file names
    assert json.loads(schema.read_text("utf-8")) == problem_schema()
    for name, file in (("a", "a.yaml"), ("b.yml", "b.yml"), ("c.d", "c.d.yaml"), ("ü", "ü.yaml")):
        run("init", name, code=0)
        assert (place / file).exists()
    (place / "problem.yaml").unlink()
    for words, said in (
        ("carry", "solve problem"),
        ("swarm s", "solve s"),
    ):
        done = run("init", "--kind", *words.split(), code=0)
        assert f"hitchopt {said}.yaml\n" in done.stdout
    assert [*ho.load_problem("problem.yaml").objects] == ["table", "shelf", "box"]
    assert ho.load_problem("s.yaml").team.drones == 6
    assert "error: --kind" in refused("init", "--kind", "swarm", "--example", "triangle")
    (place / "mine.yaml").write_text("precious")
    assert "error: mine.yaml: exists already; use another name" in refused("init", "mine")
    assert (place / "mine.yaml").read_text() == "precious"
    (place / "dangling.yaml").symlink_to("nowhere")
    refused("init", "dangling")
    assert not (place / "nowhere").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("place")
@pytest.mark.parametrize(("name", "robots"), [*zip(MODELS, (3, 6, 4, 5, 8), strict=True)])
def test_a_problem_for_drones_of_a_model_is_planned(name: str, robots: int) -> None:
    said = run("init", "mine", "--drone", name, "--robots", str(robots), code=0).stdout
    team = ho.load_problem("mine.yaml").team
    assert (team.robots, team.cable_density) == (robots, MODELS[name].cable_density)
    assert team.quadrotor == ho.Team(robots, 2.4, quadrotor=name).quadrotor
    told = re.search(r"tension ([\d.]+) N \(tilt allows ([\d.]+) N\)", said)
    assert told is not None
    weight = 9.81 * team.mass[0]
    pulls = [team.tension[0], weight]
    assert [float(told[1]), float(told[2])] == pytest.approx(pulls, rel=5e-3)  # three digits
    done = run("solve", "mine.yaml", "-o", "out", "--no-picture", code=0)
    assert told[0] in done.stdout
    assert "warning" not in done.stderr


RANGE = re.compile(
    r"cables of ([\d.]+) (?:to ([\d.]+) )?m.* and tensions of ([\d.]+) to ([\d.]+) N"
)


@pytest.mark.slow
def test_cable_lengths_and_tensions_that_fit_are_planned(place: Path) -> None:
    """At both ends of their ranges; the written ones are within."""
    said = run("init", "mine", "--robots", "6", code=0).stdout
    told = RANGE.search(said)
    assert told is not None
    shortest, longest, *pulls = (float(each or "inf") for each in told.groups())
    text, team = (place / "mine.yaml").read_text("utf-8"), ho.load_problem("mine.yaml").team
    assert shortest <= team.cable_length[0] <= longest
    assert pulls[0] <= team.tension[0] <= pulls[1]
    longest = min(longest, shortest + 1.0)
    ends = [("cable_length", x) for x in (shortest, longest)] + [("tension", x) for x in pulls]
    for key, value in ends:
        plan = ho.solve(parse_problem(with_value(text, ("team", key), value)))
        assert plan.certificate.certified, (key, value)


@pytest.mark.slow
@pytest.mark.usefixtures("place")
def test_init_fits_any_number_of_robots_to_models() -> None:
    template = problem_text(PACKAGE / "mission" / "template.yaml")
    assert for_team(template).text == template  # which is written for its own drones
    for name, robots in zip((*MODELS, *MODELS), range(3, 13), strict=True):
        fitted = for_team(template, name, robots)
        team = parse_problem(fitted.text).team
        assert team.quadrotor == (ho.Quadrotor(model=name),) * robots
        assert not re.search(r"[^\s#]#", fitted.text), "a comment begins after a blank"
        assert fitted.lengths[0] < team.cable_length[0] < fitted.lengths[1], (name, robots)
        assert fitted.tensions[0] <= team.tension[0] <= fitted.tensions[1], (name, robots)


def test_a_reader_that_has_left_changes_nothing(place: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "hitchopt", "init", "x"]
    with os.fdopen(writing, "wb") as closed:
        done = subprocess.run(
            command, stdout=closed, stderr=subprocess.PIPE, timeout=60, check=False
        )
    assert (done.returncode, done.stderr) == (0, b"")
    assert (place / "x.yaml").exists()


@pytest.mark.slow
def test_results_are_one_json_object_and_slow_commands_report_progress() -> None:
    def object_of(words: str) -> Any:
        done = run(*words.split(), "--json", "-v")
        assert " s  " in done.stderr, words
        return json.loads(done.stdout)

    def written(name: str) -> Any:
        return json.loads(Path(name).read_text())

    solved = object_of(f"solve {TRIANGLE} -o out --rate 100")
    assert (solved["command"], solved["exit_code"], solved["directory"]) == ("solve", 0, "out")
    certificate = written("out/certificate.json")
    assert {*certificate.pop("tables")} == {"setpoints.csv", "vertices.csv"}
    assert solved["certificate"] == certificate
    assert [phase["name"] for phase in solved["phases"]] == ["morph", "hold"]
    assert object_of("check out --closest")["certificate"] == solved["certificate"]
    assert {row["verdict"] for row in object_of("verify out")["verified"]} == {"proven"}
    exported = object_of("export out --format csv --rate 20")
    assert exported["parts"][0]["files"] == ["setpoints_enu.csv"]
    assert object_of("lint out-csv")["reports"][0]["sound"] is True
    assert object_of("report out")["file"] == "out/report.html"
    assert object_of("view out --save plan.png")["file"] == "plan.png"
    aborts = object_of("abort out --how hold")
    assert (aborts["how"], aborts["missing"], aborts["directory"]) == ("hold", [], "out")
    (table,) = written("out/aborts.json")["tables"]
    assert len(aborts["entries"]) == len(table["entries"])
    fitted = object_of("fit circle:0.15 --robots 3 -o fit")
    assert fitted["fit"] == written("fit/fit.json")
    assert object_of("statics out --at 1")["statics"] == written("out/statics.json")
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
    assert run("check", "nowhere", "-q").stderr.startswith('error: No plan in "nowhere"')
    faulty = run("solve", "-", given="team: {robots: 3,\n  cable_length: -2}\n", code=2)
    assert "error: <stdin>:2:3: team.cable_length = -2: must be" in faulty.stderr
    assert run("solve", "-", given="").stderr.startswith("error: <stdin>: is empty")


def test_every_example_is_listed_and_written() -> None:
    listed = strict("init", "--list")["examples"]
    assert [entry["name"] for entry in listed] == [path.stem for path in example_files()]
    assert len({entry["name"] for entry in listed}) == len(listed) > 30
    for path, entry in zip(example_files(), listed, strict=True):
        run("init", "--example", path.stem, code=0)
        written = Path(f"{path.stem}.yaml")
        assert written.read_text(encoding="utf-8").startswith(MODELINE)
        assert ho.load_problem(written).title == entry["title"]
    run("init", "mine", "--example", "triangle", code=0)
    assert ho.load_problem("mine.yaml").title == ho.load_problem(TRIANGLE).title


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("hitchopt export out --format ", list(registered_formats())),
        ("hitchopt export out --format sky", ["skybrush"]),
        ("hitchopt init --example tie_", ["tie_carry_untie"]),
        ("hitchopt sim", ["simulate"]),
    ],
)
def test_names_complete_in_the_shell(words: str, expected: list[str]) -> None:
    count = str(len(words.split(" ")) - 1)
    asked = {"_HITCHOPT_COMPLETE": "bash_complete", "COMP_WORDS": words, "COMP_CWORD": count}
    done = started("-c", "from hitchopt.__main__ import run; run()", **asked)
    assert [line.split(",")[1] for line in done.stdout.splitlines()] == expected, done.stderr


KNOWN = {each.name: each for each in QUANTITIES}


def check_of(name: str, *values: Any, **options: Any) -> ho.Check:
    """Return a check under its heading."""
    if name in KNOWN:
        options |= {"group": KNOWN[name].group, "derivative": KNOWN[name].derivative}
    return ho.Check.of(name, *values, **options)


CERTIFICATE = ho.Certificate(
    12.5,
    (
        check_of("speed", 0.985, 1.0, "max", "m/s", 1.0, ("q0",)),
        check_of("jerk", 19.99, 20.0, "max", "m/s³", 1.0, ("q0",)),
        check_of("arena", -8e-12, 0.0, "min", "m", 0.0, ("q0",)),
        check_of("thrust", 1.3, 2.6, "max", "N", 1.0, ("q0",)),
        check_of("separation", 1.0625, 1.0, "min", "ratio", 3.25, ("q11", "r3")),
        check_of("cable_clearance", 0.099999, 0.1, "min", "m", 4.5, ("q11", "cable 10")),
        check_of("crossing", float("inf"), 0.05, "min", "m", 0.0, ()),
        check_of("tracking_radius", 0.0125, None, "min", "m", 3.5, ("q0", "r1"), gamma=1.5),
        check_of("span", 0.9, 1.0, "max", "ratio", 1.5, tuple(f"cable {k}" for k in range(99))),
        check_of("interlacing", 0, 0, "max", "1", 1.5, ()),
        check_of("wobble", 1.0, 9.0, "max", "1", 1.5, ()),
    ),
)


def cells(text: str) -> list[str]:
    return ["|".join(re.split(r"  +", line.strip())) for line in text.splitlines()]


def test_tables_have_four_digits_and_fit_80_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    rows = cells(phase_table((Phase("morph", 0, 0.0, 1.25), Phase("hold [b]", 1, 1.25, 12.5))))
    assert rows[-2:] == [
        "morph|0|0.000 s|1.250 s|1.250 s",
        "hold [b]|1|1.250 s|12.500 s|11.250 s",
    ]
    shown = str(CERTIFICATE)
    rows = cells(shown)
    for row in (
        "check|worst|limit|unit|where|when|holds",
        "separation|1.062|≥ 1|ratio|q11, r3|3.250 s|yes",
        "cable_clearance|0.099999|≥ 0.1|m|q11, cable 10|4.500 s|NO",  # as many as tell them apart
        "crossing|–|≥ 0.05|m|nothing to check|yes",
        "tracking_radius|0.0125|γ = 1.5|m|q0, r1|3.500 s|yes",
        "span|0.9|≤ 1|ratio|cable 0, cable 1 and 97 more|1.500 s|yes",
        "arena|0|≥ 0|m|q0|0.000 s|yes",
    ):
        assert row in rows
    checks = {check.name for check in CERTIFICATE.checks}
    named = [row.split("|")[0] for row in rows]
    assert " ".join(name for name in named if name.endswith(":") or name in checks) == (
        "distances: arena separation cable_clearance crossing tracking_radius motion: speed "
        "jerk forces: thrust cables: span interlacing other: wobble"
    )
    # A pipe gets no colours. Nothing binds where something does not hold.
    monkeypatch.setenv("COLUMNS", "80")
    shown = str(CERTIFICATE)
    assert not {"\x1b", "…"} & set(shown)
    assert all(len(line) <= 80 and line == line.rstrip() for line in shown.splitlines())
    assert "as fast as" not in shown


def test_certified_plans_have_no_column_of_verdicts_and_binding_limits_are_named() -> None:
    held = ho.Certificate(1.0, tuple(check for check in CERTIFICATE.checks if check.holds))
    shown = str(held)
    assert held.binding == ("jerk", "speed")
    assert shown.endswith("\n\nas fast as jerk and speed allow")
    assert "holds" not in shown
    assert "holds" not in held._repr_html_()
    assert "<td>0.099999</td>" in CERTIFICATE._repr_html_()
    with pytest.raises(KeyError, match=r"no check 'speeed'; did you mean speed\?"):
        held["speeed"]


def test_text_wraps_and_numbers_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "30")
    words = "a q-leg that is too long for its column"
    lines = table("T", [{"name": "one", "why": words, "of": 1234.5678}]).splitlines()
    assert max(map(len, lines)) <= 30
    assert re.fullmatch(r"one   a q-leg .* 1235", lines[3])
    assert " ".join(" ".join(lines[3:]).replace("1235", "").split()) == f"one {words}"
    where = ["north.q-leg 0", "north.cable 12"]
    lines = table("T", [{"worst": 1.5, "limit": "≥ 1", "where": ", ".join(where)}]).splitlines()
    assert lines[3:] == ["1.5      ≥ 1  north.q-leg 0,", " " * 14 + where[1]]


def test_errors_are_red_and_wrapped_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    words = "error: one = 3: must be below 2 at q-leg 0 and at all times; give another"
    for stream in (Terminal(), io.StringIO()):
        with contextlib.redirect_stderr(stream):
            say(words, err=True)
        assert ("\x1b[31m" in stream.getvalue()) is stream.isatty()
        first, *others = click.unstyle(stream.getvalue()).splitlines()
        assert (len(first) <= 40 and bool(others)) is stream.isatty()
        assert all(re.fullmatch(r"  \S.{,37}", line) for line in others)
        assert " ".join([first, *(line[2:] for line in others)]) == words


def test_every_check_has_a_heading() -> None:
    assert [each.name for each in QUANTITIES if each.group not in GROUPS] == []


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_terminal_sees_a_bar_filled_by_counts_and_a_file_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    long = "transport_object.via none -> [3.5, -2.72, 0.3]"
    messages = (("timing [step 1]",) * 2, (long, "transport_object.via none -> [3…"))
    for stream, (message, words) in product((Terminal, io.StringIO), messages):
        written = stream()
        with contextlib.redirect_stderr(written), ProgressBar("planning", 600.0) as progress:
            progress(message)
        shown = re.sub(r"\x1b\[[\d;]*m", "", written.getvalue())
        for part in (f"{words} ", "0:00:00 of at most 600 s\n"):
            assert (part in shown) is written.isatty(), shown
    for message, done in (
        ("speed, 3 of 22", (3.0, 22.0)),
        ("flying, 1.5 of 12.0 s", (1.5, 12.0)),
        ("writing setpoints, 40%", (40.0, 100.0)),
        ("splitting the slack", (None, None)),
        ("0 of 0 done", (None, None)),
    ):
        assert progress_in(message) == done


def test_long_work_without_a_terminal_is_reported_now_and_then(clock: Clock) -> None:
    written = io.StringIO()
    with contextlib.redirect_stderr(written), ProgressBar("planning") as progress:
        for count in range(100):
            progress(f"certifying, {count} of 100")
    lines = written.getvalue().splitlines()
    assert [line.partition(":")[0] for line in lines] == ["20 s", "80 s"]
    assert lines[0].endswith(": certifying, 18 of 100")
    assert clock.now == 102.0


def test_a_key_of_a_file_that_is_called_as_an_option_is_placed_in_the_file(tmp_path: Path) -> None:
    file = tmp_path / "problem.yaml"
    file.write_text("limit: {speed: 1}\n" + problem_text(TRIANGLE))
    error = refused("solve", file, "-o", tmp_path / "out")
    assert "problem.yaml:1" in error
    assert "--limit" not in error


def test_terminals_show_titles_verdicts_and_warnings_by_style(
    capsys: pytest.CaptureFixture[str],
) -> None:
    text = "Limits\ncheck  verdict\n──────────────\nlegs   NO\n\nproven: all\nwarning: low"
    shown = {}
    for colour in (False, True):
        with click.Context(click.Command("x"), color=colour):
            echo(text)
        shown[colour] = capsys.readouterr().out
    assert shown[False] == f"{text}\n"
    assert click.unstyle(shown[True]) == shown[False]
    styled = re.findall(r"((?:\x1b\[\d+m)+)(.+?)\x1b\[0m", shown[True])
    assert [words for _, words in styled] == [
        *("Limits", "─" * 14, "NO", "proven", "warning:"),
    ]
    assert len({style for style, _ in styled}) == 5
