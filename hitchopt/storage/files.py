"""A set of files in a directory, replaced whole.

Files are written into a hidden folder first, so a writer that fails or is killed leaves the set
alone. A new directory is that folder, renamed. In one that exists files get their names one by one:
the ``seal``, say the certificate, is removed first and comes last, and until it is there the set
that it sealed before is whole in ``previous``. So files beside a seal are of one set.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import secrets
import shutil
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

from hitchopt.errors import FileError

if sys.platform != "win32":
    import fcntl

PREVIOUS = "previous"  # Name of the subdirectory with the set before

Fate = Literal["leave", "keep", "remove"]
"""Treatment of the set before: none, it stays in PREVIOUS, or only until the new one is
whole."""

STAGE, SUFFIX = ".hitchopt-", ".tmp"  # Beginning and end of the names of hidden folders

Writer = Callable[[Path], None]  # Function that writes one file at the path that it is given


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
    writers: for each file's name, what writes it, in this order.
    owned: the names that may be replaced and removed, those of ``writers`` among them.
    seal: the name among ``owned`` that marks a whole set.
    previous: whether the last sealed set goes to the subdirectory ``previous``.

    Returns the directory as it was given. FileError tells that it is none or cannot be written to;
    nothing in it has changed then, or the seal is missing.
    """
    given, missing = Path(directory), list[Path]()
    if "\0" in str(given):
        raise FileError(f"{given!r}: is no path; name another directory")
    try:
        target = Path(os.path.realpath(given))
        if target.exists() and not target.is_dir():
            raise FileError(f"{given}: is a file, not a directory; name another one")
        for path in (target / name for name in owned):
            if path.is_dir() and not path.is_symlink():
                raise FileError(f"{path}: is a directory where a file is to go; move it away")
        last = target / PREVIOUS
        if previous != "leave" and (last.is_symlink() or last.is_file()):
            raise FileError(f"{last}: is where hitchopt keeps the last plan; move it away")
        missing = [parent for parent in target.parents if not parent.exists()]
        target.parent.mkdir(parents=True, exist_ok=True)
        with _staged(target, owned) as stage:
            for name, write in writers.items():
                write(stage / name)
                sync(stage / name)
            sync(stage)
            with locked(target.parent):
                _exchange(target, stage, set(writers), set(owned), seal, previous)
    except OSError as error:
        culprit = f" ({Path(error.filename).name})" if isinstance(error.filename, str) else ""
        words = f"{error.strerror or error}{culprit}; free space there, or name another directory"
        raise FileError(f"{given}: cannot be written: {words}") from error
    finally:
        for parent in missing:
            with contextlib.suppress(OSError):  # not empty: it is in use now
                parent.rmdir()
    return given


@contextlib.contextmanager
def _staged(target: Path, owned: Collection[str]) -> Iterator[Path]:
    """Give a new hidden folder to write into; remove it, and those of writers that were killed.

    A writer holds the lock of its own hidden folder, which ends with its process.
    """
    home = target if target.exists() else target.parent
    stage = home / f"{STAGE}{secrets.token_hex(4)}{SUFFIX}"
    with contextlib.ExitStack() as held:
        with locked(target.parent):
            for left in home.glob(f"{STAGE}*{SUFFIX}"):
                with contextlib.suppress(BlockingIOError), locked(left, wait=False):
                    _remove(left, owned)
            stage.mkdir()
            held.enter_context(locked(stage))
        try:
            yield stage
        finally:
            _remove(stage, owned)


def _exchange(
    target: Path, stage: Path, written: set[str], owned: set[str], seal: str, previous: Fate
) -> None:
    """Put the files of a hidden folder in place of the set."""
    if not target.exists():
        stage.rename(target)
        sync(target.parent)
        return
    if previous != "leave" and (target / seal).is_file():
        _keep(target, owned)
    for name in sorted(owned - written | {seal}, key=lambda name: name != seal):
        (target / name).unlink(missing_ok=True)
    sync(target)
    for name in sorted(written, key=lambda name: name == seal):
        (stage / name).replace(target / name)
    sync(target)
    if previous == "remove":
        _remove(target / PREVIOUS, owned)


def _keep(target: Path, owned: Collection[str]) -> None:
    """Give the set's files second names in PREVIOUS, in place of the set there."""
    last = target / PREVIOUS
    _remove(last, owned)
    last.mkdir(exist_ok=True)  # others' files may be in it
    for name in (name for name in owned if (target / name).is_file()):
        try:
            os.link(target / name, last / name)
        except OSError:  # a file system without such links
            shutil.copy2(target / name, last / name)
        sync(last / name)
    sync(last)


def _remove(directory: Path, owned: Collection[str]) -> None:
    """Remove our files from a directory, and itself unless others' are in it."""
    with contextlib.suppress(OSError):
        for name in owned:
            (directory / name).unlink(missing_ok=True)
        directory.rmdir()


def sync(path: Path) -> None:
    """Make what was written to a file or directory outlast a loss of power, where that works."""
    with contextlib.suppress(OSError):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


@contextlib.contextmanager
def locked(directory: Path, *, wait: bool = True) -> Iterator[None]:
    """Hold the lock of a directory within the block, where there are locks; others wait for it.

    BlockingIOError tells that it is held elsewhere, if this is not to wait.
    """
    with contextlib.ExitStack() as held:
        if sys.platform != "win32":
            with contextlib.suppress(PermissionError, FileNotFoundError):
                descriptor = os.open(directory, os.O_RDONLY)
                held.callback(os.close, descriptor)
                try:
                    fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
                except OSError as error:
                    if isinstance(error, BlockingIOError):
                        raise  # else a file system without locks: better unlocked than not at all
        yield


def digest(path: Path) -> str:
    """Return the SHA-256 of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_strict_json(path: Path, content: dict[str, Any]) -> None:
    """Write the content, indented, in UTF-8; raise OSError if the file cannot be written."""
    path.write_text(strict_json(content) + "\n", encoding="utf-8", newline="\n")


def strict_json(content: dict[str, Any]) -> str:
    """Return the text of the content, indented; every number that is not finite is null."""
    return json.dumps(_strict(content), indent=2, allow_nan=False, ensure_ascii=False)


def parsed_json(text: str | bytes) -> Any:
    """Return what the text says, every number as a float; ValueError tells that it is no JSON."""
    try:
        return json.loads(text, parse_int=float)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def _strict(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _strict(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
