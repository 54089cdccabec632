"""The tables that our fleet flies: one row per time and robot, east-north-up, in m and m/s."""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hitchopt.exports.contents import FileContents
from hitchopt.exports.format import ExportTask, Format, FormatOutput
from hitchopt.storage.archive import reading

COLUMNS = ("time_s", "robot", "x", "y", "z", "vx", "vy", "vz")


class OurFleet(Format):
    """A table of positions and velocities for our fleet."""

    name = "our_fleet"  # of --format
    file = "our_fleet.csv"
    endings = (".csv",)
    header = "time_s,robot"  # by which lint recognises the files
    frames = ("enu",)
    rate = 50.0  # samples per second
    accuracy = 1e-3  # largest error of positions [m]; larger ones are refused
    feed_forward = "none"
    has_heading = False

    def write(self, folder: Path, task: ExportTask) -> FormatOutput:
        """Write a row per time and robot."""
        with (folder / self.file).open("w", encoding="utf-8", newline="") as file:
            table = csv.writer(file)
            table.writerow(COLUMNS)
            for times, samples in task.blocks(10_000):
                states = np.concatenate([samples["positions"], samples["velocities"]], axis=-1)
                for time, robots in zip(times.tolist(), states.tolist(), strict=True):
                    for name, state in zip(task.names, robots, strict=True):
                        table.writerow([time, name, *state])
        return FormatOutput((self.file,))

    def load(self, files: Sequence[Path]) -> FileContents:
        """Read a table; robots fly cubics through its rows."""
        with reading(files[0], "table of our fleet"):
            cells = np.array([*csv.reader(files[0].read_text("utf-8").splitlines())][1:])
            names = list(dict.fromkeys(cells[:, 1].tolist()))
            rows = cells.reshape(-1, len(names), len(COLUMNS))
            if np.any(rows[:, :, 1] != names) or np.any(rows[:, :, 0] != rows[:, :1, 0]):
                raise ValueError("the rows are not sorted by time, then robot")
            numbers = rows[:, :, [0, *range(2, 8)]].astype(float)
            return FileContents.of_samples(
                names, numbers[:, 0, 0], numbers[:, :, 1:], frame="enu", smooth=1
            )
