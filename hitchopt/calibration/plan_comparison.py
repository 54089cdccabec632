"""Deviations of a recorded flight from its plan, vertex by vertex and drone by drone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.calibration.recordings import Recording
from hitchopt.simulation.error_measures import STILL, TIGHT, Spread
from hitchopt.simulation.flight_task import Task
from hitchopt.values import Array


@dataclass(frozen=True, eq=False)
class PlanRows:
    """Samples of a plan between which the times of a recording fall.

    Attributes
    ----------
    low, high: indices of samples (times,).
    share: (times,), from 0 at the first to 1 at the second.
    """

    low: NDArray[np.intp]
    high: NDArray[np.intp]
    share: Array

    @classmethod
    def at(cls, task: Task, times: Array) -> PlanRows:
        """Return the samples about some times (times,) [s] from the plan's start.

        Before its start and after its end a plan stands still.
        """
        asked = task.t[0] + np.clip(times, 0.0, task.duration)
        last = len(task.t) - 1
        low = np.clip(np.searchsorted(task.t, asked, side="right") - 1, 0, last)
        high = np.minimum(low + 1, last)
        step = np.where(high > low, task.t[high] - task.t[low], 1.0)
        return cls(low, high, np.clip((asked - task.t[low]) / step, 0.0, 1.0))

    def of(self, values: Array) -> Array:
        """Return the plan's values (samples, …), interpolated linearly: (times, …)."""
        share = self.share.reshape(-1, *[1] * (values.ndim - 1))
        found: Array = (1.0 - share) * values[self.low] + share * values[self.high]
        return found


@dataclass(frozen=True, eq=False)
class Comparison:
    """Distances from the plan.

    Attributes
    ----------
    t: (samples,) [s]
    vertices: (samples, points) [m], nan where there is no hitch, drawn tight, or none was seen.
    drones: (samples, 2n) [m]
    moving: whether the plan moves a drone (samples,).
    """

    t: Array
    vertices: Array
    drones: Array
    moving: NDArray[np.bool_]

    def spreads(self, errors: Array) -> list[tuple[Spread, Spread, Spread]]:
        """Return the spreads of each column: over all samples, at rest, and moving."""
        return [
            (Spread.of(e), Spread.of(e[~self.moving]), Spread.of(e[self.moving])) for e in errors.T
        ]


def compare(recording: Recording, task: Task) -> Comparison:
    """Return how far a recording is from its plan, in three dimensions."""
    rows = PlanRows.at(task, recording.t)
    tight = np.all(task.tensions >= TIGHT * task.team.tension, axis=-1) & task.formed
    hitched = tight[rows.low] & tight[rows.high]
    off = recording.vertices - rows.of(task.vertices)
    vertices = np.where(hitched[:, None], np.linalg.norm(off, axis=-1), np.nan)
    places = task.setpoints.positions
    drones = np.linalg.norm(recording.drones - rows.of(places), axis=-1)
    steps = np.max(np.abs(places[rows.high] - places[rows.low]), axis=(1, 2))
    inside = (recording.t >= 0.0) & (recording.t <= task.duration)
    return Comparison(recording.t, vertices, drones, (steps > STILL) & inside)
