"""Fly a plan on a common clock that can be slowed, paused, resumed, reversed and sought.

The clock's rate changes in phases of constant jerk. Candidates have many durations and delays; the
one that ends first, among those that keep all limits at all times, is flown.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from math import comb
from typing import NamedTuple

import numpy as np

from hitchopt.checks.stops import MAX_STOP, MIN_STOP, ClockLimits, StopTable, stop_table
from hitchopt.errors import InfeasibleError, InputError, OneLine
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import Motion
from hitchopt.slices import provided
from hitchopt.support import Feature, Neighbour, unsupported
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.clock_phases import ClockPhases, concatenate_clocks
from hitchopt.trajectory.piecewise import MIN_SPACING
from hitchopt.values import Array, Indices, counted, finite, nonnegative
from hitchopt.values.fields import suggest_keywords

SEEK_RATES = (1.0, 0.7, 0.4)  # candidate rates to seek a plan time
DURATIONS = tuple(np.geomspace(MIN_STOP, MAX_STOP, 27).tolist())
"""Candidate durations of a change of the rate by 1 [s]."""
DELAYS = (0.1, 0.2, 0.4, 0.8, 1.6)  # candidate delays of a change that cannot start at once [s]
BATCH = 24  # number of candidates that are verified together
CLOCK_TOLERANCE = 1e-9  # for differences of rates, and of plan times [s]
MIN_PHASE = 1e-9  # shorter phases, and shorter remainders of phases, are dropped [s]
TENSION_TOLERANCE = 1e-9  # difference of tensions up to which legs are symmetric [N]
MIN_SLIDE = 1e-6  # change of a leg's length on a piece up to which it does not slide [m]


@dataclass(frozen=True, eq=False)
class Setpoints(OneLine):
    """Setpoints of a player at the current time, drones in the order of the problem.

    Attributes
    ----------
    time: plan time [s].
    rate: rate of the clock, 1 for the plan's own speed.
    positions, velocities, accelerations, jerks: (drones, 3) [m], [m/s], [m/s²], [m/s³], with
        derivatives with respect to real time.
    """

    time: float
    rate: float
    positions: Array
    velocities: Array
    accelerations: Array
    jerks: Array


class Player(OneLine):
    """A plan flown on a clock that all drones share, also after the loss of a robot.

    Paths, separations, clearances and crossings are those of the plan at every rate. Every change
    of the rate is verified for its whole duration before it starts: acceleration, jerk, thrust,
    tilt and body rates keep their limits, and a held object its balance. If a change cannot start
    at once, the clock continues until it can.

    Parameters
    ----------
    plan: a plan, its flight, or the motion of a team; players of the same one share computed data.
    time: initial plan time [s].
    rate: initial rate of the clock, from -1 to 1.

    Raises
    ------
    InputError: the time is outside the plan, or the rate out of range.
    UnsupportedError: other plans fly at the same time, on separate clocks.
    """

    @suggest_keywords
    def __init__(self, plan: object, time: float = 0.0, rate: float = 1.0) -> None:
        flown = getattr(plan, "flight", plan)
        if not isinstance(flown, Flight | Motion):
            raise InputError("plan", plan, "a Plan or a Motion", "solve or load one")
        flight = Flight.of(flown)
        if flight.others:
            raise unsupported(Feature.PLAYER, Neighbour.OTHERS, other=flight.others[0].name)
        self.flight = flight
        self._shared = _shared_data(flight.alone or flight)
        self._start, self._end = (float(b) for b in flight.breaks[[0, -1]])
        self._check_time(time)
        self._profile = self._clamped(ClockProfile(float(time), _checked_rate(rate)))
        self._durations = DURATIONS
        self._listed = flight.team.listed
        self._following: _Following | None = None

    def _parts(self) -> Iterator[str]:
        yield counted(len(self.flight.team.drone_names), "drone")
        yield f"{self.flight.duration:.4g} s"

    @property
    def stops(self) -> StopTable:
        """The stops from full rate; ``stoppable`` is the longest time until rest."""
        return self._shared.stops

    @property
    def time(self) -> float:
        """Plan time [s]."""
        return self._profile.now[0]

    @property
    def clock_rate(self) -> float:
        """Rate of the plan time: 1 for the plan's own speed, negative backward."""
        return self._profile.now[1]

    @property
    def resting(self) -> bool:
        """Return whether the clock is at rest and not about to start."""
        is_still = not self._profile.phases and self._profile.rate == 0.0
        return is_still and self._following is None

    @property
    def listed(self) -> Indices:
        """Places (drones,) of the drones of setpoints among those of ``flight``."""
        return self._listed

    @property
    def rest(self) -> float:
        """Plan time [s] at which the current change of the rate ends."""
        return self._profile.time

    @property
    def ahead(self) -> ClockPhases:
        """The remaining phases of the current change of the rate."""
        return self._profile.clock

    def step(self, seconds: float) -> Setpoints:
        """Advance the time [s] and return the setpoints.

        Raises InputError if the time is negative or not finite.
        """
        if self._following is not None and not self._profile.phases:
            self._begin(self._following)
        self._profile = self._profile.after(nonnegative("seconds", seconds))
        if not self._start <= self.time <= self._end:
            self._profile = self._clamped(ClockProfile(self.time, self.clock_rate))
        time, rate, slope, jerk = self._profile.now
        each = [sampler.values(time, rate, slope, jerk) for sampler in self._shared.samplers]
        places = np.concatenate(each, axis=1)
        return Setpoints(time, rate, *places[:, self._listed])

    def pause(self) -> float:
        """Stop as soon as the limits allow; return the time until rest [s]."""
        return self.rate(0.0)

    def resume(self) -> float:
        """Return to the plan's own rate; return the time until it is reached [s]."""
        return self.rate(1.0)

    def rate(self, rate: float) -> float:
        """Change to a constant rate from -1 to 1 as soon as possible; return the time it takes [s].

        A stop ends at the end of the plan if no earlier one is possible. Raises InputError if the
        rate is out of range, and InfeasibleError if no change was found that keeps all limits, or
        cables would slide backward where legs lean against friction; the clock continues as before.
        """
        rate = _checked_rate(rate)
        profile = self._first_feasible(partial(_to_rate, rate), rate)
        if rate == 0.0:
            stop = self._guaranteed_stop()
            profile = stop if profile is None or stop.seconds <= profile.seconds else profile
        return self._follow(profile, f"a rate of {rate:g}")

    def back(self) -> float:
        """Fly the plan backward at full rate; return the time until that is reached [s].

        The clock stops after the last span in which legs lean against friction: backward, cables
        slide the other way, and the legs would have to lean to the other side. Raises
        InfeasibleError as ``rate``.
        """
        spans = self._shared.sliding_spans
        time = self.time
        until = float(np.max(spans[spans[:, 0] < time, 1], initial=self._start))
        return self.seek(until) if self._start < until < time else self.rate(-1.0)

    def seek(self, time: float) -> float:
        """Move the clock to a plan time and stop there; return the time it takes [s].

        Raises InputError if the time is outside the plan, and InfeasibleError as ``rate``.
        """
        self._check_time(time)
        profile = self._first_feasible(partial(_to_time, time), 0.0)
        return self._follow(profile, f"plan time {time:g} s")

    def lose(self, robot: int | str) -> float:
        """Stop after the loss of a robot, and fly on as ``Plan.after_loss`` plans from there.

        All stop as soon as the limits allow; then the robot's drones rise, and the others form the
        chain. Return the time until it is held [s]. Setpoints keep their order; from the rest on,
        ``flight`` and ``time`` are those of what follows.

        Raises
        ------
        InputError: as ``Plan.after_loss``; the clock continues.
        InfeasibleError: a limit that is not kept after the loss; the clock stops.
        """
        time = self.time
        provided("check_loss")(self.flight, str(robot), time)
        seconds = self.pause()
        found = provided("after_loss_at_rest")(self.flight, str(robot), time, self.rest)
        self.follow(found.flight, found.drones)
        return seconds + float(found.flight.duration)

    def follow(self, flight: Flight, drones: tuple[str, ...]) -> None:
        """Continue with another flight once at rest, where it begins at rest.

        ``drones`` are those of the flight, in its order, by their names in this one. From then on
        ``flight`` and ``time`` are those of the other flight; setpoints keep their order.
        """
        names = self.flight.team.drone_names
        places = [drones.index(names[drone]) for drone in self._listed]
        self._following = _Following(flight, np.array(places))

    def _begin(self, following: _Following) -> None:
        """Continue, at rest, with the flight that follows."""
        self.flight, self._listed, self._following = *following, None
        self._shared = _shared_data(self.flight)
        self._start, self._end = (float(b) for b in self.flight.breaks[[0, -1]])
        self._profile = ClockProfile(self._start, 1.0)
        self._durations = DURATIONS

    def _check_time(self, time: float) -> None:
        if not self._start <= finite("time", time) <= self._end:
            raise InputError("time", time, f"within [0, {self._end:g}] s", "stay within the plan")

    def _clamped(self, profile: ClockProfile) -> ClockProfile:
        """Return the profile limited to the plan, at rest if it ends at the plan's start or end."""
        time, rate = profile.time, profile.rate
        excess = time - self._end if rate > 0.0 else self._start - time
        rate = 0.0 if excess > -CLOCK_TOLERANCE else rate
        return replace(profile, time=min(max(time, self._start), self._end), rate=rate)

    def _first_feasible(self, change: Change, rate: float) -> ClockProfile | None:
        """Return the change to a rate that ends first and keeps all limits; None if none does."""
        candidates = []
        for first_part in self._first_parts(rate):
            for duration in self._durations:
                for profile in change(first_part, duration):
                    extended = self._extended(profile, rate)
                    if not self._shared.slides_back(extended.clock):
                        candidates.append((profile, profile if abs(rate) == 1.0 else extended))
        candidates.sort(key=lambda candidate: candidate[0].seconds)
        for first in range(0, len(candidates), BATCH):
            batch = candidates[first : first + BATCH]
            clocks = concatenate_clocks([extended.clock for _, extended in batch])
            feasible = self._shared.limits.keep(clocks, len(batch))
            if np.any(feasible):
                return batch[int(np.argmax(feasible))][0]
        return None

    def _first_parts(self, rate: float) -> Iterator[ClockProfile]:
        """Yield courses before a change: none, the rest of the current change, a delay, a stop."""
        current = self._profile
        yield ClockProfile(*current.now[:3])
        if current.phases:
            yield current
        elif current.rate != 0.0:
            yield from (current.then(delay) for delay in DELAYS)
        if rate != 1.0 and not self.resting:
            yield self._guaranteed_stop()

    def _extended(self, profile: ClockProfile, rate: float) -> ClockProfile:
        """Return a change with its continuation: to the plan's end, or a restart after a stop.

        A restart is needed only while an object is held. The plan's own rate needs no check.
        """
        if not profile.phases:
            return profile
        if rate != 0.0:
            return self._to_end(profile)
        is_loaded = self._shared.limits.carries(np.array([profile.time]))[0]
        return profile.to(1.0, 2.0 * profile.phases[-1][0]) if is_loaded else profile

    def _to_end(self, profile: ClockProfile) -> ClockProfile:
        """Return a profile that continues at its rate to the plan's end, or back to its start."""
        remaining = (self._end if profile.rate > 0.0 else self._start) - profile.time
        return profile.then(remaining / profile.rate)

    def _guaranteed_stop(self) -> ClockProfile:
        """Return a stop that needs no check: one of the table, or a run to the plan's end."""
        current = self._profile
        if current.rate == 0.0:
            return current
        if current.rate < 1.0 - CLOCK_TOLERANCE:
            return self._to_end(current)
        start, duration = self.stops.after(current.time)
        run = current.then(start - current.time)
        return run.to(0.0, duration) if duration > 0.0 else run

    def _follow(self, profile: ClockProfile | None, goal: str) -> float:
        """Start following a profile; return its duration [s]."""
        if self._following is not None:
            raise InfeasibleError([], f"{goal}: the flight that follows begins at rest")
        if profile is None:
            reason = "no change of the clock was found that keeps all limits"
            if self._shared.limits.carried:
                reason += "; a held object has inertia: stop where the plan stops"
            if len(self._shared.sliding_spans):
                reason += "; legs lean against friction, and are not flown backward"
            remedy = "try later, use another rate or time, or plan with limits.reserve below 1"
            raise InfeasibleError([], f"{goal} from t = {self.time:.4g} s: {reason}; {remedy}")
        self._profile = self._clamped(profile)
        if profile.phases:  # a held object can start as slowly as it has stopped
            self._durations = (*DURATIONS, 2.0 * profile.phases[-1][0])
        return profile.seconds


class _Following(NamedTuple):
    """What a player flies next."""

    flight: Flight  # Its flight, from rest
    listed: Indices  # (drones,), places in it of the drones of setpoints


def _checked_rate(rate: float) -> float:
    if abs(finite("rate", rate)) > 1.0:
        raise InputError("rate", rate, "from -1 to 1", "plans are as fast as their limits allow")
    return 0.0 if abs(rate) <= CLOCK_TOLERANCE else float(rate)


class _SharedData:
    """Data shared by all players of a flight, or of the motion of a team that flies alone."""

    def __init__(self, flown: Flight | Motion) -> None:
        self.flight = flight = Flight.of(flown)
        self.limits = ClockLimits(flight)
        self.samplers = [Sampler(each.motion.drones) for each in flight.teams]

    @cached_property
    def stops(self) -> StopTable:
        """The stops from full rate."""
        return stop_table(self.flight, self.limits)

    @cached_property
    def sliding_spans(self) -> Array:
        """Spans (m, 2) [s] of the pieces on which legs lean and cables slide.

        Spans in which drones swing at fixed leg lengths may be flown backward.
        """
        return np.concatenate([_sliding_spans(each.motion) for each in self.flight.teams])

    def slides_back(self, clock: ClockPhases) -> bool:
        """Return whether cables slide backward while legs lean."""
        backward = np.minimum(clock.jets[:, 1], clock.ends[:, 1]) < -CLOCK_TOLERANCE
        spans = np.sort(np.stack([clock.jets[:, 0], clock.ends[:, 0]], axis=-1)[backward], axis=-1)
        starts, ends = self.sliding_spans.T
        return bool(np.any((ends > spans[:, :1]) & (starts < spans[:, 1:])))


def _sliding_spans(motion: Motion) -> Array:
    """Return the spans (m, 2) [s] of pieces on which one team's legs lean and cables slide."""
    if not motion.leg_tensions_differ:
        return np.zeros((0, 2))
    breaks, pulls = motion.drones.breaks, motion.pulls.coefficients
    differences = np.ptp(pulls.reshape(len(pulls), motion.team.robots, -1), axis=-1)
    leans = np.max(differences, axis=-1) > TENSION_TOLERANCE
    slides = np.max(np.ptp(motion.legs.coefficients, axis=-1), axis=(1, 2)) > MIN_SLIDE
    runs = np.cumsum(leans & ~np.concatenate([[False], leans[:-1]]))
    leans &= np.isin(runs, runs[leans & slides])
    spans: Array = np.stack([breaks[:-1], breaks[1:]], axis=-1)[leans]
    return spans


_shared_data = lru_cache(maxsize=4)(_SharedData)


@dataclass(frozen=True, eq=False)
class ClockProfile:
    """A clock's phases of constant jerk, followed by a constant rate."""

    time: float  # plan time at the end [s]
    rate: float  # at the end
    slope: float = 0.0  # derivative of the rate at the end [1/s]
    # duration [s], and initial plan time with three derivatives, of each phase
    phases: tuple[tuple[float, float, float, float, float], ...] = ()

    @property
    def now(self) -> tuple[float, float, float, float]:
        """Initial plan time and three derivatives."""
        return self.phases[0][1:] if self.phases else (self.time, self.rate, self.slope, 0.0)

    @property
    def seconds(self) -> float:
        """Duration of the phases [s]."""
        return sum(phase[0] for phase in self.phases)

    @property
    def clock(self) -> ClockPhases:
        """The phases as arrays."""
        rows = np.reshape(self.phases, (-1, 5))
        return ClockPhases(np.zeros(len(rows), dtype=np.intp), rows[:, 1:], rows[:, 0])

    def then(self, seconds: float, jerk: float = 0.0) -> ClockProfile:
        """Return the profile with another phase of a duration [s], dropped if it is too short."""
        if seconds <= MIN_PHASE:
            return self
        start = self.time, self.rate, self.slope, jerk
        return ClockProfile(*_advanced(start, seconds)[:3], (*self.phases, (seconds, *start)))

    def to(self, rate: float, duration: float) -> ClockProfile:
        """Return the profile with a change from a constant rate to another one.

        Two phases change the rate in ``duration`` [s] with the smallest jerk.
        """
        if abs(rate - self.rate) <= CLOCK_TOLERANCE:
            return self
        jerk = 4.0 * (rate - self.rate) / duration**2
        changed = self.then(0.5 * duration, jerk).then(0.5 * duration, -jerk)
        return replace(changed, rate=rate, slope=0.0)

    def to_constant_rate(self, duration: float) -> ClockProfile | None:
        """Return the profile with a phase to a constant rate; None if the rate changes its sign.

        The jerk is that of a change of the rate by 1 in ``duration`` [s].
        """
        jerk = 4.0 / duration**2
        rate = self.rate + 0.5 * self.slope * abs(self.slope) / jerk
        if abs(rate) > 1.0 + CLOCK_TOLERANCE or self.rate * rate < 0.0:
            return None
        profile = self.then(abs(self.slope) / jerk, -math.copysign(jerk, self.slope))
        return replace(profile, rate=0.0 if abs(rate) <= CLOCK_TOLERANCE else rate, slope=0.0)

    def after(self, seconds: float) -> ClockProfile:
        """Return the rest of the profile after some time [s]."""
        for i, (duration, *jet) in enumerate(self.phases):
            if seconds < duration - MIN_PHASE:
                first = duration - seconds, *_advanced(tuple(jet), seconds)
                return replace(self, phases=(first, *self.phases[i + 1 :]))
            seconds = max(seconds - duration, 0.0)
        return ClockProfile(self.time + seconds * self.rate, self.rate)


Change = Callable[[ClockProfile, float], Iterator[ClockProfile]]
"""Function that yields courses extended by a change of the rate of a duration [s]."""


def _advanced(jet: tuple[float, ...], dt: float) -> tuple[float, float, float, float]:
    """Return the jet of a cubic after ``dt``; scalars are faster here than arrays of four."""
    p, v, a, j = jet
    position = p + dt * (v + dt * (a / 2.0 + dt * j / 6.0))
    return position, v + dt * (a + dt * j / 2.0), a + dt * j, j


def _to_rate(rate: float, first_part: ClockProfile, duration: float) -> Iterator[ClockProfile]:
    """Yield the change to a constant rate, with a stop where the direction reverses."""
    profile = first_part.to_constant_rate(duration)
    if profile is not None:
        profile = profile.to(0.0, duration) if rate * profile.rate < 0.0 else profile
        yield profile.to(rate, duration)


def _to_time(goal: float, first_part: ClockProfile, duration: float) -> Iterator[ClockProfile]:
    """Yield courses that stop at a plan time: at the current rate, or after a stop at others."""
    profile = first_part.to_constant_rate(duration)
    if profile is None:
        return
    if profile.rate != 0.0:
        delay = (goal - profile.time) / profile.rate - 0.5 * duration
        if delay >= MIN_SPACING:
            yield profile.then(delay).to(0.0, duration)
        profile = profile.to(0.0, duration)
    change = goal - profile.time
    if abs(change) <= CLOCK_TOLERANCE:
        yield profile
        return
    for max_rate in SEEK_RATES:
        rate = math.copysign(min(max_rate, abs(change) / (duration + MIN_SPACING)), change)
        yield profile.to(rate, duration).then(change / rate - duration).to(0.0, duration)


class Sampler:
    """Polynomials (points, 3) [m] in a layout for fast evaluation at single times."""

    def __init__(self, part: PiecewisePolynomial) -> None:
        degree = part.degree
        derivatives = [part.differentiated(k).elevated(degree).coefficients for k in range(4)]
        rows = np.moveaxis(np.stack(derivatives, axis=1), -1, 1)
        self._rows = np.ascontiguousarray(rows.reshape(part.pieces, degree + 1, -1))
        self._binomials = [float(comb(degree, k)) for k in range(degree + 1)]
        self._shape = 4, *part.shape
        self._breaks = part.breaks.tolist()

    def values(
        self, time: float, rate: float = 1.0, slope: float = 0.0, jerk: float = 0.0
    ) -> Array:
        """Return positions and three real-time derivatives (4, points, 3) at a plan time.

        ``slope`` and ``jerk`` are derivatives of the clock's rate.
        """
        piece = min(max(bisect_right(self._breaks, time) - 1, 0), len(self._breaks) - 2)
        start, end = self._breaks[piece : piece + 2]
        x = min(max((time - start) / (end - start), 0.0), 1.0)
        degree = len(self._binomials) - 1
        weights = [c * x**k * (1.0 - x) ** (degree - k) for k, c in enumerate(self._binomials)]
        values: Array = np.dot(weights, self._rows[piece]).reshape(4, -1)
        if (rate, slope, jerk) != (1.0, 0.0, 0.0):
            first, second, third = values[1:].copy()
            values[1] = rate * first
            values[2] = rate**2 * second + slope * first
            values[3] = rate**3 * third + 3.0 * rate * slope * second + jerk * first
        return values.reshape(self._shape)
