"""Format npz: ``setpoints.npz``, arrays over samples and drones, none of them held as a whole.

``t`` (S,), ``drones`` (D,), ``frame``, and for every group of columns an array: ``positions``,
``velocities``, ``accelerations``, ``jerks``, ``cable_forces``, ``feed_forward``, ``body_rates``
(S, D, 3), ``quaternions`` (S, D, 4), w, x, y, z, and ``yaw`` (S, D, 1).
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from hitchopt.errors import FileError
from hitchopt.exports.formats.file_reading import reading
from hitchopt.exports.formats.format import Task
from hitchopt.exports.formats.long_table import COLUMNS, GROUPS, ROWS, SMOOTH, Table, blocks_of
from hitchopt.exports.recording import Recording, Samples, recording_of_samples
from hitchopt.motion.states import sample_times
from hitchopt.storage.archive import read_arrays, read_header, refuse_bomb
from hitchopt.values import Array

WHAT = "archive that hitchopt wrote"
FLOWN = ("positions", "velocities", "accelerations")
"""Arrays that say where the drones go; readers need no others."""


def write_npz(path: Path, task: Task) -> None:
    """Write the arrays one after the other, each block by block: samples are computed anew.

    Raises
    ------
    OSError: the file cannot be written.
    """
    samples, drones = len(sample_times(task.motion.duration, task.rate)), len(task.names)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
        for name, value in (("frame", np.array(task.frame.name)), ("drones", np.array(task.names))):
            _write(archive, name, value.shape, value.dtype, [value])
        number = np.dtype(np.float64)
        _write(archive, "t", (samples,), number, (block.t for block in blocks_of(task)))
        for name, columns in GROUPS.items():
            first = COLUMNS.index(columns[0])
            here = slice(first, first + len(columns))
            parts = (block.values[..., here] for block in blocks_of(task))
            _write(archive, name, (samples, drones, len(columns)), number, parts)


def _write(
    archive: zipfile.ZipFile,
    name: str,
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    parts: Iterable[NDArray[Any]],
) -> None:
    header = {"descr": npy.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
        npy.write_array_header_1_0(file, header)
        for part in parts:
            file.write(part.tobytes())


def read_npz(path: Path) -> Recording:
    """Return what such an archive says, without holding its arrays.

    Raises
    ------
    FileError: it is not such an archive, or a damaged one; from the windows too.
    """
    with reading(path, WHAT):
        head = read_arrays(path, ("frame", "drones", "t"))
    if head["t"].dtype.kind not in "iuf":
        raise FileError(f"{path}: its times are of type {head['t'].dtype}, not numbers")
    names = tuple(str(name) for name in np.atleast_1d(head["drones"]))
    t = np.asarray(head["t"], dtype=np.float64).ravel()
    frame = str(head["frame"])
    return recording_of_samples(names, lambda: _samples(path, t, len(names)), frame, SMOOTH)


def _samples(path: Path, t: Array, drones: int) -> Iterator[Samples]:
    size = max(1, ROWS // max(1, drones))
    with reading(path, WHAT), zipfile.ZipFile(path) as archive:
        members = [archive.getinfo(f"{name}.npy") for name in FLOWN]
        refuse_bomb(members, path.stat().st_size)
        files = [archive.open(member) for member in members]
        whole = (len(t), drones, 3)
        for name, file in zip(FLOWN, files, strict=True):
            found, fortran, dtype, _ = read_header(name, file.read)
            if found != whole or fortran or dtype != np.float64:
                raise FileError(f"array {name!r} is {found} of {dtype}, not {whole} of float64")
        for first in range(0, len(t), size):
            here = t[first : first + size]
            shape = (len(here), drones, 3)  # a file that is truncated has less, and is refused
            data = [file.read(8 * math.prod(shape)) for file in files]
            yield Samples(here, np.stack([np.frombuffer(d).reshape(shape) for d in data]))


class NpzTable(Table):
    """Arrays for numpy."""

    name = "npz"
    file = "setpoints.npz"
    feed_forward = Table.feed_forward.replace("ff_*", "feed_forward").replace(
        "cable_*", "cable_forces"
    )
    write_file = staticmethod(write_npz)
    read_file = staticmethod(read_npz)
