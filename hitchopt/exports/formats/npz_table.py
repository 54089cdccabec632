"""Format npz: ``setpoints.npz``, arrays over samples and drones, none of them held as a whole.

``t`` (S,), ``drones`` (D,), ``frame``, and for every group of columns an array: ``positions``,
``velocities``, ``accelerations``, ``jerks``, ``cable_forces``, ``feed_forward`` (S, D, 3), and
``yaw`` (S, D, 1).
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from hitchopt.errors import FileError
from hitchopt.exports.formats.format import Candidate, Task
from hitchopt.exports.formats.long_table import (
    FEED_FORWARD,
    ROWS,
    SMOOTH,
    Table,
    blocks_of,
    sample_count,
)
from hitchopt.exports.frame import AXES
from hitchopt.exports.recording import Recording, Samples, recording_of_samples
from hitchopt.storage.archive import BROKEN, read_arrays, read_header, refuse_bomb

Array = NDArray[np.float64]

FILE = "setpoints.npz"

GROUPS = {
    "positions": slice(0, 3),
    "velocities": slice(3, 6),
    "accelerations": slice(6, 9),
    "jerks": slice(9, 12),
    "yaw": slice(12, 13),
    "cable_forces": slice(13, 16),
    "feed_forward": slice(16, 19),
}
"""Columns of the table that every array holds."""

FLOWN = ("positions", "velocities", "accelerations")


class NpzTable(Table):
    """Arrays for numpy."""

    name = "npz"
    summary = "arrays over samples and drones for numpy"
    feed_forward = FEED_FORWARD.replace("ff_*", "feed_forward").replace("cable_*", "cable_forces")

    def candidates(self, task: Task) -> Iterator[Candidate]:
        """Give the one archive there is."""
        yield Candidate({FILE: lambda path: write_npz(path, task)})

    def read(self, folder: Path, task: Task) -> Recording:  # noqa: ARG002
        """Return what the arrays say."""
        return read_npz(folder / FILE)


def write_npz(path: Path, task: Task) -> None:
    """Write the arrays one after the other, each block by block: samples are computed anew.

    Raises
    ------
    OSError: the file cannot be written.
    """
    samples, drones = sample_count(task), len(task.names)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
        for name, value in (("frame", np.array(task.room.frame)), ("drones", np.array(task.names))):
            _write(archive, name, value.shape, value.dtype, iter([value]))
        times = (block.t for block in blocks_of(task))
        _write(archive, "t", (samples,), np.dtype(np.float64), times)
        for name, columns in GROUPS.items():
            shape = (samples, drones, columns.stop - columns.start)
            parts = (block.values[..., columns] for block in blocks_of(task))
            _write(archive, name, shape, np.dtype(np.float64), parts)


def _write(
    archive: zipfile.ZipFile,
    name: str,
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    parts: Iterator[NDArray[Any]],
) -> None:
    header = {"descr": npy.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
        npy.write_array_header_1_0(file, header)
        for part in parts:
            file.write(np.ascontiguousarray(part).tobytes())


def read_npz(path: Path) -> Recording:
    """Return what such an archive says, without holding its arrays.

    Raises
    ------
    FileError: it is not such an archive, or a damaged one; from the windows too.
    """
    try:
        head = read_arrays(path, ("frame", "drones", "t"))
    except BROKEN as error:
        raise FileError(f"{path}: not an archive that hitchopt wrote: {error}") from error
    if head["t"].dtype.kind not in "iuf":
        raise FileError(f"{path}: its times are of type {head['t'].dtype}, not numbers")
    names = tuple(str(name) for name in np.atleast_1d(head["drones"]))
    t = np.asarray(head["t"], dtype=np.float64).ravel()
    frame = str(head["frame"])
    return recording_of_samples(
        names, lambda: _blocks(path, t, len(names)), frame if frame in AXES else "", SMOOTH
    )


def _blocks(path: Path, t: Array, drones: int) -> Iterator[Samples]:
    size = max(1, ROWS // max(1, drones))
    try:
        with zipfile.ZipFile(path) as archive:
            members = [archive.getinfo(f"{name}.npy") for name in FLOWN]
            refuse_bomb(members, path.stat().st_size)
            files = [archive.open(member) for member in members]
            for name, file in zip(FLOWN, files, strict=True):
                _check_header(name, file, (len(t), drones, 3))
            for first in range(0, len(t), size):
                here = t[first : first + size]
                parts = [_taken(file.read, (len(here), drones, 3)) for file in files]
                yield Samples(here, np.stack(parts))
    except BROKEN as error:
        raise FileError(f"{path}: not an archive that hitchopt wrote: {error}") from error


def _check_header(name: str, file: IO[bytes], shape: tuple[int, ...]) -> None:
    found, fortran, dtype, _ = read_header(name, file.read)
    if found != shape or fortran or dtype != np.float64:
        raise FileError(f"array {name!r} is {found} of {dtype}, not {shape} of float64")


def _taken(read: Callable[[int], bytes], shape: tuple[int, ...]) -> Array:
    wanted = 8 * math.prod(shape)
    data = read(wanted)
    if len(data) != wanted:
        raise FileError("it is truncated")
    return np.frombuffer(data, dtype=np.float64).reshape(shape)
