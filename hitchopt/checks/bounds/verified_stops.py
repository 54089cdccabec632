"""Whether stops of the common clock can be flown, with all that a plan asks of its clock."""

from __future__ import annotations

import numpy as np

from hitchopt.checks.bounds.clock_limits import ClockLimits
from hitchopt.checks.bounds.stop_bounds import Flags, StopBounds
from hitchopt.trajectory.clock_phases import ClockPhases, advanced
from hitchopt.values import Array


def stop_phases(start: Array, duration: Array) -> ClockPhases:
    """Return the phases of stops that begin at plan times ``start`` (m,) at rate 1."""
    return _between(start, duration, 1.0)


def start_phases(start: Array, duration: Array) -> ClockPhases:
    """Return the phases that lead from rest at plan times (m,) back to rate 1, as stops do."""
    return _between(start, duration, 0.0)


def _between(start: Array, duration: Array, rate: float) -> ClockPhases:
    """Return the phases from one of the rates 0 and 1 to the other."""
    start, duration = np.broadcast_arrays(np.asarray(start, float), np.asarray(duration, float))
    jerk = (4.0 - 8.0 * rate) / duration**2
    zero = np.zeros_like(start)
    first = np.stack([start, zero + rate, zero, jerk], axis=-1)
    second = advanced(first, 0.5 * duration)
    second[..., 3] = -jerk
    jets = np.stack([first, second], axis=1).reshape(-1, 4)
    return ClockPhases(np.repeat(np.arange(len(start)), 2), jets, np.repeat(0.5 * duration, 2))


def shown(bounds: StopBounds, starts: Array, durations: Array) -> Flags:
    """Return (m,) whether stops are shown to keep all limits.

    While something is carried, the clock can also start again from their rests.
    """
    kept, limits = bounds.show(starts, durations), bounds.limits
    if limits.motion.requirements.limits.body_rate is not None:
        left = np.flatnonzero(kept)
    elif limits.inertia is not None:
        left = np.flatnonzero(kept & limits.inertia.during(starts, starts + 0.5 * durations))
    else:
        return kept
    kept[left] = limits.keep(stop_phases(starts[left], durations[left]), len(left))
    if limits.inertia is not None:
        rests = starts + 0.5 * durations
        left = np.flatnonzero(kept & limits.inertia.during(rests, rests))
        kept[left] = limits.keep(start_phases(rests[left], durations[left]), len(left))
    return kept


def balanced(limits: ClockLimits, starts: Array, durations: Array) -> Flags:
    """Return (m,) whether stops keep the balance of what is carried, at samples."""
    if limits.inertia is None:
        return np.ones(len(starts), dtype=np.bool_)
    clocks = stop_phases(starts, durations)
    cells, pieces = clocks.cut(limits.breaks)
    flown = pieces < len(limits.breaks) - 1
    cells = cells.taken(flown)
    kept = np.ones(len(starts), dtype=np.bool_)
    kept[cells.owner[limits.inertia.broken(cells, pieces[flown], sampled=True)]] = False
    return kept
