"""Formats csv and parquet: one table for scripts, one row per sample and drone.

Its columns are those of ``setpoints.csv``, and ``ff_*``, the feed-forward acceleration for
controllers that add gravity, ``a_ff = a - F / m`` with the cable force F on the drone: the thrust
is ``m (a_ff + g ẑ)``; ``q*``, the corresponding attitude, from the body frame to the file's frame;
``rate_*``, the angular velocity in the body frame.

csv: ``setpoints_FRAME.csv``, twelve significant digits: quintics through positions of nine would
have other accelerations far from the origin. parquet: the frame is in the metadata, a
row group has complete samples. Readers use positions, velocities and accelerations.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.directory import QUANTITIES, ROWS, write_rows
from hitchopt.errors import FileError
from hitchopt.exports.contents import FileContents, check_times, present_columns, required_module
from hitchopt.exports.format import ExportTask, Format, FormatOutput
from hitchopt.exports.placing import AXES
from hitchopt.storage.archive import check_expansion, reading
from hitchopt.storage.tables import labelled_table, text_lines
from hitchopt.values import Array

GROUPS = QUANTITIES | {
    "feed_forward": ("ff_x", "ff_y", "ff_z"),
    "quaternions": ("qw", "qx", "qy", "qz"),
    "body_rates": ("rate_x", "rate_y", "rate_z"),
}
"""Quantities of ``ExportTask.samples`` and their columns."""

COLUMNS = tuple(name for group in GROUPS.values() for name in group)  # After t and drone
HEADER = ",".join(("t", "drone", *COLUMNS))
STATE_COLUMNS = COLUMNS[:3], COLUMNS[3:6], COLUMNS[6:9]
"""Columns of position, velocity and acceleration; the latter two are optional."""
SENT_COLUMNS = *STATE_COLUMNS[:2], GROUPS["feed_forward"]
"""Columns of position, velocity and feed-forward acceleration."""
SMOOTH = 2  # The curves are quintics with continuous accelerations
DIGITS = 12  # Significant digits of numbers in csv
GROUP = 100_000  # Rows of a parquet row group, 23 MB of numbers
FRAME_KEY = b"hitchopt.frame"  # Key in a parquet schema's metadata


def rows_of(task: ExportTask, rows: int) -> Iterator[tuple[Array, Array]]:
    """Yield times (S,) [s] and values of COLUMNS (S, D, 26), in blocks of rows."""
    for t, samples in task.blocks(rows):
        yield t, np.concatenate([samples[name] for name in GROUPS], axis=-1) + 0.0  # no -0


class TableFormat(Format):
    """A format that samples a plan for scripts."""

    frames = tuple(AXES)
    rate = 100.0
    accuracy = 1e-3
    feed_forward = (
        "ff_* = a - G F/m with the cable's force F, the mass m and the pull gain G (1 without a "
        "named controller), for controllers that add gravity; cable_* = F"
    )
    flown_by = "stream"
    needs_stiffness = False
    dotted = True

    @abstractmethod
    def table(
        self, path: Path, columns: Sequence[Sequence[str]]
    ) -> tuple[NDArray[np.str_], Array, str]:
        """Read names of drones (rows,), times and vectors (rows, 4, 7 or 10), and the frame.

        ``columns`` are those of positions, velocities and accelerations.
        """

    def load(self, files: Sequence[Path]) -> FileContents:
        """Return the contents of rows sorted by time, then drone."""
        return self._contents(files[0], STATE_COLUMNS)

    def sent(self, files: Sequence[Path], manifest: Mapping[str, Any]) -> FileContents:  # noqa: ARG002
        """Return the contents with feed-forward accelerations, for controllers that take them."""
        return self._contents(files[0], SENT_COLUMNS)

    def _contents(self, path: Path, columns: Sequence[Sequence[str]]) -> FileContents:
        with reading(path, f"{self.name} table with hitchopt's columns"):
            return _contents_of_rows(*self.table(path, columns))


def _contents_of_rows(drones: NDArray[np.str_], table: Array, frame: str) -> FileContents:
    """Return the contents of rows sorted by time, then drone: t, then vectors."""
    if not len(drones):
        raise FileError("has no rows; it is truncated")
    t = table[:, 0]
    check_times(t[:1])
    names = tuple(drones[: int(np.argmax(t != t[0])) or len(t)].tolist())
    if len(t) % len(names):
        raise FileError(f"ends within the sample at t = {t[-1]:g} s; it is truncated")
    times = t.reshape(-1, len(names))
    invalid = np.any((times != times[:, :1]) | (drones.reshape(times.shape) != names), axis=1)
    if len(set(names)) != len(names) or np.any(invalid):
        where = f"its rows at t = {times[np.argmax(invalid), 0]:g} s"
        reason = "are not one per drone, in one order; sort them by time, then drone"
        raise FileError(f"{where} {reason}")
    values = table[:, 1:].reshape(*times.shape, -1)
    return FileContents.of_samples(names, times[:, 0], values, frame, SMOOTH)


class CsvTable(TableFormat):
    """A table as text, for all programs."""

    name = "csv"
    endings = (".csv",)
    file = "setpoints_{frame}.csv"
    header = "t,drone"

    def write(self, folder: Path, task: ExportTask) -> FormatOutput:
        """Write the only file."""
        rows = task.names, rows_of(task, ROWS)
        write_rows(folder / self.files(task)[0], HEADER, rows, digits=DIGITS)
        return FormatOutput(self.files(task))

    def table(
        self, path: Path, columns: Sequence[Sequence[str]]
    ) -> tuple[NDArray[np.str_], Array, str]:
        """Read the columns that are there; the file's name has the frame."""
        table = labelled_table(lambda: text_lines(path), ("t", "drone"), str(path))
        labels = ["t", *present_columns(table, columns)]
        numbers = table.numbers(labels)
        table.check_finite(numbers, labels)
        drones = np.array(table.words("drone"), np.str_)
        return drones, numbers, path.stem.rpartition("_")[2]


class ParquetTable(TableFormat):
    """A table in columns, for data frames."""

    name = "parquet"
    endings = (".parquet",)
    file = "setpoints.parquet"

    def write(self, folder: Path, task: ExportTask) -> FormatOutput:
        """Write the only file."""
        arrow, parquet = required_module("pyarrow"), required_module("pyarrow.parquet")
        names = arrow.array(task.names)
        number = arrow.float64()
        fields = [("t", number), ("drone", arrow.dictionary(arrow.int32(), arrow.string()))]
        fields += [(column, number) for column in COLUMNS]
        metadata = {FRAME_KEY: task.frame.name.encode()}
        schema = arrow.schema(fields, metadata=metadata)
        with parquet.ParquetWriter(folder / self.file, schema) as writer:
            for t, values in rows_of(task, GROUP):
                indices = np.tile(np.arange(len(names), dtype=np.int32), len(t))
                drones = arrow.DictionaryArray.from_arrays(indices, names)
                columns = [np.repeat(t, len(names)), drones, *values.reshape(-1, len(COLUMNS)).T]
                writer.write_table(arrow.table(columns, schema=writer.schema), len(indices))
        return FormatOutput((self.file,))

    def table(
        self, path: Path, columns: Sequence[Sequence[str]]
    ) -> tuple[NDArray[np.str_], Array, str]:
        """Read the columns that are there; the metadata has the frame."""
        arrow, parquet = required_module("pyarrow"), required_module("pyarrow.parquet")
        with reading(path, "parquet file", arrow.ArrowException), parquet.ParquetFile(path) as file:
            check_expansion(72 * file.metadata.num_rows, path.stat().st_size)
            schema = file.schema_arrow
            frame = (schema.metadata or {}).get(FRAME_KEY, b"").decode("ascii", "replace")
            present = ["drone", "t", *present_columns(schema.names, columns)]
            drones, *rows = file.read(present).columns
            numbers = np.column_stack([row.to_numpy() for row in rows]).astype(np.float64)
            return np.array(drones.to_pylist(), np.str_), numbers, frame
