"""Format parquet: ``setpoints.parquet``, a row per sample and drone; its metadata say the frame."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError
from hitchopt.exports.formats.file_reading import needed, reading
from hitchopt.exports.formats.format import Task
from hitchopt.exports.formats.long_table import (
    COLUMNS,
    FLOWN,
    PLACED,
    Rows,
    Table,
    blocks_of,
    read_rows,
    told_in,
)
from hitchopt.exports.recording import Recording
from hitchopt.storage.archive import refuse_expansion

WHAT = "parquet file"
FRAME, PLACE = b"hitchopt.frame", b"hitchopt.room"
"""Keys of the schema's metadata: the frame's name, and where the plan lies in it, as JSON."""

GROUP = 200_000
"""Rows of a row group at most, or one sample: readers skip and share work by groups. 35 MB of
numbers wait until one is full."""


def write_parquet(path: Path, task: Task) -> None:
    """Write the table, block by block, in double precision.

    Raises
    ------
    UnsupportedError: pyarrow is not installed.
    OSError: the file cannot be written.
    """
    arrow, parquet = needed("pyarrow"), needed("pyarrow.parquet")
    names = arrow.array(task.names)
    number = arrow.float64()
    fields = [("t", number), ("drone", arrow.dictionary(arrow.int32(), arrow.string()))]
    fields += [(column, number) for column in COLUMNS]
    place = json.dumps(task.frame.to_dict(), allow_nan=False).encode()
    schema = arrow.schema(fields, metadata={FRAME: task.frame.name.encode(), PLACE: place})
    with parquet.ParquetWriter(path, schema) as writer:
        waiting: list[Any] = []
        for block in blocks_of(task):
            samples, drones = block.values.shape[:2]
            who = np.tile(np.arange(drones, dtype=np.int32), samples)
            columns = [
                arrow.array(np.repeat(block.t, drones)),
                arrow.DictionaryArray.from_arrays(who, names),
                *(arrow.array(block.values[..., i].ravel()) for i in range(len(COLUMNS))),
            ]
            if sum(map(len, waiting)) + samples * drones > GROUP:
                _write_group(writer, waiting)
            waiting.append(arrow.Table.from_arrays(columns, schema=schema))
        _write_group(writer, waiting)


def _write_group(writer: Any, tables: list[Any]) -> None:
    """Write the tables, if there are any, as one row group, and forget them."""
    if tables:
        whole = needed("pyarrow").concat_tables(tables)
        writer.write_table(whole, row_group_size=len(whole))
        tables.clear()


def read_parquet(path: Path) -> Recording:
    """Return what a table of these columns says; other columns are not looked at.

    Raises
    ------
    UnsupportedError: pyarrow is not installed.
    FileError: it is not such a table, or a damaged one; from the windows too.
    """
    with _opened(path) as file:
        frame = (file.schema_arrow.metadata or {}).get(FRAME, b"").decode("ascii", "replace")
    return read_rows(path, _rows, frame)


def _opened(path: Path) -> Any:
    arrow, parquet = needed("pyarrow"), needed("pyarrow.parquet")
    with reading(path, WHAT, arrow.ArrowException):
        file = parquet.ParquetFile(path)
        refuse_expansion(8 * file.metadata.num_rows * len(FLOWN), path.stat().st_size)
        for name in PLACED:
            if name not in file.schema_arrow.names:
                raise FileError(f"has no column {name!r}; hitchopt writes t, drone and others")
        return file


def _rows(path: Path) -> Iterator[Rows]:
    with reading(path, WHAT, needed("pyarrow").ArrowException), _opened(path) as file:
        told = told_in(file.schema_arrow.names)
        wanted = ["t", "drone", *told]
        for batch in file.iter_batches(columns=wanted):
            values = np.column_stack([batch[name].to_numpy(False) for name in wanted[2:]])
            t = batch["t"].to_numpy(False).astype(np.float64)
            if len(t):
                names = [str(name) for name in batch["drone"].to_pylist()]
                yield Rows.telling(t, names, values, told)


class ParquetTable(Table):
    """Columns for data frames; a row group holds whole samples."""

    name = "parquet"
    file = "setpoints.parquet"
    write_file = staticmethod(write_parquet)
    read_file = staticmethod(read_parquet)
