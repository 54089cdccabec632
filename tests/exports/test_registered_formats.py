"""Formats of other packages: found by their entry points, certified as exported, and linted."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from hitchopt.cli import main
from hitchopt.errors import FaultWarning, FileError, InputError, UnsupportedError
from hitchopt.exports.format import format_of
from hitchopt.exports.lint import Report, lint
from hitchopt.exports.options import GROUP, HOMES, registered_formats
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import write_plan
from tests.helpers.exported_plans import exported, hitch_plan, swarm_plan
from tests.helpers.plans import ROOT

pytestmark = pytest.mark.filterwarnings("always::hitchopt.errors.FaultWarning")

EXAMPLE = ROOT / "docs" / "how_to" / "extend_example"
Install = Callable[[str, dict[str, str], str], None]
"""Installs a package: its name, the formats that it registers, and the text of its module."""


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Install packages of one module, for the time of a test."""
    site = tmp_path / "site"
    site.mkdir()
    monkeypatch.syspath_prepend(site)

    def install(name: str, formats: dict[str, str], module: str) -> None:
        facts = site / f"{name.replace('-', '_')}-1.0.dist-info"
        facts.mkdir()
        (facts / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        lines = [f"{key} = {value}" for key, value in formats.items()]
        (facts / "entry_points.txt").write_text("\n".join([f"[{GROUP}]", *lines]) + "\n")
        (site / f"{name.replace('-', '_')}.py").write_text(module)

    return install


def declared_formats(project: Path) -> dict[str, str]:
    """Return the formats that a pyproject.toml registers."""
    content = tomllib.loads(project.read_text("utf-8"))
    formats: dict[str, str] = content["project"]["entry-points"][GROUP]
    return formats


@pytest.fixture
def example(install: Install) -> None:
    """Install the package that the documentation shows."""
    module = (EXAMPLE / "our_fleet.py").read_text("utf-8")
    install("our-fleet", declared_formats(EXAMPLE / "pyproject.toml"), module)


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    write_plan(tmp_path / "plan.npz", Flight.of(hitch_plan()), "A plan")
    return tmp_path / "plan.npz"


def run(*arguments: str | Path, code: int) -> Result:
    """Run a command in this process; it ends with ``code``."""
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == code, result.output
    return result


def help_of_export() -> str:
    """Return what ``hitchopt export --help`` prints in a process of its own, as one line."""
    command = [sys.executable, "-m", "hitchopt", "export", "--help"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    return " ".join(done.stdout.split())


def report(path: Path) -> Report:
    (only,) = lint(path)
    return only


def test_the_formats_of_the_package_come_first() -> None:
    assert [*registered_formats()][: len(HOMES)] == [*HOMES]


@pytest.mark.usefixtures("example")
def test_the_documented_package_is_listed_certified_as_exported_and_linted(
    plan: Path, place: Path
) -> None:
    assert "mjcf, our_fleet." in help_of_export()
    assert "A table of positions and velocities for our fleet." in run("export", code=2).stderr
    export = ("export", plan, "--format", "our_fleet")
    assert "Cables will go slack" in run(*export, "-o", "ours", code=3).stderr
    assert not (place / "ours").exists()
    for name, files in (("ours", "our_fleet.csv"), ("ours.csv", "ours.csv")):
        said = run(*export, "--stiffness", "4.75", "-o", name, code=0).stdout
        assert "certified as exported" in said
        assert f"{files}" in said
        found = report(place / name)
        assert (found.kind, found.sound, len(found.facts)) == ("our_fleet", True, 6)
        run("lint", name, code=0)


@pytest.mark.usefixtures("example")
@pytest.mark.parametrize("motion", [hitch_plan, swarm_plan])
def test_the_documented_format_loses_little(motion: Callable[[], Motion], tmp_path: Path) -> None:
    (part,) = exported(motion(), "our_fleet", tmp_path / "ours")
    assert part.verdict.position.worst < 2e-5
    assert not part.verdict.violated
    assert {"separation", "speed", "thrust", "tilt"} <= {x.name for x in part.verdict.checks}


@pytest.mark.usefixtures("example")
@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda rows: rows[:-1], "is not a valid table of our fleet"),
        (lambda rows: [*rows[:2], rows[3], rows[2], *rows[4:]], "not sorted by time, then robot"),
        (lambda rows: rows[:1], "is not a valid table of our fleet"),
        (lambda rows: [*rows[:1], rows[1] + ",1", *rows[2:]], "is not a valid table of our fleet"),
        (lambda rows: [*rows[:1], rows[1].replace("0.1", "nan"), *rows[2:]], "nan"),
    ],
)
def test_damaged_tables_of_the_documented_format_are_refused(
    change: Callable[[list[str]], list[str]], told: str, tmp_path: Path
) -> None:
    exported(swarm_plan(), "our_fleet", tmp_path / "ours")
    table = tmp_path / "ours" / "our_fleet.csv"
    table.write_text("\n".join(change(table.read_text().splitlines())))
    with pytest.raises(FileError, match=told):
        lint(table)


VARIANT = """
from our_fleet import OurFleet

class Text(OurFleet):
    name, file, endings = "text", "ours.txt", (".txt",)

class Show(OurFleet):
    name, file, endings = "show", "ours.skyc", (".skyc",)

class Headless(OurFleet):
    name, header = "headless", "(?!)"

class Csv(OurFleet):
    name = "csv"
"""


@pytest.fixture
def variants(install: Install, example: None) -> None:
    del example  # installed, too
    formats = {name.lower(): f"variants:{name}" for name in ("Text", "Show", "Headless", "Csv")}
    install("variants", formats, VARIANT)


@pytest.mark.usefixtures("variants")
@pytest.mark.parametrize(
    ("name", "file"),
    [("text", "plan.txt"), ("show", "plan.skyc"), ("headless", "plan.csv")],
)
def test_formats_have_endings_of_their_own_or_share_them(
    name: str, file: str, tmp_path: Path
) -> None:
    """What has been exported is read as the format that its manifest names."""
    for place in (tmp_path / "folder", tmp_path / "files" / file):
        (part,) = exported(swarm_plan(), name, place)
        found = report(place)
        assert (found.kind, found.sound) == (name, True)
        assert part.files == ((file,) if place.suffix else (format_of(name).file,))
    if name == "text":
        assert report(tmp_path / "files").kind == name  # with its manifest next to it


@pytest.mark.usefixtures("variants")
@pytest.mark.parametrize("name", ["csv", "skybrush", "mavsdk_drone_show", "crazyswarm2"])
def test_formats_of_hitchopt_are_what_they_were(name: str, tmp_path: Path) -> None:
    assert type(format_of(name)).__module__.startswith("hitchopt.")
    exported(swarm_plan(), name, tmp_path / name)
    assert report(tmp_path / name).kind == name


BROKEN = """
from hitchopt.exports.format import Format
from our_fleet import OurFleet

class Incomplete(Format):
    name = "broken"

class Nameless(Format):
    def write(self, folder, task): pass
    def load(self, files): pass

class OtherName(OurFleet):
    name = "other"

class Word(OurFleet):
    name, endings = "broken", (".csv")

class Turned(OurFleet):
    name, frames = "broken", ("esu",)

class Pattern(OurFleet):
    name, header = "broken", "time_s("

class Foreign:
    name = "broken"

class Faulty(OurFleet):
    def __init__(self):
        raise RuntimeError("two\\nlines")
"""


@pytest.mark.usefixtures("example")
@pytest.mark.parametrize(
    ("home", "told"),
    [
        ("nowhere:Broken", "ModuleNotFoundError: No module named 'nowhere'"),
        ("broken_fleet:Missing", "has no attribute 'Missing'"),
        ("broken_fleet:Incomplete", "Can't instantiate abstract class"),
        ("broken_fleet:Nameless", "states no name, file, endings, frames, accuracy, feed_forward"),
        ("broken_fleet:OtherName", "is registered as broken, and its name is other"),
        ("broken_fleet:Word", r"endings = '\.csv' is not a tuple"),
        ("broken_fleet:Turned", "frame esu is not one of enu, nwu, ned"),
        ("broken_fleet:Pattern", "missing \\)"),
        ("broken_fleet:Foreign", "is not derived from hitchopt.exports.format.Format"),
        ("broken_fleet:Faulty", "RuntimeError: two lines"),
    ],
)
def test_a_broken_package_is_named_in_one_line_and_stops_nothing_else(
    home: str, told: str, install: Install, plan: Path, place: Path
) -> None:
    install("broken-fleet", {"broken": home}, BROKEN)
    with pytest.raises(UnsupportedError, match=told) as refusal:
        format_of("broken")
    text = str(refusal.value)
    assert text.startswith(f"format broken: {home} of broken-fleet cannot be used: ")
    assert text.endswith("; update or uninstall broken-fleet")
    assert "\n" not in text
    exported(swarm_plan(), "csv", place / "table")
    with pytest.warns(FaultWarning, match=told):
        assert report(place / "table").sound
    assert f"error: {text}\n" == run("export", plan, "--format", "broken", code=3).stderr
    listed = run("export", code=2).stderr
    assert f"warning: loading formats failed: {text}" in listed
    assert "our_fleet" in listed


@pytest.mark.usefixtures("example")
def test_a_fault_of_another_package_s_writer_is_told_in_one_line(
    install: Install, place: Path
) -> None:
    faulty = """
from our_fleet import OurFleet

class Typo(OurFleet):
    name = "typo"
    def write(self, folder, task):
        return task.nonsense
"""
    install("typo-fleet", {"typo": "typo_fleet:Typo"}, faulty)
    words = "the format typo failed to write: AttributeError: .*nonsense"
    with pytest.raises(UnsupportedError, match=words):
        exported(swarm_plan(), "typo", place / "typo")
    assert not (place / "typo").exists()


@pytest.mark.usefixtures("example")
def test_a_format_that_samples_without_a_rate_is_named(install: Install, place: Path) -> None:
    module = (
        "from our_fleet import OurFleet\n\nclass Hasty(OurFleet):\n    name, rate = 'hasty', 0.0\n"
    )
    install("hasty-fleet", {"hasty": "hasty_fleet:Hasty"}, module)
    with pytest.raises(UnsupportedError, match=r"the format hasty samples without a rate: set"):
        exported(swarm_plan(), "hasty", place / "hasty")


def test_a_format_whose_package_is_gone_is_unknown() -> None:
    with pytest.raises(InputError, match=r"one of crazyswarm2, .*hitchopt export lists them"):
        format_of("our_fleet")


@pytest.mark.parametrize("frame", ["enu", "ned"])
def test_tables_that_state_no_axes_are_told_with_those_of_their_manifest(
    frame: str, place: Path
) -> None:
    exported(swarm_plan(), "csv", place / "show.csv", frame=frame)
    (note,) = [each for each in report(place / "show.csv").findings if each.rule == "frame"]
    assert str(note).endswith(f"the files do not state their axes, exported as {frame}")
