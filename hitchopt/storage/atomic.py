"""A set of files in a directory, replaced all at once or not at all.

Where the directory can be exchanged for its successor (see ``swap``), readers and killed processes
only ever see all of the old files or all of the new ones. Where it cannot (other systems and some
file systems, a mount point, the current directory or one above it, a parent that is not writable),
the files are made in a hidden subdirectory and renamed one by one: the ``seal``, say the
certificate, is removed first and comes last, so that files without it are known to be unfinished.
"""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path

from hitchopt.errors import FileError
from hitchopt.storage.directory_swap import (
    SUFFIX,
    ExchangeUnavailableError,
    Swap,
    abandoned,
    prefix,
    sync,
)
from hitchopt.storage.previous_set import (
    PREVIOUS,
    Fate,
    check_previous,
    empty_previous,
    kept_writers,
)

STAGE = ".hitchopt-"
"""Beginning of the hidden subdirectory's name."""

Writer = Callable[[Path], None]
"""Function that writes one file at the path that it is given."""


def replace_files(
    directory: Path | str,
    writers: Mapping[str, Writer],
    owned: Collection[str],
    seal: str,
    previous: Fate = "leave",
) -> Path:
    """Let ``directory`` hold the named files and of ``owned`` no others; leave the rest alone.

    Parameters
    ----------
    directory: made if it is missing, with its parents; a symbolic link is followed.
    writers: for each file's name, what writes it.
    owned: the names that may be replaced and removed, those of ``writers`` among them.
    seal: the name among ``owned`` that marks a whole set where files come one by one.
    previous: whether the last set with a seal is kept in the subdirectory ``previous``, or that
        subdirectory is removed, or left alone.

    Returns
    -------
    The directory, as it was given.

    Raises
    ------
    FileError: it is no directory or cannot be written to; nothing in it has changed, or the seal
        is missing.
    """
    given = Path(directory)
    target = _resolved(given)
    missing: list[Path] = []
    try:
        for name in owned:
            path = target / name
            if path.is_dir() and not path.is_symlink():
                raise FileError(f"{path}: is a directory where a file is to go; move it away")
        if previous != "leave":
            check_previous(target)
        missing = [parent for parent in target.parents if not parent.exists()]
        target.parent.mkdir(parents=True, exist_ok=True)
        with locked(_lock(target)):
            _finish_abandoned(target, owned)
            kept = kept_writers(target, owned, seal) if previous == "keep" else {}
            try:
                ours = owned if previous == "leave" else (*owned, PREVIOUS)
                _exchange(target, writers, ours, kept)
            except ExchangeUnavailableError:
                kept = kept if (target / seal).is_file() else {}  # else it is in its place
                _rename_one_by_one(target, writers, owned, seal, kept)
                if previous == "remove" and (target / PREVIOUS).is_dir():
                    _remove_previous(target / PREVIOUS, owned)
    except OSError as error:
        culprit = f" ({Path(error.filename).name})" if isinstance(error.filename, str) else ""
        raise FileError(
            f"{given}: cannot be written: {error.strerror or error}{culprit}; free space or "
            "permissions there, or name another directory"
        ) from error
    finally:
        for parent in missing:
            with contextlib.suppress(OSError):  # not empty: it is in use now
                parent.rmdir()
    return given


def _resolved(given: Path) -> Path:
    try:
        target = Path(os.path.realpath(given))
        if not target.exists() or target.is_dir():
            return target
    except (OSError, ValueError) as error:
        raise FileError(f"{given}: no path: {error}; name another directory") from error
    raise FileError(f"{given}: is a file, not a directory; name another one")


def _lock(target: Path) -> Path:
    """Return where writers of ``target`` wait for each other."""
    if os.access(target.parent, os.W_OK | os.X_OK) or not target.exists():
        return target.parent / f"{prefix(target)}lock"
    return target / f"{STAGE}lock"


def _finish_abandoned(target: Path, owned: Collection[str]) -> None:
    for swap in abandoned(target, owned):
        with contextlib.suppress(ExchangeUnavailableError):
            swap.settle()
    for stage in target.glob(f"{STAGE}*{SUFFIX}/"):
        _remove_stage(stage, owned)


def _exchange(
    target: Path,
    writers: Mapping[str, Writer],
    owned: Collection[str],
    kept: Mapping[str, Writer],
) -> None:
    if os.path.ismount(target) or _holds_current_directory(target):
        raise ExchangeUnavailableError
    swap = Swap.begun(target, owned)
    try:
        _write_kept(swap.new, kept)
        _write_all(swap.new, writers)
        swap.commit()
    finally:
        swap.settle()


def _rename_one_by_one(
    target: Path,
    writers: Mapping[str, Writer],
    owned: Collection[str],
    seal: str,
    kept: Mapping[str, Writer],
) -> None:
    made = not target.exists()
    target.mkdir(exist_ok=True)
    stage = None
    try:
        stage = Path(tempfile.mkdtemp(SUFFIX, STAGE, target))
        _write_kept(stage, kept)
        _write_all(stage, writers)
        if kept:  # while the set itself is still there
            _place_previous(stage / PREVIOUS, target / PREVIOUS, owned)
        old = [seal, *(name for name in owned if name != seal and name not in writers)]
        for name in old:
            (target / name).unlink(missing_ok=True)
        sync(target)
        for name in sorted(writers, key=lambda name: name == seal):
            (stage / name).replace(target / name)
        sync(target)
    finally:
        if stage is not None:
            _remove_stage(stage, owned)
        if made:
            with contextlib.suppress(OSError):  # not empty: the files are there
                target.rmdir()


def _place_previous(new: Path, old: Path, owned: Collection[str]) -> None:
    """Put ``new`` in the place of ``old``; others' files in that go along."""
    if old.is_dir():
        _remove_previous(old, owned)
    if old.is_dir():  # others' files are in it
        for name in os.listdir(new):
            (new / name).replace(old / name)
        new.rmdir()
    else:
        new.rename(old)
    sync(old.parent)


def _remove_previous(place: Path, owned: Collection[str]) -> None:
    with contextlib.suppress(OSError):  # not empty: something in it is not ours to delete
        empty_previous(place, place, owned)


def _write_kept(directory: Path, kept: Mapping[str, Writer]) -> None:
    if kept:
        (directory / PREVIOUS).mkdir()
        _write_all(directory / PREVIOUS, kept)


def _remove_stage(stage: Path, owned: Collection[str]) -> None:
    if (stage / PREVIOUS).is_dir():
        _remove_previous(stage / PREVIOUS, owned)
    with contextlib.suppress(OSError):  # not empty: something in it is not ours to delete
        for name in owned:
            (stage / name).unlink(missing_ok=True)
        stage.rmdir()


def _write_all(directory: Path, writers: Mapping[str, Writer]) -> None:
    for name, write in writers.items():
        write(directory / name)
        sync(directory / name)
    sync(directory)


def _holds_current_directory(target: Path) -> bool:
    """Return whether the shell that started us would be left in a removed directory."""
    try:
        current = Path(os.path.realpath(os.getcwd()))
    except OSError:
        return False
    return target == current or target in current.parents


PATIENCE = 120.0
"""Longest wait for another writer [s]: a large plan takes about a minute to write."""

POLL = 0.05
"""Interval between looks whether the other writer is done [s]."""

if sys.platform != "win32":
    import fcntl


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the lock file ``path`` within the block, and remove it afterwards.

    Windows has no locks that end with their process: there the block is entered at once.

    Raises
    ------
    FileError: another process held it all through PATIENCE.
    OSError: it cannot be created.
    """
    if sys.platform == "win32":
        yield
        return
    descriptor = _taken(path)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink()
        os.close(descriptor)


def _taken(path: Path) -> int:
    deadline = time.monotonic() + PATIENCE
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(path.stat(), os.fstat(descriptor)):
                return descriptor
        except (BlockingIOError, FileNotFoundError):
            pass  # another process holds it, or has just removed it: ours locks nobody out
        except OSError:
            return descriptor  # a file system without locks: better unlocked than not at all
        os.close(descriptor)
        if time.monotonic() > deadline:
            raise FileError(
                f"{path}: another process has been writing there for {PATIENCE:g} s; "
                "let it end, or name another directory"
            )
        time.sleep(POLL)
