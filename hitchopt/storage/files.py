"""Replace the set of files in a directory atomically.

Files are written into a hidden staging folder first, so the set survives a writer that fails or is
killed. A new directory is the staging folder, renamed. In an existing directory files are replaced
one by one: the ``seal``, for example the certificate, is removed first and written last, and in
between ``previous`` holds the last complete set. So files next to a seal belong to one set.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import secrets
import shutil
import stat
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from io import BufferedReader
from pathlib import Path
from typing import Any, Literal

from hitchopt.errors import FileError

if sys.platform != "win32":
    import fcntl

DIAGNOSIS = "diagnosis.json"  # Reasons why there is no plan in a directory
PREVIOUS = "previous"  # Name of the subdirectory with the last set

BackupPolicy = Literal["leave", "keep", "remove"]
"""Backup of the last set in PREVIOUS: none, permanent, or until the new set is complete."""

STAGE_PREFIX = ".hitchopt-"  # Prefix of staging folders
STAGE_SUFFIX = ".tmp"  # Suffix of staging folders
Writer = Callable[[Path], object]  # Function that writes one file to a path


def replace_files(
    directory: Path | str,
    writers: Mapping[str, Writer],
    owned: Collection[str],
    seal: str,
    previous: BackupPolicy = "leave",
    check: Callable[[], object] = lambda: None,
) -> Path:
    """Write the named files into a directory, and remove the other files of ``owned``.

    Parameters
    ----------
    directory: created with its parents if it is missing; a symbolic link is followed.
    writers: the function that writes each file, by name, called in this order.
    owned: names that may be replaced and removed, those of ``writers`` among them.
    seal: the name among ``owned`` that marks a complete set.
    previous: backup policy for the last sealed set.
    check: called once the files are complete and no other process replaces files in the directory;
        it raises an error to leave the directory as it is.

    Returns the directory as passed. Raises FileError if it is no directory or not writable; then
    nothing in it has changed, or the seal is missing.
    """
    folder = Path(directory)
    missing = list[Path]()
    if "\0" in str(folder):
        raise FileError(f"{folder!r}: is not a path; name another directory")
    try:
        target = Path(os.path.realpath(folder))
        if target.exists() and not target.is_dir():
            raise FileError(f"{folder}: is a file, not a directory; name another one")
        for path in (target / name for name in owned):
            if path.is_dir() and not path.is_symlink():
                raise FileError(
                    f"{path}: is a directory; a file of that name is needed; move it away"
                )
        backup = target / PREVIOUS
        if previous != "leave" and (backup.is_symlink() or backup.is_file()):
            raise FileError(f"{backup}: is where hitchopt keeps the last plan; move it away")
        missing = [parent for parent in target.parents if not parent.exists()]
        target.parent.mkdir(parents=True, exist_ok=True)
        with _staging_folder(target, owned) as stage:
            for name, write in writers.items():
                write(stage / name)
                _sync(stage / name)
            _sync(stage)
            with _directory_lock(target.parent):
                check()
                _exchange(target, stage, set(writers), set(owned), seal, previous)
    except OSError as error:
        file = f" ({Path(error.filename).name})" if isinstance(error.filename, str) else ""
        reason = f"{error.strerror or error}{file}; free space there, or name another directory"
        raise FileError(f"{folder}: cannot be written: {reason}") from error
    finally:
        for parent in missing:
            with contextlib.suppress(OSError):  # not empty: it is in use now
                parent.rmdir()
    return folder


@contextlib.contextmanager
def _staging_folder(target: Path, owned: Collection[str]) -> Iterator[Path]:
    """Create a staging folder for the context; remove those of killed writers.

    A writer locks its own staging folder; the lock ends with the process.
    """
    home = target if target.exists() else target.parent
    stage = home / f"{STAGE_PREFIX}{secrets.token_hex(4)}{STAGE_SUFFIX}"
    with contextlib.ExitStack() as stack:
        with _directory_lock(target.parent):
            for stale in home.glob(f"{STAGE_PREFIX}*{STAGE_SUFFIX}"):
                with contextlib.suppress(BlockingIOError), _directory_lock(stale, wait=False):
                    _remove(stale, owned)
            stage.mkdir()
            stack.enter_context(_directory_lock(stage))
        try:
            yield stage
        finally:
            _remove(stage, owned)


def _exchange(
    target: Path, stage: Path, new: set[str], owned: set[str], seal: str, previous: BackupPolicy
) -> None:
    """Replace the set of files by those of the staging folder."""
    if not target.exists():
        stage.rename(target)
        _sync(target.parent)
        return
    if previous != "leave" and (target / seal).is_file():
        _back_up(target, owned)
    for name in sorted(owned - new | {seal}, key=lambda name: name != seal):
        (target / name).unlink(missing_ok=True)
    _sync(target)
    for name in sorted(new, key=lambda name: name == seal):
        (stage / name).replace(target / name)
    _sync(target)
    if previous == "remove":
        _remove(target / PREVIOUS, owned)


def _back_up(target: Path, owned: Collection[str]) -> None:
    """Replace the set in PREVIOUS by hard links to the current files."""
    backup = target / PREVIOUS
    _remove(backup, owned)
    backup.mkdir(exist_ok=True)  # it may contain files that are not owned
    for name in (name for name in owned if (target / name).is_file()):
        try:
            os.link(target / name, backup / name)
        except OSError:  # a file system without hard links
            shutil.copy2(target / name, backup / name)
        _sync(backup / name)
    _sync(backup)


def _remove(directory: Path, owned: Collection[str]) -> None:
    """Remove the owned files from a directory, and the directory if it is empty then."""
    with contextlib.suppress(OSError):
        for name in owned:
            (directory / name).unlink(missing_ok=True)
        directory.rmdir()


def _sync(path: Path) -> None:
    """Flush a file or directory to disk, where the system supports it."""
    with contextlib.suppress(OSError):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


@contextlib.contextmanager
def _directory_lock(directory: Path, *, wait: bool = True) -> Iterator[None]:
    """Lock a directory within the context, where the system supports locks.

    Raises BlockingIOError if another process holds the lock and ``wait`` is false.
    """
    with contextlib.ExitStack() as stack:
        if sys.platform != "win32":
            with contextlib.suppress(PermissionError, FileNotFoundError):
                descriptor = os.open(directory, os.O_RDONLY)
                stack.callback(os.close, descriptor)
                try:
                    fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
                except BlockingIOError:
                    raise
                except OSError:  # a file system without locks
                    pass
        yield


INHERITED = ("/dev/stdin", "/dev/fd/", "/proc/self/fd/")
"""Paths of files that the caller has opened for this process, such as ``<(command)`` of a shell."""


def opened(path: Path | str) -> BufferedReader:
    """Open a file at a user's path for reading bytes.

    All such files are opened here; those that libraries open pass ``require_file``. Raises
    FileError for pipes, devices and sockets, and OSError if there is no such file.
    """
    require_file(path)
    return open(path, "rb")


def require_file(path: Path | str) -> None:
    """Raise FileError for pipes, devices and sockets, which may never begin or end.

    OSError if there is no such file.
    """
    mode = os.stat(path).st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode) or str(path).startswith(INHERITED)):
        kind = (
            "a pipe" if stat.S_ISFIFO(mode) else "a socket" if stat.S_ISSOCK(mode) else "a device"
        )
        raise FileError(f"{path}: is {kind}, not a regular file; name a regular file")


def file_bytes(path: Path | str) -> bytes:
    """Return the bytes of a file at a user's path; errors as ``opened``."""
    with opened(path) as file:
        return file.read()


def file_text(path: Path | str) -> str:
    """Return the text of a file at a user's path in UTF-8; errors as ``opened``, and ValueError."""
    return file_bytes(path).decode("utf-8")


def digest(path: Path) -> str:
    """Return the SHA-256 of a file, of a text with the line ends that hitchopt writes.

    Git and editors may write those of Windows. A text has no zero byte.
    """
    content = file_bytes(path)
    if b"\0" not in content:
        content = content.replace(b"\r\n", b"\n")
    return hashlib.sha256(content).hexdigest()


def has_other_line_ends(path: Path) -> bool:
    """Return whether a text has line ends of Windows, which hitchopt does not write."""
    content = file_bytes(path)
    return b"\r\n" in content and b"\0" not in content


def write_strict_json(path: Path, content: dict[str, Any]) -> None:
    """Write indented JSON in UTF-8; raises OSError if the file cannot be written."""
    path.write_text(strict_json(content) + "\n", encoding="utf-8", newline="\n")


def strict_json(content: dict[str, Any]) -> str:
    """Return indented JSON, with null for numbers that are not finite."""
    return json.dumps(with_nulls(content), indent=2, allow_nan=False, ensure_ascii=False)


def parsed_json(text: str | bytes) -> Any:
    """Parse JSON, every number as a float; raises ValueError if the text is invalid."""
    try:
        return json.loads(text, parse_int=float)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def with_nulls(value: Any) -> Any:
    """Return plain data with None for numbers that are not finite, and lists for tuples."""
    if isinstance(value, dict):
        return {key: with_nulls(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [with_nulls(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
