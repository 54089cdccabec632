"""Format csv: ``setpoints_FRAME.csv``, one row per sample and drone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from hitchopt.errors import FileError
from hitchopt.exports.formats.format import Candidate, Task
from hitchopt.exports.formats.long_table import (
    COLUMNS,
    FLOWN,
    PLACED,
    Rows,
    Table,
    blocks_of,
    columns_told,
    first_names,
    grouped,
    recording_of_rows,
    spread_out,
)
from hitchopt.exports.recording import Recording
from hitchopt.exports.setpoints import lines_of

HEADER = ",".join(("t", "drone", *COLUMNS))

ROWS = 2000
"""Rows that are formatted at once: more are slower, since they leave the processor's cache."""

READ = 20_000
"""Rows that are parsed at once."""


class CsvTable(Table):
    """Text that everything reads."""

    name = "csv"
    summary = "one table of text, a row per sample and drone"

    def candidates(self, task: Task) -> Iterator[Candidate]:
        """Give the one table there is."""
        name = f"setpoints_{task.room.frame}.csv"
        yield Candidate({name: lambda path: write_csv(path, task)})

    def read(self, folder: Path, task: Task) -> Recording:
        """Return what the table says."""
        return read_csv(folder / f"setpoints_{task.room.frame}.csv", task.room.frame)


def write_csv(path: Path, task: Task) -> None:
    """Write the table, twelve significant digits each, block by block.

    Raises
    ------
    OSError: the file cannot be written.
    """
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(HEADER + "\n")
        for block in blocks_of(task, ROWS):
            t = np.broadcast_to(block.t[:, None, None], (*block.values.shape[:2], 1))
            file.write(lines_of(task.names, np.concatenate([t, block.values], axis=-1)))


def read_csv(path: Path, frame: str = "") -> Recording:
    """Return what a table of these columns says; other columns are not looked at.

    Raises
    ------
    FileError: it is not such a table, or a damaged one; from the windows too.
    """
    first = next(_rows(path), None)
    if first is None:
        raise FileError(f"{path}: holds no rows; it is truncated")
    names = first_names(first)
    return recording_of_rows(names, lambda: grouped(_rows(path), names), frame)


def _rows(path: Path) -> Iterator[Rows]:
    try:
        with path.open(encoding="utf-8", newline="") as file:
            header = file.readline().rstrip("\r\n").split(",")
            missing = [name for name in PLACED if name not in header]
            if missing:
                raise FileError(
                    f"{path}: its first line has no column {missing[0]!r}; it must be {HEADER}"
                )
            told = columns_told(header)
            numbers = [header.index(name) for name in ("t", *(FLOWN[i] for i in told))]
            drone = header.index("drone")
            line = 2
            while lines := list(islice(file, READ)):
                rows = _parsed(path, line, lines, drone, numbers)
                yield replace(rows, values=spread_out(rows.values, told))
                line += len(lines)
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: is no text in UTF-8: {error.reason}") from error


def _parsed(path: Path, line: int, lines: list[str], drone: int, numbers: list[int]) -> Rows:
    try:
        names = [text.split(",", drone + 1)[drone] for text in lines]
        values = np.loadtxt(lines, delimiter=",", usecols=numbers, ndmin=2, comments=None)
    except (ValueError, IndexError) as error:
        raise FileError(
            f"{path}: lines {line} to {line + len(lines) - 1}: {error}; it is truncated or damaged"
        ) from error
    return Rows(values[:, 0], names, values[:, 1:])
