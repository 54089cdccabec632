"""A plan on a common clock that can be slowed, paused, resumed, turned back and sought in.

The clock's rate changes by phases of constant jerk. Changes of many durations are made, to begin
now or later; the soonest that is verified for all of its time is flown.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from math import comb

import numpy as np

from hitchopt.checks.stops import SHORTEST, SLOWEST, ClockLimits, StopTable, stop_table
from hitchopt.errors import InfeasibleError, InputError, OneLine, UnsupportedError
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.clock_phases import ClockPhases, concatenated_clocks
from hitchopt.values import Array, finite, nonnegative

RATES = (1.0, 0.7, 0.4)  # candidates for going to a plan time
DURATION_CANDIDATES = tuple(
    np.geomspace(SHORTEST, SLOWEST, 27).tolist()
)  # durations of a change by 1 [s]
WAITS = (0.1, 0.2, 0.4, 0.8, 1.6)  # delays before a change that cannot begin at once [s]
BATCH = 24  # number of changes that are verified together

STEADY = 1e-9  # difference of equal rates, and distance [s] at which an end is reached
BRIEF = 1e-9  # shorter phases are dropped, and those of which less is left are over [s]
ALIKE = 1e-9  # difference of tensions [N] with which legs do not lean
MIN_SLIDE = 1e-6  # difference of lengths on a piece [m] with which legs do not slide


@dataclass(frozen=True, eq=False)
class Setpoints(OneLine):
    """Setpoints of a player at the present time.

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
    UnsupportedError: a plan beside others, whose clock is not this one.
    """

    def __init__(self, plan: object, time: float = 0.0, rate: float = 1.0) -> None:
        motion = getattr(plan, "motion", plan)
        if not isinstance(motion, Motion):
            raise InputError("plan", plan, "a Plan or a Motion", "solve or load one")
        if motion.others:
            words = (
                f"a clock that can be slowed, beside {motion.others[0].name}, which does not wait"
            )
            raise UnsupportedError(f"{words}; plan without others, or use aborts alone")
        self.motion: Motion = motion
        self._known = _known(motion)
        self._begin, self._end = (float(b) for b in motion.drones.breaks[[0, -1]])
        self._check_within("time", time)
        self._course = self._within(Course(float(time), _checked_rate(rate)))
        self._durations = DURATION_CANDIDATES  # of changes that are tried

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
        return self._course.now[0]

    @property
    def clock_rate(self) -> float:
        """Plan time per time: 1 for the plan as it is, negative backward."""
        return self._course.now[1]

    @property
    def resting(self) -> bool:
        """Whether the clock stands still and is not about to move."""
        return not self._course.phases and self._course.rate == 0.0

    @property
    def ahead(self) -> ClockPhases:
        """The rest of the present change of the clock's rate."""
        return self._course.clock

    def step(self, seconds: float) -> Setpoints:
        """Let time pass [s] and return the setpoints then.

        Raises
        ------
        InputError: a time that is negative or not finite.
        """
        self._course = self._course.after(nonnegative("seconds", seconds))
        if not self._begin <= self.time <= self._end:
            self._course = self._within(Course(self.time, self.clock_rate))
        time, rate, slope, jerk = self._course.now
        each = [one.values(time, rate, slope, jerk) for one in self._known.samplers]
        return Setpoints(time, rate, *np.concatenate(each, axis=1))

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
        course = self._first(partial(_to_rate, rate), rate)
        if rate == 0.0:
            certain = self._certain_stop()
            course = certain if course is None or certain.seconds <= course.seconds else course
        return self._adopt(course, f"a rate of {rate:g}")

    def back(self) -> float:
        """Fly the plan backward at full rate; return the time until that is reached [s].

        Where legs have leaned against friction, the clock rests after that: flown
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

    def _within(self, course: Course) -> Course:
        """Return the same course, at rest then where it has come to an end of the plan."""
        time, rate = course.time, course.rate
        over = time - self._end if rate > 0.0 else self._begin - time
        rate = 0.0 if over > -STEADY else rate
        return replace(course, time=min(max(time, self._begin), self._end), rate=rate)

    def _first(self, change: Change, rate: float) -> Course | None:
        """Return the soonest change to a rate that is verified; None if there is none."""
        options = []
        for before in self._delays(rate):
            for duration in self._durations:
                for course in change(before, duration):
                    tailed = self._tailed(course, rate)
                    if not self._known.slides_back(tailed.clock):
                        options.append((course, course if abs(rate) == 1.0 else tailed))
        options.sort(key=lambda option: option[0].seconds)
        for first in range(0, len(options), BATCH):
            batch = options[first : first + BATCH]
            clocks = concatenated_clocks([tailed.clock for _, tailed in batch])
            feasible = self._known.limits.keep(clocks, len(batch))
            if np.any(feasible):
                return batch[int(np.argmax(feasible))][0]
        return None

    def _delays(self, rate: float) -> Iterator[Course]:
        """Yield courses before a change: none, the rest of the present one, a wait, a stop."""
        left = self._course
        yield Course(*left.now[:3])
        if left.phases:
            yield left
        elif left.rate != 0.0:
            yield from (left.then(wait) for wait in WAITS)
        if rate != 1.0 and not self.resting:
            yield self._certain_stop()

    def _tailed(self, course: Course, rate: float) -> Course:
        """Return a change with what follows: a run to the plan's end, or the start from a rest.

        Where nothing is carried any rest suffices. The plan's own rate needs no check.
        """
        if not course.phases:
            return course
        if rate != 0.0:
            return self._run(course)
        carried = self._known.limits.carries(np.array([course.time]))[0]
        return course.to(1.0, 2.0 * course.phases[-1][0]) if carried else course

    def _run(self, course: Course) -> Course:
        """Return a course that goes on at its rate to the end of the plan, or back to the start."""
        left = (self._end if course.rate > 0.0 else self._begin) - course.time
        return course.then(left / course.rate)

    def _certain_stop(self) -> Course:
        """Return a stop that needs no check: the present change, then one of the table or a run."""
        left = self._course
        if left.rate == 0.0:
            return left
        if left.rate < 1.0 - STEADY:
            return self._run(left)
        start, duration = self.stops.after(left.time)
        run = left.then(start - left.time)
        return run.to(0.0, duration) if duration > 0.0 else run

    def _adopt(self, course: Course | None, goal: str) -> float:
        """Fly a change from now on; return how long it takes [s]."""
        if course is None:
            words = "no change of the clock was found that keeps all limits"
            if self._known.limits.carried:
                words += "; what is carried has inertia, rest where the plan does"
            if len(self._known.leaning):
                words += "; legs lean against friction, and are not flown backward"
            remedy = "ask later, for another rate or time, or plan with limits.reserve below 1"
            raise InfeasibleError([], f"{goal} from t = {self.time:.4g} s: {words}; {remedy}")
        self._course = self._within(course)
        if course.phases:  # what is carried can start as slowly as it has stopped
            self._durations = (*DURATION_CANDIDATES, 2.0 * course.phases[-1][0])
        return course.seconds


def _checked_rate(rate: float) -> float:
    if abs(finite("rate", rate)) > 1.0:
        raise InputError("rate", rate, "from -1 to 1", "plans are as fast as their limits allow")
    return float(rate)


class _Known:
    """Data that all players of a motion share."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self.limits = ClockLimits(motion)
        self.samplers = [Sampler(each.motion.drones) for each in motion.groups]

    @cached_property
    def stops(self) -> StopTable:
        """The stops from full rate."""
        return stop_table(self.motion, self.limits)

    @cached_property
    def leaning(self) -> Array:
        """Begins and ends (m, 2) [s] of the runs of pieces on which legs lean and cables slide.

        Where drones swing to work the clasps none slides: that may be flown backward.
        """
        return np.concatenate([_leaning(each.motion) for each in self.motion.groups])

    def slides_back(self, clock: ClockPhases) -> bool:
        """Whether cables slide back where legs lean."""
        backward = np.minimum(clock.jets[:, 1], clock.ends[:, 1]) < -STEADY
        spans = np.sort(np.stack([clock.jets[:, 0], clock.ends[:, 0]], axis=-1)[backward], axis=-1)
        begins, ends = self.leaning.T
        return bool(np.any((ends > spans[:, :1]) & (begins < spans[:, 1:])))


def _leaning(motion: Motion) -> Array:
    """Return the runs of pieces (m, 2) [s] on which one group's legs lean and cables slide."""
    if motion.leg_tensions is None:
        return np.zeros((0, 2))
    breaks, pulls = motion.drones.breaks, motion.pulls.coefficients
    apart = np.ptp(pulls.reshape(len(pulls), motion.team.robots, -1), axis=-1)
    leans = np.max(apart, axis=-1) > ALIKE
    slides = np.max(np.ptp(motion.legs.coefficients, axis=-1), axis=(1, 2)) > MIN_SLIDE
    runs = np.cumsum(leans & ~np.concatenate([[False], leans[:-1]]))
    leans &= np.isin(runs, runs[leans & slides])
    spans: Array = np.stack([breaks[:-1], breaks[1:]], axis=-1)[leans]
    return spans


_known = lru_cache(maxsize=4)(_Known)


@dataclass(frozen=True, eq=False)
class Course:
    """Phases of a clock's constant jerk, one after the other; then its rate is constant."""

    time: float  # plan time in the end [s]
    rate: float
    slope: float = 0.0  # of the rate [1/s], where a change begins amid another one
    # durations [s], and plan times with three derivatives where each begins
    phases: tuple[tuple[float, float, float, float, float], ...] = ()

    @property
    def now(self) -> tuple[float, float, float, float]:
        """Plan time and three derivatives where it begins."""
        return self.phases[0][1:] if self.phases else (self.time, self.rate, self.slope, 0.0)

    @property
    def seconds(self) -> float:
        """Duration of the phases [s]."""
        return sum(phase[0] for phase in self.phases)

    @property
    def clock(self) -> ClockPhases:
        """The phases, as they are verified and flown."""
        rows = np.reshape(self.phases, (-1, 5))
        return ClockPhases(np.zeros(len(rows), dtype=np.intp), rows[:, 1:], rows[:, 0])

    def then(self, seconds: float, jerk: float = 0.0) -> Course:
        """Return the course with one more phase [s], dropped if it is brief."""
        if seconds <= BRIEF:
            return self
        start = self.time, self.rate, self.slope, jerk
        return Course(*_advanced(start, seconds)[:3], (*self.phases, (seconds, *start)))

    def to(self, rate: float, duration: float) -> Course:
        """Return the course with a change to a rate [s], the shortest that a bound of jerk allows.

        From a constant rate, by two phases.
        """
        if abs(rate - self.rate) <= STEADY:
            return self
        jerk = 4.0 * (rate - self.rate) / duration**2
        changed = self.then(0.5 * duration, jerk).then(0.5 * duration, -jerk)
        return replace(changed, rate=rate, slope=0.0)

    def eased(self, duration: float) -> Course | None:
        """Return the course until its rate is constant; None if that would change its sign.

        ``duration`` is that of a change by 1 with the same jerk [s].
        """
        jerk = 4.0 / duration**2
        steady = self.rate + 0.5 * self.slope * abs(self.slope) / jerk
        if abs(steady) > 1.0 + STEADY or self.rate * steady < 0.0:
            return None
        eased = self.then(abs(self.slope) / jerk, -math.copysign(jerk, self.slope))
        return replace(eased, rate=0.0 if abs(steady) <= STEADY else steady, slope=0.0)

    def after(self, seconds: float) -> Course:
        """Return the rest of the course after some time [s]."""
        for i, (duration, *jet) in enumerate(self.phases):
            if seconds < duration - BRIEF:
                first = duration - seconds, *_advanced(tuple(jet), seconds)
                return replace(self, phases=(first, *self.phases[i + 1 :]))
            seconds = max(seconds - duration, 0.0)
        return Course(self.time + seconds * self.rate, self.rate)


Change = Callable[[Course, float], Iterator[Course]]  # adds a change of a duration [s]


def _advanced(jet: tuple[float, ...], dt: float) -> tuple[float, float, float, float]:
    """Return the jet of a cubic later; plain numbers are faster than arrays of four."""
    p, v, a, j = jet
    moved = p + dt * (v + dt * (a / 2.0 + dt * j / 6.0))
    return moved, v + dt * (a + dt * j / 2.0), a + dt * j, j


def _to_rate(rate: float, course: Course, duration: float) -> Iterator[Course]:
    """Yield the change to a constant rate, with a rest where it turns."""
    eased = course.eased(duration)
    if eased is not None:
        turned = eased.to(0.0, duration) if rate * eased.rate < 0.0 else eased
        yield turned.to(rate, duration)


def _to_time(goal: float, course: Course, duration: float) -> Iterator[Course]:
    """Yield courses to rest at a plan time: at the present rate, or from rest at other ones."""
    eased = course.eased(duration)
    if eased is None:
        return
    if eased.rate != 0.0:
        wait = (goal - eased.time) / eased.rate - 0.5 * duration
        if wait >= 0.0:
            yield eased.then(wait).to(0.0, duration)
        eased = eased.to(0.0, duration)
    change = goal - eased.time
    if abs(change) <= STEADY:
        yield eased
        return
    for fastest in RATES:
        rate = math.copysign(min(fastest, abs(change) / duration), change)
        yield eased.to(rate, duration).then(change / rate - duration).to(0.0, duration)


class Sampler:
    """Polynomials (points, 3) [m], laid out for one time at a time: for control loops."""

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

        The clock has a rate with two derivatives, ``slope`` and ``jerk``.
        """
        piece = min(max(bisect_right(self._breaks, time) - 1, 0), len(self._breaks) - 2)
        start, end = self._breaks[piece : piece + 2]
        x = min(max((time - start) / (end - start), 0.0), 1.0)
        order = len(self._binomials) - 1
        weights = [c * x**k * (1.0 - x) ** (order - k) for k, c in enumerate(self._binomials)]
        values: Array = np.dot(weights, self._rows[piece]).reshape(4, -1)
        if (rate, slope, jerk) != (1.0, 0.0, 0.0):  # else the clock is the plan's
            first, second, third = values[1:].copy()
            values[1] = rate * first
            values[2] = rate**2 * second + slope * first
            values[3] = rate**3 * third + 3.0 * rate * slope * second + jerk * first
        return values.reshape(self._shape)
