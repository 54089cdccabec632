"""Breaks of a trajectory's pieces: close where its acceleration changes."""

from __future__ import annotations

import numpy as np

from hitchopt.planners.timing.speed_profile import SpeedProfile
from hitchopt.values import Array

WIDEST = 1.0 / 12.0
"""Longest piece, as a share of the whole time."""

PER_RAMP = 6.0
"""Number of pieces in a change of the acceleration from one limit to the other."""

SHORTEST = 5e-3
"""[s] Shortest piece: shorter ones lose more digits in third derivatives than they gain speed."""

MOST = 200
"""Approximate number of pieces of the first mesh; where more would be needed, all are wider."""

GRADING = 0.4
"""Largest growth of pieces' lengths with their distance from one another."""

SAME = 1e-9
"""Share of the whole time: places closer than this are one, which rounding alone tells apart."""

ACTIVE = 0.1
"""Share of the largest change of acceleration below which a time counts as quiet."""


def time_mesh(profile: SpeedProfile, ramp: float, finer: int = 1) -> Array:
    """Return the knots (K + 1,) [s] for a profile smoothed over ``ramp`` [s].

    Parameters
    ----------
    profile: toppra's optimum.
    ramp: width of the moving average; the knots run from 0 to the profile's duration and this.
    finer: every piece is divided by about as much.
    """
    whole = profile.duration + ramp
    # Wherever the smoothed profile's acceleration may begin or end to change, and in between.
    places = np.concatenate([profile.times, profile.times + 0.5 * ramp, profile.times + ramp])
    t = np.unique(np.clip(np.append(places, np.linspace(0.0, whole, 801)), 0.0, whole))
    t = t[np.append(True, np.diff(t) > SAME * whole)]
    # The acceleration jumps at t: it is evaluated in between, where no rounding changes it.
    middle = 0.5 * (t[1:] + t[:-1])
    change = np.abs(profile.acceleration(middle) - profile.acceleration(middle - ramp))
    busy = np.append(change > ACTIVE * np.max(change), False)
    busy[1:] |= busy[:-1]
    fine = max(ramp / PER_RAMP, SHORTEST)
    widths = np.where(busy, np.minimum(fine, WIDEST * whole), WIDEST * whole)
    widths = np.maximum(_graded(t, widths), SHORTEST)
    density = 0.5 * (1.0 / widths[1:] + 1.0 / widths[:-1]) * np.diff(t)
    pieces = np.append(0.0, np.cumsum(density))
    count = finer * max(int(np.ceil(min(pieces[-1], MOST))), 4)
    knots: Array = np.interp(np.linspace(0.0, pieces[-1], count + 1), pieces, t)
    knots[0], knots[-1] = 0.0, whole
    return knots


def _graded(t: Array, widths: Array) -> Array:
    """Return the widths lowered until none exceeds another by more than GRADING of its distance."""
    # min over u of w(u) + g |t - u|, from the left and from the right.
    left = np.minimum.accumulate(widths - GRADING * t) + GRADING * t
    right = np.minimum.accumulate((widths + GRADING * t)[::-1])[::-1] - GRADING * t
    return np.minimum(left, right)
