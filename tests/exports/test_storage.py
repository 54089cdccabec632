"""Atomic replacement of sets of files; the directory after plans and refusals."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace as with_changes
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import pytest
from click.testing import CliRunner

from hitchopt.checks.certificate import CertificateError, Check
from hitchopt.checks.certifying import certificate_of
from hitchopt.cli import main
from hitchopt.directory import changed_tables, diagnosis_content, save_diagnosis, save_plan
from hitchopt.errors import FileError, HitchoptError, InfeasibleError, Violation
from hitchopt.exports.lint import lint
from hitchopt.lab.simulation.task import read_task
from hitchopt.motion.flight import Flight
from hitchopt.motion.plan_file import read_saved_plan
from hitchopt.motion.states import sample_times
from hitchopt.storage.files import Writer, digest, replace_files
from tests.helpers.exported_plans import hitch_plan

OWNED = ("plan", "table", "seal", "diagnosis")


def text(content: str) -> Writer:
    def write(path: Path) -> None:
        path.write_text(content)

    return write


def replace(directory: Path, **contents: str) -> Path:
    return replace_files(directory, {n: text(c) for n, c in contents.items()}, OWNED, "seal")


def everything(directory: Path) -> dict[str, str]:
    files = (p for p in directory.rglob("*") if not p.is_dir())
    return {str(p.relative_to(directory)): p.read_text() for p in files}


@pytest.fixture
def home(tmp_path: Path) -> Iterator[Path]:
    """A directory in which nothing but ``out`` may be when the test is over."""
    yield tmp_path
    assert {p.name for p in tmp_path.iterdir()} <= {"out", "elsewhere"}


def test_only_ours_are_replaced_and_removed(home: Path) -> None:
    assert replace(home / "out/a/b", plan="1", seal="s") == home / "out/a/b"
    (home / "elsewhere").write_text("not ours")
    (home / "out/plan").symlink_to("../elsewhere")  # replaced, not followed
    kept = {"a/b/plan": "1", "a/b/seal": "s"}
    for contents in ({"plan": "1", "table": "1", "seal": "1"}, {"diagnosis": "2"}, {"seal": "3"}):
        replace(home / "out", **contents)
        assert everything(home / "out") == {**contents, **kept}
    assert (home / "elsewhere").read_text() == "not ours"


def test_a_failing_writer_changes_nothing(home: Path) -> None:
    def failing(error: BaseException) -> Writer:
        def write(path: Path) -> None:
            path.write_text("half")
            raise error

        return write

    full = failing(OSError(errno.ENOSPC, "No space left on device", "seal"))
    out = home / "out"
    with pytest.raises(FileError, match=r"out/x/y: cannot be written: No space left.*\(seal\)"):
        replace_files(out / "x/y", {"plan": text("new"), "seal": full}, OWNED, "seal")
    assert not out.exists()
    replace(out, plan="1", seal="1")
    for writer, caught in ((full, FileError), (failing(KeyboardInterrupt()), KeyboardInterrupt)):
        with pytest.raises(caught):
            replace_files(out, {"plan": text("new"), "seal": writer}, OWNED, "seal")
        assert everything(home) == {"out/plan": "1", "out/seal": "1"}


def test_modes_links_and_the_current_directory_stay(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = home / "elsewhere/real"
    (real / "a").mkdir(parents=True)
    real.chmod(0o2715)
    (home / "out").symlink_to("elsewhere/real")
    old = os.umask(0o027)
    try:
        replace(home / "out", plan="1")
        replace(home / "elsewhere/new", plan="1")
    finally:
        os.umask(old)
    modes = [stat.S_IMODE(p.stat().st_mode) for p in (real, real / "plan", real.with_name("new"))]
    assert (modes, (home / "out").is_symlink()) == ([0o2715, 0o640, 0o750], True)
    monkeypatch.chdir(real / "a")
    for up in (".", ".."):
        inode = os.stat(up).st_ino
        replace(Path(up), diagnosis="2")
        assert os.stat(up).st_ino == inode
    found = {"real/diagnosis", "real/a/diagnosis", "new/plan"}
    assert set(everything(home / "elsewhere")) == found


@pytest.mark.parametrize(
    ("taken", "asked", "words"),
    [
        ("out", "out", "out: is a file, not a directory"),
        ("out", "out/a/b", "out/a/b: cannot be written: Not a directory"),
        ("out/table/x", "out", "table: is a directory; a file of that name is needed"),
        ("out/x", "a\0b", "not a path"),
        ("out/x", "x" * 300, "name"),
    ],
)
def test_files_in_the_way_are_named(taken: str, asked: str, words: str, home: Path) -> None:
    (home / taken).parent.mkdir(parents=True, exist_ok=True)
    (home / taken).write_text("mine")
    with pytest.raises(FileError, match=words):
        replace(home / asked, plan="1")
    assert everything(home) == {taken: "mine"}


def test_long_names_and_faster_writers(home: Path) -> None:
    out = home / "out" / ("x" * 255)
    replace(out, plan="1")

    def slow(path: Path) -> None:
        replace(out, plan="2", seal="2")  # another writer is faster
        path.write_text("3")

    replace_files(out, {"plan": slow, "seal": text("3")}, OWNED, "seal")
    assert everything(home / "out") == {f"{out.name}/plan": "3", f"{out.name}/seal": "3"}


FILES = {"plan.npz", "setpoints.csv", "vertices.csv", "certificate.json"}


def strict_json(path: Path) -> Any:
    def refuse(word: str) -> NoReturn:
        raise AssertionError(f"{word} is no JSON")

    return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)


def names(directory: Path) -> set[str]:
    return {p.name for p in directory.iterdir()}


def save(directory: Path, title: str = "", **more: Any) -> Path:
    return save_plan(
        directory,
        Flight.of(hitch_plan()),
        certificate_of(Flight.of(hitch_plan())),
        title,
        5.0,
        **more,
    )


def test_a_certified_plan_leaves_its_files_and_others_are_refused(tmp_path: Path) -> None:
    motion, done = hitch_plan(), list[float]()
    pages = {"report.html": text("<html>")}
    out = save(tmp_path / "out", "Drei", pages=pages, progress=done.append)
    assert names(out) == {*FILES, "report.html"}
    assert (done[-1], read_saved_plan(out / "plan.npz").title) == (1.0, "Drei")
    samples = len(sample_times(motion.duration, 5.0))
    for name, rows in (("setpoints.csv", 6), ("vertices.csv", 3)):
        assert (out / name).read_text().count("\n") == 1 + rows * samples
    low = Check.of("legs", 0.1, 0.15, "min", "m", 1.25, ("q2",))
    failing = with_changes(certificate_of(Flight.of(motion)), limited=(low,))
    with pytest.raises(CertificateError, match="legs"):
        save_plan(tmp_path / "other", Flight.of(motion), failing)
    assert names(tmp_path) == {"out"}


def test_others_files_in_previous_stay(tmp_path: Path) -> None:
    kept = tmp_path / "previous"
    kept.mkdir()
    (kept / "notes.txt").write_text("mine")
    for title in ("once", "again"):
        save(tmp_path, title)
        assert names(kept) == {"notes.txt"}
        for reason in ("not found", "not found again"):
            save_diagnosis(tmp_path, diagnosis_content(HitchoptError(reason)))
            assert names(kept) == {"notes.txt", *FILES}
            assert read_saved_plan(kept / "plan.npz").title == title
    assert names(tmp_path) == {"diagnosis.json", "previous"}


def test_files_of_different_plans_are_refused(tmp_path: Path) -> None:
    one, other = (save(tmp_path / title, title) for title in ("one", "other"))
    read_task(one)
    plan = (one / "plan.npz").read_bytes()
    assert strict_json(one / "certificate.json")["plan"] == hashlib.sha256(plan).hexdigest()
    (other / "plan.npz").write_bytes(plan)
    with pytest.raises(FileError, match=r"certificate\.json: belongs to a different plan\.npz"):
        read_task(other)
    (one / "certificate.json").unlink()
    with pytest.raises(FileError, match="a save may have been interrupted"):
        read_task(one)


def test_the_diagnosis_of_an_infeasible_problem(tmp_path: Path) -> None:
    first = Violation("legs", -0.1, 0.15, "min", "m", ("q0", "r2"), "at the start", "lengthen")
    second = Violation("duration", float("inf"), 3.0, "max", "s", (), "", "allow more – länger")
    save_diagnosis(tmp_path, diagnosis_content(InfeasibleError([first, second])))
    data = strict_json(tmp_path / "diagnosis.json")
    one, other = data["violations"]
    assert (data["format"], data["feasible"]) == ("hitchopt-diagnosis/1", False)
    assert one == {**first.to_dict(), "where": ["q0", "r2"], "message": str(first)}
    assert (other["value"], other["remedy"]) == (None, second.remedy)


COMMON = '''
import os, shutil, signal, sys
from pathlib import Path
from hitchopt.storage.files import replace_files

OWNED = ("plan.npz", "setpoints.csv", "certificate.json", "diagnosis.json")
PLAN, SEAL = OWNED[:3], "certificate.json"
directory = Path(sys.argv[1]) / "some dir"

def files(tag):
    """The files of one save, each telling which: a plan for odd tags, a refusal for even ones."""
    names = PLAN if tag % 2 else OWNED[3:]
    return {name: f"{tag} {name}\\n" * 50 for name in names}

def writer(text):
    def write(path):
        path.write_text(text)
        os.getppid()  # one more place to be killed at: the file is written, not synced
    return write

def save(tag):
    writers = {name: writer(text) for name, text in files(tag).items()}
    replace_files(directory, writers, OWNED, SEAL, "remove" if tag % 2 else "keep")

def put(place, contents):
    place.mkdir(parents=True, exist_ok=True)
    for name, text in contents.items():
        (place / name).write_text(text)

def prepare(now, last):
    """The directory after save(now); ``last`` is the plan that a refusal keeps, or 0."""
    put(directory, files(now))
    put(directory / "sub", {"notes.txt": "mine"})
    if last:
        put(directory / "previous", files(last))
    (directory / "link").symlink_to("sub/notes.txt")

def check_others(final):
    assert (directory / "sub" / "notes.txt").read_text() == "mine"
    assert (directory / "link").is_symlink()
    if final:
        names = {p.name for p in directory.iterdir()} - {*OWNED, "previous"}
        assert names == {"sub", "link"}, names
        assert [p.name for p in directory.parent.iterdir()] == [directory.name]

def have(place=directory):
    if not place.is_dir():
        return {}
    return {n: (place / n).read_text() for n in OWNED if (place / n).exists()}

def forked(work):
    """Run ``work`` in a child; return whether it came to its end."""
    child = os.fork()
    if child == 0:
        try:
            work()
            os._exit(0)
        except BaseException:
            import traceback
            traceback.print_exc()
            os._exit(3)
    status = os.waitpid(child, 0)[1]
    assert status in (0, signal.SIGKILL), status
    return status == 0

os.fsync = lambda descriptor: None  # no power is cut here, and it takes most of the time
'''

STEPS = '''
def killed_at(count):
    """Let the process be killed at its count-th step that the file system sees."""
    left = [count]
    def dying(function):
        def call(*args, **kwargs):
            if left[0] == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            left[0] -= 1
            return function(*args, **kwargs)
        return call
    for name in "mkdir rename replace link symlink unlink rmdir open fsync getppid".split():
        setattr(os, name, dying(getattr(os, name)))

def run(count, tag):
    killed_at(count)
    save(tag)

instants = 0
# What is there, the plan that it keeps, what is saved, what is saved after that.
for now, last, new, after in (
    (1, 0, 3, 5), (1, 0, 2, 4), (2, 1, 3, 4), (2, 1, 4, 6), (3, 1, 5, 6), (3, 1, 4, 5), (0, 0, 1, 2)
):
    seen = set()
    for count in range(1000):
        if now:
            prepare(now, last)
        done = forked(lambda: run(count, new))
        instants += 1
        found, kept = have(), have(directory / "previous")
        plans = [files(tag) for tag in (now, last, new) if tag % 2]
        if SEAL in found or "diagnosis.json" in found:  # no mixture
            assert found in (files(now), files(new)), (count, found.keys())
        if now:  # nothing is lost
            plan = {name: text for name, text in found.items() if name in PLAN}
            assert plan in plans or kept in plans, (now, new, count)
            check_others(final=done)
        else:
            assert found == (files(new) if directory.exists() else {})
        seen.add((found == (files(now) if now else {}), found == files(new)))
        whole = found if SEAL in found else kept
        assert forked(lambda: save(after)) and have() == files(after)
        assert have(directory / "previous") == ({} if after % 2 else whole), (now, new, count)
        if now:
            check_others(final=True)
        shutil.rmtree(directory.parent)
        directory.parent.mkdir()
        if done:
            break
    assert {(True, False), (False, True)} <= seen, (now, new, seen)
assert instants > 200, instants
print("ok")
'''

TOGETHER = """
prepare(1, 0)
children = []
for process in range(4):
    child = os.fork()
    if child == 0:
        for i in range(15):
            save(100 * process + i)
        os._exit(0)
    children.append(child)
assert [os.waitpid(child, 0)[1] for child in children] == [0] * 4
found = have()
assert found == files(int(next(iter(found.values())).split()[0]))
check_others(final=True)
print("ok")
"""


@pytest.mark.slow
@pytest.mark.parametrize("script", [STEPS, TOGETHER], ids=["steps", "four"])
def test_killed_or_crowded_writers_lose_and_mix_nothing(script: str, tmp_path: object) -> None:
    run = subprocess.run(
        [sys.executable, "-c", COMMON + script, str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert (run.stdout, run.returncode) == ("ok\n", 0), run.stderr


def test_changed_tables_are_reported(tmp_path: Path) -> None:
    """All drones one second later, say, is a sound flight of its own: its digest tells."""
    save(tmp_path, "one")
    table = tmp_path / "setpoints.csv"
    assert changed_tables(tmp_path) == []
    assert not [each for each in lint(table)[0].findings if each.rule == "changed"]
    text = table.read_text()
    table.write_text(text.replace(",q0,", ",q9,").replace(",r0,", ",q0,").replace(",q9,", ",r0,"))
    assert changed_tables(tmp_path) == ["setpoints.csv"]
    assert [each for each in lint(table)[0].findings if each.rule == "changed"]
    told = CliRunner().invoke(main, ["check", str(tmp_path)])
    assert (told.exit_code, "setpoints.csv: differs from the table" in told.stderr) == (3, True)
    (tmp_path / "certificate.json").unlink()
    assert changed_tables(tmp_path) == []


def test_line_ends_of_tables_may_change(tmp_path: Path) -> None:
    """Git and editors write those of Windows; lone carriage returns are another content."""
    save(tmp_path, "one")
    for table in (tmp_path / "setpoints.csv", tmp_path / "vertices.csv"):
        table.write_bytes(table.read_bytes().replace(b"\n", b"\r\n"))
    assert changed_tables(tmp_path) == []
    assert CliRunner().invoke(main, ["check", str(tmp_path)]).exit_code == 0
    assert not [x for x in lint(tmp_path / "setpoints.csv")[0].findings if x.rule == "changed"]
    table.write_bytes(table.read_bytes().replace(b"\r\n", b"\r\r\n", 1))
    assert changed_tables(tmp_path) == ["vertices.csv"]


@pytest.mark.parametrize("zeros", [b"", b"\0"])
def test_digests_ignore_line_ends_of_texts_alone(zeros: bytes, tmp_path: Path) -> None:
    (tmp_path / "unix").write_bytes(zeros + b"a\nb\n")
    (tmp_path / "windows").write_bytes(zeros + b"a\r\nb\r\n")
    one, other = digest(tmp_path / "unix"), digest(tmp_path / "windows")
    assert one == hashlib.sha256(zeros + b"a\nb\n").hexdigest()
    assert (one == other) is (zeros == b"")


def _edit_check(content: dict[str, Any], name: str, key: str) -> None:
    """Double a number of a check, or give it another name."""
    (check,) = (each for each in content["checks"] if each["name"] == name)
    check[key] = "left out" if key == "name" else 2.0 * check[key] + 2e-6


def edited_certificates() -> Iterator[tuple[str, Callable[[dict[str, Any]], object]]]:
    """Yield what is changed in a certificate, and the change."""
    for name in ("separation", "equilibrium", "speed"):
        for key in ("worst", "limit", "name"):
            yield f"{name} is", partial(_edit_check, name=name, key=key)
    yield "another plan.npz", lambda content: content.update(plan="0" * 64)
    yield "certified is", lambda content: content.update(certified=False)
    yield "duration is", lambda content: content.update(duration=1.0)
    yield "not a certificate", lambda content: content.clear()


@pytest.mark.parametrize(("words", "change"), [*edited_certificates()])
def test_check_compares_the_certificate(
    words: str, change: Callable[[dict[str, Any]], object], tmp_path: Path
) -> None:
    save(tmp_path, "one")
    path = tmp_path / "certificate.json"
    content = strict_json(path)
    change(content)
    path.write_text(json.dumps(content))
    result = CliRunner().invoke(main, ["check", str(tmp_path)])
    assert (result.exit_code, words in result.stderr) == (3, True), result.stderr
    path.unlink()
    assert CliRunner().invoke(main, ["check", str(tmp_path)]).exit_code == 0


@pytest.mark.parametrize("has_previous", [False, True])
def test_the_folder_of_a_refused_solve_names_what_it_has(
    has_previous: bool, tmp_path: Path
) -> None:
    if has_previous:
        motion = hitch_plan()
        save_plan(tmp_path, Flight.of(motion), certificate_of(Flight.of(motion)))
    save_diagnosis(tmp_path, {"format": "hitchopt-diagnosis/1"})
    done = CliRunner().invoke(main, ["check", str(tmp_path)])
    said = " ".join(done.output.split())
    assert done.exit_code == 2
    assert "solve was refused" in said
    assert f"{tmp_path / 'diagnosis.json'} says why".replace(" ", "") in said.replace(" ", "")
    assert ("the last certified plan is in" in said) is has_previous
