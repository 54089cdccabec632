"""Nominal curves of single drones: along routes around prisms, on a grid of time."""

from __future__ import annotations

import math

import numpy as np

from hitchopt.geometry.vectors import length
from hitchopt.planners.timing.ramps import fastest_ramps
from hitchopt.swarms.around_prisms import points_along, routes_around
from hitchopt.swarms.task import END_COUNT, Grid, SeparationTask, Setting
from hitchopt.values import Array

RAMP_PIECES = 3  # Number of pieces of a ramp, which resolve the fastest flight to within 2 %

MAX_CRUISE_PIECES = 20
"""Maximum number of pieces between the ramps; if there are fewer, each is as long as a ramp."""

MIN_RAMP_SHARE = 1e-5  # Shortest ramp over the duration; splines do not resolve shorter ones
FIT_SAMPLES = 12  # Number of samples of every piece through which nominal curves are fitted

MIN_ROUTE_RATIO = 1e-6
"""Length of the longest route, over the length scale, below which no drone moves."""

BREAK_ROUNDING = 1e-9  # Rounding of the duration of the cruise [ramps], which adds no piece


def setting_of(task: SeparationTask, duration_ratio: float = 1.0) -> Setting:
    """Return the task on a grid for the drone with the longest flight; all leave at once.

    Parameters
    ----------
    duration_ratio: duration over that of the slowest flight, by which the grid has more pieces.

    Raises
    ------
    InfeasibleError: no route around the prisms was found.
    """
    limits = task.requirements.limits
    n = task.drones
    usable = limits.acceleration if task.acceleration is None else np.asarray(task.acceleration)
    acceleration = np.minimum(np.broadcast_to(usable, n), limits.acceleration)
    caps = np.stack([np.full(n, limits.speed), acceleration, np.full(n, limits.jerk)])
    routes = routes_around(task)
    route_lengths = np.array([np.sum(length(np.diff(route, axis=0))) for route in routes])
    distances = length(task.goal - task.start)
    bounds, _ = fastest_ramps(distances, limits.speed, acceleration, limits.jerk)
    durations, ramps = fastest_ramps(route_lengths, limits.speed, acceleration, limits.jerk)
    slowest = int(np.argmax(durations))
    duration = float(durations[slowest])
    ramp = max(float(ramps[slowest]), MIN_RAMP_SHARE * duration)
    diameter = 2.0 * task.requirements.separation.radius
    length_scale = max(float(np.max(route_lengths)), diameter)
    cruise = 0.0
    if float(route_lengths[slowest]) > MIN_ROUTE_RATIO * length_scale:
        cruise = max(duration_ratio * duration / ramp - 2.0, 0.0)
    breaks = _breaks(cruise, duration_ratio)
    grid = Grid(breaks / breaks[-1])
    s = fit_samples(grid)
    progress = _progress(s, 1.0 / breaks[-1])
    targets = np.stack([points_along(route, progress) for route in routes])
    return Setting(
        task=task,
        grid=grid,
        nominal=fitted_curves(task, grid, targets),
        caps=caps,
        bound=float(np.max(bounds)),
        single_duration=duration,
        length_scale=length_scale,
    )


def _breaks(cruise: float, duration_ratio: float) -> Array:
    """Return the breaks (pieces + 1,) of the first ramp, a cruise, and the last ramp.

    The unit of time is a ramp.
    """
    ramp_breaks = np.linspace(0.0, 1.0, RAMP_PIECES + 1)
    max_pieces = math.ceil(duration_ratio * MAX_CRUISE_PIECES)
    cruise_pieces = min(max_pieces, math.ceil(cruise - BREAK_ROUNDING))
    cruise_breaks = 1.0 + np.linspace(0.0, cruise, cruise_pieces + 1)
    return np.concatenate([ramp_breaks[:-1], cruise_breaks, 1.0 + cruise + ramp_breaks[1:]])


def fit_samples(grid: Grid) -> Array:
    """Return the times (FIT_SAMPLES · pieces + 1,) through which curves are fitted."""
    return np.linspace(0.0, 1.0, FIT_SAMPLES * grid.pieces + 1)


def fitted_curves(
    task: SeparationTask, grid: Grid, targets: Array, smoothing_time: float = 0.0
) -> Array:
    """Return the coefficients (N, count, 3) [m] of curves from start to goal.

    Parameters
    ----------
    targets: (N, samples, 3) [m], positions at the times ``fit_samples``.
    smoothing_time: see ``Grid.fitting``.
    """
    coefficients = np.zeros((task.drones, grid.count, 3))
    coefficients[:, :END_COUNT] = task.start[:, None]
    coefficients[:, -END_COUNT:] = task.goal[:, None]
    s = fit_samples(grid)
    offsets = targets - grid.sampled(s) @ coefficients
    coefficients[:, grid.free] = grid.fitting(s, smoothing_time) @ offsets
    return coefficients


PROGRESS_SAMPLES = 1001  # Number of times between which the progress along a route is linear


def _progress(s: Array, ramp: float) -> Array:
    """Return the progress along a route at times s, from 0 to 1, with ramps of ``ramp`` ≤ ½."""
    times = np.linspace(0.0, 1.0, PROGRESS_SAMPLES)
    rising = np.clip(times / ramp, 0.0, 1.0)
    falling = np.clip((1.0 - times) / ramp, 0.0, 1.0)
    speed = rising**2 * (3.0 - 2.0 * rising) * falling**2 * (3.0 - 2.0 * falling)
    distance = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1])))
    progress: Array = np.interp(s, times, distance / distance[-1])
    return progress
