"""Format csv: ``setpoints_FRAME.csv``, one row per sample and drone."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from hitchopt.errors import FileError
from hitchopt.exports.formats.file_reading import column_places, read_numbers, reading
from hitchopt.exports.formats.format import Task
from hitchopt.exports.formats.long_table import COLUMNS, Rows, Table, blocks_of, read_rows, told_in
from hitchopt.exports.recording import Recording
from hitchopt.exports.setpoints import lines_of

HEADER = ",".join(("t", "drone", *COLUMNS))

ROWS = 2000
"""Rows that are formatted at once: more are slower, since they leave the processor's cache."""

READ = 20_000
"""Rows that are parsed at once."""


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

    Parameters
    ----------
    path: name of the file; its last word names the frame where none is given.
    frame: enu, nwu or ned.

    Raises
    ------
    FileError: it is not such a table, or a damaged one; from the windows too.
    """
    return read_rows(path, _rows, frame or path.stem.rpartition("_")[2])


def _rows(path: Path) -> Iterator[Rows]:
    with reading(path, "readable text in UTF-8"), path.open(encoding="utf-8", newline="") as file:
        header = file.readline().rstrip("\r\n")
        told = told_in(header.split(","))
        wanted = ("t", "drone", *told)
        t, drone, *numbers = column_places(header, wanted, HEADER, str(path))
        line = 2
        while lines := list(islice(file, READ)):
            place = f"{path}: lines {line} to {line + len(lines) - 1}"
            cells = [text.split(",", drone + 1) for text in lines]
            if not all(map(str.strip, lines)):
                raise FileError(f"{place}: a line is empty; it is truncated or damaged")
            if lines[-1].count(",") != header.count(","):
                raise FileError(f"{place}: the last line is not whole; it is truncated")
            values = read_numbers(lines, (t, *numbers), place)
            if min(map(len, cells)) <= drone:
                raise FileError(f"{place}: a row names no drone; it is truncated or damaged")
            names = [row[drone] for row in cells]
            yield Rows.telling(values[:, 0], names, values[:, 1:], told)
            line += len(lines)


class CsvTable(Table):
    """Text that everything reads."""

    name = "csv"
    file = "setpoints_{frame}.csv"
    write_file = staticmethod(write_csv)
    read_file = staticmethod(read_csv)
