"""A plan on a common clock that can be slowed, paused, resumed, turned back and sought in."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from hitchopt.checks.stops import ClockLimits, StopTable, stop_table
from hitchopt.errors import InfeasibleError, InputError
from hitchopt.motion.motion import Motion
from hitchopt.one_line import OneLine
from hitchopt.stopping.clock_changes import STEADY, Change, ChangeSearch
from hitchopt.stopping.clock_profiles import NOTHING, phases_of, to_rate, to_time
from hitchopt.stopping.clock_remedies import other_rate, other_rests
from hitchopt.stopping.one_way_spans import earliest_return
from hitchopt.stopping.sampler import Sampler, Setpoints
from hitchopt.trajectory.clock_phases import ClockPhases
from hitchopt.values import Array, finite, not_negative

RATES = (1.0, 0.9, 0.7, 0.5)
"""Largest rates that are tried on the way to a plan time."""


class Player(OneLine):
    """A plan flown on a clock that all drones share.

    Paths, separations, clearances and crossings are the plan's at every rate. Every change of the
    rate is verified for all of its time before it begins: acceleration, jerk, thrust, tilt and
    body rates keep their limits, and what is carried its balance. Where a change cannot begin at
    once, the clock runs on until it can.

    Parameters
    ----------
    plan: a plan or its motion.
    time: plan time to start at [s].
    rate: of the clock at the start, from -1 to 1.
    like: another player of this plan: what it has computed is not computed again.

    Raises
    ------
    InputError: a time outside the plan, a rate out of its range, or a player of another plan.
    """

    def __init__(
        self,
        plan: object,
        time: float = 0.0,
        rate: float = 1.0,
        *,
        like: Player | None = None,
    ) -> None:
        motion = getattr(plan, "motion", plan)
        if not isinstance(motion, Motion):
            raise InputError("plan", plan, "a Plan or a Motion", "solve or load one")
        other: object = like
        if other is not None and not (isinstance(other, Player) and other.motion is motion):
            raise InputError("like", like, "a Player of this plan", "leave it out")
        self.motion: Motion = motion
        self._like = like
        self.limits: ClockLimits = ClockLimits(motion) if like is None else like.limits
        self._search: ChangeSearch = ChangeSearch(self.limits) if like is None else like._search
        self._sampler: Sampler = Sampler(motion.drones) if like is None else like._sampler
        self._begin, self._end = (float(b) for b in motion.drones.breaks[[0, -1]])
        self._check_within("time", time)
        self._stops: StopTable | None = None
        self._now = 0.0
        self._schedule(np.array([[time, _checked_rate(rate), 0.0, 0.0]]), np.zeros(1))

    def _parts(self) -> Iterator[str]:
        yield f"{len(self.motion.team.drone_names)} drones"
        yield f"{self.motion.duration:.4g} s"

    @property
    def stops(self) -> StopTable:
        """The stops from full rate; ``stoppable`` is the longest time until one of them rests."""
        if self._stops is None:
            like = self._like
            self._stops = stop_table(self.motion, self.limits) if like is None else like.stops
        return self._stops

    @property
    def time(self) -> float:
        """Plan time [s]."""
        return self._jet()[0]

    @property
    def clock_rate(self) -> float:
        """Plan time per time, 1 where the plan is flown as it is; negative on the way back."""
        return self._jet()[1]

    @property
    def resting(self) -> bool:
        """Whether the clock stands still and is not about to move."""
        return self._now >= self._begins[-1] and abs(self.clock_rate) <= STEADY

    @property
    def ahead(self) -> ClockPhases:
        """What is left of the present change of the clock's rate."""
        if self._now >= self._begins[-1] or self.time in (self._begin, self._end):
            return NOTHING
        here = _last(self._begins, self._now)
        edges = [self._now, *self._begins[here + 1 :]]
        jerks = [row[3] for row in self._rows[here:-1]]
        return phases_of(np.array(self._jet()[:3]), np.diff(edges), np.array(jerks))

    def step(self, seconds: float) -> Setpoints:
        """Let time pass [s] and return the setpoints then.

        Raises
        ------
        InputError: a time that is negative or not finite.
        """
        self._now += not_negative("seconds", seconds)
        return self._sampler.at(*self._jet())

    def pause(self) -> float:
        """Stop as soon as the limits allow; return the time until rest [s]."""
        return self.rate(0.0)

    def resume(self) -> float:
        """Return to the rate of the plan; return the time until it is reached [s]."""
        return self.rate(1.0)

    def rate(self, rate: float) -> float:
        """Change to a constant rate from -1 to 1 as soon as it can be; return after how long [s].

        A stop that is nowhere possible earlier ends at the end of the plan.

        Raises
        ------
        InputError: a rate out of its range.
        InfeasibleError: no such change was found to keep all limits, or cables would slide back
            where legs lean against friction; the clock goes on as before.
        """
        rate = _checked_rate(rate)
        if rate < 0.0 and earliest_return(self.motion, self.time) > self._begin:
            words = "legs have leaned against friction on the way; back() rests after that"
            raise InfeasibleError([], f"a rate of {rate:g} from t = {self.time:.4g} s: {words}")

        def change(jet: Array, duration: float) -> ClockPhases | None:
            difference = max(abs(rate - jet[1]), 0.25 * abs(jet[2]) * duration, 1e-3)
            return to_rate(jet, rate, 2.0 / duration * difference, 4.0 / duration**2 * difference)

        found = self._first(change, rate)
        if rate == 0.0:
            found = self._sooner_stop(found)
        remedy = partial(other_rate, self.limits, rate, self.time)
        return self._adopt(found, f"a rate of {rate:g}", remedy)

    def back(self) -> float:
        """Fly the plan backward at full rate; return the time until that is reached [s].

        Where legs have leaned against friction on the way, the clock rests after that: flown
        backward, cables slide the other way and legs would lean wrongly.

        Raises
        ------
        InfeasibleError: as rate.
        """
        until = earliest_return(self.motion, self.time)
        return self.rate(-1.0) if until <= self._begin else self.seek(until)

    def seek(self, time: float) -> float:
        """Go to a plan time on the clock and rest there; return the time it takes [s].

        Raises
        ------
        InputError: a time outside the plan.
        InfeasibleError: as rate.
        """
        self._check_within("time", time)
        return self._sought(time, self._way_to(time))

    def path(self, time: float, goal: float) -> ClockPhases:
        """Return the certified clock from rest at one plan time to rest at another one [s].

        The player rests at ``goal`` then.

        Raises
        ------
        InputError, InfeasibleError: as seek.
        """
        self._check_within("time", time)
        self._check_within("goal", goal)
        self._schedule(np.array([[time, 0.0, 0.0, 0.0]]), np.array([self._now]))
        found = self._way_to(goal)
        self._sought(goal, found)
        self._schedule(np.array([[goal, 0.0, 0.0, 0.0]]), np.array([self._now]))
        return NOTHING if found is None else found

    def _check_within(self, key: str, time: float) -> None:
        if not self._begin <= finite(key, time) <= self._end:
            raise InputError(key, time, f"within [0, {self._end:g}] s", "stay within the plan")

    def _way_to(self, time: float) -> ClockPhases | None:
        """Return the first change that ends at rest at a plan time [s]."""
        for fastest in RATES:

            def change(jet: Array, duration: float, most: float = fastest) -> ClockPhases | None:
                return to_time(jet, time, most, 2.0 / duration, 4.0 / duration**2)

            found = self._first(change, 0.0)
            if found is not None:
                return found
        return None

    def _first(self, change: Change, rate: float) -> ClockPhases | None:
        """Return the first change to a rate that keeps all limits; None if there is none."""
        stopped = 2.0 * np.diff(self._begins[-2:])  # as long, the clock can start again
        here = np.array(self._jet()[:3])
        return self._search.first(here, self.ahead, change, rate, also=stopped)

    def _sooner_stop(self, found: ClockPhases | None) -> ClockPhases | None:
        """Return the stop of the table, or the run to the end, if it comes to rest sooner."""
        time, rate, slope, _ = self._jet()
        left = self.ahead
        if abs(rate - 1.0) <= STEADY and abs(slope) <= STEADY:
            left = NOTHING  # a change that has only begun is given up
        elif len(left):
            time, rate, slope, _ = left.ends[-1].tolist()
        options = [] if found is None else [found]
        if abs(rate - 1.0) <= STEADY and abs(slope) <= STEADY:
            start, duration = self.stops.after(time)
            seconds = [start - time, *([0.5 * duration] * 2 if duration else [])]
            jerks = [0.0, *([-4.0 / duration**2, 4.0 / duration**2] if duration else [])]
            kept = np.array(seconds) > 0.0
            own = phases_of(
                np.array([time, 1.0, 0.0]), np.array(seconds)[kept], np.array(jerks)[kept]
            )
            options.append(left.followed_by(own))
        elif not options and rate != 0.0:
            ahead = self._end - time if rate > 0.0 else time - self._begin
            run = np.array([time, rate, 0.0]), np.array([ahead / abs(rate)]), np.zeros(1)
            options.append(left.followed_by(phases_of(*run)))
        return min(options, key=lambda made: float(np.sum(made.duration)), default=found)

    def _sought(self, goal: float, found: ClockPhases | None) -> float:
        def remedy() -> str:
            return other_rests(self.limits, self.stops, goal)

        return self._adopt(found, f"plan time {goal:g} s", remedy)

    def _adopt(self, found: ClockPhases | None, goal: str, remedy: Callable[[], str]) -> float:
        if found is None:
            words = "no change of the clock was found that keeps all limits"
            raise InfeasibleError([], f"{goal} from t = {self.time:.4g} s: {words}; {remedy()}")
        if not len(found):
            time, rate, _, _ = self._jet()
            self._schedule(np.array([[time, rate, 0.0, 0.0]]), np.array([self._now]))
            return 0.0
        last = found.ends[-1]
        last[2:] = 0.0
        last[1] = 0.0 if abs(last[1]) <= STEADY else last[1]
        begins = self._now + np.concatenate([[0.0], np.cumsum(found.duration)])
        self._schedule(np.vstack([found.jets, last]), begins)
        return float(begins[-1] - self._now)

    def _schedule(self, jets: Array, times: Array) -> None:
        """Set the phases from now on; the last one has no end."""
        self._rows = jets.tolist()
        self._begins = times.tolist()

    def _jet(self) -> tuple[float, float, float, float]:
        """Return plan time, rate and its derivatives now; all rest beyond the plan's ends."""
        i = _last(self._begins, self._now)
        p, v, a, j = self._rows[i]
        dt = self._now - self._begins[i]
        time = p + dt * (v + dt * (a / 2.0 + dt * j / 6.0))
        rate = v + dt * (a + dt * j / 2.0)
        if time >= self._end and rate >= 0.0:
            return self._end, 0.0, 0.0, 0.0
        if time <= self._begin and rate <= 0.0:
            return self._begin, 0.0, 0.0, 0.0
        return time, rate, a + dt * j, j


def _last(times: list[float], now: float) -> int:
    """Return the index of the last time that is not after ``now``."""
    return max(bisect_right(times, now) - 1, 0)


def _checked_rate(rate: float) -> float:
    if abs(finite("rate", rate)) > 1.0:
        raise InputError("rate", rate, "from -1 to 1", "plans are as fast as their limits allow")
    return float(rate)
