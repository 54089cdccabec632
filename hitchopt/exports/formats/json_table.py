"""Format json: ``setpoints.json``, one sample a line, so that it can be read line by line too.

``{"format", "frame", "drones": [names], "columns": [names], "samples": [{"t": s, "rows": [[…] per
drone]}, …]}``; numbers have twelve significant digits.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError
from hitchopt.exports.formats.format import Candidate, Task
from hitchopt.exports.formats.long_table import COLUMNS, Block, Table, blocks_of, recording_of_rows
from hitchopt.exports.frame import AXES
from hitchopt.exports.recording import Recording
from hitchopt.storage.archive import BROKEN
from hitchopt.storage.strict_json import parsed_json

FILE = "setpoints.json"

FORMAT = "hitchopt-setpoints/1"

START, END = '"samples": [', "]}"
"""Lines around the samples."""

ROWS = 2000
"""Rows that are formatted at once."""

MAX_LINE = 50_000_000
"""[characters] A sample of 20,000 drones takes 6 million."""


class JsonTable(Table):
    """Text for whatever knows no table."""

    name = "json"
    summary = "one document, a line per sample"

    def candidates(self, task: Task) -> Iterator[Candidate]:
        """Give the one document there is."""
        yield Candidate({FILE: lambda path: write_json(path, task)})

    def read(self, folder: Path, task: Task) -> Recording:  # noqa: ARG002
        """Return what the document says."""
        return read_json(folder / FILE)


def write_json(path: Path, task: Task) -> None:
    """Write the document block by block.

    Raises
    ------
    OSError: the file cannot be written.
    """
    head = {
        "format": FORMAT,
        **task.room.to_dict(),
        "drones": list(task.names),
        "columns": list(COLUMNS),
    }
    row = "[" + ",".join(["%.12g"] * len(COLUMNS)) + "]"
    sample = '{"t": %.12g, "rows": [' + ",".join([row] * len(task.names)) + "]}"
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(json.dumps(head, ensure_ascii=False)[:-1] + ",\n" + START)
        joint = "\n"
        for block in blocks_of(task, ROWS):
            flat = np.column_stack([block.t, block.values.reshape(len(block.t), -1)])
            text = ",\n".join([sample] * len(flat)) % tuple(flat.ravel().tolist())
            file.write(joint + text)
            joint = ",\n"
        file.write("\n" + END + "\n")


def read_json(path: Path) -> Recording:
    """Return what such a document says, line by line.

    Raises
    ------
    FileError: it is not such a document, or a damaged one; from the windows too.
    """
    head = _head(path)
    names = tuple(str(name) for name in head["drones"])
    frame = str(head.get("frame"))
    return recording_of_rows(
        names, lambda: _blocks(path, len(names)), frame if frame in AXES else ""
    )


def _head(path: Path) -> dict[str, Any]:
    try:
        with path.open(encoding="utf-8") as file:
            text = file.readline(MAX_LINE).rstrip().removesuffix(",") + "}"
        head = parsed_json(text)
        known = head["format"] == FORMAT and head["columns"] == list(COLUMNS)
        if known and isinstance(head["drones"], list) and head["drones"]:
            return dict(head)
    except BROKEN as error:
        raise FileError(f"{path}: is no document that hitchopt wrote: {error}") from error
    raise FileError(f"{path}: its format is not {FORMAT} with the columns that hitchopt writes")


def _blocks(path: Path, drones: int) -> Iterator[Block]:
    size = max(1, 20 * ROWS // drones)
    try:
        with path.open(encoding="utf-8") as file:
            file.readline(MAX_LINE)
            if file.readline(MAX_LINE).strip() != START:
                raise FileError(f"{path}: its second line is not {START}")
            t: list[float] = []
            rows: list[Any] = []
            while (line := file.readline(MAX_LINE).strip()) != END:
                sample = parsed_json(line.removesuffix(","))
                t.append(float(sample["t"]))
                rows.append(np.array(sample["rows"], dtype=np.float64))
                if rows[-1].shape != (drones, len(COLUMNS)):
                    raise FileError(f"{path}: at t = {t[-1]:g} s its rows are not one per drone")
                if len(t) == size:
                    yield Block(np.array(t), np.stack(rows))
                    t, rows = [], []
            if t:
                yield Block(np.array(t), np.stack(rows))
    except FileError:
        raise
    except BROKEN as error:
        raise FileError(f"{path}: is damaged or truncated: {error}") from error
