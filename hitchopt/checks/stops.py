"""Stops of the common clock, and the report ``stoppable``: the longest time to rest.

With x(τ) the plan, D its derivatives by plan time and s = dτ/dt, the acceleration on a clock is
``s² D²x + ṡ Dx`` and the jerk ``s³ D³x + 3 s ṡ D²x + s̈ Dx``: with these, the formulas of the checks
apply to drones on that clock. Forces on carried objects match the plan's own rate: ``(s² - 1) D²x +
ṡ Dx`` times their mass is unbalanced.

A cell is a phase of constant s̈ within one piece. If norms on whole pieces do not prove that it
keeps all limits, the formulas are enclosed on it, s and ṡ by lines over plan time. It is halved
until its middle violates a limit or all of it keeps them. A stop of duration T slows the rate from
1 to 0 in two phases of constant jerk ∓4/T², in 1/2 T of plan time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.clasps import spare_forces
from hitchopt.checks.drones import Drones, Hovering, thrust_share, tilt, turning_rate
from hitchopt.checks.objects import (
    SUPPORT,
    heading_error,
    moving_objects,
    spare_friction,
    turning_reach,
)
from hitchopt.checks.rule import FlightReport, WorstCase
from hitchopt.checks.spans import (
    MotionSpans,
    derivative,
    derivative_margin,
    joined_arrays,
    value_cache,
)
from hitchopt.errors import check_time
from hitchopt.geometry.vectors import column_lengths
from hitchopt.hitch import GRAVITY
from hitchopt.motion.flight import REST_RATE, Flight
from hitchopt.motion.loads import centre_path, held_pieces, supports_of
from hitchopt.motion.motion import HoldBy, Motion
from hitchopt.objects import SolidObject
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.clock_phases import ClockPhases, advance
from hitchopt.trajectory.enclosed import Enclosed
from hitchopt.values import Array, Indices, known, lazy, true_runs

Flags = NDArray[np.bool_]

HALVINGS = 7  # halvings of a cell to decide a bound; undecided cells count as violations
BATCH = 20_000  # pairs of a cell and a drone that are evaluated at a time
SLACK = 1e-9  # relative margin for the clock's rounding
MIN_STOP = 0.1  # shortest candidate of a stop [s]
MAX_STOP = 20.0  # longest candidate of a stop [s]
STOP_COUNT = 19  # number of candidates, each a third longer than the last one
SPACING = 0.1  # spacing of stops [s]
MAX_STARTS = 20_000  # maximum number of pairs of a stop and a drone
MIN_STOPS = 8  # minimum number of stops


def stop_phases(start: Array, duration: Array, rate: float = 1.0) -> ClockPhases:
    """Return the phases from a rate, 1 or 0, at plan times (m,) to the other one."""
    start, duration = np.broadcast_arrays(np.asarray(start, float), np.asarray(duration, float))
    jerk, zero = (4.0 - 8.0 * rate) / duration**2, np.zeros_like(start)
    first = np.stack([start, zero + rate, zero, jerk], axis=-1)
    second = advance(first, 0.5 * duration)
    second[..., 3] = -jerk
    jets = np.stack([first, second], axis=1).reshape(-1, 4)
    return ClockPhases(np.repeat(np.arange(len(start)), 2), jets, np.repeat(0.5 * duration, 2))


def rates_of(cells: ClockPhases) -> Array:
    """Return bounds (3, cells, 1) of the rate s and its two time derivatives."""
    (s, a, j), t = cells.jets.T[1:], cells.duration
    each = [s, s + 0.5 * t * a, s + t * (a + 0.5 * t * j)], [a, a + t * j], [j]
    return np.stack([np.max(np.abs(c), axis=0)[:, None] for c in each])


class OnClock(MotionSpans):
    """Spans of plan time along cells of clocks, one each."""

    cells: ClockPhases

    @classmethod
    def of_cells(
        cls, source: Any, breaks: Array, cells: ClockPhases, piece: Indices, item: Indices
    ) -> Self:
        """Return the spans of items (spans,) along cells within pieces (spans,)."""
        times = np.stack([cells.jets[:, 0], cells.ends[:, 0]])
        x = (times - breaks[piece]) / (breaks[piece + 1] - breaks[piece])
        extent = np.sort(np.clip(x, 0.0, 1.0), axis=0)
        spans = cls(source, breaks, piece, item, extent, points=not np.any(cells.duration))
        spans.cells = cells
        return spans

    def _on_cells(self, cells: ClockPhases, index: Any = slice(None)) -> Self:
        return self.of_cells(self.source, self.breaks, cells, self.piece[index], self.item[index])

    def take(self, index: Flags | Indices | slice) -> Self:
        """Return the chosen spans."""
        return self._on_cells(self.cells.select(index), index)

    def halves(self) -> Self:
        """Return all first halves by time, then all second halves."""
        half, twice = 0.5 * self.cells.duration, np.tile(np.arange(len(self)), 2)
        jets = np.concatenate([self.cells.jets, advance(self.cells.jets, half)])
        return self._on_cells(ClockPhases(self.cells.owner[twice], jets, half[twice]), twice)

    def at(self, x: Array | float, index: Any = slice(None)) -> Self:
        """Return the points at x (spans,) of their time, from 0 to 1, of the chosen spans."""
        cells = self.cells.select(index)
        jets = advance(cells.jets, x * cells.duration)
        return self._on_cells(ClockPhases(cells.owner, jets, 0.0 * cells.duration), index)

    @lazy
    def clock(self) -> tuple[Enclosed, Enclosed, Enclosed]:
        """The rate s and its time derivatives, as lines over plan time.

        In h seconds, plan time deviates from its chord by ``h² |ṡ| / 8``, and s by ``h² |s̈| / 8``.
        """
        start, end = self.cells.jets, self.cells.ends
        travel = np.abs(end[:, 0] - start[:, 0])
        error = self.cells.duration**2 / 8.0
        deviation = error * np.maximum(np.abs(start[:, 2]), np.abs(end[:, 2]))
        # Of the chord of plan time, by which values on a line over it are off
        fraction = np.divide(
            deviation, travel, out=np.ones_like(deviation), where=deviation < travel
        )
        is_backward = end[:, :1] < start[:, :1]

        def line(order: int, curvature: Array | float) -> Enclosed:
            """Return a derivative of plan time as a line over it, from its lower end on."""
            ends = np.stack([start[:, order], end[:, order]], axis=-1)
            radius = curvature + fraction * np.abs(end[:, order] - start[:, order])
            return Enclosed(np.where(is_backward, ends[:, ::-1], ends)[:, None], radius)

        return line(1, error * np.abs(start[:, 3])), line(2, 0.0), Enclosed(start[:, 3:, None])

    def accelerated(self, v: Enclosed, a: Enclosed) -> Enclosed:
        """Return the acceleration from derivatives by plan time."""
        s, slope, _ = self.clock
        return s * s * a + slope * v


class DronesOnClock(OnClock, Drones):
    """Spans of drones on clocks: derivatives are by time, the rest is as in the checks."""

    @lazy
    def _moved(self) -> tuple[Enclosed, Enclosed]:
        s, slope, jerk = self.clock
        v, a, j = (self.derivative(self.source.drones, order) for order in (1, 2, 3))
        return self.accelerated(v, a), s * s * s * j + s * slope * 3.0 * a + jerk * v

    def motion_rate(self, order: int) -> Enclosed:
        """Return the acceleration or the jerk."""
        return self._moved[order - 2]

    @lazy
    def load_rate(self) -> Enclosed:
        """[N/s] The time derivative of the load."""
        return super().load_rate * self.clock[0]


@dataclass(frozen=True, eq=False)
class ClockLimit:
    """Limits of items that bound a clock's rates."""

    path: PiecewisePolynomial  # paths of the items, on pieces of the plan [m]
    orders: int  # number of its derivatives that enter
    over: type[OnClock]  # type of the spans on which utilization is bounded
    source: Any  # of the spans
    # whether norms of derivatives (orders, cells, items) prove that limits hold, for pieces
    # (cells,) and the clock's rate and its derivatives there, (cells, 1) each
    norms_suffice: Callable[..., Flags]
    utilization: Callable[[Any], Array]  # largest fraction of a limit (spans,)

    @lazy
    def sizes(self) -> Array:
        """(orders, pieces, items): bounds of the norms of derivatives by plan time."""
        bounds = []
        for order in range(1, self.orders + 1):
            norms = column_lengths(derivative(self.path, order))
            bounds.append(np.max(norms, axis=-1) + derivative_margin(self.path, order))
        return np.stack(bounds) * (1.0 + SLACK)

    def decide(self, phases: ClockPhases, feasible: Flags) -> None:
        """Set ``feasible`` (owners,) to False unless phases provably keep the limits."""
        breaks = self.path.breaks
        cells, piece = phases.cut(breaks, 0.0)
        flown = (piece >= 0) & (piece < len(breaks) - 1)
        cells, piece = cells.select(flown), piece[flown]
        count = max(1, BATCH // self.sizes.shape[2])
        for first in range(0, len(piece), count):
            check_time()
            row = np.arange(first, min(first + count, len(piece)))
            row = row[feasible[cells.owner[row]]]
            rates = rates_of(cells.select(row))
            sizes = self.sizes[:, piece[row]]
            where, item = np.nonzero(~self.norms_suffice(sizes, piece[row], *rates))
            row = row[where]
            spans = self.over.of_cells(self.source, breaks, cells.select(row), piece[row], item)
            self._refine(spans, feasible, HALVINGS)

    def _refine(self, spans: OnClock, feasible: Flags, halvings: int) -> None:
        """Set ``feasible`` to False where spans violate a limit, or stay undecided."""
        if len(spans):
            middle = self.utilization(spans.at(0.5))
            feasible[spans.cells.owner[~(middle <= 1.0)]] = False
            spans = spans.take(feasible[spans.cells.owner])
        if len(spans):
            open_ = spans.take(~(self.utilization(spans) * (1.0 + SLACK) <= 1.0))
            if halvings:
                self._refine(open_.halves(), feasible, halvings - 1)
            else:
                feasible[open_.cells.owner] = False


class ClockLimits:
    """Limits of a flight's teams that bound clocks; ``carried`` are those of carried objects."""

    def __init__(self, flight: Flight) -> None:
        motions = [flown.motion for flown in flight.teams]
        with value_cache():
            paths = (path for motion in motions for path in carried_paths(motion))
            self.carried = [_inertia(path, slack) for path, slack in paths]
            self._drones = [_limit_of_drones(motion) for motion in motions]

    def keep(self, phases: ClockPhases, owners: int) -> Flags:
        """Return which clocks (owners,), with rates from -1 to 1, keep all limits."""
        feasible = np.ones(owners, dtype=np.bool_)
        with value_cache():
            for limit in (*self.carried, *self._drones):
                limit.decide(phases, feasible)
        return feasible

    def carries(self, times: Array) -> Flags:
        """Return whether an object is carried at plan times (m,) [s]."""
        spans = np.array([limit.path.breaks[[0, -1]] for limit in self.carried]).reshape(-1, 2)
        inside = (spans[:, 0] < times[:, None]) & (times[:, None] < spans[:, 1])
        return np.asarray(np.any(inside, axis=1))


def _limit_of_drones(motion: Motion) -> ClockLimit:
    """Return the limits of a motion's drones."""
    limits, spare = motion.requirements.limits, _spare(motion)
    body_rate = limits.body_rate

    def norms_suffice(sizes: Array, piece: Indices, s: Array, slope: Array, jerk: Array) -> Flags:
        v, a, j = sizes
        feasible: Flags = s * s * a + slope * v <= np.minimum(spare[piece], limits.acceleration)
        feasible &= s * s * s * j + 3.0 * s * slope * a + jerk * v <= limits.jerk
        return feasible & (body_rate is None)  # norms do not bound turning rates tightly

    def utilization(spans: DronesOnClock) -> Array:
        """Return the largest fraction of a limit (spans,), by the formulas of the checks."""
        acceleration, jerk = (spans.motion_rate(order).norm_upper.value for order in (2, 3))
        shares = [acceleration / limits.acceleration, jerk / limits.jerk]
        if body_rate is not None:
            shares.append(turning_rate(spans).value / math.degrees(body_rate))
        if body_rate is not None or not np.all(acceleration <= spare[spans.piece, spans.item]):
            shares += [thrust_share(spans).value, tilt(spans).value / math.degrees(limits.tilt)]
        return np.asarray(np.max(shares, axis=0))

    return ClockLimit(motion.drones, 3, DronesOnClock, motion, norms_suffice, utilization)


def _spare(motion: Motion) -> Array:
    """Return the spare acceleration of hovering drones in any direction (pieces, drones) [m/s²]."""
    spare, max_thrust = np.zeros((motion.drones.pieces, motion.team.drones)), motion.team.max_thrust
    for spans in Hovering.of(motion):
        margin = math.degrees(motion.requirements.limits.tilt) - tilt(spans).value
        sines = np.sin(np.radians(np.clip(margin, -90.0, 90.0)))
        horizontal = spans.thrust.norm_lower.value * sines
        thrust_margin = max_thrust[spans.item] - spans.thrust.norm_upper.value
        spare[spans.piece, spans.item] = np.minimum(thrust_margin, horizontal) / spans.mass[:, 0]
    return spare * (1.0 - SLACK)


def _inertia(path: PiecewisePolynomial, slack: Array) -> ClockLimit:
    """Return the limit of additional accelerations of paths (items, 3) to ``slack``."""
    slack = np.maximum(np.nan_to_num(slack), 0.0)

    def norms_suffice(sizes: Array, piece: Indices, s: Array, slope: Array, _: Array) -> Flags:
        return np.asarray(np.maximum(s * s, 1.0) * sizes[1] + slope * sizes[0] <= slack[piece])

    def utilization(spans: OnClock) -> Array:
        v, a = (spans.derivative(path, order) for order in (1, 2))
        added = (spans.accelerated(v, a) - a).norm_upper.value
        return np.divide(added, slack[spans.piece, spans.item])

    return ClockLimit(path, 2, OnClock, path, norms_suffice, utilization)


@dataclass(frozen=True, eq=False)
class StopTable:
    """Stops that keep all limits, by the plan time at which they begin."""

    end: float  # plan time at which the plan ends at rest [s]; infinite if it does not
    starts: Array  # (stops,) [s], increasing
    durations: Array  # (stops,) [s]; infinite if no stop is feasible

    @property
    def longest(self) -> tuple[Array, Array]:
        """Longest times to rest [s] from the intervals between starts, and their begins [s].

        The last interval lies between the last start and the end of the plan.
        """
        begins = np.concatenate([[min(0.0, self.starts[0])], self.starts])
        rest_times = np.append(self.starts + self.durations, self.end)
        return np.minimum.accumulate(rest_times[::-1])[::-1] - begins, begins

    def after(self, time: float) -> tuple[float, float]:
        """Return start and duration [s] of the earliest rest for a command at a time.

        If the plan ends sooner, return its end and zero.
        """
        first = int(np.searchsorted(self.starts, time))
        rest_times = self.starts[first:] + self.durations[first:]
        if not len(rest_times) or np.min(rest_times) >= self.end:
            return self.end, 0.0
        best = first + int(np.argmin(rest_times))
        return float(self.starts[best]), float(self.durations[best])


def stop_table(flight: Flight, limits: ClockLimits | None = None) -> StopTable:
    """Return stops that provably keep all limits of a flight, SPACING [s] from each other.

    Each has the shortest of some candidate durations, by bisection; stops that end no sooner than a
    later one are skipped. The end counts as rest if the drones are at rest there. ``limits`` are
    those of the flight, if known.
    """
    limits = limits or ClockLimits(flight)
    begin, end = flight.breaks[[0, -1]].tolist()
    max_starts = max(MAX_STARTS // flight.team.drones, MIN_STOPS)
    count = max(2, int(min(np.ceil((end - begin) / SPACING), max_starts)) + 1)
    starts = np.linspace(begin, end, count)[:-1]
    rate = max(np.max(np.abs(flight.drones.ends(order)[1][-1])) for order in (1, 2))
    rest = end if rate <= REST_RATE else np.inf
    ladder = np.geomspace(MIN_STOP, MAX_STOP, STOP_COUNT)
    durations = np.full(len(starts), np.inf)
    # Rungs of the ladder: the longest that is known to be infeasible, the shortest that is not
    low, high = np.full(len(starts), -1), np.full(len(starts), len(ladder))
    while True:
        rest_times = np.append(starts + durations, rest)
        soonest = np.minimum.accumulate(rest_times[::-1])[-2::-1]  # of all later ones
        high = np.minimum(high, np.searchsorted(ladder, soonest - starts))
        if not len(undecided := np.flatnonzero(high - low > 1)):
            return StopTable(rest, starts, durations)
        # With a carried object, longer stops may be infeasible: no bisection then.
        rung = low[undecided] + 1 if limits.carried else (low[undecided] + high[undecided]) // 2
        feasible = _feasible_stops(limits, starts[undecided], ladder[rung])
        durations[undecided[feasible]] = ladder[rung[feasible]]
        high[undecided[feasible]] = rung[feasible]
        low[undecided[~feasible]] = rung[~feasible]


def _feasible_stops(limits: ClockLimits, starts: Array, durations: Array) -> Flags:
    """Return which stops (m,) keep all limits, as do restarts with a carried object."""
    feasible = limits.keep(stop_phases(starts, durations), len(starts))
    rest_times = starts + 0.5 * durations
    held = np.flatnonzero(feasible & limits.carries(rest_times))
    feasible[held] = limits.keep(stop_phases(rest_times[held], durations[held], 0.0), len(held))
    return feasible


def carried_paths(motion: Motion) -> Iterator[tuple[PiecewisePolynomial, Array]]:
    """Yield paths (items, 3) [m] of carried objects, and their slack (pieces, items) [m/s²]."""
    breaks = motion.drones.breaks
    for index, (name, body) in enumerate(motion.requirements.objects.items()):
        for by, paths_of in ((HoldBy.REST, _resting), (HoldBy.GRIP, _gripped)):
            mask = moving_objects(motion)[:, index] & held_pieces(motion, name, by)
            for first, last in true_runs(mask):
                if by is HoldBy.REST and body.rim is None:  # violates the check ``support``
                    continue
                phases = motion.overlapping(breaks[first], breaks[last])
                yield paths_of(motion.slice_pieces(slice(first, last), phases), index, body)


def _resting(motion: Motion, index: int, body: SolidObject) -> tuple[PiecewisePolynomial, Array]:
    """Return the paths of clasps below a rim and of the centre of mass, and their slack.

    Clasps carry shares of the mass, and loads that the higher centre of mass shifts between them.
    Friction moves the rim with them. The force line meets their plane within their polygon.
    """
    pose = motion.poses.coefficients[:, index]
    places = motion.vertices.coefficients[:, motion.team.layout.clasps]
    centre = centre_path(pose, body)[:, None]
    points = motion.vertices.replaced(joined_arrays([places, centre], axis=1))
    height = abs(body.centre_of_mass[2] - known(body.rim).height)
    supports = supports_of(motion, index, body)
    shifted = height * np.linalg.norm(supports.gains, axis=-1)
    shifted *= 1.0 + heading_error(Enclosed(pose[:, 3:]))[:, None]
    bearing = spare_forces(motion) / (body.mass * (supports.shares + shifted))
    pushed = points.differentiated(2).coefficients
    level = np.max(np.linalg.norm(pushed[:, :, :2], axis=2), axis=-1)
    pressing = GRAVITY + np.min(pushed[:, :, 2], axis=-1)
    sliding = (body.friction * pressing - level)[:, :-1] / (1.0 + body.friction)
    inside = SUPPORT.evaluators[0].evaluate(motion, 0.0).worst
    lean = height * (1.0 + level[:, -1] / pressing[:, -1])
    tipping = inside * pressing[:, -1] / (lean + inside)
    whole = np.minimum(tipping, np.min(bearing, axis=1))
    slack = np.column_stack([np.minimum(bearing, sliding), whole])
    return points, slack


def _gripped(motion: Motion, index: int, body: SolidObject) -> tuple[PiecewisePolynomial, Array]:
    """Return the paths of centre and heading of a gripped object, and their slack.

    Edges push it as a whole. Friction carries it and turns it, one half for each.
    """
    pose = motion.poses.coefficients[:, index]
    heading = np.pad(pose[:, None, 3:], [(0, 0), (0, 0), (0, 1), (0, 0)])
    paths = joined_arrays([centre_path(pose, body)[:, None], heading], axis=1)
    forces, friction = np.min(spare_forces(motion), axis=1), 0.5 * spare_friction(motion, index)
    slack = [np.minimum(forces, friction), friction / turning_reach(body)]
    return motion.drones.replaced(paths), np.column_stack(slack) / body.mass


def _longest_stop(flight: Flight) -> WorstCase:
    """Return the longest time to rest [s] over all times of a command, with that time."""
    longest, begins = stop_table(flight).longest
    worst = int(np.argmax(longest))
    return WorstCase(float(longest[worst]), float(begins[worst]))


STOPPABLE = FlightReport("stoppable", "s", "max", _longest_stop)
