"""Formats csv, parquet, npz and json: one table for scripts, one row per sample and drone.

Its columns are those of ``setpoints.csv``, and ``ff_*``, the acceleration to feed forward to a
controller that adds gravity itself, ``a_ff = a - F / m`` with the cable's force F on the drone: the
thrust is ``m (a_ff + g ẑ)``; ``q*``, the attitude that points the thrust so, from the body's axes
to the file's; ``rate_*``, its angular velocity about the body's axes.

csv: ``setpoints_FRAME.csv``, twelve significant digits. parquet: its metadata say the frame, a row
group holds whole samples. npz: ``t`` (S,), ``drones`` (D,), ``frame``, and an array (S, D, …) for
every group of columns. json: ``{"format", "frame", "drones", "columns", "samples": [{"t", "rows":
[[…] per drone]}, …]}``, one sample a line. Of what is read, places, velocities and accelerations
are held.
"""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError
from hitchopt.exports.directory import ROWS, SAVED, write_rows
from hitchopt.exports.format import Format, Task, Written
from hitchopt.exports.placing import AXES
from hitchopt.exports.recording import Recording, check_times, needed, present_columns
from hitchopt.storage.archive import read_arrays, reading, refuse_expansion
from hitchopt.storage.files import parsed_json
from hitchopt.storage.tables import labelled_table, text_lines
from hitchopt.values import Array

GROUPS = SAVED | {
    "feed_forward": ("ff_x", "ff_y", "ff_z"),
    "quaternions": ("qw", "qx", "qy", "qz"),
    "body_rates": ("rate_x", "rate_y", "rate_z"),
}
"""Quantities of ``Task.samples`` and their columns."""

COLUMNS = tuple(name for group in GROUPS.values() for name in group)  # After t and drone
HEADER = ",".join(("t", "drone", *COLUMNS))
FLOWN = COLUMNS[:3], COLUMNS[3:6], COLUMNS[6:9]  # All that readers need; places alone will do
SMOOTH = 2  # Positions, velocities and accelerations are in the table: quintics run through them
GROUP = 100_000  # Rows of a parquet row group, 23 MB of numbers
MAX_TEXT = 2_000_000_000  # Size limit of a JSON document that is read [B]
FRAME_KEY = b"hitchopt.frame"  # Key in a parquet schema's metadata
JSON_FORMAT = "hitchopt-setpoints/1"


def rows_of(task: Task, rows: int) -> Iterator[tuple[Array, Array]]:
    """Yield times (S,) [s] and the numbers of COLUMNS (S, D, 26), so many rows at once."""
    for t, samples in task.blocks(rows):
        yield t, np.concatenate([samples[name] for name in GROUPS], axis=-1) + 0.0  # no -0


class Table(Format):
    """A format that samples a plan for scripts."""

    frames = tuple(AXES)
    rate = 100.0
    accuracy = 1e-3
    feed_forward = (
        "ff_* or feed_forward = a - G F/m, the cable's force F, the drone's mass m and G, the pull "
        "gain of a named controller, else 1: for controllers that add gravity; cable_* = F for "
        "those that take forces; a for others"
    )
    flown_by = "stream"
    dotted = True

    @abstractmethod
    def _write(self, path: Path, task: Task) -> None:
        """Write the file."""

    @abstractmethod
    def _read(self, path: Path) -> Recording:
        """Read the file; raise FileError or others of BROKEN if it is damaged."""

    def write(self, folder: Path, task: Task) -> Written:
        """Write the one file there is."""
        (name,) = self.files(task)
        self._write(folder / name, task)
        return Written((name,))

    def load(self, files: Sequence[Path]) -> Recording:
        """Read the file."""
        with reading(files[0], f"{self.name} table of hitchopt's columns"):
            return self._read(files[0])


def _recording_of_rows(who: NDArray[np.str_], table: Array, frame: str) -> Recording:
    """Return the recording of rows by time, then drone: t, then whole vectors."""
    if not len(who):
        raise FileError("holds no rows; it is truncated")
    t = table[:, 0]
    check_times(t[:1])
    names = tuple(who[: int(np.argmax(t != t[0])) or len(t)].tolist())
    if len(t) % len(names):
        raise FileError(f"ends within the sample at t = {t[-1]:g} s; it is truncated")
    times = t.reshape(-1, len(names))
    wrong = np.any((times != times[:, :1]) | (who.reshape(times.shape) != names), axis=1)
    if len(set(names)) != len(names) or np.any(wrong):
        words = (
            f"its rows at t = {times[np.argmax(wrong), 0]:g} s are not one per drone, in one order"
        )
        raise FileError(f"{words}; sort them by time, then drone")
    values = table[:, 1:].reshape(*times.shape, -1)
    return Recording.of_samples(names, times[:, 0], values, frame, SMOOTH)


class CsvTable(Table):
    """A table as text that everything reads."""

    name = "csv"
    endings = (".csv",)
    file = "setpoints_{frame}.csv"
    header = "t,drone"

    def _write(self, path: Path, task: Task) -> None:
        write_rows(path, HEADER, (task.names, rows_of(task, ROWS)))

    def _read(self, path: Path) -> Recording:
        table = labelled_table(lambda: text_lines(path), ("t", "drone"), str(path))
        numbers = table.numbers(["t", *present_columns(table, FLOWN)])
        who = np.array(table.words("drone"), np.str_)
        return _recording_of_rows(who, numbers, path.stem.rpartition("_")[2])


class ParquetTable(Table):
    """A table in columns, for data frames."""

    name = "parquet"
    endings = (".parquet",)
    file = "setpoints.parquet"

    def _write(self, path: Path, task: Task) -> None:
        arrow, parquet = needed("pyarrow"), needed("pyarrow.parquet")
        names, number = arrow.array(task.names), arrow.float64()
        fields = [("t", number), ("drone", arrow.dictionary(arrow.int32(), arrow.string()))]
        fields += [(column, number) for column in COLUMNS]
        metadata = {FRAME_KEY: task.frame.name.encode()}
        with parquet.ParquetWriter(path, arrow.schema(fields, metadata=metadata)) as writer:
            for t, values in rows_of(task, GROUP):
                who = np.tile(np.arange(len(names), dtype=np.int32), len(t))
                drones = arrow.DictionaryArray.from_arrays(who, names)
                columns = [np.repeat(t, len(names)), drones, *values.reshape(-1, len(COLUMNS)).T]
                writer.write_table(arrow.table(columns, schema=writer.schema), len(who))

    def _read(self, path: Path) -> Recording:
        arrow, parquet = needed("pyarrow"), needed("pyarrow.parquet")
        with reading(path, "parquet file", arrow.ArrowException), parquet.ParquetFile(path) as file:
            refuse_expansion(72 * file.metadata.num_rows, path.stat().st_size)
            schema = file.schema_arrow
            frame = (schema.metadata or {}).get(FRAME_KEY, b"").decode("ascii", "replace")
            who, *rows = file.read(["drone", "t", *present_columns(schema.names, FLOWN)]).columns
            numbers = np.column_stack([row.to_numpy() for row in rows]).astype(np.float64)
            return _recording_of_rows(np.array(who.to_pylist(), np.str_), numbers, frame)


class NpzTable(Table):
    """Arrays for numpy."""

    name = "npz"
    endings = (".npz",)
    file = "setpoints.npz"

    def _write(self, path: Path, task: Task) -> None:
        times, blocks = zip(*task.blocks(GROUP), strict=True)
        arrays: dict[str, Any] = {"frame": task.frame.name, "drones": task.names}
        arrays |= {name: np.concatenate([block[name] for block in blocks]) for name in GROUPS}
        np.savez(path, **arrays | {"t": np.concatenate(times)})

    def _read(self, path: Path) -> Recording:
        flown = tuple(GROUPS)[:3]
        arrays = read_arrays(path, ("frame", "drones", "t", *flown))
        names, t = tuple(map(str, arrays["drones"].ravel())), np.atleast_1d(arrays["t"])
        for name in flown:
            array, whole = arrays[name], (*t.shape, len(names), 3)
            if {array.dtype.kind, t.dtype.kind} - set("iuf") or array.shape != whole:
                raise FileError(f"array {name!r} is {array.shape}, not {whole} of numbers")
        values = np.concatenate([arrays[name] for name in flown], axis=-1).astype(float)
        return Recording.of_samples(names, t.astype(float), values, str(arrays["frame"]), SMOOTH)


class JsonTable(Table):
    """Text for whatever knows no table, to be read line by line too."""

    name = "json"
    endings = (".json",)
    file = "setpoints.json"

    def _write(self, path: Path, task: Task) -> None:
        head = {"format": JSON_FORMAT, **task.frame.to_dict()}
        head |= {"drones": list(task.names), "columns": list(COLUMNS)}
        with path.open("w", encoding="utf-8", newline="\n") as file:
            file.write(json.dumps(head, ensure_ascii=False)[:-1] + ',\n"samples": [')
            joint = "\n"
            for t, values in rows_of(task, ROWS):
                for time, rows in zip(t.tolist(), values.tolist(), strict=True):
                    file.write(joint + json.dumps({"t": time, "rows": rows}))
                    joint = ",\n"
            file.write("\n]}\n")

    def _read(self, path: Path) -> Recording:
        if path.stat().st_size > MAX_TEXT:
            raise FileError(f"is larger than {MAX_TEXT} bytes")
        content = parsed_json(path.read_bytes())
        known = content["columns"][:9] == list(COLUMNS[:9])
        if not (known and content["format"] == JSON_FORMAT and content["drones"]):
            raise FileError(f"its format is not {JSON_FORMAT} with hitchopt's columns")
        names, samples = tuple(map(str, content["drones"])), content["samples"]
        values = np.array([sample["rows"] for sample in samples], dtype=np.float64)
        if values.shape != (len(samples), len(names), len(content["columns"])):
            raise FileError("a sample's rows are not one per drone")
        t = np.array([sample["t"] for sample in samples], dtype=np.float64)
        frame = str(content.get("frame"))
        return Recording.of_samples(names, t, values[..., :9], frame, SMOOTH)
