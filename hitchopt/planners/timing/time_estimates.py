"""Estimates of how long paths take, to compare them before any is flown.

At every point of a path the pairs (s̈, ṡ²) that all limits allow are a convex polygon, whose corners
are known. The largest speed from which the path can still be ended is where a polygon meets a
line, from the last point to the first; the fastest motion is then found from the first to the last.
No linear program is solved, so that this takes half of toppra's time. Limits hold at the
points, not between them.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from functools import lru_cache

import numpy as np

from hitchopt.planners.path.shape_path import Path
from hitchopt.planners.timing.demands import Demands
from hitchopt.planners.timing.speed_profile import (
    SpeedProfile,
    TimingError,
    acceleration_ramp,
    allowed_corners,
    path_grid,
)
from hitchopt.requirements import Limits
from hitchopt.values import Array

GRID = 80
"""Number of steps of the grid along the path: coarser ones mistake which of two paths is faster."""

TIE = 1e-9
"""Share of ṡ² below it at which the largest s̈ is read: at a limit of speed corners tie, and
rounding would choose among them."""

RAMP_SHARE = 0.5
"""Share of the acceleration's ramp by which a limit of jerk makes flights longer at least: that of
a change from rest to full speed."""


@lru_cache(maxsize=2)
def grid_demands(path: Path, limits: Limits) -> Demands:
    """Return the demands of a path on the grid of estimates; those of the last paths are stored."""
    return Demands.along(path, limits, path_grid(GRID))


@lru_cache(maxsize=16)
def flight_estimate(path: Path, limits: Limits) -> float:
    """Return an estimate of the duration [s] of a flight along a path; infinite if there is none.

    Flights are mostly longer, by up to a tenth of the ramp.
    """
    demands = grid_demands(path, limits)
    try:
        profile = quick_profile(path_grid(GRID), demands)
    except TimingError:
        return math.inf
    return profile.duration + RAMP_SHARE * acceleration_ramp(profile, demands)


def quick_profile(s: Array, demands: Demands) -> SpeedProfile:
    """Return nearly the profile of ``fastest_profile``.

    Raises
    ------
    TimingError: none exists, as where rest itself breaks a limit on the path.
    """
    steps = np.diff(s)
    corners = allowed_corners(demands).points[:-1]
    u, x = corners[..., 0], corners[..., 1]
    tops = np.argmax(x, axis=1).tolist()
    # ṡ² at the next point falls on the way down from the top; bisection wants it to rise.
    after = -(x + 2.0 * steps[:, None] * u)
    ends = (np.argmax(after, axis=1) + 1).tolist()
    rates, squares, falling, lengths = u.tolist(), x.tolist(), after.tolist(), steps.tolist()
    most = [0.0] * len(s)
    for i in reversed(range(len(steps))):
        most[i] = _where(falling[i], squares[i], -most[i + 1], tops[i], ends[i])
    square = [0.0] * len(s)
    for i in range(len(steps)):
        fastest = _where(squares[i], rates[i], (1.0 - TIE) * square[i], 0, tops[i])
        square[i + 1] = min(square[i] + 2.0 * lengths[i] * fastest, most[i + 1])
    return _profile(s, np.array(square))


def _profile(s: Array, square: Array) -> SpeedProfile:
    """Return the profile of ṡ² (J,) on the grid s (J,)."""
    if not np.min(square[1:-1]) > 0.0:
        raise TimingError("there is no speed profile from rest to rest on this path")
    return SpeedProfile(s, np.sqrt(np.maximum(square, 0.0)))


def _where(along: list[float], values: list[float], level: float, low: int, high: int) -> float:
    """Return the value where ``along``, rising from index ``low`` to ``high``, reaches a level."""
    k = bisect_left(along, level, low, high)
    if k == low or k == high == len(along):
        return values[min(k, len(along) - 1)]
    rise = along[k] - along[k - 1]
    share = min(1.0, (level - along[k - 1]) / rise) if rise > 0.0 else 0.0
    return values[k - 1] + share * (values[k] - values[k - 1])
