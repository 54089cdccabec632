"""Everything that ends before a plan is made, and how errors and signals end a command."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from importlib import metadata
from pathlib import Path

import click
import pydantic
import pytest
from click.testing import CliRunner
from commands import TRIANGLE, refused, run, started
from plans import BAD
from pydantic_core import core_schema

from hitchopt.checks.certificate import CertificateError
from hitchopt.cli.failures import SafeGroup
from hitchopt.errors import (
    FileError,
    HitchoptError,
    InfeasibleError,
    InputError,
    UnsupportedError,
    Violation,
)
from hitchopt.mission.loading import load_problem
from hitchopt.storage import interrupts

pytestmark = pytest.mark.usefixtures("place")

SOLVE = f"solve {TRIANGLE}"
FAULTY = next(path for path in BAD if path.stem == "several_faults")
RATE = "error: --rate = {}: must be above 0 and at most 10000 Hz"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        *((words, "Usage: ") for words in ("fly", "solve", "solve a b", "check", "-x")),
        ("solve a --rate often", "'often' is not a valid float"),
        ("view a --save a.mp4 --ghost b", "--ghost = 'b': must be no ghost"),
        *((f"{SOLVE} --rate {x}", RATE.format(x)) for x in ("0.0", "nan", "1e+300")),
        (f"{SOLVE} --limit inf", "error: --limit = inf: "),
        (f"{SOLVE} -o ''", "error: -o = '': must be a path that is not empty; name one"),
        ("solve ''", "error: FILE = '': must be a path that is not empty"),
        ("check ''", "error: DIR = '': must be a path that is not empty"),
        (f"{SOLVE} -o /", "error: -o = '/': must be a directory of its own"),
        (
            f"solve {FAULTY}",
            f"\nerror: {FAULTY}:8:23: limits.jerk = 0: must be greater than 0; give",
        ),
        ("solve nowhere.yaml", "error: nowhere.yaml: no such file"),
        ("solve .", "Is a directory"),
        ("check nowhere", "error: nowhere/plan.npz: "),
        ("simulate .", "plan.npz: there is no such file"),
        ("init --example triangl", "hitchopt init --list names them"),
        *((f"init {name}", "error: ") for name in ("''", ".", "/", "missing/x", "x" * 300)),
    ],
)
def test_wrong_usage_ends_with_2(words: str, told: str, place: Path) -> None:
    assert told in refused(*(word.strip("'") for word in words.split()))
    assert list(place.iterdir()) == []


def test_what_is_in_the_way_is_told(place: Path) -> None:
    (place / "triangle").write_text("mine")
    assert "error: triangle: is not a directory; choose another" in refused("solve", TRIANGLE)
    told = run("solve", TRIANGLE, "-o", "triangle/out", "--rate", "5", code=2).stderr
    assert told.startswith("error: triangle/out: ")
    assert (place / "triangle").read_text() == "mine"
    (place / "out").mkdir()
    for content in (b"", b"PK\x03\x04 no archive", b"\x93NUMPY"):
        (place / "out" / "plan.npz").write_bytes(content)
        for command in ("check", "view"):  # nothing is served
            assert "error: out/plan.npz: " in refused(command, "out")


@pytest.mark.slow
def test_a_bad_file_in_a_process_of_its_own() -> None:
    done = started("-m", "hitchopt", "solve", str(FAULTY))
    assert (done.returncode, done.stdout) == (2, "")
    assert [line.partition(" ")[0] for line in done.stderr.splitlines()] == ["error:"] * 4
    done = started("-m", "hitchopt", "solve", "größe.yaml", PYTHONIOENCODING="ascii:strict")
    assert (done.returncode, done.stderr[:31]) == (2, "error: gr??e.yaml: no such file")


def test_help_is_light_and_names_every_command() -> None:
    heavy = "casadi matplotlib toppra scipy osqp numpy pydantic ruamel rich"
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
            *("hitchopt.exports.directory.write_setpoints", "", "SIGTERM", f"{SOLVE} -o out"),
            marks=SLOW,
        ),
    ],
)
def test_signals_end_quietly_wherever_they_come(
    target: str, within: str, name: str, words: str, place: Path
) -> None:
    needs = "" if within else "import click, hitchopt.exports.directory"
    told = {"place": target, "within": within, "name": name, "words": words.split(), "needs": needs}
    done = started("-c", DISTURBED.format(**told))
    assert (done.returncode, done.stderr) == ({"SIGINT": 130, "SIGTERM": 143}[name], "")
    assert [path.name for path in place.iterdir()] == ["seen"]
    written = ".hitchopt-" in (place / "seen").read_text()
    assert written is target.endswith("write_setpoints")


@pytest.mark.slow
def test_signals_wait_until_pydantic_has_built_a_model() -> None:
    built = []

    class Noisy:
        @classmethod
        def __get_pydantic_core_schema__(cls, *_: object) -> core_schema.CoreSchema:
            signal.raise_signal(signal.SIGINT)
            return core_schema.any_schema()

    @interrupts.ending_signals()
    def build_and_wait() -> None:
        built.append(pydantic.create_model("Model", noisy=(Noisy, ...)))
        threading.Event().wait(10.0)

    with pytest.raises(SystemExit) as end:
        build_and_wait()
    assert (end.value.code, len(built)) == (130, 1)


VIOLATION = Violation("speed", 2.0, 1.0, "max", "m/s", ("q1",), "at t = 3 s", "slow down")


@pytest.mark.parametrize(
    ("error", "code", "told"),
    [
        (InputError("a.b", 1, "2", "write 2"), 2, "error: a.b = 1: must be 2; write 2\n"),
        (FileError("x: no such file"), 2, "error: x: no such file\n"),
        (InfeasibleError([VIOLATION] * 2), 3, f"error: {VIOLATION}\nerror: {VIOLATION}\n"),
        (UnsupportedError("not yet"), 3, "error: not yet\n"),
        (CertificateError("speed: 2"), 3, "error: speed: 2\n"),
        (HitchoptError(), 3, "error: HitchoptError\n"),
        (KeyboardInterrupt(), 130, ""),
        (OSError(28, "No space left on device", "x"), 2, "error: x: No space left on device; che"),
        (ZeroDivisionError(), 1, ""),  # a bug stays a bug
        (None, 130, ""),  # an interrupt that compiled code made an error of stays one
    ],
    ids=lambda x: type(x).__name__,
)
def test_errors_become_exit_codes(
    error: BaseException | None, code: int, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
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

    monkeypatch.setattr(interrupts, "_shielded", lambda _: False)
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
    assert load_problem("problem.yaml").team.robots == 3
    for name, file in (("a", "a.yaml"), ("b.yml", "b.yml"), ("c.d", "c.d.yaml"), ("ü", "ü.yaml")):
        run("init", name, code=0)
        assert (place / file).exists()
    (place / "mine.yaml").write_text("precious")
    assert "error: mine.yaml: exists already; give another name" in refused("init", "mine")
    assert (place / "mine.yaml").read_text() == "precious"
    (place / "dangling.yaml").symlink_to("nowhere")
    refused("init", "dangling")
    assert not (place / "nowhere").exists()


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
