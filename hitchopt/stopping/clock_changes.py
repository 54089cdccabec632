"""The search for a change of a clock's rate that keeps all limits of a plan."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from hitchopt.checks.stops import LONGEST, SHORTEST, SLOWEST, ClockLimits, start_phases
from hitchopt.motion.cutting import rests
from hitchopt.stopping.clock_profiles import NOTHING, phases_of
from hitchopt.stopping.one_way_spans import leaning_pieces
from hitchopt.trajectory.clock_phases import ClockPhases, together
from hitchopt.values import Array

LADDER = tuple(np.geomspace(SHORTEST, LONGEST, 18).tolist())
"""[s] Durations of a change of the rate by 1 that are tried first."""

SLOW = (5.0, 10.0, SLOWEST)
"""[s] Those that are tried where none of these can be."""

CARRYING = (3.0, 3.6, 4.3, 5.0, 7.0, 10.0, 14.0, SLOWEST)
"""[s] The same for plans that carry objects: slow ones leave less unbalanced, but have to fit into
steady motion."""

WAITS = (0.1, 0.2, 0.4, 0.8, 1.6)
"""[s] Times that a change may wait for."""

RESTS = 2
"""Number of the plan's own rests that a change is tried at while something is carried."""

CLOSE = 0.03
"""[s] Changes at a rest begin so much earlier: the shortest stop is almost symmetric to it then."""

STEADY = 1e-9
"""Rates closer than this are the same."""

Change = Callable[[Array, float], ClockPhases | None]
"""Function of a jet (3,) and a duration; gives the phases of a change that begins there."""


class ChangeSearch:
    """Changes of a plan's clock, verified for all of their time.

    Parameters
    ----------
    limits: of the plan.
    """

    def __init__(self, limits: ClockLimits) -> None:
        self.limits = limits
        self.motion = limits.motion
        self._leaning = leaning_pieces(limits.motion)

    def first(
        self, here: Array, left: ClockPhases, change: Change, rate: float, also: Array
    ) -> ClockPhases | None:
        """Return the first change that keeps all limits; None if there is none.

        Short ones are preferred, even where they begin later.

        Parameters
        ----------
        here: (3,) plan time [s], rate and its derivative now.
        left: what is left of the present change.
        change: gives the changes.
        rate: at their end.
        also: durations that are tried as well [s].
        """
        longer = also[(also > SHORTEST) & (also < SLOWEST)].tolist()
        slow = SLOW if self.limits.inertia is None else CARRYING
        for durations in ((*LADDER, *longer), slow):
            for before in self._bases(here, left):
                begin = before.ends[-1, :3] if len(before) else here
                made = [change(begin, duration) for duration in durations]
                options = [before.followed_by(each) for each in made if each is not None]
                found = self._shortest([each for each in options if self._may_fly(each)], rate)
                if found is not None:
                    return found
        return None

    def _bases(self, here: Array, left: ClockPhases) -> Iterator[ClockPhases]:
        """Yield what the clock does before a change: nothing, the present one's end, or waiting."""
        yield NOTHING
        if len(left):
            yield left
        elif abs(here[1]) > STEADY:
            for wait in (*WAITS, *self._until_rests(here)):
                yield phases_of(here, np.array([wait]), np.zeros(1))

    def _until_rests(self, here: Array) -> list[float]:
        """Return the times until the plan almost rests by itself [s], where it carries anything."""
        if self.limits.inertia is None:
            return []
        waits = (self.motion.drones.breaks[rests(self.motion)] - here[0]) / here[1] - CLOSE
        return sorted(waits[waits > WAITS[0]].tolist())[:RESTS]

    def _shortest(self, options: Sequence[ClockPhases], rate: float) -> ClockPhases | None:
        """Return the shortest of these that keeps all limits, with what follows it."""
        if not options:
            return None
        tailed = [made.followed_by(self._tail(made, rate)) for made in options]
        kept = self.limits.keep(together(tailed), len(tailed), sampled=True)
        order = np.argsort([float(np.sum(made.duration)) for made in options])
        for i in order[kept[order]].tolist():
            if self.limits.keep(tailed[i], 1)[0]:
                found: ClockPhases = options[i]
                return found
        return None

    def _tail(self, made: ClockPhases, rate: float) -> ClockPhases:
        """Return what follows: a run at a constant rate, or from a rest the start from there.

        The plan's own rate needs no look, nor does a rest where nothing is carried.
        """
        if abs(rate) == 1.0 or not len(made):
            return NOTHING
        begin, end = self.motion.drones.breaks[[0, -1]]
        time = made.ends[-1, :1]
        if rate == 0.0:
            carried = self.limits.inertia is not None and self.limits.inertia.during(time, time)[0]
            return start_phases(time, 2.0 * made.duration[-1:]) if carried else NOTHING
        left = end - time[0] if rate > 0.0 else time[0] - begin
        if left <= 0.0:
            return NOTHING
        jet = np.array([time[0], rate, 0.0])
        return phases_of(jet, np.array([left / abs(rate)]), np.zeros(1))

    def _may_fly(self, made: ClockPhases) -> bool:
        """Whether no cable slides back where legs lean."""
        if not len(self._leaning):
            return True
        backward = np.minimum(made.jets[:, 1], made.ends[:, 1]) < -STEADY
        spans = np.sort(np.stack([made.jets[:, 0], made.ends[:, 0]], axis=-1)[backward], axis=-1)
        begins, ends = self._leaning.T
        return not np.any((ends > spans[:, :1]) & (begins < spans[:, 1:]))
