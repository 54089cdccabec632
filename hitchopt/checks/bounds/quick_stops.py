"""Certified stops of a plan in little time, one at each of many times, nearly the shortest.

How long a stop has to take at least is read off samples by bisection; that duration and a little
more is then shown to keep all limits, or longer ones where it is not. What is found is certified as
all stops are; samples decide only what is tried.
"""

from __future__ import annotations

import numpy as np

from hitchopt.checks.bounds.clock_limits import ClockLimits
from hitchopt.checks.bounds.clock_stops import (
    DURATIONS,
    StopTable,
    rest_of,
    slow_durations,
    spaced_starts,
)
from hitchopt.checks.bounds.stop_bounds import Flags, StopBounds
from hitchopt.checks.bounds.verified_stops import balanced, shown
from hitchopt.motion.motion import Motion
from hitchopt.time_limit import check_time
from hitchopt.values import Array

WIDTH = 0.02
"""[s] Largest distance of the grid's nodes."""

LONGER = (1.01, 1.08, 1.3, 1.8, 3.0)
"""Multiples of the least duration that are tried, one after the other."""

BISECTIONS = 7
"""Number of bisections of the least duration's logarithm: it is found to within 3 %."""

VECTORS = 4000
"""Vectors of each kind that are looked at in one go."""

_W = np.array([0.0, 0.3, 0.5, 0.5, 0.75])
"""Shares of a stop's time at which samples are taken."""

_V = 1.0 - _W
_LATE = np.array([False, False, False, True, True])
_PLAN = np.where(_LATE, 0.5 - 2.0 / 3.0 * _V**3, _W - 2.0 / 3.0 * _W**3)[:, None]
_S = np.where(_LATE, 2.0 * _V**2, 1.0 - 2.0 * _W**2)[:, None, None, None]
_A = -4.0 * np.where(_LATE, _V, _W)[:, None, None, None]
_J = np.where(_LATE, 4.0, -4.0)[:, None, None, None]
"""Plan time, rate and its derivatives there, of a stop of one second (samples, …)."""


def quick_stop_table(motion: Motion) -> StopTable:
    """Return stops that keep all limits of a motion, by a few per cent longer than need be."""
    starts, clock = spaced_starts(motion), ClockLimits(motion)
    slow = slow_durations(motion, carried=clock.inertia is not None)
    span = np.array([DURATIONS[0], slow[-1] if slow else DURATIONS[-1]])
    rounds = BISECTIONS + 2 * bool(slow)
    bounds = StopBounds(clock, WIDTH)
    durations = np.full(len(starts), np.inf)
    left = np.arange(len(starts))
    least = _least(bounds, starts, span, rounds)
    for factor in LONGER:
        check_time()
        tried = factor * least[left]
        kept = shown(bounds, starts[left], tried)
        durations[left[kept]] = tried[kept]
        left = left[~kept]
        if not len(left):
            break
    return StopTable(rest_of(motion), starts, durations)


def _least(bounds: StopBounds, starts: Array, span: Array, rounds: int) -> Array:
    """Return durations (m,) [s] below which samples break a limit that is sampled."""
    least = np.full(len(starts), span[0])
    left = np.flatnonzero(~_kept_at_samples(bounds, starts, least))
    low, high = (np.full(len(left), np.log(each)) for each in span)
    for _ in range(rounds if len(left) else 0):
        middle = 0.5 * (low + high)
        kept = _kept_at_samples(bounds, starts[left], np.exp(middle))
        high = np.where(kept, middle, high)
        low = np.where(kept, low, middle)
    least[left] = np.exp(high)
    return least


def _kept_at_samples(bounds: StopBounds, starts: Array, durations: Array) -> Flags:
    """Return (m,) whether stops keep the limits of acceleration and jerk, and a balance, there."""
    count = max(1, VECTORS // (len(_W) * len(bounds.limits.motion.team.mass)))
    parts = [slice(first, first + count) for first in range(0, max(1, len(starts)), count)]
    kept = np.concatenate([_kept(bounds, starts[part], durations[part]) for part in parts])
    kept &= balanced(bounds.limits, starts, durations)
    return kept


def _kept(bounds: StopBounds, starts: Array, durations: Array) -> Flags:
    """Return the same for so few stops that they stay within the caches."""
    limits, grid = bounds.limits.motion.requirements.limits, bounds.grid
    node = grid.node_before(starts + _PLAN * durations)
    x1, x2, x3 = (grid.values[order][node] for order in range(3))
    T = durations[:, None, None]
    a, j = _A / T, _J / T**2
    acceleration = _S**2 * x2 + a * x1
    jerk = _S**3 * x3 + 3.0 * _S * a * x2 + j * x1
    return _within(acceleration, limits.acceleration) & _within(jerk, limits.jerk)


def _within(vectors: Array, limit: float) -> Flags:
    """Return (m,) whether all vectors (samples, m, drones, 3) are no longer than a limit."""
    squared = np.einsum("smdx,smdx->smd", vectors, vectors)
    found: Flags = squared.max(axis=(0, 2)) <= limit * limit
    return found
