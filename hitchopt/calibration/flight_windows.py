"""Short windows of a recorded flight, averaged, with what the plan asks for in them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.calibration.plan_comparison import PlanRows
from hitchopt.calibration.recordings import Recording
from hitchopt.simulation.flight_task import Task
from hitchopt.values import Array

WINDOW = 0.5
"""Length of a window [s]: some times the correlation time of a drone's position error."""

CALMED = 0.7
"""Time after which a hitch that the plan has stopped counts as resting [s]."""

STILL = 1e-4
"""Largest movement of set points within a window at rest [m]."""

TIGHT = 0.9
"""Least planned tension over the team's at which a hitch counts as drawn tight."""


@dataclass(frozen=True, eq=False)
class Windows:
    """Means over windows in which the plan has a hitch, drawn tight, and all of it was seen.

    Attributes
    ----------
    t: middles (windows,) [s].
    drones, vertices: measured (windows, 2n, 3), (windows, points, 3) [m].
    commanded: set points (windows, 2n, 3) [m].
    planned: planned vertices (windows, points, 3) [m].
    cable_forces: of the set points (windows, 2n, 3) [N].
    tensions: planned (windows, n) [N].
    resting: whether the plan stands still, and has done so for CALMED (windows,).
    """

    t: Array
    drones: Array
    vertices: Array
    commanded: Array
    planned: Array
    cable_forces: Array
    tensions: Array
    resting: NDArray[np.bool_]

    def __getitem__(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> Windows:
        """Return some of the windows."""
        columns: Any = (getattr(self, field.name)[rows] for field in fields(self))
        return Windows(*columns)

    def poses(self) -> Windows:
        """Return the windows at rest, those of one stop averaged."""
        still = self[self.resting]
        if not len(still.t):
            return still
        moved = np.max(np.abs(np.diff(still.commanded, axis=0)), axis=(1, 2)) > STILL
        pose = np.concatenate([[0], np.cumsum(moved)])
        first = np.flatnonzero(np.diff(pose, prepend=-1))
        count = np.diff(np.append(first, len(pose)))

        def mean(values: Array) -> Array:
            sums: Array = np.add.reduceat(values, first, axis=0)
            return sums / count.reshape(-1, *[1] * (values.ndim - 1))

        return Windows(
            mean(still.t),
            mean(still.drones),
            mean(still.vertices),
            mean(still.commanded),
            mean(still.planned),
            mean(still.cable_forces),
            mean(still.tensions),
            still.resting[first],
        )


def windows_of(recording: Recording, task: Task) -> Windows:
    """Return the windows of a recording, each with the set points that applied.

    After its end a plan stands still at its last set point.
    """
    rows = PlanRows.at(task, recording.t)
    row = rows.low
    tight = task.formed[row] & np.all(task.tensions[row] >= TIGHT * task.team.tension, axis=-1)
    steps = np.max(np.linalg.norm(np.diff(task.setpoints.positions, axis=0), axis=-1), axis=-1)
    moves = np.flatnonzero(steps > 1e-7)
    last_move = np.full(len(task.t), -np.inf)
    last_move[moves + 1] = task.t[moves + 1]
    last_move = np.maximum.accumulate(last_move)[row] - task.t[0]
    calm = (recording.t - last_move >= CALMED) | ~np.isfinite(last_move)
    seen = np.all(np.isfinite(recording.drones), axis=(1, 2))
    seen &= np.all(np.isfinite(recording.vertices), axis=(1, 2))
    window = np.floor(recording.t / WINDOW).astype(np.intp)
    usable = tight & seen & (recording.t >= 0.0)
    number, of_sample = np.unique(window, return_inverse=True)
    total = np.bincount(of_sample, minlength=len(number))
    good = np.bincount(of_sample, usable, minlength=len(number))
    chosen = usable & (good >= 0.5 * np.median(total))[of_sample]
    number, of_sample = np.unique(window[chosen], return_inverse=True)
    count = np.bincount(of_sample, minlength=len(number))

    def mean(values: Array) -> Array:
        sums = np.zeros((len(number), *values.shape[1:]))
        np.add.at(sums, of_sample, values[chosen])
        return sums / count.reshape(-1, *[1] * (values.ndim - 1))

    setpoints = task.setpoints
    return Windows(
        mean(recording.t),
        mean(recording.drones),
        mean(recording.vertices),
        mean(rows.of(setpoints.positions)),
        mean(rows.of(task.vertices)),
        mean(rows.of(setpoints.cable_forces)),
        mean(rows.of(task.tensions)),
        mean(calm.astype(np.float64)) > 1.0 - 1e-9,
    )
