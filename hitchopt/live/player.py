"""A plan on a common clock that can be slowed, paused, resumed, turned back and sought in.

Changes of the clock's rate are the fastest profiles under bounds of its acceleration and jerk, by
ruckig. Several are tried, now and later, and the first that is verified for all of its time is
flown.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from itertools import pairwise
from math import comb, perm

import numpy as np

from hitchopt.checks.stops import (
    LONGEST,
    SHORTEST,
    SLOWEST,
    ClockLimits,
    StopTable,
    start_phases,
    stop_phases,
    stop_table,
)
from hitchopt.errors import InfeasibleError, InputError, OneLine
from hitchopt.motion.motion import Motion
from hitchopt.motion.retiming import rests
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.clock_phases import ClockPhases, together
from hitchopt.values import Array, finite, not_negative

RATES = (1.0, 0.9, 0.7, 0.5)
"""Largest rates that are tried on the way to a plan time."""

LADDER = tuple(np.geomspace(SHORTEST, LONGEST, 18).tolist())
"""[s] Durations of a change of the rate by 1 that are tried first."""

SLOW = (5.0, 10.0, SLOWEST)
"""[s] Durations that are tried where none of these is possible."""

CARRYING = (3.0, 3.6, 4.3, 5.0, 7.0, 10.0, 14.0, SLOWEST)
"""[s] The same for plans that carry objects: slow changes leave less unbalanced, but have to fit
into steady motion."""

WAITS = (0.1, 0.2, 0.4, 0.8, 1.6)
"""[s] Delays before a change that cannot begin at once."""

RESTS, CLOSE = 2, 0.03
"""While something is carried, changes are tried at so many of the plan's own rests, and begin so
much earlier [s]: the shortest stop is almost symmetric to it then."""

STEADY = 1e-9
"""Rates closer than this are the same."""

BRIEF, NEAR = 1e-9, 1e-6
"""[s] Shorter phases of a profile are dropped. A rate that changes sign so close to the end of a
phase does so by rounding: polynomials cannot follow so short a phase."""

ALIKE = 1e-9
"""[N] Legs that pull with tensions of a smaller difference do not lean."""

STILL = 1e-6
"""[m] Legs whose lengths differ by less on a piece do not slide."""

USUAL = "ask later, for a smaller rate, or plan with limits.reserve below 1"

Change = Callable[[Array, float], ClockPhases | None]
"""Function of a jet (3,) and a duration; gives the phases of a change that begins there."""


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
        self._search = _searched(motion)
        self.limits: ClockLimits = self._search.limits
        self._begin, self._end = (float(b) for b in motion.drones.breaks[[0, -1]])
        self._check_within("time", time)
        self._now = 0.0
        self._stand(time, _checked_rate(rate))

    def _parts(self) -> Iterator[str]:
        yield f"{len(self.motion.team.drone_names)} drones"
        yield f"{self.motion.duration:.4g} s"

    @property
    def stops(self) -> StopTable:
        """The stops from full rate; ``stoppable`` is the longest time until one of them rests."""
        return self._search.stops

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
        time, rate, slope, jerk = self._jet()
        return Setpoints(time, rate, *self._search.sampler.values(time, rate, slope, jerk))

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
        if rate < 0.0 and self._search.earliest_return(self.time) > self._begin:
            words = "legs have leaned against friction on the way; back() rests after that"
            raise InfeasibleError([], f"a rate of {rate:g} from t = {self.time:.4g} s: {words}")

        found = self._first(partial(_to_rate, rate), rate)
        if rate == 0.0:
            found = self._sooner_stop(found)
        return self._adopt(found, f"a rate of {rate:g}", self._other_rate)

    def back(self) -> float:
        """Fly the plan backward at full rate; return the time until that is reached [s].

        Where legs have leaned against friction on the way, the clock rests after that: flown
        backward, cables slide the other way and legs would lean wrongly.

        Raises
        ------
        InfeasibleError: as rate.
        """
        until = self._search.earliest_return(self.time)
        return self.rate(-1.0) if until <= self._begin else self.seek(until)

    def seek(self, time: float) -> float:
        """Go to a plan time on the clock and rest there; return the time it takes [s].

        Raises
        ------
        InputError: a time outside the plan.
        InfeasibleError: as rate.
        """
        self._check_within("time", time)
        return self._sought(time)[0]

    def path(self, time: float, goal: float) -> ClockPhases:
        """Return the certified clock from rest at one plan time to rest at another one [s].

        The player rests at ``goal`` then.

        Raises
        ------
        InputError, InfeasibleError: as seek.
        """
        self._check_within("time", time)
        self._check_within("goal", goal)
        self._stand(time, 0.0)
        found = self._sought(goal)[1]
        self._stand(goal, 0.0)
        return found

    def _check_within(self, key: str, time: float) -> None:
        if not self._begin <= finite(key, time) <= self._end:
            raise InputError(key, time, f"within [0, {self._end:g}] s", "stay within the plan")

    def _sought(self, goal: float) -> tuple[float, ClockPhases]:
        """Take the first change that ends at rest at a plan time [s]; return how long it lasts."""
        changes = (partial(_to_time, goal, fastest) for fastest in RATES)
        options = (self._first(change, 0.0) for change in changes)
        found = next((made for made in options if made is not None), None)
        seconds = self._adopt(found, f"plan time {goal:g} s", partial(self._other_rests, goal))
        return seconds, NOTHING if found is None else found

    def _first(self, change: Change, rate: float) -> ClockPhases | None:
        """Return the first change to a rate that keeps all limits; None if there is none."""
        stopped = (2.0 * np.diff(self._begins[-2:])).tolist()  # as long, the clock can start again
        return self._search.first(np.array(self._jet()[:3]), self.ahead, change, rate, stopped)

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
            run = _steady(np.array([time, 1.0]), start - time) if start > time else NOTHING
            stop = stop_phases(np.array([start]), np.array([duration])) if duration else NOTHING
            options.append(left.followed_by(run).followed_by(stop))
        elif not options and rate != 0.0:
            ahead = self._end - time if rate > 0.0 else time - self._begin
            options.append(left.followed_by(_steady(np.array([time, rate]), ahead / abs(rate))))
        return min(options, key=lambda made: float(np.sum(made.duration)), default=found)

    def _adopt(self, found: ClockPhases | None, goal: str, remedy: Callable[[], str]) -> float:
        if found is None:
            words = "no change of the clock was found that keeps all limits"
            raise InfeasibleError([], f"{goal} from t = {self.time:.4g} s: {words}; {remedy()}")
        if not len(found):
            self._stand(*self._jet()[:2])
            return 0.0
        last = found.ends[-1]
        last[2:] = 0.0
        last[1] = 0.0 if abs(last[1]) <= STEADY else last[1]
        begins = self._now + np.concatenate([[0.0], np.cumsum(found.duration)])
        self._rows, self._begins = np.vstack([found.jets, last]).tolist(), begins.tolist()
        return float(begins[-1] - self._now)

    def _other_rate(self) -> str:
        """Return what to ask for in place of a rate from now on."""
        carried = self.limits.inertia is not None
        return "ask for a faster rate: what is carried has inertia" if carried else USUAL

    def _other_rests(self, time: float) -> str:
        """Return the rests to seek in place of a plan time [s]: the nearest on both sides."""
        inertia, stops = self.limits.inertia, self.stops
        if inertia is None or not inertia.during(np.array([time]), np.array([time]))[0]:
            return USUAL
        known = np.isfinite(stops.durations)
        made = stops.starts[known] + 0.5 * stops.durations[known]
        every = np.append(made, self.motion.drones.breaks[rests(self.motion)])
        nearest = np.max(every[every <= time]), np.min(every[every >= time])
        words = " or ".join(f"{each:.3f} s" for each in nearest)
        return f"seek {words}: what is carried has inertia"

    def _stand(self, time: float, rate: float) -> None:
        """Let the clock go on from a plan time at a constant rate."""
        self._rows, self._begins = [[time, rate, 0.0, 0.0]], [self._now]

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


class _Search:
    """The changes of a plan's clock that keep all limits, and what they are looked for with."""

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

    def earliest_return(self, time: float) -> float:
        """Return the earliest plan time [s] to which the plan may be flown backward.

        Raises
        ------
        InfeasibleError: legs lean at ``time`` itself.
        """
        before = self.leaning[self.leaning[:, 0] < time]
        if not len(before):
            return float(self.motion.drones.breaks[0])
        if before[-1, 1] > time:
            words = "legs lean against friction as cables slide, which they would the other way"
            remedy = "let the plan run on until they do not, or plan without team.cable_friction"
            raise InfeasibleError([], f"going back at t = {time:.4g} s: {words}; {remedy}")
        return float(before[-1, 1])

    def first(
        self, here: Array, left: ClockPhases, change: Change, rate: float, also: Sequence[float]
    ) -> ClockPhases | None:
        """Return the first change that keeps all limits; None if there is none.

        Short ones are preferred, even where they begin later: from ``here`` (3,), from the end of
        what is ``left`` of the present change, or after a delay. ``rate`` is that at their end,
        ``also`` are durations that are tried as well [s].
        """
        usual = (*LADDER, *(each for each in also if SHORTEST < each < SLOWEST))
        for durations in (usual, SLOW if self.limits.inertia is None else CARRYING):
            for before in self._delays(here, left):
                begin = before.ends[-1, :3] if len(before) else here
                made = [change(begin, duration) for duration in durations]
                options = [before.followed_by(each) for each in made if each is not None]
                options = [each for each in options if not self._slides_back(each)]
                if not options:
                    continue
                tailed = [each.followed_by(self._tail(each, rate)) for each in options]
                kept = self.limits.keep(together(tailed), len(tailed))
                seconds = np.array([np.sum(each.duration) for each in options])
                if np.any(kept):
                    return options[int(np.argmin(np.where(kept, seconds, np.inf)))]
        return None

    def _delays(self, here: Array, left: ClockPhases) -> Iterator[ClockPhases]:
        """Yield what the clock does before a change: nothing, the present one's end, or waiting."""
        yield NOTHING
        if len(left):
            yield left
        elif abs(here[1]) > STEADY:
            waits = list(WAITS)
            if self.limits.inertia is not None:  # until the plan almost rests by itself
                still = self.motion.drones.breaks[rests(self.motion)]
                until = (still - here[0]) / here[1] - CLOSE
                waits += sorted(until[until > WAITS[0]].tolist())[:RESTS]
            yield from (_steady(here, wait) for wait in waits)

    def _tail(self, made: ClockPhases, rate: float) -> ClockPhases:
        """Return what follows: a run at a constant rate, or from a rest the start from there.

        The plan's own rate needs no look, nor does a rest where nothing is carried.
        """
        if abs(rate) == 1.0 or not len(made):
            return NOTHING
        begin, end = self.motion.drones.breaks[[0, -1]]
        time, inertia = made.ends[-1, :1], self.limits.inertia
        if rate == 0.0:
            carried = inertia is not None and inertia.during(time, time)[0]
            return start_phases(time, 2.0 * made.duration[-1:]) if carried else NOTHING
        left = end - time[0] if rate > 0.0 else time[0] - begin
        return _steady(np.array([time[0], rate]), left / abs(rate)) if left > 0.0 else NOTHING

    def _slides_back(self, made: ClockPhases) -> bool:
        """Whether cables slide back where legs lean."""
        backward = np.minimum(made.jets[:, 1], made.ends[:, 1]) < -STEADY
        spans = np.sort(np.stack([made.jets[:, 0], made.ends[:, 0]], axis=-1)[backward], axis=-1)
        begins, ends = self.leaning.T
        return bool(np.any((ends > spans[:, :1]) & (begins < spans[:, 1:])))


_searched = lru_cache(maxsize=4)(_Search)


def _to_rate(rate: float, jet: Array, duration: float) -> ClockPhases | None:
    """Return a change to a constant rate from a jet (3,), in about a duration [s]."""
    from ruckig import ControlInterface, InputParameter

    task = InputParameter(1)
    task.control_interface = ControlInterface.Velocity
    task.target_velocity, task.target_acceleration = [rate], [0.0]
    difference = max(abs(rate - jet[1]), 0.25 * abs(jet[2]) * duration, 1e-3)
    return _profile(task, jet, duration, difference)


def _to_time(time: float, fastest: float, jet: Array, duration: float) -> ClockPhases | None:
    """Return a course from a jet (3,) to rest at a plan time [s], at rates of at most ``fastest``.

    A change of the rate by 1 takes a duration [s].
    """
    from ruckig import InputParameter

    task = InputParameter(1)
    task.max_velocity, task.target_position = [fastest], [time]
    begin = np.array(jet[:3])
    if abs(abs(begin[1]) - fastest) <= STEADY:  # ruckig brakes for a rate that is off by rounding
        begin[1] = math.copysign(fastest, begin[1])
    return _profile(task, begin, duration)


def _profile(
    task: object, jet: Array, duration: float, difference: float = 1.0
) -> ClockPhases | None:
    """Return the fastest profile of a task of ruckig from a jet (3,); None if there is none."""
    from ruckig import Result, Ruckig, RuckigError, Trajectory

    place, rate, slope = (float(value) for value in jet[:3])
    values = {
        "current_position": place,
        "current_velocity": rate,
        "current_acceleration": slope,
        "max_acceleration": 2.0 / duration * difference,
        "max_jerk": 4.0 / duration**2 * difference,
    }
    for name, value in values.items():
        setattr(task, name, [value])
    trajectory = Trajectory(1)
    try:
        result = Ruckig(1).calculate(task, trajectory)
    except RuckigError:  # bounds far below what the clock does now
        return None
    if result not in {Result.Working, Result.Finished}:
        return None
    profile = trajectory.profiles[0][0]
    seconds = np.array([*profile.brake.t, *profile.t], dtype=np.float64)
    jerks = np.array([*profile.brake.j, *profile.j], dtype=np.float64)
    kept = seconds > BRIEF
    return _one_sign(phases_of(np.array([place, rate, slope]), seconds[kept], jerks[kept]))


def phases_of(jet: Array, seconds: Array, jerks: Array) -> ClockPhases:
    """Return phases of constant jerk one after the other, from a jet (3,) on."""
    jets = []
    p, v, a = (float(value) for value in jet[:3])  # plain numbers are faster than arrays of four
    for dt, j in zip(np.asarray(seconds).tolist(), np.asarray(jerks).tolist(), strict=True):
        jets.append((p, v, a, j))
        p += dt * (v + dt * (a / 2.0 + dt * j / 6.0))
        v += dt * (a + dt * j / 2.0)
        a += dt * j
    owner = np.zeros(len(jets), dtype=np.intp)
    return ClockPhases(owner, np.reshape(jets, (-1, 4)), np.array(seconds, dtype=np.float64))


NOTHING = phases_of(np.zeros(3), np.zeros(0), np.zeros(0))
"""No phase."""


def _steady(jet: Array, seconds: float) -> ClockPhases:
    """Return a run from a plan time at a constant rate, the first numbers of a jet."""
    return phases_of(np.array([*jet[:2], 0.0]), np.array([seconds]), np.zeros(1))


def _one_sign(phases: ClockPhases) -> ClockPhases:
    """Return the phases, split where their rates change sign."""
    seconds: list[float] = []
    jerks: list[float] = []
    for (_, rate, slope, jerk), duration in zip(
        phases.jets.tolist(), phases.duration.tolist(), strict=True
    ):
        cuts = [t for t in _zeros(rate, slope, 0.5 * jerk) if NEAR < t < duration - NEAR]
        edges = [0.0, *sorted(cuts), duration]
        seconds += [last - first for first, last in pairwise(edges)]
        jerks += [jerk] * (len(edges) - 1)
    if len(seconds) == len(phases):
        return phases
    return phases_of(phases.jets[0], np.array(seconds), np.array(jerks))


def _zeros(c: float, b: float, a: float) -> tuple[float, ...]:
    """Return the real zeros of ``a t² + b t + c``."""
    inside = b * b - 4.0 * a * c
    if inside < 0.0 or a == b == 0.0:
        return ()
    larger = -0.5 * (b + math.copysign(math.sqrt(inside), b))  # adds numbers of one sign
    return tuple(top / below for top, below in ((larger, a), (c, larger)) if below != 0.0)


class Sampler:
    """Polynomials of drones or vertices, laid out for one time at a time: for control loops.

    Parameters
    ----------
    part: of shape (points, 3) [m].
    """

    def __init__(self, part: PiecewisePolynomial) -> None:
        c = part.coefficients
        pieces, self._points, _, count = c.shape
        self._order = order = count - 1
        to_powers = np.zeros((count, count))
        for k in range(count):
            for i in range(k + 1):
                to_powers[k, i] = comb(order, k) * comb(k, i) * (-1.0) ** (k - i)
        powers = np.einsum("ki,pdci->pkdc", to_powers, c).reshape(pieces, count, -1)
        rows = np.zeros((pieces, count, 4, powers.shape[-1]))
        h = part.durations[:, None]
        for derivative in range(4):
            for k in range(derivative, count):
                factor = perm(k, derivative)
                rows[:, k - derivative, derivative] = factor * powers[:, k] / h**derivative
        self._rows = rows.reshape(pieces, count, -1)
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
        start = self._breaks[piece]
        x = min(max((time - start) / (self._breaks[piece + 1] - start), 0.0), 1.0)
        powers = [1.0]
        for _ in range(self._order):  # plain numbers are faster than an array of eight
            powers.append(powers[-1] * x)
        values: Array = np.dot(powers, self._rows[piece]).reshape(4, -1)
        if (rate, slope, jerk) != (1.0, 0.0, 0.0):  # else the clock is the plan's
            chain = [
                [1.0, 0.0, 0.0, 0.0],
                [0.0, rate, 0.0, 0.0],
                [0.0, slope, rate * rate, 0.0],
                [0.0, jerk, 3.0 * rate * slope, rate * rate * rate],
            ]
            values = np.dot(np.array(chain), values)
        return values.reshape(4, self._points, 3)
