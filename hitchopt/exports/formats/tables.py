"""Formats csv, parquet, npz and json: one table for scripts, one row per sample and drone.

``ff_*`` is the acceleration to feed forward to a controller that adds gravity itself:
``a_ff = a - F / m`` with the cable's force F on the drone, so that the thrust is
``m (a_ff + g ẑ)``. ``q*`` is the attitude that points the thrust so, from the body's axes to the
file's, and ``rate_*`` its angular velocity about the body's axes.

csv: ``setpoints_FRAME.csv``, twelve significant digits. parquet: its metadata say the frame, a row
group holds whole samples. npz: ``t`` (S,), ``drones`` (D,), ``frame``, and an array (S, D, …) for
every group of columns. json: ``{"format", "frame", "drones", "columns", "samples": [{"t", "rows":
[[…] per drone]}, …]}``, one sample a line. Tables are written in blocks; of what is read, places,
velocities and accelerations are held.
"""

from __future__ import annotations

import json
import zipfile
from abc import abstractmethod
from collections.abc import Collection, Iterator, Sequence
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from hitchopt.errors import FileError
from hitchopt.exports.formats.file_reading import needed, read_columns, reading
from hitchopt.exports.formats.format import Candidate, DroneFacts, Format, Loaded, Task
from hitchopt.exports.recording import Recording, check_times, recording_of_samples
from hitchopt.exports.reference_frame import AXES
from hitchopt.exports.setpoints import GROUPS as SAVED
from hitchopt.exports.setpoints import lines_of
from hitchopt.motion.states import iterate_states, sample_times
from hitchopt.storage.archive import read_arrays, refuse_expansion
from hitchopt.storage.files import parsed_json
from hitchopt.values import Array

GROUPS = SAVED | {
    "feed_forward": ("ff_x", "ff_y", "ff_z"),
    "quaternions": ("qw", "qx", "qy", "qz"),
    "body_rates": ("rate_x", "rate_y", "rate_z"),
}
"""Quantities of a row and their columns: those of setpoints.csv, [m/s²], 1, [rad/s]."""

COLUMNS = tuple(name for group in GROUPS.values() for name in group)
"""Names of the numbers of a row, after ``t`` and ``drone``."""

HEADER = ",".join(("t", "drone", *COLUMNS))

FLOWN = COLUMNS[:9]
"""Columns that say where the drones go; readers need no others, and positions alone will do."""

SMOOTH = 2  # Positions, velocities and accelerations are in the table: quintics run through them

LINES = 2000
"""Rows that are formatted as text at once: more are slower, since they leave the processor's
cache."""

READ = 20_000  # Rows of text that are parsed at once

ROWS = 100_000
"""Rows that are held at a time, 23 MB of numbers, and of a parquet row group: readers skip and
share work by groups."""

MAX_LINE = 50_000_000
"""Longest line of JSON that is read [characters]: a sample of 20,000 drones takes 6 million."""


class Table(Format):
    """A format that samples a plan for scripts."""

    frames = tuple(AXES)
    rate = 100.0
    accuracy = 1e-3
    feed_forward = (
        "ff_* = a - F/m, the cable's force F and the drone's mass m: for controllers that add "
        "gravity themselves; cable_* = F for those that take forces; a alone for those that know "
        "the cable"
    )
    carries_pull = True

    @staticmethod
    @abstractmethod
    def write_file(path: Path, task: Task) -> None:
        """Write the file block by block; raise OSError if it cannot be written."""

    @staticmethod
    @abstractmethod
    def read_file(path: Path) -> Recording:
        """Return what the file says; raise FileError if it is damaged."""

    def candidates(self, task: Task) -> Iterator[Candidate]:
        """Give the one file there is."""
        yield Candidate({name: partial(self.write_file, task=task) for name in self.files(task)})

    def load(self, files: Sequence[Path]) -> Loaded:
        """Return what the file says."""
        recording = self.read_file(files[0])
        return Loaded(self.name, recording, tuple(map(DroneFacts, recording.names)))


def blocks_of(task: Task, rows: int = ROWS) -> Iterator[tuple[Array, Array]]:
    """Yield times (S,) [s] and numbers (S, D, C) in blocks of ``rows`` rows, or one sample.

    Raises
    ------
    InputError: a rate that is not positive, or more samples than anyone can use.
    """
    times, frame, drones = sample_times(task.motion.duration, task.rate), task.frame, task.names
    for states in iterate_states(task.motion, times, max(1, rows // len(drones))):
        positions, velocities, forward = task.setpoints(states)
        attitudes = task.attitudes(states)
        parts = (
            positions,
            velocities,
            frame.vectors(states.accelerations),
            frame.vectors(states.jerks),
            np.full((len(states.t), len(drones), 1), frame.heading),
            task.cable_forces(states),
            forward,
            attitudes.quaternions,
            attitudes.body_rates,
        )
        yield states.t, np.concatenate(parts, axis=-1) + 0.0  # no negative zeros


def _told_in(header: Collection[str]) -> list[str]:
    """Return which of FLOWN a table with these columns tells: velocities where they are whole."""
    vectors = [FLOWN[:3], *(v for v in (FLOWN[3:6], FLOWN[6:]) if set(v) <= set(header))]
    return [name for vector in vectors for name in vector]


def _recording_of_rows(
    path: Path, drones: Sequence[str], rows: Sequence[Array], told: Sequence[str], frame: str
) -> Recording:
    """Return the recording of rows (rows, 1 + told) by time, then drone: t and the told columns."""
    if not drones:
        raise FileError(f"{path}: holds no rows; it is truncated")
    table, who = np.concatenate(rows), np.array(drones)
    t = table[:, 0]
    check_times(t[:1], str(path))
    names = tuple(who[: int(np.argmax(t != t[0])) or len(t)].tolist())
    if len(set(names)) != len(names):
        raise FileError(f"{path}: drone {names[-1]!r} comes twice at t = {t[0]:g} s")
    if len(t) % len(names):
        raise FileError(f"{path}: ends within the sample at t = {t[-1]:g} s; it is truncated")
    times = t.reshape(-1, len(names))
    wrong = np.any((times != times[:, :1]) | (who.reshape(times.shape) != names), axis=1)
    if np.any(wrong):
        raise FileError(
            f"{path}: its rows at t = {times[np.argmax(wrong), 0]:g} s are not one per drone, in "
            "one order; sort them by time, then drone"
        )
    whole = np.zeros((len(t), len(FLOWN)))
    whole[:, [FLOWN.index(name) for name in told]] = table[:, 1:]
    values = whole.reshape(*times.shape, len(FLOWN))
    return recording_of_samples(names, times[:, 0], values, frame, SMOOTH)


class CsvTable(Table):
    """Text that everything reads."""

    name = "csv"
    endings = (".csv",)
    file = "setpoints_{frame}.csv"

    @staticmethod
    def write_file(path: Path, task: Task) -> None:
        """Write one row per sample and drone."""
        with path.open("w", encoding="utf-8", newline="") as file:
            file.write(HEADER + "\n")
            for t, values in blocks_of(task, LINES):
                file.write(lines_of(task.names, t, values))

    @staticmethod
    def read_file(path: Path) -> Recording:
        """Return what columns of these names say; the last word of the name is the frame."""
        with reading(path, "readable text in UTF-8"), path.open(encoding="utf-8") as file:
            header = file.readline().rstrip("\r\n")
            told = _told_in(header.split(","))
            drones: list[str] = []
            read_columns((), header, ("t", "drone", *told), HEADER, str(path))
            rows = []
            drone = header.split(",").index("drone")
            while lines := list(islice(file, READ)):
                start = 2 + len(drones)
                place = f"{path}: lines {start} to {start + len(lines) - 1}"
                if not all(map(str.strip, lines)):
                    raise FileError(f"{place}: a line is empty; it is truncated or damaged")
                if any(line.count(",") != header.count(",") for line in lines):
                    raise FileError(f"{place}: a line is not whole; it is truncated or damaged")
                rows.append(read_columns(lines, header, ("t", *told), HEADER, place))
                drones += [line.rstrip("\r\n").split(",")[drone] for line in lines]
            return _recording_of_rows(path, drones, rows, told, path.stem.rpartition("_")[2])

    def recognises(self, labels: Sequence[str]) -> bool:
        """Return whether the first columns are t and drone."""
        return labels[:2] == ["t", "drone"]


class ParquetTable(Table):
    """Columns for data frames."""

    name = "parquet"
    endings = (".parquet",)
    file = "setpoints.parquet"
    frame_key, place_key = b"hitchopt.frame", b"hitchopt.room"  # of the schema's metadata

    @staticmethod
    def write_file(path: Path, task: Task) -> None:
        """Write the table in double precision; raise UnsupportedError without pyarrow."""
        arrow, parquet = needed("pyarrow"), needed("pyarrow.parquet")
        names, number = arrow.array(task.names), arrow.float64()
        fields = [("t", number), ("drone", arrow.dictionary(arrow.int32(), arrow.string()))]
        fields += [(column, number) for column in COLUMNS]
        place = json.dumps(task.frame.to_dict(), allow_nan=False).encode()
        frame = {ParquetTable.frame_key: task.frame.name.encode(), ParquetTable.place_key: place}
        schema = arrow.schema(fields, metadata=frame)
        with parquet.ParquetWriter(path, schema) as writer:
            for t, values in blocks_of(task):
                samples, drones = values.shape[:2]
                who = np.tile(np.arange(drones, dtype=np.int32), samples)
                columns = [
                    arrow.array(np.repeat(t, drones)),
                    arrow.DictionaryArray.from_arrays(who, names),
                    *(arrow.array(values[..., i].ravel()) for i in range(len(COLUMNS))),
                ]
                table = arrow.Table.from_arrays(columns, schema=schema)
                writer.write_table(table, row_group_size=len(table))

    @staticmethod
    def read_file(path: Path) -> Recording:
        """Return what columns of these names say; raise UnsupportedError without pyarrow."""
        arrow, parquet = needed("pyarrow"), needed("pyarrow.parquet")
        with reading(path, "parquet file", arrow.ArrowException), parquet.ParquetFile(path) as file:
            refuse_expansion(8 * file.metadata.num_rows * len(FLOWN), path.stat().st_size)
            held = file.schema_arrow.names
            for name in ("t", "drone", *FLOWN[:3]):
                if name not in held:
                    raise FileError(f"has no column {name!r}; hitchopt writes t, drone and others")
            frame = (file.schema_arrow.metadata or {}).get(ParquetTable.frame_key, b"")
            told = _told_in(held)
            drones: list[str] = []
            rows = []
            for batch in file.iter_batches(columns=["t", "drone", *told]):
                columns = [batch[name].to_numpy(False) for name in ("t", *told)]
                rows.append(np.column_stack(columns).astype(np.float64))
                drones += map(str, batch["drone"].to_pylist())
            return _recording_of_rows(path, drones, rows, told, frame.decode("ascii", "replace"))


class NpzTable(Table):
    """Arrays for numpy, one after the other: none of them is held as a whole."""

    name = "npz"
    endings = (".npz",)
    file = "setpoints.npz"
    feed_forward = Table.feed_forward.replace("ff_*", "feed_forward").replace(
        "cable_*", "cable_forces"
    )

    @staticmethod
    def write_file(path: Path, task: Task) -> None:
        """Write array after array; samples are computed anew for each."""
        times = sample_times(task.motion.duration, task.rate)
        whole = {"frame": np.array(task.frame.name), "drones": np.array(task.names), "t": times}
        with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
            for name in (*whole, *GROUPS):
                array: NDArray[np.generic] = whole.get(name, np.zeros(()))
                shape, parts = array.shape, iter([array])
                if name in GROUPS:
                    first, columns = COLUMNS.index(GROUPS[name][0]), len(GROUPS[name])
                    shape, here = (
                        (len(times), len(task.names), columns),
                        slice(first, first + columns),
                    )
                    parts = (values[..., here] for _, values in blocks_of(task))
                descr = npy.dtype_to_descr(array.dtype)
                head = {"descr": descr, "fortran_order": False, "shape": shape}
                with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                    npy.write_array_header_1_0(file, head)
                    for part in parts:
                        file.write(part.tobytes())

    @staticmethod
    def read_file(path: Path) -> Recording:
        """Return what such an archive says."""
        flown = tuple(GROUPS)[:3]
        with reading(path, "archive that hitchopt wrote"):
            arrays = read_arrays(path, ("frame", "drones", "t", *flown))
            names = tuple(map(str, np.atleast_1d(arrays["drones"])))
            t = np.atleast_1d(arrays["t"])
            for name in ("t", *flown):
                array, whole = arrays[name], (len(t),) if name == "t" else (len(t), len(names), 3)
                if array.dtype.kind not in "iuf" or array.shape != whole:
                    raise FileError(
                        f"array {name!r} is {array.shape} of {array.dtype}, not {whole} of numbers"
                    )
            values = np.concatenate([arrays[name] for name in flown], axis=-1)
            frame = str(arrays["frame"])
            return recording_of_samples(names, t.astype(float), values.astype(float), frame, SMOOTH)


class JsonTable(Table):
    """Text for whatever knows no table, to be read line by line too."""

    name = "json"
    endings = (".json",)
    file = "setpoints.json"
    format = "hitchopt-setpoints/1"
    start, end = '"samples": [', "]}"  # lines around the samples

    @staticmethod
    def write_file(path: Path, task: Task) -> None:
        """Write the document, twelve significant digits each."""
        head = {"format": JsonTable.format, **task.frame.to_dict()}
        head |= {"drones": list(task.names), "columns": list(COLUMNS)}
        row = "[" + ",".join(["%.12g"] * len(COLUMNS)) + "]"
        sample = '{"t": %.12g, "rows": [' + ",".join([row] * len(task.names)) + "]}"
        with path.open("w", encoding="utf-8", newline="\n") as file:
            file.write(json.dumps(head, ensure_ascii=False)[:-1] + ",\n" + JsonTable.start)
            joint = "\n"
            for t, values in blocks_of(task, LINES):
                flat = np.column_stack([t, values.reshape(len(t), -1)])
                file.write(joint + ",\n".join([sample] * len(flat)) % tuple(flat.ravel().tolist()))
                joint = ",\n"
            file.write("\n" + JsonTable.end + "\n")

    @staticmethod
    def read_file(path: Path) -> Recording:
        """Return what such a document says, line by line."""
        what = "document that hitchopt wrote"
        with reading(path, what), path.open(encoding="utf-8") as file:
            head = parsed_json(file.readline(MAX_LINE).rstrip().removesuffix(",") + "}")
            known = head["columns"][: len(FLOWN)] == list(FLOWN)
            if not (known and head["format"] == JsonTable.format and head["drones"]):
                words = "with the columns that hitchopt writes"
                raise FileError(f"its format is not {JsonTable.format} {words}")
            if file.readline(MAX_LINE).strip() != JsonTable.start:
                raise FileError(f"its second line is not {JsonTable.start}")
            names, t, values = tuple(map(str, head["drones"])), [], []
            while (line := file.readline(MAX_LINE).strip()) != JsonTable.end:
                sample = parsed_json(line.removesuffix(","))
                t.append(float(sample["t"]))
                rows = np.array(sample["rows"], dtype=np.float64)
                if rows.shape != (len(names), len(head["columns"])):
                    raise FileError(f"from t = {t[-1]:g} s on its rows are not one per drone")
                values.append(rows[:, : len(FLOWN)])
            whole = np.array(values).reshape(-1, len(names), len(FLOWN))
            frame = str(head.get("frame"))
            return recording_of_samples(names, np.array(t), whole, frame, SMOOTH)
