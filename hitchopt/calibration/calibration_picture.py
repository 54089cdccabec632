"""Picture of a recorded flight: from above against its plan, and deviations over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hitchopt.calibration.calibrate import Calibration
from hitchopt.errors import FileError

SIZE, DOTS = (11.0, 5.0), 110
"""Size of the picture [in], and its resolution [1/in]."""

LABELLED = 12
"""Largest number of curves for which a legend has space."""


def save_calibration_picture(path: Path, calibration: Calibration) -> None:
    """Draw where drones and vertices were and should have been, and how far they were off.

    Raises
    ------
    FileError: the file cannot be written, or its ending names no format.
    """
    from matplotlib.figure import Figure

    task, recording, found = calibration.task, calibration.recording, calibration.comparison
    figure = Figure(SIZE, dpi=DOTS, layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.1))
    above = figure.add_subplot(grid[:, 0])
    for k in range(task.team.drones):
        above.plot(*task.setpoints.positions[:, k, :2].T, color="0.75", lw=0.8)
        above.plot(*recording.drones[:, k, :2].T, color="0.35", lw=0.8)
    seen = np.isfinite(found.vertices)
    layout, last = task.team.layout, np.flatnonzero(seen.all(axis=1))[-1:]
    for i in last:
        for k in range(task.team.robots):
            ends = recording.vertices[i, [layout.starts[k], layout.ends[k]]]
            line = np.vstack([recording.drones[i, 2 * k], ends, recording.drones[i, 2 * k + 1]])
            above.plot(line[:, 0], line[:, 1], "o-", color=f"C{k % 10}", lw=0.8, ms=3, alpha=0.5)
    for p, name in enumerate(task.team.point_names):
        planned = task.vertices[task.formed][:, p]
        above.plot(planned[:, 0], planned[:, 1], color="black", lw=0.9, ls=":")
        above.plot(*recording.vertices[seen[:, p], p, :2].T, color=f"C{p % 10}", lw=1.2)
        above.text(float(planned[-1, 0]), float(planned[-1, 1]), name, fontsize=8)
    above.set(
        xlabel="x [m]",
        ylabel="y [m]",
        title="recorded, cables at the end; dotted and pale: the plan",
    )
    above.set_aspect("equal", "datalim")
    for row, errors, title in (
        (0, found.vertices, "vertex error [cm]"),
        (1, found.drones, "drone to set point [cm]"),
    ):
        axes = figure.add_subplot(grid[row, 1])
        names = task.team.drone_names if row else task.team.point_names
        axes.plot(found.t, 100.0 * errors, lw=0.9, label=names)
        if len(names) <= LABELLED:
            axes.legend(fontsize=7, ncols=3)
        axes.set(ylabel=title, xlabel="t [s]" if row else "")
        axes.grid(alpha=0.3)
    try:
        figure.savefig(path)
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: cannot be written: {error}; take .png or .pdf") from error
