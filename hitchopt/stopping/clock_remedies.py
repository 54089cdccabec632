"""What to ask a player for in place of what it refuses while something is carried."""

from __future__ import annotations

import math

import numpy as np

from hitchopt.checks.stops import ClockLimits, StopTable
from hitchopt.motion.cutting import rests

USUAL = "ask later, for a smaller rate, or plan with limits.reserve below 1"


def other_rate(limits: ClockLimits, rate: float, time: float) -> str:
    """Return what to ask for in place of a rate from a plan time [s] on."""
    begin, end = limits.breaks[[0, -1]]
    ends = (time, end) if rate > 0.0 else (begin, time)
    least = 0.0 if limits.inertia is None else limits.inertia.least_rate(*ends)
    if abs(rate) >= least:
        return USUAL
    least = math.ceil(100.0 * least + 0.1) / 100.0
    return f"ask for {math.copysign(least, rate):g} or faster: what is carried has inertia"


def other_rests(limits: ClockLimits, stops: StopTable, time: float) -> str:
    """Return the rests to seek in place of a plan time [s]: the nearest before and after it."""
    if limits.inertia is None or not limits.inertia.during(np.array([time]), np.array([time]))[0]:
        return USUAL
    known = np.isfinite(stops.durations)
    made = stops.starts[known] + 0.5 * stops.durations[known]
    every = np.append(made, limits.breaks[rests(limits.motion)])
    nearest = np.max(every[every <= time]), np.min(every[every >= time])
    words = " or ".join(f"{each:.3f} s" for each in nearest)
    return f"seek {words}: what is carried has inertia"
