"""The first mesh of a timed motion: short pieces where the acceleration changes."""

from __future__ import annotations

import numpy as np

from hitchopt.planners.timing.profile import SpeedProfile
from hitchopt.values import Array

MAX_PIECE_SHARE = 1.0 / 12.0  # Longest piece over the duration

PIECES_PER_RAMP = 6.0
"""Number of pieces in a change of the acceleration from one limit to the other."""

MIN_PIECE = 5e-3
"""[s] Shortest piece; shorter ones lose more digits of third derivatives than they gain speed."""

MAX_INITIAL_PIECES = 200  # Approximate largest number of pieces of the first mesh
MIN_INITIAL_PIECES = 4  # Smallest number of pieces of the first mesh
GRADING = 0.4  # Largest slope of the length of pieces over time
TIME_TOLERANCE = 1e-9  # Distance over the duration below which times are equal up to rounding
ACTIVE_SHARE = 0.1  # Change of acceleration, over the largest one, above which pieces are short


def time_mesh(
    profile: SpeedProfile, ramp: float, refinement: int = 1, joints: Array | None = None
) -> Array:
    """Return the knots (K + 1,) [s] for a profile smoothed over ``ramp`` [s].

    Parameters
    ----------
    profile: toppra's optimum.
    ramp: width of the moving average, which adds to the profile's duration.
    refinement: factor of the number of pieces.
    joints: (k,), path parameters at which the speed changes, however little.
    """
    duration = profile.duration + ramp
    changes = [profile.times, profile.times + 0.5 * ramp, profile.times + ramp]
    grid = np.linspace(0.0, duration, 801)
    t = np.unique(np.clip(np.concatenate([*changes, grid]), 0.0, duration))
    t = t[np.append(True, np.diff(t) > TIME_TOLERANCE * duration)]
    # The smoothed acceleration starts or ends to change at t, and is evaluated between
    middle = 0.5 * (t[1:] + t[:-1])
    change = np.abs(profile.acceleration(middle) - profile.acceleration(middle - ramp))
    active = np.append(change > ACTIVE_SHARE * np.max(change), False)
    for start in () if joints is None else np.interp(joints, profile.s, profile.times):
        active |= (start <= t) & (t <= start + ramp)
    active[1:] |= active[:-1]
    longest = MAX_PIECE_SHARE * duration
    fine = max(ramp / PIECES_PER_RAMP, MIN_PIECE)
    widths = np.where(active, np.minimum(fine, longest), longest)
    # Limit the slope of widths to the left and to the right
    left = np.minimum.accumulate(widths - GRADING * t) + GRADING * t
    right = np.minimum.accumulate((widths + GRADING * t)[::-1])[::-1] - GRADING * t
    widths = np.maximum(np.minimum(left, right), MIN_PIECE)
    pieces_per_step = 0.5 * (1.0 / widths[1:] + 1.0 / widths[:-1]) * np.diff(t)
    pieces = np.append(0.0, np.cumsum(pieces_per_step))
    initial = max(int(np.ceil(min(pieces[-1], MAX_INITIAL_PIECES))), MIN_INITIAL_PIECES)
    evenly = np.linspace(0.0, pieces[-1], refinement * initial + 1)
    knots: Array = np.interp(evenly, pieces, t)
    knots[0] = 0.0
    knots[-1] = duration
    return knots
