"""Format json: ``setpoints.json``, one sample a line, so that it can be read line by line too.

``{"format", "frame", "drones": [names], "columns": [names], "samples": [{"t": s, "rows": [[…] per
drone]}, …]}``; numbers have twelve significant digits.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import IO, Any

import numpy as np

from hitchopt.errors import FileError
from hitchopt.exports.formats.file_reading import reading
from hitchopt.exports.formats.format import Task
from hitchopt.exports.formats.long_table import COLUMNS, FLOWN, SMOOTH, Table, blocks_of
from hitchopt.exports.recording import Recording, Samples, recording_of_samples
from hitchopt.storage.strict_json import parsed_json

FORMAT = "hitchopt-setpoints/1"
WHAT = "document that hitchopt wrote"

START, END = '"samples": [', "]}"
"""Lines around the samples."""

ROWS = 2000
"""Rows that are formatted at once."""

MAX_LINE = 50_000_000
"""Longest line that is read [characters]: a sample of 20,000 drones takes 6 million."""


def write_json(path: Path, task: Task) -> None:
    """Write the document block by block.

    Raises
    ------
    OSError: the file cannot be written.
    """
    head = {
        "format": FORMAT,
        **task.frame.to_dict(),
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
    with reading(path, WHAT), path.open(encoding="utf-8") as file:
        head = _head(file)
    names = tuple(str(name) for name in head["drones"])
    frame = str(head.get("frame"))
    shape = (len(names), len(head["columns"]))
    return recording_of_samples(names, lambda: _samples(path, shape), frame, SMOOTH)


def _head(file: IO[str]) -> dict[str, Any]:
    head = parsed_json(file.readline(MAX_LINE).rstrip().removesuffix(",") + "}")
    known = head["format"] == FORMAT and head["columns"][: len(FLOWN)] == list(FLOWN)
    if not (known and isinstance(head["drones"], list) and head["drones"]):
        raise FileError(f"its format is not {FORMAT} with the columns that hitchopt writes")
    return dict(head)


def _samples(path: Path, row: tuple[int, int]) -> Iterator[Samples]:
    """Yield the samples, each of ``row`` (drones, columns) numbers."""
    with reading(path, WHAT), path.open(encoding="utf-8") as file:
        _head(file)
        if file.readline(MAX_LINE).strip() != START:
            raise FileError(f"its second line is not {START}")
        lines = iter(lambda: file.readline(MAX_LINE).strip(), END)
        while some := list(islice(lines, max(1, 20 * ROWS // row[0]))):
            samples = [parsed_json(line.removesuffix(",")) for line in some]
            t = np.array([float(sample["t"]) for sample in samples])
            rows = np.array([sample["rows"] for sample in samples], dtype=np.float64)
            if rows.shape[1:] != row:
                raise FileError(f"from t = {t[0]:g} s on its rows are not one per drone")
            yield Samples.of_rows(t, rows[..., : len(FLOWN)])


class JsonTable(Table):
    """Text for whatever knows no table."""

    name = "json"
    file = "setpoints.json"
    write_file = staticmethod(write_json)
    read_file = staticmethod(read_json)
