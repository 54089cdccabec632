"""Pipes and devices in place of files, control characters and floods of keys are refused."""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt.cli import main
from hitchopt.cli.output import echo
from hitchopt.exports.format import own_endings
from hitchopt.storage.yaml_file import MAX_KEYS
from tests.helpers.commands import TRIANGLE, refused, run
from tests.helpers.plans import PROBLEMS

if os.name == "nt":
    pytest.skip("Windows has no pipes in the file system", allow_module_level=True)

pytestmark = pytest.mark.usefixtures("place")


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("plan") / "out"
    run("solve", TRIANGLE, "-q", "-o", directory, code=0)
    return directory


# Commands by the file that is a pipe or a device, with PLAN for a directory of a plan
COMMANDS = {
    "problem.yaml": ("solve problem.yaml", "view problem.yaml --save a.png"),
    "out/plan.npz": (
        "check out",
        "check out/plan.npz",
        "verify out",
        "report out",
        "export out --format csv",
        "statics out",
        "simulate out",
        "abort out",
        "react out --lose 0 --at 1 -o after",
        "fly out --over json",
        "view out --save a.mp4",
    ),
    "out/certificate.json": ("simulate out",),
    "a.csv": (
        "evaluate a.csv",
        "evaluate a.csv --plan PLAN",
        "calibrate a.csv --plan PLAN",
        "lint a.csv",
    ),
    "a.c3d": ("evaluate a.c3d",),
    **{f"a{ending}": (f"lint a{ending}",) for ending in own_endings() if ending != ".csv"},
    "logs/cf1.ulg": ("evaluate logs/cf1.ulg",),
    "outline.csv": ("fit outline.csv --robots 3",),
    "fleet.yaml": ("export PLAN --format crazyswarm2 --fleet fleet.yaml",),
}


@pytest.fixture(params=["pipe", "device"])
def special(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.mark.parametrize(
    ("file", "command"), [(file, each) for file, own in COMMANDS.items() for each in own]
)
def test_files_that_never_end_are_refused(
    file: str, command: str, special: str, plan: Path, place: Path
) -> None:
    path = place / file
    path.parent.mkdir(exist_ok=True)
    if file.startswith("out/"):
        shutil.copytree(plan, path.parent, dirs_exist_ok=True)
        path.unlink()
    if special == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    words = refused(*command.replace("PLAN", str(plan)).split())
    kind = "a pipe" if special == "pipe" else "a device"
    assert words.count(f"{file}: is {kind}, not a regular file; name a regular file") == 1, words
    assert words.count("\n") == 1


def test_a_pipe_that_the_shell_has_opened_is_read(place: Path) -> None:
    """As ``hitchopt solve <(command)`` names one."""
    reading, writing = os.pipe()

    def write() -> None:
        with os.fdopen(writing, "wb") as file:
            file.write(TRIANGLE.read_bytes())

    writer = threading.Thread(target=write)
    writer.start()
    run("solve", f"/dev/fd/{reading}", "-q", "-o", place / "out", code=0)
    writer.join()
    os.close(reading)


def flood(where: str) -> Iterator[str]:
    text = TRIANGLE.read_text(encoding="utf-8")
    keys = [f"key_{i}: 1" for i in range(20 * MAX_KEYS)]
    if where == "team":
        yield text.replace("team:", "\n  ".join(["team:", *keys]), 1)
    else:
        yield text + ("\n".join(keys) if where == "file" else f"x: {{{', '.join(keys)}}}") + "\n"


@pytest.mark.parametrize("where", ["file", "team", "brackets"])
def test_floods_of_keys_are_refused_before_they_are_read(where: str, place: Path) -> None:
    (text,) = flood(where)
    (place / "problem.yaml").write_text(text, encoding="utf-8")
    words = refused("solve", "problem.yaml")
    assert words.count("\n") == 1
    assert f"must be a mapping of at most {MAX_KEYS} keys; leave some out" in words


def test_many_unknown_keys_are_counted(place: Path) -> None:
    """A few unknown keys have a suggestion each."""
    text = TRIANGLE.read_text(encoding="utf-8")
    for count in (5, 20, 21, MAX_KEYS - 20):
        keys = "".join(f"  robts{i}: 1\n" for i in range(count))
        (place / "problem.yaml").write_text(text.replace("team:\n", f"team:\n{keys}", 1))
        words = refused("solve", "problem.yaml")
        if count <= 20:
            assert words.count("did you mean robots?") == count
        else:
            assert f"team = '{count} unknown keys': must be a mapping of robots, " in words
            assert words.count("\n") == 1


CONTROLS = "\x1b[2J\x07\x9b5m\u202eevil\r\x00"


def test_no_text_reaches_the_terminal_with_control_characters(
    capsys: pytest.CaptureFixture[str],
) -> None:
    echo(f"a{CONTROLS}b\tc\r\nd é — ü")
    out = capsys.readouterr().out
    assert not any(ord(c) < 32 and c not in "\t\n\r" for c in out)
    assert "\x9b" not in out
    assert "\u202e" not in out
    assert out.endswith("b\tc\r\nd é — ü\n")


def test_a_plan_with_a_title_of_control_characters_is_refused(place: Path, plan: Path) -> None:
    arrays = dict(np.load(plan / "plan.npz"))
    settings = str(arrays["settings"])
    title = f'"title": "{ho.load(plan).title}"'
    assert title in settings
    arrays["settings"] = np.array(settings.replace(title, '"title": "\\u001b[2J"'))
    np.savez(place / "plan.npz", **arrays)
    words = CliRunner().invoke(main, ["check", "plan.npz"])
    assert words.exit_code == 2
    assert "printable text on one line" in words.stderr
    assert "\x1b" not in words.output + words.stderr


@pytest.mark.parametrize("command", ["check", "verify", "simulate", "abort", "statics", "report"])
def test_a_problem_file_is_called_no_plan(command: str) -> None:
    path = PROBLEMS / "triangle.yaml"
    run = CliRunner().invoke(main, [command, str(path)])
    assert run.exit_code == 2
    assert f"{path}: a problem, not a plan: run hitchopt solve on it" in run.output
