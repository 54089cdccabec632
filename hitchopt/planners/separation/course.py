"""What a task looks like to the planner: a grid of time, splines, limits and scales."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.planners.separation.fastest import fastest_ramps
from hitchopt.planners.separation.spline import HELD, Grid
from hitchopt.planners.separation.task import SeparationTask
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

RAMP_PIECES = 3
"""Pieces in which a drone gets up to speed: what the fastest flight needs to within 2 %."""

MOST_PIECES = 20
"""Of the time between the ramps; otherwise each is as long as one of them."""

SAMPLES = 3
"""Of every piece, where curves are looked at between their ends."""


@dataclass(frozen=True, eq=False)
class Course:
    """A task on its grid.

    Attributes
    ----------
    task: what is asked.
    grid: the pieces of time.
    nominal: (N, count, 3) [m]: coefficients of the curves to stay near to.
    caps: (3, N): largest norms of the first three derivatives of each drone, by time.
    bound: no flight of all drones takes less [s].
    size: the longest way [m], by which deviations are measured.
    """

    task: SeparationTask
    grid: Grid
    nominal: Array
    caps: Array
    bound: float
    size: float

    @property
    def scale(self) -> Array:
        """(3,) [1/m]: the norm of an offset times this is a separation."""
        return self.task.separation.scale


def course_of(task: SeparationTask) -> Course:
    """Return the task's course: its grid suits the drone that takes longest."""
    limits = task.limits
    n = task.drones
    given = limits.acceleration if task.acceleration is None else task.acceleration
    acceleration = np.minimum(np.broadcast_to(np.asarray(given), (n,)), limits.acceleration)
    caps = np.stack([np.full(n, limits.speed), acceleration, np.full(n, limits.jerk)])
    distance = np.linalg.norm(task.goal - task.start, axis=1)
    ramps = fastest_ramps(distance, limits.speed, acceleration, limits.jerk)
    slowest = int(np.argmax(ramps.duration))
    bound, rise = float(ramps.duration[slowest]), float(ramps.rise[slowest])
    size = max(float(np.max(distance)), 2.0 * task.separation.radius)
    if bound <= 0.0 or float(distance[slowest]) < 1e-6 * size:  # nobody goes anywhere
        rise, bound_shape = 1.0, 2.0
    else:
        bound_shape = bound
    cruise = max(bound_shape - 2.0 * rise, 0.0) / rise  # in ramps
    middle = min(MOST_PIECES, math.ceil(cruise - 1e-9))
    first = np.linspace(0.0, 1.0, RAMP_PIECES + 1)
    lasting = 1.0 + np.linspace(0.0, cruise, middle + 1)
    breaks = np.concatenate([first[:-1], lasting, 1.0 + cruise + first[1:]])
    grid = Grid(breaks / breaks[-1])
    nominal = _nominal(task, grid, 1.0 / breaks[-1])
    return Course(task, grid, nominal, caps, bound, size)


def at_rest(grid: Grid, start: Array, goal: Array) -> Array:
    """(N, count, 3): coefficients held at both ends, zero between."""
    coefficients = np.zeros((len(start), grid.count, 3))
    coefficients[:, :HELD] = start[:, None]
    coefficients[:, -HELD:] = goal[:, None]
    return coefficients


def _nominal(task: SeparationTask, grid: Grid, ramp: float) -> Array:
    """Return splines near the nominal curves, or near straight flights that rise as ``ramp``."""
    s = np.linspace(0.0, 1.0, 12 * grid.pieces + 1)
    basis = grid.sampled(s)
    if task.nominal is None:
        speed = _smooth(s / ramp) * _smooth((1.0 - s) / ramp)
        way = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))])
        way /= way[-1]
        points = task.start[:, None] + way[:, None] * (task.goal - task.start)[:, None]
    else:
        points = np.swapaxes(_sampled(task.nominal, s), 0, 1)
    coefficients = at_rest(grid, task.start, task.goal)
    rest = points - np.einsum("sc,ncd->nsd", basis, coefficients)
    free = basis[:, grid.free]
    fitted = np.linalg.solve(free.T @ free, free.T)  # well conditioned: B-splines
    coefficients[:, grid.free] = np.einsum("fs,nsd->nfd", fitted, rest)
    return coefficients


def _smooth(x: Array) -> Array:
    """Return a step from 0 to 1 that starts and ends level."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def _sampled(curves: PiecewisePolynomial, s: Array) -> Array:
    return curves.at(curves.breaks[0] + s * curves.duration)
