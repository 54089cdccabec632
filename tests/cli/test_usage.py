"""Everything that ends before a plan is made."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from importlib import metadata
from pathlib import Path

import click
import pydantic
import pytest
from click.testing import CliRunner, Result
from problem_files import BAD, GOOD, header
from pydantic_core import core_schema

from hitchopt import interrupts
from hitchopt.checks.certificate import CertificateError
from hitchopt.cli import main
from hitchopt.cli.commands import MAX_ROWS
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

TRIANGLE = next(path for path in GOOD if path.stem == "triangle")


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty current directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def refused(result: Result, code: int = 2) -> str:
    assert result.exit_code == code, result.output
    assert isinstance(result.exception, SystemExit)
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
    return result.stderr


def started(*arguments: str, **options: object) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, **{k: str(v) for k, v in options.items()}}
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        env=environment,
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize("path", BAD, ids=lambda path: path.stem)
def test_bad_files_end_with_2_and_leave_nothing(path: Path, place: Path) -> None:
    told = refused(run("solve", path))
    assert header(path, "Names") in told
    assert all(line.startswith("error: ") for line in told.splitlines())
    assert list(place.iterdir()) == []


def test_a_bad_file_in_a_process_of_its_own(place: Path) -> None:
    bad = next(path for path in BAD if path.stem == "several_faults")
    done = started("-m", "hitchopt", "solve", str(bad))
    assert done.returncode == 2
    assert done.stdout == ""
    lines = done.stderr.splitlines()
    assert len(lines) == 4
    reason = "limits.jerk = 0: must be greater than 0; give a positive number"
    assert lines[1] == f"error: {bad}:8:23: {reason}"
    assert list(place.iterdir()) == []


def test_help_is_light() -> None:
    heavy = "casadi matplotlib toppra scipy osqp numpy pydantic ruamel rich"
    code = (
        "import sys\n"
        "from hitchopt.cli import main\n"
        "try:\n    main(['--help'])\n"
        "except SystemExit as end:\n    assert end.code == 0\n"
        f"print([name for name in {heavy.split()!r} if name in sys.modules])\n"
    )
    done = started("-c", code)
    assert done.returncode == 0, done.stderr
    *shown, loaded = done.stdout.splitlines()
    assert loaded == "[]"
    assert shown[0].startswith("Usage:")
    assert {"solve", "check", "init"} <= {line.split()[0] for line in shown if line.strip()}


@pytest.mark.parametrize("command", ["solve", "check", "init"])
def test_every_command_has_help(command: str) -> None:
    result = run(command, "-h")
    assert result.exit_code == 0
    assert result.stdout.startswith(f"Usage: main {command}")


def test_version() -> None:
    result = run("--version")
    assert result.exit_code == 0
    assert result.stdout.split()[-1] == metadata.version("hitchopt")


@pytest.mark.parametrize(
    "arguments",
    [
        *(["fly"], ["solve"], ["solve", "a", "b"], ["solve", "a", "--rate", "often"], ["check"]),
        *(["view", "a", "--save", "a.mp4", "--ghost", "b"], ["-x"]),
    ],
    ids=" ".join,
)
def test_wrong_usage_ends_with_2(arguments: list[str]) -> None:
    refused(run(*arguments))


@pytest.mark.parametrize("rate", ["0", "-1", "nan", "inf", "10001", "1e300"])
def test_rates_out_of_range_are_refused(rate: str, place: Path) -> None:
    told = refused(run("solve", TRIANGLE, "--rate", rate))
    assert "error: --rate = " in told
    assert "must be above 0 and at most 10000 Hz" in told
    assert list(place.iterdir()) == []


def test_absurdly_long_tables_are_refused_before_planning(place: Path) -> None:
    file = place / "long.yaml"
    file.write_text(TRIANGLE.read_text().replace("seconds: 1.0", "seconds: 1e7"))
    told = refused(run("solve", file))
    # 1e7 s of 6 drones: 6e7 rows a second of rate.
    assert f"at most {MAX_ROWS / 6e7:.3g} Hz for a plan of 1e+07 s and 6 drones" in told
    assert [path.name for path in place.iterdir()] == ["long.yaml"]


@pytest.mark.parametrize(
    ("arguments", "key"),
    [
        (["solve", str(TRIANGLE), "-o", ""], "-o"),
        (["solve", ""], "FILE"),
        (["check", ""], "DIR"),
        (["export", "out", "--format", "csv", "-o", ""], "-o"),
        (["simulate", "out", "-o", ""], "-o"),
    ],
    ids=lambda x: " ".join(x) if isinstance(x, list) and len(x) < 4 else None,
)
def test_empty_paths_are_refused(arguments: list[str], key: str, place: Path) -> None:
    assert f"error: {key} = '': must be a path that is not empty; name one" in refused(
        run(*arguments)
    )
    assert list(place.iterdir()) == []


@pytest.mark.parametrize("limit", ["0", "-1", "nan", "inf"])
def test_limits_of_time_out_of_range_are_refused(limit: str, place: Path) -> None:
    assert "error: --limit = " in refused(run("solve", TRIANGLE, "--limit", limit))
    assert list(place.iterdir()) == []


INTERRUPTED = """
import builtins, sys
from pathlib import Path

real, sent = builtins.__import__, []

def disturbed(name, *rest, **options):
    if name.startswith({module!r}) and not sent:
        sent.append(name)
        real("hostile")
    return real(name, *rest, **options)

builtins.__import__ = disturbed
sys.argv = ["hitchopt", "solve", {file!r}, "-o", "out"]
from hitchopt.__main__ import run
try:
    run()
finally:
    Path("sent").write_text(str(len(sent)))
"""


HOSTILE = """
import os, signal
try:
    os.kill(os.getpid(), signal.{signal})
    for _ in range(1000):
        pass
except BaseException:  # as compiled modules do
    raise ImportError("failed to import") from None
"""


@pytest.mark.slow
@pytest.mark.parametrize("module", ["click", "hitchopt.cli.commands", "numpy", "casadi"])
@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_signals_within_imports_end_quietly(module: str, name: str, code: int, place: Path) -> None:
    (place / "hostile.py").write_text(HOSTILE.format(signal=name))
    script = INTERRUPTED.format(module=module, file=str(TRIANGLE))
    done = started("-c", script)
    assert (done.returncode, done.stderr) == (code, "")
    assert {path.name for path in place.iterdir()} <= {"sent", "hostile.py", "__pycache__"}
    assert (place / "sent").read_text() == "1"


BETWEEN = """
import os, signal, sys
import click

real = {method}

def disturbed(*arguments, **options):
    {method} = real
    os.kill(os.getpid(), signal.{signal})
    return real(*arguments, **options)

{method} = disturbed
sys.argv = ["hitchopt", "init", "x"]
from hitchopt.__main__ import run
run()
"""


@pytest.mark.parametrize("method", ["click.Context.__init__", "click.Context.close"])
@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_signals_between_imports_and_command_end_quietly(method: str, name: str, code: int) -> None:
    done = started("-c", BETWEEN.format(method=method, signal=name))
    assert (done.returncode, done.stderr) == (code, "")


@pytest.mark.slow
def test_signals_wait_until_pydantic_has_built_a_model() -> None:
    built = []

    class Noisy:
        @classmethod
        def __get_pydantic_core_schema__(cls, *_: object) -> core_schema.CoreSchema:
            signal.raise_signal(signal.SIGINT)
            return core_schema.any_schema()

    def build_and_wait() -> None:
        with interrupts.ending_signals():
            built.append(pydantic.create_model("Model", noisy=(Noisy, ...)))
            time.sleep(10.0)

    with pytest.raises(SystemExit) as end:
        build_and_wait()
    assert end.value.code == 130
    assert len(built) == 1


def test_signals_after_the_command_end_the_process_at_once() -> None:
    script = (
        "import os, signal, sys\nfrom hitchopt.__main__ import run\nsys.argv = ['hitchopt', '-h']\n"
        "try:\n    run()\nfinally:\n    os.kill(os.getpid(), signal.SIGINT)\n    print('survived')"
    )
    done = started("-c", script)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")
    assert "survived" not in done.stdout


WRITING = """
import os, signal, sys
from pathlib import Path
import hitchopt.exports.directory as directory

def kill(*_):
    seen = [path.name for path in Path().iterdir()]
    Path("seen").write_text(repr(seen))
    os.kill(os.getpid(), signal.SIGTERM)

directory.write_setpoints = kill
sys.argv = ["hitchopt", "solve", {file!r}, "-o", "out"]
from hitchopt.__main__ import run
run()
"""


def test_sigterm_while_a_plan_is_written_leaves_nothing(place: Path) -> None:
    done = started("-c", WRITING.format(file=str(TRIANGLE)))
    assert (done.returncode, done.stderr) == (143, "")
    assert "out" in (place / "seen").read_text()  # the temporary directory's name
    assert [path.name for path in place.iterdir() if path.name != "seen"] == []


def test_an_interrupt_that_compiled_code_made_an_error_of_stays_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    @click.group(cls=SafeGroup)
    def group() -> None: ...

    @group.command()
    def fail() -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise SystemError("returned a result with an exception set") from None

    monkeypatch.setattr(interrupts, "_shielded", lambda _: False)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    refused(CliRunner().invoke(group, ["fail"]), 130)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_missing_files_are_told() -> None:
    assert "error: nowhere.yaml: no such file" in refused(run("solve", "nowhere.yaml"))
    assert "is a directory" in refused(run("solve", "."))
    assert "error: nowhere/plan.npz: " in refused(run("check", "nowhere"))


def test_a_file_in_the_directorys_place_is_told_before_planning(place: Path) -> None:
    (place / "triangle").write_text("mine")
    told = refused(run("solve", TRIANGLE))
    assert "error: triangle: is not a directory; choose another one with -o" in told
    assert (place / "triangle").read_text() == "mine"


def test_broken_plans_are_told(place: Path) -> None:
    plan = place / "out" / "plan.npz"
    plan.parent.mkdir()
    for content in (b"", b"PK\x03\x04 no archive", b"\x93NUMPY"):
        plan.write_bytes(content)
        assert "error: out/plan.npz: " in refused(run("check", "out"))
        assert "error: out/plan.npz: " in refused(run("view", "out"))  # nothing is served


def test_init_writes_a_problem_that_loads(place: Path) -> None:
    result = run("init")
    assert result.exit_code == 0
    assert result.stdout.splitlines() == ["wrote problem.yaml; try: hitchopt solve problem.yaml"]
    assert load_problem("problem.yaml").team.robots == 3
    assert [path.name for path in place.iterdir()] == ["problem.yaml"]


@pytest.mark.parametrize(
    ("name", "file"),
    [("a", "a.yaml"), ("b.yml", "b.yml"), ("c.d", "c.d.yaml"), ("ü x", "ü x.yaml")],
)
def test_init_adds_the_suffix(name: str, file: str, place: Path) -> None:
    assert run("init", name).exit_code == 0
    assert [path.name for path in place.iterdir()] == [file]


def test_init_never_overwrites(place: Path) -> None:
    (place / "mine.yaml").write_text("precious")
    told = refused(run("init", "mine"))
    assert "error: mine.yaml: exists already; give another name" in told
    assert (place / "mine.yaml").read_text() == "precious"
    assert [path.name for path in place.iterdir()] == ["mine.yaml"]
    (place / "dangling.yaml").symlink_to("nowhere")
    refused(run("init", "dangling"))
    assert not (place / "nowhere").exists()


@pytest.mark.parametrize("name", ["", ".", "..", "/", "missing/x", "a\0b", "x" * 300])
def test_init_refuses_names_that_cannot_be(name: str, place: Path) -> None:
    assert refused(run("init", name)).startswith("error: ")
    assert list(place.iterdir()) == []


def test_init_without_hard_links(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", refuse)
    assert run("init", "x").exit_code == 0
    (place / "x.yaml").write_text("precious")
    refused(run("init", "x"))
    assert (place / "x.yaml").read_text() == "precious"
    assert [path.name for path in place.iterdir()] == ["x.yaml"]


VIOLATION = Violation("speed", 2.0, 1.0, "max", "m/s", ("q1",), "at t = 3 s", "slow down")
FAILURES: list[tuple[BaseException, int, str]] = [
    (InputError("a.b", 1, "2", "write 2"), 2, "error: a.b = 1: must be 2; write 2\n"),
    (FileError("x: no such file"), 2, "error: x: no such file\n"),
    (InfeasibleError([VIOLATION] * 2), 3, f"error: {VIOLATION}\nerror: {VIOLATION}\n"),
    (UnsupportedError("not yet"), 3, "error: not yet\n"),
    (CertificateError("speed: 2"), 3, "error: speed: 2\n"),
    (HitchoptError(), 3, "error: HitchoptError\n"),
    (KeyboardInterrupt(), 130, ""),
    (OSError(28, "No space left on device", "x"), 2, "error: x: No space left on device; check"),
]


@pytest.mark.parametrize(("error", "code", "told"), FAILURES, ids=lambda x: type(x).__name__)
def test_errors_become_exit_codes(error: BaseException, code: int, told: str) -> None:
    @click.group(cls=SafeGroup)
    def group() -> None: ...

    @group.command()
    def fail() -> None:
        raise error

    result = CliRunner().invoke(group, ["fail"])
    message = refused(result, code)
    assert message.startswith(told)
    assert message.count("error: ") == told.count("error: ")


def test_a_bug_stays_a_bug() -> None:
    @click.group(cls=SafeGroup)
    def group() -> None: ...

    @group.command()
    def fail() -> None:
        raise ZeroDivisionError

    assert isinstance(CliRunner().invoke(group, ["fail"]).exception, ZeroDivisionError)


def test_a_reader_that_has_left_changes_nothing(place: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "hitchopt", "init", "x"],
            stdout=writing,
            stderr=subprocess.PIPE,
            timeout=60,
            check=False,
        )
    finally:
        os.close(writing)
    assert done.stderr == b""
    assert done.returncode == 0
    assert (place / "x.yaml").exists()


def test_terminals_that_know_only_ascii_are_served() -> None:
    done = started("-m", "hitchopt", "solve", "größe.yaml", PYTHONIOENCODING="ascii:strict")
    assert done.returncode == 2
    assert done.stderr.startswith("error: gr??e.yaml: no such file")
