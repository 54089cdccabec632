"""A plan on a common clock that can be slowed, paused, resumed, turned back and sought in.

The clock's rate changes by phases of constant jerk. Changes of many durations are made, to begin
now or later; the soonest that is verified for all of its time is flown.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from math import comb

import numpy as np

from hitchopt.checks.stops import SHORTEST, SLOWEST, ClockLimits, StopTable, stop_table
from hitchopt.errors import InfeasibleError, InputError, OneLine
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.clock_phases import ClockPhases, advanced, together
from hitchopt.values import Array, finite, not_negative

RATES = (1.0, 0.7, 0.4)
"""Rates that are tried on the way to a plan time."""

LADDER = tuple(np.geomspace(SHORTEST, SLOWEST, 27).tolist())
"""[s] Durations of a change of the rate by 1 that are tried."""

WAITS = (0.1, 0.2, 0.4, 0.8, 1.6)
"""[s] Delays before a change that cannot begin at once."""

BATCH = 24
"""Number of changes that are verified together."""

STEADY = 1e-9
"""Rates closer than this are the same, and plan times [s] closer than this to an end are there."""

BRIEF = 1e-9
"""[s] Shorter phases are dropped."""

ALIKE = 1e-9
"""[N] Legs that pull with tensions of a smaller difference do not lean."""

STILL = 1e-6
"""[m] Legs whose lengths differ by less on a piece do not slide."""

Change = Callable[[Array, float], Iterator[ClockPhases]]
"""Function of a jet (3,) and a duration; yields changes that begin there."""


@dataclass(frozen=True, eq=False)
class Setpoints(OneLine):
    """Where a player has its drones be now.

    Attributes
    ----------
    time: plan time [s].
    rate: of the clock, 1 where the plan is flown as it is.
    positions, velocities, accelerations, jerks: (drones, 3) [m], [m/s], [m/s²], [m/s³], of real
        time.
    """

    time: float
    rate: float
    positions: Array
    velocities: Array
    accelerations: Array
    jerks: Array


class Player(OneLine):
    """A plan flown on a clock that all drones share.

    Paths, separations, clearances and crossings are the plan's at every rate. Every change of the
    rate is verified for all of its time before it begins: acceleration, jerk, thrust, tilt and
    body rates keep their limits, and what is carried its balance. Where a change cannot begin at
    once, the clock runs on until it can.

    Parameters
    ----------
    plan: a plan or its motion; what players of the same motion compute is computed once.
    time: plan time to start at [s].
    rate: of the clock at the start, from -1 to 1.

    Raises
    ------
    InputError: a time outside the plan, or a rate out of its range.
    """

    def __init__(self, plan: object, time: float = 0.0, rate: float = 1.0) -> None:
        motion = getattr(plan, "motion", plan)
        if not isinstance(motion, Motion):
            raise InputError("plan", plan, "a Plan or a Motion", "solve or load one")
        self.motion: Motion = motion
        self._known = _known(motion)
        self._begin, self._end = (float(b) for b in motion.drones.breaks[[0, -1]])
        self._check_within("time", time)
        self._now = 0.0
        self._jets: Array = np.zeros((1, 4))
        self._begins = [0.0]
        self._stand(time, _checked_rate(rate))

    def _parts(self) -> Iterator[str]:
        yield f"{len(self.motion.team.drone_names)} drones"
        yield f"{self.motion.duration:.4g} s"

    @property
    def stops(self) -> StopTable:
        """The stops from full rate; ``stoppable`` is the longest time until one of them rests."""
        return self._known.stops

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
        following = bisect_right(self._begins, self._now)
        if following == len(self._begins):
            return NOTHING
        jets = np.vstack([self._jet(), self._jets[following:-1]])
        return _phases(jets, np.diff([self._now, *self._begins[following:]]))

    def step(self, seconds: float) -> Setpoints:
        """Let time pass [s] and return the setpoints then.

        Raises
        ------
        InputError: a time that is negative or not finite.
        """
        self._now += not_negative("seconds", seconds)
        if not self._begin <= self.time <= self._end:
            self._stand(min(max(self.time, self._begin), self._end), 0.0)
        time, rate, slope, jerk = self._jet()
        return Setpoints(time, rate, *self._known.sampler.values(time, rate, slope, jerk))

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
        found = self._first(partial(_to_rate, rate), rate)
        if rate == 0.0:
            options = [self._certain_stop(), *([] if found is None else [found])]
            found = min(options, key=_seconds)
        return self._adopt(found, f"a rate of {rate:g}")

    def back(self) -> float:
        """Fly the plan backward at full rate; return the time until that is reached [s].

        Where legs have leaned against friction on the way, the clock rests after that: flown
        backward, cables slide the other way and legs would lean wrongly.

        Raises
        ------
        InfeasibleError: as rate.
        """
        leaning, time = self._known.leaning, self.time
        until = float(np.max(leaning[leaning[:, 0] < time, 1], initial=self._begin))
        return self.seek(until) if self._begin < until < time else self.rate(-1.0)

    def seek(self, time: float) -> float:
        """Go to a plan time on the clock and rest there; return the time it takes [s].

        Raises
        ------
        InputError: a time outside the plan.
        InfeasibleError: as rate.
        """
        self._check_within("time", time)
        return self._adopt(self._first(partial(_to_time, time), 0.0), f"plan time {time:g} s")

    def _check_within(self, key: str, time: float) -> None:
        if not self._begin <= finite(key, time) <= self._end:
            raise InputError(key, time, f"within [0, {self._end:g}] s", "stay within the plan")

    def _first(self, change: Change, rate: float) -> ClockPhases | None:
        """Return the soonest change to a rate that is verified; None if there is none."""
        known, here = self._known, np.array(self._jet()[:3])
        again = [float(2.0 * each) for each in np.diff(self._begins[-2:])]  # as long as the stop
        options = []
        for before in self._delays(rate):
            begin = before.ends[-1, :3] if len(before) else here
            for duration in (*LADDER, *again):
                for made in change(begin, duration):
                    whole = before.followed_by(made)
                    tailed = whole.followed_by(self._tail(whole, rate))
                    if not known.slides_back(tailed):
                        options.append((whole, whole if abs(rate) == 1.0 else tailed))
        options.sort(key=lambda option: _seconds(option[0]))
        for first in range(0, len(options), BATCH):
            batch = options[first : first + BATCH]
            kept = known.limits.keep(together([tailed for _, tailed in batch]), len(batch))
            if np.any(kept):
                return batch[int(np.argmax(kept))][0]
        return None

    def _delays(self, rate: float) -> Iterator[ClockPhases]:
        """Yield what precedes a change: nothing, the rest of the present one, a wait, a stop."""
        time, now, left = self.time, self.clock_rate, self.ahead
        yield NOTHING
        if len(left):
            yield left
        elif abs(now) > STEADY:
            yield from (_steady(time, now, wait) for wait in WAITS)
        if rate != 1.0 and not self.resting:
            yield self._certain_stop()

    def _tail(self, made: ClockPhases, rate: float) -> ClockPhases:
        """Return what follows: a run at a constant rate, or from a rest the start from there.

        Where nothing is carried any rest will do. The plan's own rate needs no look.
        """
        if not len(made):
            return NOTHING
        time = made.ends[-1, :1]
        if rate == 0.0:
            carried = self._known.limits.carries(time, time)[0]
            rest = np.array([*time, 0.0, 0.0])
            return _to_rates(rest, [1.0], 2.0 * made.duration[-1]) if carried else NOTHING
        return self._run(float(time[0]), rate)

    def _run(self, time: float, rate: float) -> ClockPhases:
        """Return the run at a constant rate from a plan time to the end, or back to the start."""
        left = (self._end if rate > 0.0 else self._begin) - time
        return _steady(time, rate, left / rate) if left / rate > 0.0 else NOTHING

    def _certain_stop(self) -> ClockPhases:
        """Return a stop that needs no look: what is under way, then one of the table or a run."""
        left = self.ahead
        time, rate = (left.ends[-1].tolist() if len(left) else self._jet())[:2]
        if abs(rate) <= STEADY:
            return left
        if rate < 1.0 - STEADY:
            return left.followed_by(self._run(time, rate))
        start, duration = self.stops.after(time)
        run = left.followed_by(_steady(time, 1.0, start - time) if start > time else NOTHING)
        full = np.array([start, 1.0, 0.0])
        return run.followed_by(_to_rates(full, [0.0], duration)) if duration > 0.0 else run

    def _adopt(self, found: ClockPhases | None, goal: str) -> float:
        """Fly a change from now on; return how long it takes [s]."""
        if found is None:
            words = "no change of the clock was found that keeps all limits"
            if self._known.limits.carried:
                words += "; what is carried has inertia, rest where the plan does"
            if len(self._known.leaning):
                words += "; legs lean against friction, and are not flown backward"
            remedy = "ask later, for another rate or time, or plan with limits.reserve below 1"
            raise InfeasibleError([], f"{goal} from t = {self.time:.4g} s: {words}; {remedy}")
        if not len(found):
            self._stand(*self._jet()[:2])
            return 0.0
        self._stand(*_end(found, found.jets[-1])[:2].tolist())
        self._jets = np.vstack([found.jets, self._jets])
        self._begins = (self._now + np.cumsum([0.0, *found.duration])).tolist()
        return _seconds(found)

    def _stand(self, time: float, rate: float) -> None:
        """Let the clock go on at a constant rate, which ends with the plan."""
        over = time - self._end if rate > 0.0 else self._begin - time
        place = min(max(time, self._begin), self._end)
        self._jets = np.array([[place, 0.0 if over > -STEADY else rate, 0.0, 0.0]])
        self._begins = [self._now]

    def _jet(self) -> tuple[float, float, float, float]:
        """Return plan time, rate and its two derivatives now."""
        i = max(bisect_right(self._begins, self._now) - 1, 0)
        time, rate, slope, jerk = advanced(self._jets[i], self._now - self._begins[i]).tolist()
        return time, rate, slope, jerk


def _checked_rate(rate: float) -> float:
    if abs(finite("rate", rate)) > 1.0:
        raise InputError("rate", rate, "from -1 to 1", "plans are as fast as their limits allow")
    return float(rate)


class _Known:
    """What all players of a motion need."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self.limits = ClockLimits(motion)
        self.sampler = Sampler(motion.drones)

    @cached_property
    def stops(self) -> StopTable:
        """The stops from full rate."""
        return stop_table(self.motion, self.limits)

    @cached_property
    def leaning(self) -> Array:
        """Begins and ends (m, 2) [s] of the pieces on which a leg leans as cables slide.

        Where drones swing to work the clasps legs lean, but no cable slides in the plan: that may
        be flown backward. A run of pieces on which legs lean counts whole.
        """
        motion, breaks = self.motion, self.motion.drones.breaks
        if motion.leg_tensions is None:
            return np.zeros((0, 2))
        pulls = motion.pulls.coefficients
        apart = np.ptp(pulls.reshape(len(pulls), motion.team.robots, -1), axis=-1)
        leans = np.max(apart, axis=-1) > ALIKE
        slides = np.max(np.ptp(motion.legs.coefficients, axis=-1), axis=(1, 2)) > STILL
        runs = np.cumsum(leans & ~np.concatenate([[False], leans[:-1]]))
        leans &= np.isin(runs, runs[leans & slides])
        found: Array = np.stack([breaks[:-1], breaks[1:]], axis=-1)[leans]
        return found

    def slides_back(self, made: ClockPhases) -> bool:
        """Whether cables slide back where legs lean."""
        backward = np.minimum(made.jets[:, 1], made.ends[:, 1]) < -STEADY
        spans = np.sort(np.stack([made.jets[:, 0], made.ends[:, 0]], axis=-1)[backward], axis=-1)
        begins, ends = self.leaning.T
        return bool(np.any((ends > spans[:, :1]) & (begins < spans[:, 1:])))


_known = lru_cache(maxsize=4)(_Known)


def _eased(jet: Array, duration: float) -> ClockPhases | None:
    """Return the phase in which a jet's (3,) rate becomes constant; None if it changes its sign."""
    jerk, (_, rate, slope) = 4.0 / duration**2, jet.tolist()
    steady = rate + 0.5 * slope * abs(slope) / jerk
    if abs(steady) > 1.0 + STEADY or rate * steady < 0.0:
        return None
    return _in_a_row(jet, [abs(slope) / jerk], [-math.copysign(jerk, slope)])


def _to_rates(jet: Array, rates: Sequence[float], duration: float) -> ClockPhases:
    """Return changes from a constant rate, a jet's (3,), to one after the other [s each].

    Each takes two phases of constant jerk, the shortest that a bound of that allows.
    """
    now, jerks = float(jet[1]), []
    for rate in rates:
        jerk = 4.0 * (rate - now) / duration**2
        jerks += [jerk, -jerk]
        now = rate
    return _in_a_row(jet, [0.5 * duration] * len(jerks), jerks)


def _to_rate(rate: float, jet: Array, duration: float) -> Iterator[ClockPhases]:
    """Yield the change to a constant rate from a jet (3,), with a rest where it turns [s]."""
    eased = _eased(jet, duration)
    if eased is not None:
        jet = _end(eased, jet)
        rates = [rate] if abs(rate - jet[1]) > STEADY else []
        if rate * jet[1] < 0.0:
            rates.insert(0, 0.0)
        yield eased.followed_by(_to_rates(jet, rates, duration))


def _to_time(goal: float, jet: Array, duration: float) -> Iterator[ClockPhases]:
    """Yield courses from a jet (3,) to rest at a plan time: at its own rate, or first to rest [s].

    Every change of the rate takes a duration.
    """
    eased = _eased(jet, duration)
    if eased is None:
        return
    time, now, _ = jet = _end(eased, jet)
    if abs(now) > STEADY:
        wait = (goal - time) / now - 0.5 * duration
        if wait >= 0.0:
            run = _steady(time, now, wait)
            stop = _to_rates(_end(run, jet), [0.0], duration)
            yield eased.followed_by(run).followed_by(stop)
        eased = eased.followed_by(_to_rates(jet, [0.0], duration))
        jet = _end(eased, jet)
    way = goal - float(jet[0])
    for fastest in RATES if abs(way) > STEADY else ():
        rate = math.copysign(min(fastest, abs(way) / duration), way)
        start = _to_rates(jet, [rate], duration)
        run = _steady(start.ends[-1, 0], rate, max(way / rate - duration, 0.0))
        stop = _to_rates(_end(run, jet), [0.0], duration)
        yield eased.followed_by(start).followed_by(run).followed_by(stop)


def _end(phases: ClockPhases, jet: Array) -> Array:
    """Return the jet (3,) at a constant rate after some phases, or where there are none."""
    time, rate = phases.ends[-1, :2] if len(phases) else jet[:2]
    return np.array([time, 0.0 if abs(rate) <= STEADY else rate, 0.0])


def _phases(jets: Array, seconds: Array) -> ClockPhases:
    """Return phases (m,) of one clock."""
    return ClockPhases(np.zeros(len(seconds), dtype=np.intp), jets, seconds)


NOTHING = _phases(np.zeros((0, 4)), np.zeros(0))
"""No phase."""


def _seconds(phases: ClockPhases) -> float:
    """Return how long the phases of one clock take [s]."""
    return float(np.sum(phases.duration))


def _steady(time: float, rate: float, seconds: float) -> ClockPhases:
    """Return a run from a plan time at a constant rate."""
    return _phases(np.array([[time, rate, 0.0, 0.0]]), np.array([seconds]))


def _in_a_row(jet: Array, seconds: Sequence[float], jerks: Sequence[float]) -> ClockPhases:
    """Return phases of constant jerk one after the other, from a jet (3,) on."""
    jets, kept = [], [each for each in zip(seconds, jerks, strict=True) if each[0] > BRIEF]
    p, v, a = jet[:3].tolist()
    for dt, j in kept:
        jets.append((p, v, a, j))  # plain numbers are faster than arrays of four
        p += dt * (v + dt * (a / 2.0 + dt * j / 6.0))
        v += dt * (a + dt * j / 2.0)
        a += dt * j
    return _phases(np.reshape(jets, (-1, 4)), np.array([dt for dt, _ in kept]))


class Sampler:
    """Polynomials of drones or vertices, laid out for one time at a time: for control loops.

    Parameters
    ----------
    part: of shape (points, 3) [m].
    """

    def __init__(self, part: PiecewisePolynomial) -> None:
        order = part.degree
        orders = [part.differentiated(k).elevated(order).coefficients for k in range(4)]
        rows = np.moveaxis(np.stack(orders, axis=1), -1, 1)
        self._rows = np.ascontiguousarray(rows.reshape(part.pieces, order + 1, -1))
        self._binomials = [float(comb(order, k)) for k in range(order + 1)]
        self._shape = 4, *part.shape
        self._breaks = part.breaks.tolist()

    def values(
        self, time: float, rate: float = 1.0, slope: float = 0.0, jerk: float = 0.0
    ) -> Array:
        """Return positions and three derivatives by real time (4, points, 3) at a plan time.

        Parameters
        ----------
        rate, slope, jerk: the clock's derivatives.
        """
        piece = min(max(bisect_right(self._breaks, time) - 1, 0), len(self._breaks) - 2)
        start, end = self._breaks[piece : piece + 2]
        x = min(max((time - start) / (end - start), 0.0), 1.0)
        order = len(self._binomials) - 1
        weights = [c * x**k * (1.0 - x) ** (order - k) for k, c in enumerate(self._binomials)]
        values: Array = np.dot(weights, self._rows[piece]).reshape(4, -1)
        if (rate, slope, jerk) != (1.0, 0.0, 0.0):  # else the clock is the plan's
            chain = [
                [1.0, 0.0, 0.0, 0.0],
                [0.0, rate, 0.0, 0.0],
                [0.0, slope, rate * rate, 0.0],
                [0.0, jerk, 3.0 * rate * slope, rate * rate * rate],
            ]
            values = np.dot(np.array(chain), values)
        return values.reshape(self._shape)
