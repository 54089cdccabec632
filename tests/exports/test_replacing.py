"""Replacing a set of files: whole, only ours, everywhere. Being killed is tested in test_kill."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from hitchopt.errors import FileError
from hitchopt.storage.files import Writer, replace_files

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


def test_a_missing_directory_is_made_with_its_parents(home: Path) -> None:
    assert replace(home / "out/a/b", plan="1", seal="s") == home / "out/a/b"
    assert everything(home) == {"out/a/b/plan": "1", "out/a/b/seal": "s"}


def test_only_ours_are_replaced_and_removed(home: Path) -> None:
    out = home / "out"
    (out / "sub/deep").mkdir(parents=True)
    (out / "sub/deep/plan").write_text("not ours: not at the top")
    (out / "notes").write_text("mine")
    (home / "elsewhere").write_text("not ours")
    (out / "plan").symlink_to("../elsewhere")  # replaced, not followed
    replace(out, plan="1", table="1", seal="1")
    replace(out, diagnosis="2")
    kept = {"sub/deep/plan": "not ours: not at the top", "notes": "mine"}
    assert everything(out) == {"diagnosis": "2", **kept}
    replace(out, plan="3", seal="3")
    assert everything(out) == {"plan": "3", "seal": "3", **kept}
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


def test_the_mode_is_kept_and_a_new_one_is_the_usual(home: Path) -> None:
    old = os.umask(0o027)
    try:
        replace(home / "out", plan="1")
        assert stat.S_IMODE((home / "out").stat().st_mode) == 0o750
        assert stat.S_IMODE((home / "out/plan").stat().st_mode) == 0o640
        (home / "out").chmod(0o2715)
        replace(home / "out", plan="2")
        assert stat.S_IMODE((home / "out").stat().st_mode) == 0o2715
    finally:
        os.umask(old)


def test_a_symbolic_link_and_the_current_directory_stay(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (home / "elsewhere/real/a").mkdir(parents=True)
    (home / "out").symlink_to("elsewhere/real")
    assert replace(home / "out", plan="1") == home / "out"
    assert (home / "out").is_symlink()
    monkeypatch.chdir(home / "elsewhere/real/a")
    for up in (".", ".."):
        inode = os.stat(up).st_ino
        replace(Path(up), diagnosis="2")
        assert os.stat(up).st_ino == inode
    assert set(everything(home / "elsewhere")) == {"real/diagnosis", "real/a/diagnosis"}
    monkeypatch.undo()


def test_the_seal_goes_first_and_comes_last(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seal = home / "out/seal"
    replace(home / "out", plan="1", table="1", seal="1")
    steps: list[tuple[str, bool]] = []
    for name in ("replace", "unlink"):
        real = getattr(Path, name)

        def watched(path: Path, *args: object, real: object = real, **kwargs: object) -> object:
            result = real(path, *args, **kwargs)  # type: ignore[operator]
            steps.append((path.name, seal.exists()))
            return result

        monkeypatch.setattr(Path, name, watched)
    replace(home / "out", plan="2", seal="2", table="2")
    found = [step for step in steps if step[0] in OWNED]
    first, last = found.index(("seal", False)), found.index(("seal", True))
    assert first == 0
    assert {name for name, _ in found[first + 1 : last]} >= {"plan", "table"}


@pytest.mark.parametrize(
    ("taken", "asked", "words"),
    [
        ("out", "out", "out: is a file, not a directory"),
        ("out", "out/a/b", "out/a/b: cannot be written: Not a directory"),
        ("out/table/x", "out", "table: is a directory where a file is to go"),
        ("out/x", "a\0b", "no path"),
        ("out/x", "x" * 300, "name"),
    ],
)
def test_what_is_in_the_way_is_named(taken: str, asked: str, words: str, home: Path) -> None:
    (home / taken).parent.mkdir(parents=True, exist_ok=True)
    (home / taken).write_text("mine")
    with pytest.raises(FileError, match=words):
        replace(home / asked, plan="1")
    assert everything(home) == {taken: "mine"}


def test_a_name_too_long_for_a_hidden_neighbour_is_still_written(home: Path) -> None:
    out = home / "out" / ("x" * 255)
    replace(out, plan="1")
    replace(out, plan="2", seal="2")
    assert everything(out) == {"plan": "2", "seal": "2"}
    assert [p.name for p in (home / "out").iterdir()] == [out.name]


def test_what_another_writer_is_writing_is_left_alone(home: Path) -> None:
    def slow(path: Path) -> None:
        replace(home / "out", plan="2", seal="2")  # another writer is faster
        path.write_text("1")

    replace_files(home / "out", {"plan": slow, "seal": text("1")}, OWNED, "seal")
    assert everything(home) == {"out/plan": "1", "out/seal": "1"}
