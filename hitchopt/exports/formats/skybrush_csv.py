"""Format skybrush_csv: ``show.zip``, one CSV per drone for Skybrush's importers.

``Time [msec],x [m],y [m],z [m],Red,Green,Blue``: positions at whole milliseconds, north-west-up,
straight lines between them. There is no velocity in it, so no acceleration either.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from math import ceil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError, InputError
from hitchopt.exports.formats.format import Candidate, Task, Whole
from hitchopt.exports.recording import Recording, check_times, recording_of_curves
from hitchopt.storage.archive import BROKEN, checked_bytes, refuse_bomb
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

FILE = "show.zip"

HEADER = "Time [msec],x [m],y [m],z [m],Red,Green,Blue"

SMOOTH = 0

MAX_UNPACKED = 500_000_000
"""[bytes] All that is read of a zip."""


class SkybrushCsv(Whole):
    """Positions by the clock."""

    name = "skybrush_csv"
    summary = "a zip of one CSV per drone for Skybrush's importers"
    frames = ("nwu",)
    rate = 20.0
    accuracy = 2e-3
    feed_forward = "not in these files: they hold positions alone"

    def candidates(self, task: Task) -> Iterator[Candidate]:
        """Give the zip at the usual rate, then at higher ones; only at one that was asked for."""
        yield Candidate({FILE: partial(write_zip, task=task)})
        for rate in () if task.rate_given else (40.0, 100.0):
            more = replace(task, rate=rate)
            note = f"at {rate:g} Hz: lines between fewer samples lose a limit"
            yield Candidate({FILE: partial(write_zip, task=more)}, (note,))

    def read(self, folder: Path, task: Task) -> Recording:  # noqa: ARG002
        """Return the lines through the positions."""
        curves = read_zip(folder / FILE)
        return recording_of_curves(tuple(curves), tuple(curves.values()), "nwu", SMOOTH)


def write_zip(path: Path, task: Task) -> None:
    """Write the zip, drone by drone.

    Raises
    ------
    InputError: more than 1000 samples a second.
    OSError: the file cannot be written.
    """
    if task.rate > 1000.0:
        raise InputError("--rate", task.rate, "at most 1000 Hz", "the format has milliseconds")
    drones = task.motion.drones
    samples = ceil(drones.duration * task.rate - 1e-6)
    milliseconds = np.rint(np.arange(samples + 1) * (1e3 / task.rate)).astype(np.int64)
    t = np.minimum(milliseconds * 1e-3, float(drones.breaks[-1]))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.comment = f"frame: {task.room.frame}".encode()
        for i, name in enumerate(task.names):
            curve = PiecewisePolynomial(drones.breaks, drones.coefficients[:, i])
            places = task.room.points(curve.at(t)) + 0.0
            rows = [
                f"{at},{x:.6f},{y:.6f},{z:.6f},255,255,255"
                for at, (x, y, z) in zip(milliseconds.tolist(), places.tolist(), strict=True)
            ]
            archive.writestr(f"{name}.csv", "\n".join([HEADER, *rows, ""]))


def read_zip(path: Path) -> dict[str, PiecewisePolynomial]:
    """Return the lines through the positions (3,) [m] of every drone, by its file's name.

    Raises
    ------
    FileError: no zip, no such files, damaged ones, or more than anyone flies.
    """
    found: dict[str, PiecewisePolynomial] = {}
    try:
        with zipfile.ZipFile(path) as archive:
            members = [m for m in archive.infolist() if m.filename.lower().endswith(".csv")]
            size = sum(member.file_size for member in members)
            if size > MAX_UNPACKED:
                raise FileError(f"{path}: unpacks to {size:.3g} bytes; {MAX_UNPACKED} are the most")
            refuse_bomb(members, path.stat().st_size)
            for member in members:
                name = Path(member.filename).stem
                if name in found:
                    raise FileError(f"{path}: two files are called {name}.csv")
                text = checked_bytes(archive, member).decode("utf-8-sig")
                found[name] = lines_of(text, f"{path}: {member.filename}")
    except BROKEN as error:
        text = str(error)
        if isinstance(error, FileError) and text.startswith(str(path)):
            raise
        raise FileError(f"{path}: is no zip of CSV files, or a damaged one: {error}") from error
    if not found:
        raise FileError(f"{path}: holds no CSV file")
    return found


def lines_of(text: str, source: str) -> PiecewisePolynomial:
    """Return the lines through the positions (3,) [m] that a file of this format tells.

    Raises
    ------
    FileError: another header, rows of other lengths, times that repeat or go back.
    """
    header, _, body = text.partition("\n")
    if header.strip().split(",")[:4] != HEADER.split(",")[:4]:
        raise FileError(f"{source}: its first line is {header[:60]!r}, not {HEADER}")
    lines = [line for line in body.splitlines() if line.strip()]
    if len(lines) < 2:
        raise FileError(f"{source}: has {len(lines)} rows; two are the least")
    try:
        table = np.loadtxt(lines, delimiter=",", ndmin=2, usecols=(0, 1, 2, 3), comments=None)
    except ValueError as error:
        raise FileError(f"{source}: {error}; it is truncated or damaged") from error
    check_times(table[:, 0] * 1e-3, source)
    try:
        return PiecewisePolynomial.hermite(
            table[:, 0] * 1e-3, table[None, :-1, 1:], table[None, 1:, 1:]
        )
    except InputError as error:
        raise FileError(f"{source}: {error}") from error
