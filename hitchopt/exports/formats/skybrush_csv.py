"""Format skybrush_csv: ``show.zip``, one CSV per drone for Skybrush's importers.

``Time [msec],x [m],y [m],z [m],Red,Green,Blue``: positions at whole milliseconds, north-west-up,
straight lines between them. There is no velocity in it, so no acceleration either.
"""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from math import ceil
from pathlib import Path

import numpy as np

from hitchopt.errors import FileError, InputError
from hitchopt.exports.format import DroneFacts, Format, Loaded, Task
from hitchopt.exports.reading import read_columns, read_text
from hitchopt.exports.recording import check_times, recording_of_curves
from hitchopt.storage.archive import opened_zip, read_members
from hitchopt.trajectory import PiecewisePolynomial

HEADER = "Time [msec],x [m],y [m],z [m],Red,Green,Blue"

ROW = "%d,%.6f,%.6f,%.6f,255,255,255"


class SkybrushCsv(Format):
    """Positions by the clock."""

    name = "skybrush_csv"
    file = "show.zip"
    endings = (".zip", ".csv")
    several = (".csv",)  # outside of a zip
    frames = ("nwu",)
    rate = 20.0
    rates = (40.0, 100.0)
    accuracy = 2e-3
    feed_forward = "not in these files: they hold positions alone"

    def write(self, path: Path, task: Task) -> None:
        """Write the zip, drone by drone; raise InputError for more than 1000 samples a second."""
        if task.rate > 1000.0:
            bound = "at most 1000 Hz"
            raise InputError("--rate", task.rate, bound, "the format has milliseconds")
        drones = task.motion.drones
        samples = ceil(drones.duration * task.rate - 1e-6)
        milliseconds = np.rint(np.arange(samples + 1) * (1e3 / task.rate))
        places = drones.at(np.minimum(milliseconds * 1e-3, float(drones.breaks[-1])))
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.comment = f"frame: {task.frame.name}".encode()
            for i, name in enumerate(task.names):
                rows = np.column_stack([milliseconds, task.frame.points(places[:, i]) + 0.0])
                with archive.open(f"{name}.csv", "w") as file:
                    np.savetxt(file, rows, ROW, header=HEADER, comments="")

    def recognises(self, labels: Sequence[str]) -> bool:
        """Return whether the first column is the time in milliseconds."""
        return labels[0].startswith("time [msec]")

    def load(self, files: Sequence[Path]) -> Loaded:
        """Return what a zip holds, or CSV files of one drone each."""
        if files[0].suffix.lower() == ".zip":
            curves = read_zip(files[0])
        else:
            curves = {path.stem: lines_of(read_text(path), str(path)) for path in files}
        recording = recording_of_curves(tuple(curves), tuple(curves.values()), "nwu", 0)
        facts = (DroneFacts(n, c.pieces, 0, float(c.breaks[-1])) for n, c in curves.items())
        return Loaded(self.name, recording, tuple(facts))


def read_zip(path: Path) -> dict[str, PiecewisePolynomial]:
    """Return the lines through the positions (3,) [m] of every drone, by its file's name.

    Raises
    ------
    FileError: no zip, no such files, damaged ones, or more than anyone flies.
    """
    found: dict[str, PiecewisePolynomial] = {}
    with opened_zip(path, "zip of CSV files") as archive:
        members = [m for m in archive.infolist() if m.filename.lower().endswith(".csv")]
        for member, data in zip(members, read_members(path, archive, members), strict=True):
            name = Path(member.filename).stem
            if name in found:
                raise FileError(f"{path}: two files are called {name}.csv")
            found[name] = lines_of(data.decode("utf-8-sig"), f"{path}: {member.filename}")
    if not found:
        raise FileError(f"{path}: holds no CSV file")
    return found


def lines_of(text: str, source: str) -> PiecewisePolynomial:
    """Return the lines through the positions (3,) [m] in a file of this format.

    Raises
    ------
    FileError: another header, rows of other lengths, times that repeat or go back.
    """
    header, *lines = text.splitlines() or [""]
    wanted = HEADER.split(",")[:4]
    if header.strip().split(",")[:4] != wanted:
        raise FileError(f"{source}: its first line is {header[:60]!r}, not {HEADER}")
    table = read_columns(lines, HEADER, wanted, HEADER, source, least=2)
    t, points = table[:, 0] * 1e-3, table[None, :, 1:]
    check_times(t, source)
    try:
        return PiecewisePolynomial.hermite(t, points[:, :-1], points[:, 1:])
    except InputError as error:
        raise FileError(f"{source}: {error}") from error
