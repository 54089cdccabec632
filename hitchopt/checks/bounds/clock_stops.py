"""Certified stops of the common clock: from where on it may slow down from full rate to rest.

A stop of duration T slows the clock's rate from 1 to 0 by two phases of constant jerk ∓4/T², the
shortest that a bound of that jerk allows; it takes 1/2 T of plan time. A command may wait, the plan
running on, until a stop can begin; a plan that ends at rest has reached rest there in any case.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.checks.bounds.clock_limits import ClockLimits
from hitchopt.checks.bounds.stop_bounds import StopBounds
from hitchopt.checks.bounds.verified_stops import balanced, shown
from hitchopt.motion.cutting import REST
from hitchopt.motion.motion import Motion
from hitchopt.values import Array, Indices

USUAL_DURATIONS = (0.1, 0.2, 0.3, 0.4, 0.52, 0.68, 0.88)
"""[s] Durations of stops that are tried first; the shortest is the shortest there is."""

LONG_DURATIONS = (1.15, 1.5, 1.9, 2.5)
"""[s] Durations that are tried where none of these can be."""

DURATIONS = USUAL_DURATIONS + LONG_DURATIONS

SLOW_DURATIONS = (5.0, 10.0, 20.0)
"""[s] Longer ones, for plans with a reserve: a small one allows no shorter stops."""

CARRYING_DURATIONS = (3.0, 3.6, 4.3, 5.0, 7.0, 10.0, 14.0, 20.0)
"""[s] The same for plans that carry objects: slow ones leave less unbalanced, but have to fit into
steady motion."""

CUTS = 6
"""Parts, equal in logarithms, of the interval in which the shortest duration lies: it is found to
within 5 %."""

LATEST = 1.5
"""Longest stops, relative to the time until the plan rests: it rests sooner than these, but shorter
ones may begin close to those that are a little too long."""

SPACING = 0.07
"""[s] Distance of stops that are looked at first, for plans of up to ``SPACING * STARTS``."""

STARTS = 10_000
"""Largest number of stops that are looked at first."""

MORE = 20_000
"""Largest number of stops that are put between them in a round."""

FINEST = 0.025
"""Distance of stops at which no more are put between them, relative to the time to rest."""

DECISIVE = 0.97
"""Share of the longest time to rest from which on stops are put closer to each other."""

PARTS = 6
"""Largest number of parts into which stretches between stops are divided in one round."""

ROUNDS = 4
"""Maximum rounds in which stops are put closer."""


FEW = 60
"""Pairs of a stop and a drone up to which all durations left are tried in one go, once the shortest
of each stop have been."""


@dataclass(frozen=True, eq=False)
class StopTable:
    """Stops that keep all limits, by the plan time at which they begin.

    Attributes
    ----------
    end: plan time at which the plan ends [s].
    starts: (stops,) [s], increasing.
    durations: (stops,) [s]; infinite where no stop was found to begin.
    """

    end: float
    starts: Array
    durations: Array

    @property
    def waits(self) -> Array:
        """(stops,) [s]: time from each start to the first rest, its own stop or a later one's."""
        rests = self.starts + self.durations
        first = np.minimum.accumulate(rests[::-1])[::-1]
        found: Array = np.minimum(first, self.end) - self.starts
        return found

    @property
    def chosen(self) -> Indices:
        """(stops,): index of the stop that is at rest first for a command at each start."""
        rests = self.starts + self.durations
        index = np.arange(len(rests))
        first = np.minimum.accumulate(rests[::-1])[::-1]
        later = np.where(rests == first, index, len(rests) - 1)
        found: Indices = np.minimum.accumulate(later[::-1])[::-1]
        return found

    @property
    def longest(self) -> tuple[Array, Array]:
        """Longest time to rest [s] from each stretch between starts, (stops,), and its begin [s].

        The last stretch lies between the last start and the end of the plan.
        """
        begins = np.concatenate([[min(0.0, self.starts[0])], self.starts])
        reach = np.append(self.starts + self.waits, self.end)
        return reach - begins, begins

    def after(self, time: float) -> tuple[float, float]:
        """Return start and duration [s] of the stop that is first at rest for a command at a time.

        Where running on to the end of the plan is sooner, the end and zero.
        """
        first = int(np.searchsorted(self.starts, time))
        rests = self.starts[first:] + self.durations[first:]
        if not len(rests) or np.min(rests) >= self.end:
            return self.end, 0.0
        best = first + int(np.argmin(rests))
        return float(self.starts[best]), float(self.durations[best])


def stop_table(
    motion: Motion, limits: ClockLimits | None = None, *, decisive: bool = False
) -> StopTable:
    """Return stops that keep all limits of a motion, close to each other where these are longest.

    The end counts as rest only if the drones rest there.

    Parameters
    ----------
    motion: the plan.
    limits: of the motion, where they are known.
    decisive: find only those durations closely on which the longest time to rest depends.
    """
    bounds = StopBounds(limits or ClockLimits(motion))
    end = float(motion.drones.breaks[-1])
    rest = rest_of(motion)
    starts = spaced_starts(motion)
    low, high = _bracketed(bounds, starts, rest)
    for last in (*(False,) * ROUNDS, True):
        table = _narrowed(bounds, starts, low, high, rest, decisive=decisive)
        longest, begins = table.longest
        ends = np.append(table.starts, end)
        most = np.max(longest)
        if not np.isfinite(most):
            most = np.max(longest, initial=0.0, where=np.isfinite(longest))
        deciding = longest >= DECISIVE * most
        # Stops may become shorter near these commands, and near the stops that they lead to.
        chosen = table.chosen[np.flatnonzero(deciding[:-1])]
        near = deciding.copy()
        near[chosen] = near[chosen + 1] = True
        wide = near & (ends - begins > FINEST * most)
        parts = np.minimum(np.ceil((ends - begins)[wide] / (FINEST * most)), PARTS).astype(int)
        if last or not np.any(wide) or np.sum(parts - 1) > MORE:
            break
        share = np.concatenate([np.arange(1, count) / count for count in parts])
        more = np.repeat(begins[wide], parts - 1)
        more += share * np.repeat((ends - begins)[wide], parts - 1)
        columns = np.stack([starts, low, high]), np.stack([more, *_bracketed(bounds, more, rest)])
        joined = np.concatenate(columns, axis=1)
        starts, low, high = joined[:, np.argsort(joined[0])]
    return table


def spaced_starts(motion: Motion) -> Array:
    """Return the times (m,) [s] of stops that are looked at first."""
    begin, end = float(motion.drones.breaks[0]), float(motion.drones.breaks[-1])
    count = max(2, int(min(np.ceil((end - begin) / SPACING), STARTS)) + 1)
    return np.linspace(begin, end, count)[:-1]


def rest_of(motion: Motion) -> float:
    """Return the end of a motion [s]; infinite if drones move or accelerate there."""
    moving = max(np.max(np.abs(motion.drones.ends(order)[1][-1])) for order in (1, 2))
    return float(motion.drones.breaks[-1]) if moving <= REST else np.inf


def _most(bounds: StopBounds, starts: Array, rest: float) -> Array:
    """Return durations (m,) [s] from which on none is looked for.

    None is looked for that would take far longer than running on to the plan's ``rest`` [s], unless
    a reserve lets stops begin at any time.
    """
    if bounds.limits.motion.requirements.limits.reserve < 1.0:
        return np.full(len(starts), np.inf)
    most: Array = LATEST * (rest - starts)
    return most


def slow_durations(motion: Motion, *, carried: bool) -> tuple[float, ...]:
    """Return long durations that are tried [s], with a reserve or something that is carried."""
    if carried:
        return CARRYING_DURATIONS
    return SLOW_DURATIONS if motion.requirements.limits.reserve < 1.0 else ()


def _bracketed(bounds: StopBounds, starts: Array, rest: float) -> tuple[Array, Array]:
    """Return durations (m,) [s] of stops, infinite where none is found, and smaller ones [s].

    The shortest durations are no shorter than the smaller ones; they are the same where it is known
    or where there is none. The smaller ones come first.
    """
    high = np.full(len(starts), np.inf)
    low = np.full(len(starts), DURATIONS[0])
    most = _most(bounds, starts, rest)
    limits = bounds.limits
    slow = slow_durations(limits.motion, carried=limits.inertia is not None)
    for group in (USUAL_DURATIONS, LONG_DURATIONS, slow):
        left = np.flatnonzero(np.isinf(high) & (min(group, default=np.inf) < most))
        if len(left):
            tried = np.tile(group, (len(left), 1))
            low[left], high[left] = _first(bounds, starts[left], low[left], tried, most[left])
    return np.where(np.isinf(high), high, low), high


def _narrowed(
    bounds: StopBounds, starts: Array, low: Array, high: Array, rest: float, *, decisive: bool
) -> StopTable:
    """Find durations between given ones (m,), and set both to these.

    Parameters
    ----------
    decisive: only of the stops on which the longest times to rest may depend.
    """
    while len(left := _wanted(rest, starts, low, high, decisive=decisive)):
        ratio = (high[left] / low[left])[:, None]
        tried = low[left, None] * ratio ** (np.arange(1, CUTS + 1) / CUTS)
        tried[:, -1] = high[left]
        most = _most(bounds, starts[left], rest)
        found = _first(bounds, starts[left], low[left], tried[:, :-1], most)[1]
        low[left] = high[left] = np.fmin(high[left], found)
    return StopTable(rest, starts, high)


def _wanted(rest: float, starts: Array, low: Array, high: Array, *, decisive: bool) -> Indices:
    """Return the stops whose durations are to be found between ``low`` and ``high``."""
    open_ = low < high
    shortest, longest = (StopTable(rest, starts, each).longest[0] for each in (low, high))
    if decisive and np.all(np.isfinite(longest)):
        # A stretch whose longest time to rest may decide depends on the stops at rest before the
        # first one that is known; times only become shorter, to no less than the shortest.
        deciding = longest[:-1] >= DECISIVE * np.max(shortest)
        first = np.minimum.accumulate((starts + high)[::-1])[::-1]
        reach = np.maximum.accumulate(np.where(deciding, first, -np.inf))
        open_ &= starts + low < reach
    return np.flatnonzero(open_)


def _first(
    bounds: StopBounds, starts: Array, low: Array, tried: Array, most: Array
) -> tuple[Array, Array]:
    """Return the durations before and at the first of those ``tried`` (m, k) that can be.

    Those from ``most`` (m,) on are left out. Where none can be, the last one and infinity.
    """
    may = tried < most[:, None]
    stop, which = np.nonzero(may)
    may[stop, which] = bounds.may_keep(starts[stop], tried[stop, which])
    stop, which = np.nonzero(may)
    may[stop, which] = balanced(bounds.limits, starts[stop], tried[stop, which])
    first = np.full(len(starts), tried.shape[1])
    left = np.flatnonzero(np.any(may, axis=1))
    drones, begun = len(bounds.limits.hover[0]), False
    while len(left):
        now = may[left]
        if not begun or np.sum(now) * drones > FEW:  # one of each stop
            now &= np.cumsum(now, axis=1) == 1
        begun = True
        stop, which = np.nonzero(now)
        kept = np.zeros_like(now)
        kept[stop, which] = shown(bounds, starts[left[stop]], tried[left[stop], which])
        found = np.any(kept, axis=1)
        first[left[found]] = np.argmax(kept[found], axis=1)
        may[left] &= ~now
        left = left[~found & np.any(may[left], axis=1)]
    steps = np.column_stack([np.minimum(low, tried[:, 0]), tried, np.full(len(starts), np.inf)])
    row = np.arange(len(starts))
    return steps[row, first], steps[row, first + 1]
