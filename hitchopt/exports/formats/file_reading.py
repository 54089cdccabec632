"""Read files from any source: text, tables of numbers, zips; every fault is a FileError."""

from __future__ import annotations

import contextlib
import zipfile
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError, HitchoptError, UnsupportedError
from hitchopt.storage.archive import BROKEN, checked_bytes, refuse_bomb
from hitchopt.values import Array

MAX_UNPACKED = 500_000_000
"""Size limit of all that is read of one zip, unpacked [B]."""


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
        raise FileError(f"{path}: is no {what}, or a damaged one: {error}") from error


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


def column_places(header: str, wanted: Sequence[str], usual: str, source: str) -> list[int]:
    """Return where the wanted columns stand by a table's first line.

    Parameters
    ----------
    header: the first line.
    wanted: names of columns.
    usual: the first line that hitchopt writes.
    source: name of the file.

    Raises
    ------
    FileError: a column is missing.
    """
    found = header.split(",")
    missing = [name for name in wanted if name not in found]
    if missing:
        raise FileError(
            f"{source}: its first line has no column {missing[0]!r}; it must be {usual}"
        )
    return [found.index(name) for name in wanted]


def read_numbers(
    lines: Sequence[str], columns: Sequence[int], source: str, least: int = 0
) -> Array:
    """Return some columns of lines as numbers, (rows, columns); blank lines are left out.

    Raises
    ------
    FileError: fewer rows than ``least``, rows that are too short, or text that is no number.
    """
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
    """Open a zip file for the block; whatever is wrong with it within the block is a FileError.

    Parameters
    ----------
    path: name of the file.
    what: what it is expected to be, as in "is no ``what``".
    """
    with reading(path, what), zipfile.ZipFile(path) as archive:
        try:
            yield archive
        except (KeyError, TypeError, AttributeError, IndexError) as error:
            raise FileError(f"{path}: is no {what}: {error!r} in its description") from error


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
