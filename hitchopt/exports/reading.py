"""Read text, tables and manifests from any source; every fault is a FileError."""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError, UnsupportedError
from hitchopt.values import Array

MANIFEST, MANIFEST_FORMAT = "export.json", "hitchopt-export/1"
"""Name of the file with what an export holds, in which frame, and what was checked; its format."""

MAX_MANIFEST = 50_000_000  # Size limit of a manifest that is read [B]


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
