"""Columns of numbers in comma-separated text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hitchopt.errors import FileError
from hitchopt.values import Array


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
    lines: Sequence[str],
    columns: Sequence[int],
    source: str,
    least: int = 0,
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
    return np.asarray(table, dtype=np.float64)
