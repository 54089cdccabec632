"""Everything that ends before a plan is made, and how errors and signals end a command."""

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
from click.testing import CliRunner
from problem_files import BAD, TRIANGLE, header, refused, run
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
RATE = "error: --rate = {}: must be above 0 and at most 10000 Hz"


def started(*arguments: str, **options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, **options},
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize("path", BAD[::8], ids=lambda path: path.stem)
def test_bad_files_end_with_2_name_the_place_and_leave_nothing(path: Path, place: Path) -> None:
    told = refused("solve", path)
    assert header(path, "Names") in told
    for line in told.splitlines():
        assert line.startswith("error: ")
        if " = " in line:  # a fault of a value
            assert line.startswith(f"error: {path}:"), line
            number, column = line.removeprefix(f"error: {path}:").split(":")[:2]
            text = path.read_text(encoding="utf-8").splitlines()[int(number) - 1]
            assert 1 <= int(column) <= len(text) + 1
    assert list(place.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "told"),
    [
        *((words, "Usage: ") for words in ("fly", "solve", "solve a b", "check", "-x")),
        ("solve a --rate often", "'often' is not a valid float"),
        ("view a --save a.mp4 --ghost b", "--ghost = 'b': must be no ghost"),
        *((f"{SOLVE} --rate {x}", RATE.format(x)) for x in ("0.0", "-1.0", "nan", "inf")),
        (f"{SOLVE} --rate 1e300", RATE.format("1e+300")),
        *((f"{SOLVE} --limit {x}", f"error: --limit = {x}: ") for x in ("0.0", "nan", "inf")),
        (f"{SOLVE} -o ''", "error: -o = '': must be a path that is not empty; name one"),
        ("solve ''", "error: FILE = '': must be a path that is not empty"),
        ("check ''", "error: DIR = '': must be a path that is not empty"),
        ("export out --format csv -o ''", "error: -o = '': must be a path that is not empty"),
        ("simulate out -o ''", "error: -o = '': must be a path that is not empty"),
        (f"{SOLVE} -o /", "error: -o = '/': must be a directory of its own"),
        ("solve nowhere.yaml", "error: nowhere.yaml: no such file"),
        ("solve .", "is a directory"),
        ("check nowhere", "error: nowhere/plan.npz: "),
        ("check nowhere/plan.npz", "error: nowhere/plan.npz: "),
        ("simulate .", "plan.npz: there is no such file"),
        ("init --example triangl", "did you mean triangle?"),
        *((f"init {name}", "error: ") for name in ("''", ".", "/", "missing/x", "x" * 300)),
    ],
)
def test_wrong_usage_ends_with_2(words: str, told: str, place: Path) -> None:
    assert told in refused(*(word.strip("'") for word in words.split()))
    assert list(place.iterdir()) == []


def test_what_is_in_the_way_is_told(place: Path) -> None:
    (place / "triangle").write_text("mine")
    told = refused("solve", TRIANGLE)
    assert "error: triangle: is not a directory; choose another one with -o" in told
    assert (place / "triangle").read_text() == "mine"
    told = run("solve", TRIANGLE, "-o", "triangle/out", "--rate", "5", code=2).stderr
    assert told.startswith("error: triangle/out: ")
    (place / "out").mkdir()
    for content in (b"", b"PK\x03\x04 no archive", b"\x93NUMPY"):
        (place / "out" / "plan.npz").write_bytes(content)
        assert "error: out/plan.npz: " in refused("check", "out")
        assert "error: out/plan.npz: " in refused("view", "out")  # nothing is served


@pytest.mark.slow
def test_a_bad_file_in_a_process_of_its_own(place: Path) -> None:
    bad = next(path for path in BAD if path.stem == "several_faults")
    done = started("-m", "hitchopt", "solve", str(bad))
    assert (done.returncode, done.stdout) == (2, "")
    lines = done.stderr.splitlines()
    reason = "limits.jerk = 0: must be greater than 0; give a positive number"
    assert lines[1] == f"error: {bad}:8:23: {reason}"
    assert len(lines) == 4
    assert list(place.iterdir()) == []
    done = started("-m", "hitchopt", "solve", "größe.yaml", PYTHONIOENCODING="ascii:strict")
    assert done.returncode == 2
    assert done.stderr.startswith("error: gr??e.yaml: no such file")


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

AFTER = """
import os, signal, sys
from hitchopt.__main__ import run
sys.argv = ["hitchopt", "-h"]
try:
    run()
finally:
    os.kill(os.getpid(), signal.SIGINT)
    print("survived")
"""

SIGNALS = [("SIGINT", 130), ("SIGTERM", 143)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "name", "code"),
    [
        (module, *SIGNALS[i % 2])
        for i, module in enumerate(("click", "hitchopt.mission", "numpy", "casadi"))
    ],
)
def test_signals_within_imports_end_quietly(module: str, name: str, code: int, place: Path) -> None:
    (place / "hostile.py").write_text(HOSTILE.format(signal=name))
    done = started("-c", INTERRUPTED.format(module=module, file=str(TRIANGLE)))
    assert (done.returncode, done.stderr) == (code, "")
    assert {path.name for path in place.iterdir()} <= {"sent", "hostile.py", "__pycache__"}
    assert (place / "sent").read_text() == "1"


@pytest.mark.parametrize(
    ("method", "name", "code"),
    [("click.Context.__init__", *SIGNALS[0]), ("click.Context.close", *SIGNALS[1])],
)
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
    assert (end.value.code, len(built)) == (130, 1)


@pytest.mark.slow
def test_signals_while_writing_and_after_the_command(place: Path) -> None:
    done = started("-c", WRITING.format(file=str(TRIANGLE)))
    assert (done.returncode, done.stderr) == (143, "")
    assert ".hitchopt-" in (place / "seen").read_text()  # the temporary directory
    assert [path.name for path in place.iterdir() if path.name != "seen"] == []
    done = started("-c", AFTER)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")
    assert "survived" not in done.stdout


VIOLATION = Violation("speed", 2.0, 1.0, "max", "m/s", ("q1",), "at t = 3 s", "slow down")


def _interrupted_in_compiled_code() -> None:
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:
        raise SystemError("returned a result with an exception set") from None


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
        if error is None:
            _interrupted_in_compiled_code()
        else:
            raise error

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
    for name, file in (
        ("a", "a.yaml"),
        ("b.yml", "b.yml"),
        ("c.d", "c.d.yaml"),
        ("ü x", "ü x.yaml"),
    ):
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
    with os.fdopen(writing, "wb") as closed:
        done = subprocess.run(
            [sys.executable, "-m", "hitchopt", "init", "x"],
            stdout=closed,
            stderr=subprocess.PIPE,
            timeout=60,
            check=False,
        )
    assert (done.returncode, done.stderr) == (0, b"")
    assert (place / "x.yaml").exists()
