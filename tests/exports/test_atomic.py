"""Replacing a set of files: whole, only ours, everywhere. Being killed is tested in test_kill."""

from __future__ import annotations

import errno
import os
import stat
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from hitchopt.errors import FileError
from hitchopt.storage import atomic, directory_swap
from hitchopt.storage.atomic import Writer, replace_files
from hitchopt.storage.directory_swap import exchange

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


@pytest.fixture(params=["exchange", "one by one"])
def method(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Both methods of replacing; the second as on a file system that cannot exchange."""
    if request.param == "one by one":

        def unavailable(first: Path, second: Path) -> None:
            del first
            raise OSError(errno.EINVAL, "Invalid argument", str(second))

        monkeypatch.setattr(directory_swap, "exchange", unavailable)
    return str(request.param)


@pytest.fixture
def home(tmp_path: Path) -> Iterator[Path]:
    """A directory in which nothing but ``out`` may be when the test is over."""
    yield tmp_path
    assert {p.name for p in tmp_path.iterdir()} <= {"out", "elsewhere"}


def test_a_missing_directory_is_made_with_its_parents(home: Path) -> None:
    assert replace(home / "out/a/b", plan="1", seal="s") == home / "out/a/b"
    assert everything(home) == {"out/a/b/plan": "1", "out/a/b/seal": "s"}


@pytest.mark.usefixtures("method")
def test_only_ours_are_replaced_and_removed(home: Path) -> None:
    out = home / "out"
    (out / "sub/deep").mkdir(parents=True)
    (out / "sub/deep/plan").write_text("not ours: not at the top")
    (out / "notes").write_text("mine")
    (out / "notes-too").symlink_to("notes")
    inodes = [(out / name).lstat().st_ino for name in ("sub", "notes", "notes-too")]
    replace(out, plan="1", table="1", seal="1")
    replace(out, diagnosis="2")
    kept = {"sub/deep/plan": "not ours: not at the top", "notes": "mine", "notes-too": "mine"}
    assert everything(out) == {"diagnosis": "2", **kept}
    replace(out, plan="3", seal="3")
    assert everything(out) == {"plan": "3", "seal": "3", **kept}
    assert [(out / name).lstat().st_ino for name in ("sub", "notes", "notes-too")] == inodes
    assert (out / "notes").stat().st_nlink == 1


def test_the_exchange_is_what_is_used_here(home: Path) -> None:
    out = home / "out"
    out.mkdir()
    before = out.stat().st_ino
    replace(out, plan="1")
    assert out.stat().st_ino != before


@pytest.mark.usefixtures("method")
def test_a_failing_writer_changes_nothing(home: Path) -> None:
    def full(path: Path) -> None:
        path.write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    out = home / "out"
    for _ in range(2):
        with pytest.raises(FileError, match=r"out/x/y: cannot be written: No space left.*\(seal\)"):
            replace_files(out / "x/y", {"plan": text("new"), "seal": full}, OWNED, "seal")
        assert not out.exists()
    replace(out, plan="1", seal="1")
    (out / "sub").mkdir()
    with pytest.raises(FileError, match="No space left"):
        replace_files(out, {"plan": text("new"), "seal": full}, OWNED, "seal")
    with pytest.raises(KeyboardInterrupt):
        replace_files(out, {"plan": text("new"), "seal": interrupted}, OWNED, "seal")
    assert everything(out) == {"plan": "1", "seal": "1"}
    assert {p.name for p in out.iterdir()} == {"plan", "seal", "sub"}


def interrupted(path: Path) -> None:
    path.write_text("half")
    raise KeyboardInterrupt


@pytest.mark.usefixtures("method")
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


@pytest.mark.usefixtures("method")
def test_a_symbolic_link_is_followed_and_stays(home: Path) -> None:
    (home / "elsewhere/real").mkdir(parents=True)
    (home / "elsewhere/real/notes").write_text("mine")
    (home / "out").symlink_to("elsewhere/real")
    assert replace(home / "out", plan="1") == home / "out"
    assert (home / "out").is_symlink()
    assert everything(home / "elsewhere") == {"real/plan": "1", "real/notes": "mine"}


def test_a_link_among_ours_is_replaced_and_not_followed(home: Path) -> None:
    (home / "out").mkdir()
    (home / "elsewhere").write_text("not ours")
    (home / "out/plan").symlink_to("../elsewhere")
    replace(home / "out", plan="1")
    assert (home / "elsewhere").read_text() == "not ours"
    assert not (home / "out/plan").is_symlink()


@pytest.mark.parametrize("up", [".", "..", "../.."])
def test_the_current_directory_stays_one(
    home: Path, up: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (home / "out/a/b").mkdir(parents=True)
    monkeypatch.chdir(home / "out/a/b")
    inode = os.stat(up).st_ino
    replace(Path(up), plan="1", seal="1")
    replace(Path(up), diagnosis="2")
    assert os.stat(up).st_ino == inode
    assert {p.name for p in Path(up).iterdir()} - {"a", "b"} == {"diagnosis"}
    monkeypatch.undo()


def test_where_files_come_one_by_one_the_seal_goes_first_and_comes_last(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (home / "out").mkdir()
    monkeypatch.chdir(home / "out")
    replace(Path(), plan="1", table="1", seal="1")
    sealed: list[tuple[str, bool]] = []
    for name in ("replace", "unlink"):
        real = getattr(Path, name)

        def watched(path: Path, *args: object, real: object = real, **kwargs: object) -> object:
            result = real(path, *args, **kwargs)  # type: ignore[operator]
            sealed.append((path.name, Path("seal").exists()))
            return result

        monkeypatch.setattr(Path, name, watched)
    replace(Path(), plan="2", seal="2", table="2")
    steps = [(name, there) for name, there in sealed if name in OWNED]
    first, last = steps.index(("seal", False)), steps.index(("seal", True))
    assert {name for name, there in steps if there} <= {"seal"} | {n for n, _ in steps[last:]}
    assert {name for name, _ in steps[first + 1 : last]} >= {"plan", "table"}


def test_a_file_in_the_way_is_named(home: Path) -> None:
    (home / "out").write_text("a file")
    with pytest.raises(FileError, match=r"out: is a file, not a directory"):
        replace(home / "out", plan="1")
    with pytest.raises(FileError, match=r"out/a/b: cannot be written: Not a directory"):
        replace(home / "out/a/b", plan="1")
    assert (home / "out").read_text() == "a file"


def test_a_directory_under_one_of_our_names_is_left_alone(home: Path) -> None:
    (home / "out/table").mkdir(parents=True)
    (home / "out/table/x").write_text("mine")
    with pytest.raises(FileError, match="table: is a directory where a file is to go"):
        replace(home / "out", plan="1")
    assert everything(home / "out") == {"table/x": "mine"}


@pytest.mark.parametrize("name", ["a\0b", "x" * 300])
def test_impossible_names_are_file_errors(home: Path, name: str) -> None:
    with pytest.raises(FileError):
        replace(home / name, plan="1")


def test_a_name_too_long_for_a_hidden_neighbour_is_still_written(home: Path) -> None:
    out = home / "out" / ("x" * 240)
    replace(out, plan="1")
    replace(out, plan="2", seal="2")
    assert everything(out) == {"plan": "2", "seal": "2"}
    assert [p.name for p in (home / "out").iterdir()] == [out.name]


def test_a_subdirectory_that_cannot_move_keeps_its_place(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As one that somebody else owns, or a mount: the whole is exchanged back."""
    out = home / "out"
    for name in ("a", "b", "c"):
        (out / name).mkdir(parents=True)
        (out / name / "x").write_text(name)
    replace(out, plan="1", seal="1")

    def refusing(first: Path, second: Path) -> None:
        if second.name == "b":
            raise OSError(errno.EACCES, "Permission denied", str(second))
        exchange(first, second)

    monkeypatch.setattr(directory_swap, "exchange", refusing)
    replace(out, diagnosis="2")
    assert everything(out) == {"a/x": "a", "b/x": "b", "c/x": "c", "diagnosis": "2"}
    assert not any(p.is_symlink() for p in out.iterdir())


def test_files_that_others_make_or_replace_meanwhile_stay(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = home / "out"
    out.mkdir()
    for name in ("edited", "replaced", "still"):
        (out / name).write_text("old")

    def late(first: Path, second: Path) -> None:
        if second == out:  # just before the exchange: in what is about to be the predecessor
            (out / "made").write_text("new")
            (out / "made-dir").mkdir()
            (out / "made-dir/x").write_text("new")
            (out / "edited").write_text("new")
            (out / "other").write_text("new")
            (out / "other").replace(out / "replaced")
        exchange(first, second)

    monkeypatch.setattr(directory_swap, "exchange", late)
    replace(out, plan="1")
    new = dict.fromkeys(("made", "made-dir/x", "edited", "replaced"), "new")
    assert everything(out) == {"plan": "1", "still": "old", **new}


def test_lookalikes_of_our_working_directories_are_not_touched(tmp_path: Path) -> None:
    for place in (".out.hitchopt-backup.tmp", "out/.hitchopt-mine"):
        (tmp_path / place / "new").mkdir(parents=True)
        (tmp_path / place / "new/notes").write_text("mine")
        (tmp_path / place / "notes").write_text("mine")
    replace(tmp_path / "out", plan="1")
    replace(tmp_path / "out", plan="2")
    for place in (".out.hitchopt-backup.tmp", "out/.hitchopt-mine"):
        assert everything(tmp_path / place) == {"new/notes": "mine", "notes": "mine"}


def test_threads_take_turns(home: Path) -> None:
    out = home / "out"
    errors: list[BaseException] = []

    def work(tag: str) -> None:
        try:
            for i in range(8):
                replace(out, plan=f"{tag}{i}", table=f"{tag}{i}", seal=f"{tag}{i}")
        except BaseException as error:  # reported below: a thread's own goes unseen
            errors.append(error)

    threads = [threading.Thread(target=work, args=(tag,)) for tag in "abc"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == []
    assert len(set(everything(out).values())) == 1
    assert set(everything(out)) == {"plan", "table", "seal"}


def test_waiting_for_another_writer_ends(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(atomic, "PATIENCE", 0.1)
    with (
        atomic.locked(home / ".out.hitchopt-lock"),
        pytest.raises(FileError, match="another process has been writing"),
    ):
        replace(home / "out", plan="1")
    replace(home / "out", plan="1")
    assert everything(home) == {"out/plan": "1"}
