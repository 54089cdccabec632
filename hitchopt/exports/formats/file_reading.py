"""Read files from any source: text, tables, zips, manifests; every fault is a FileError."""

from __future__ import annotations

import contextlib
import json
import zipfile
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError, HitchoptError, UnsupportedError
from hitchopt.storage.archive import BROKEN, checked_bytes, refuse_bomb
from hitchopt.values import Array

MANIFEST, MANIFEST_FORMAT = "export.json", "hitchopt-export/1"
"""Name of the file with what an export holds, in which frame, and what was checked; its format."""

MAX_MANIFEST = 50_000_000  # Size limit of a manifest that is read [B]

MAX_UNPACKED = 500_000_000  # Size limit of all that is read of one zip, unpacked [B]


@contextlib.contextmanager
def reading(path: Path, what: str, kind: type[Exception] = HitchoptError) -> Iterator[None]:
    """Turn what a file of another kind or a damaged one raises into a FileError that names it.

    Parameters
    ----------
    path: name of the file that the block reads.
    what: what it is expected to be, as in "is no ``what``".
    kind: root of the exceptions of a library that reads it, besides ``BROKEN``.
    """
    try:
        yield
    except FileError as error:
        if str(error).startswith(str(path)):
            raise
        raise FileError(f"{path}: {error}") from error
    except (*BROKEN, kind) as error:
        words = repr(error) if isinstance(error, LookupError) else str(error)
        raise FileError(f"{path}: is no {what}, or a damaged one: {words}") from error


def read_text(path: Path) -> str:
    """Return a file's text in UTF-8, with or without a byte order mark.

    Raises
    ------
    FileError: it cannot be read, or is no such text.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: cannot be read: {error}") from error


def read_columns(
    lines: Sequence[str],
    header: str,
    wanted: Sequence[str],
    usual: str,
    source: str,
    least: int = 0,
) -> Array:
    """Return the wanted columns of a table's lines as numbers; blank ones are left out.

    Parameters
    ----------
    lines: of the table, without the first one.
    header: the first line.
    wanted: names of columns.
    usual: the first line that hitchopt writes.
    source: name of the file.
    least: fewest rows.

    Raises
    ------
    FileError: a column is missing, fewer rows, rows that are too short, or text that is no number.
    """
    labels = header.split(",")
    missing = [name for name in wanted if name not in labels]
    if missing:
        words = f"its first line has no column {missing[0]!r}; it must be {usual}"
        raise FileError(f"{source}: {words}")
    columns = [labels.index(name) for name in wanted]
    table = np.empty((0, len(columns)))
    filled = [line for line in lines if line.strip()]
    try:
        if filled:  # numpy warns of none
            table = np.loadtxt(filled, delimiter=",", usecols=columns, ndmin=2, comments=None)
    except (ValueError, IndexError) as error:
        raise FileError(f"{source}: {error}; it is truncated or damaged") from error
    if len(table) < least:
        raise FileError(f"{source}: has {len(table)} rows; {least} are the least")
    return table


@contextlib.contextmanager
def opened_zip(path: Path, what: str) -> Iterator[zipfile.ZipFile]:
    """Open a zip file for the block; whatever is wrong with it within the block is a FileError."""
    with reading(path, what), zipfile.ZipFile(path) as archive:
        yield archive


def read_members(
    path: Path, archive: zipfile.ZipFile, members: Sequence[zipfile.ZipInfo]
) -> Iterator[bytes]:
    """Yield the bytes of files in the archive, one after the other.

    Raises
    ------
    FileError: together they are too large, or they are packed in an unusual manner.
    BROKEN: the archive is damaged.
    """
    size = sum(member.file_size for member in members)
    if size > MAX_UNPACKED:
        raise FileError(f"its files unpack to {size:.3g} bytes; {MAX_UNPACKED} are the most")
    refuse_bomb(members, path.stat().st_size)
    for member in members:
        yield checked_bytes(archive, member)


def needed(module: str) -> Any:
    """Return a module of a library that only some formats need.

    Raises
    ------
    UnsupportedError: it is not installed; the message says what to install.
    """
    try:
        return import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise UnsupportedError(
            f"this format needs the package {package} ({error}); pip install 'hitchopt[export]'"
        ) from error


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """Return what the manifest in a folder says; None where there is none, or not one of ours.

    Raises
    ------
    FileError: there is one that cannot be read.
    """
    path = folder / MANIFEST
    try:
        if not path.is_file():
            return None
        if path.stat().st_size > MAX_MANIFEST:
            raise FileError(f"{path}: is too large for a manifest")
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise FileError(f"{path}: cannot be read: {error}; remove it, or export anew") from error
    ours = isinstance(content, dict) and content.get("format") == MANIFEST_FORMAT
    return content if ours else None
