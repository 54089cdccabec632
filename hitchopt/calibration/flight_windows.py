"""Short windows of a recorded flight, averaged, with what the plan asks for in them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from hitchopt.calibration.plan_comparison import PlanRows
from hitchopt.calibration.recordings import Recording
from hitchopt.simulation.flight_task import Task
from hitchopt.values import Array

WINDOW = 0.5
"""Length of a window [s]: some times the correlation time of a drone's position error."""

SPAN = 6.0
"""Length of a span over which stiffness is fitted [s]: tensions of a span of 0.5 s would follow the
noise of its drones, which makes them seem up to 24 % stiffer, spans of 2 s up to 13 %."""

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
    """

    t: Array
    drones: Array
    vertices: Array
    commanded: Array
    planned: Array
    cable_forces: Array
    tensions: Array

    def spans(self) -> Windows:
        """Return means over spans of about SPAN, each without a gap."""
        number = np.arange(len(self.t))
        run = np.cumsum(np.diff(self.t, prepend=self.t[:1]) > 1.5 * WINDOW)
        _, first, length = np.unique(run, return_index=True, return_counts=True)
        parts = np.maximum(np.round(length * WINDOW / SPAN), 1.0)
        span = ((number - first[run]) * parts[run] / length[run]).astype(np.intp)
        _, first, count = np.unique([run, span], axis=1, return_index=True, return_counts=True)

        def mean(values: Array) -> Array:
            sums: Array = np.add.reduceat(values, first, axis=0)
            return sums / count.reshape(-1, *[1] * (values.ndim - 1))

        columns: Any = (mean(getattr(self, field.name)) for field in fields(self))
        return Windows(*columns)


def windows_of(recording: Recording, task: Task) -> Windows:
    """Return the windows of a recording, each with the set points that applied.

    After its end a plan stands still at its last set point.
    """
    rows = PlanRows.at(task, recording.t)
    row = rows.low
    tight = task.formed[row] & np.all(task.tensions[row] >= TIGHT * task.team.tension, axis=-1)
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
    )
