"""Stops of the common clock, and the report ``stoppable``: the longest time to rest.

With x(τ) the plan, D its derivatives with respect to plan time and s = dτ/dt, the acceleration on a
clock is ``s² D²x + ṡ Dx`` and the jerk ``s³ D³x + 3 s ṡ D²x + s̈ Dx``: with these, the formulas of
the checks apply to drones on that clock. Forces on carried objects match the plan's own rate: ``(s²
- 1) D²x + ṡ Dx`` times their mass is unbalanced.

A cell is a phase of constant s̈ within one piece. If norms on whole pieces do not prove that it
keeps all limits, the formulas are enclosed on it, s and ṡ by lines over plan time. It is halved
until its middle violates a limit or all of it keeps them. A stop of duration T slows the rate from
1 to 0 in two phases of constant jerk ∓4/T², in 1/2 T of plan time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.clasps import spare_forces
from hitchopt.checks.drones import LIMITS, Drones, Hovering, thrust_share, tilt
from hitchopt.checks.grips import spare_friction, turning_reach
from hitchopt.checks.objects import heading_error, moving_objects
from hitchopt.checks.rule import CheckRule, FlightReport, WorstCase, WorstOverSpans
from hitchopt.checks.spans import (
    MotionSpans,
    derivative,
    derivative_margin,
    joined_arrays,
    value_cache,
)
from hitchopt.checks.support import SUPPORT
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

HALVINGS = 7  # Number of halvings of a cell to decide a bound; undecided cells count as violations
BATCH = 20_000  # Number of pairs of a cell and a drone that are evaluated at a time
SLACK = 1e-9  # Relative margin for the clock's rounding
MIN_STOP = 0.1  # [s] Shortest candidate of a stop
MAX_STOP = 20.0  # [s] Longest candidate of a stop
STOP_COUNT = 19  # Number of candidates, each a third longer than the last one
SPACING = 0.1  # [s] Spacing of stops
MAX_STARTS = 20_000  # Maximum number of pairs of a stop and a drone
MIN_STOPS = 8  # Minimum number of stops


def stop_phases(start: Array, duration: Array, rate: float = 1.0) -> ClockPhases:
    """Return the phases from a rate, 1 or 0, at plan times (m,) to the other one."""
    start, duration = np.broadcast_arrays(np.asarray(start, float), np.asarray(duration, float))
    half = 0.5 * duration
    jerk = (4.0 - 8.0 * rate) / duration**2
    at_rate = np.full_like(start, rate)
    first = np.stack([start, at_rate, np.zeros_like(start), jerk], axis=-1)
    second = advance(first, half)
    second[..., 3] = -jerk
    jets = np.stack([first, second], axis=1).reshape(-1, 4)
    return ClockPhases(np.repeat(np.arange(len(start)), 2), jets, np.repeat(half, 2))


def rates_of(cells: ClockPhases) -> Array:
    """Return bounds (3, cells, 1) of the rate s and its two time derivatives."""
    _, rate, slope, curvature = cells.jets.T
    duration = cells.duration
    # Bernstein coefficients of the quadratic rate, and of its derivatives
    middle = rate + 0.5 * duration * slope
    end = rate + duration * (slope + 0.5 * duration * curvature)
    of_rate = [rate, middle, end]
    of_slope = [slope, slope + duration * curvature]
    bounds = [np.max(np.abs(rows), axis=0) for rows in (of_rate, of_slope, [curvature])]
    return np.stack(bounds)[..., None]


class ClockRates(NamedTuple):
    """The time derivatives of plan time."""

    rate: Enclosed  # The rate s
    slope: Enclosed  # Its first time derivative [1/s]
    curvature: Enclosed  # Its second time derivative [1/s²]


class OnClock(MotionSpans):
    """Spans of plan time along cells of clocks, one each."""

    cells: ClockPhases  # The cells (spans,)

    @classmethod
    def of_cells(
        cls, source: Any, breaks: Array, cells: ClockPhases, piece: Indices, item: Indices
    ) -> Self:
        """Return the spans of items (spans,) along cells within pieces (spans,)."""
        times = np.stack([cells.jets[:, 0], cells.ends[:, 0]])
        places = (times - breaks[piece]) / (breaks[piece + 1] - breaks[piece])
        extent = np.sort(np.clip(places, 0.0, 1.0), axis=0)
        spans = cls(source, breaks, piece, item, extent, points=not np.any(cells.duration))
        spans.cells = cells
        return spans

    def _on_cells(self, cells: ClockPhases, index: Any = slice(None)) -> Self:
        """Return the chosen spans along other cells."""
        return self.of_cells(self.source, self.breaks, cells, self.piece[index], self.item[index])

    def take(self, index: Flags | Indices | slice) -> Self:
        """Return the chosen spans."""
        return self._on_cells(self.cells.select(index), index)

    def halves(self) -> Self:
        """Return all first halves by time, then all second halves."""
        half = 0.5 * self.cells.duration
        twice = np.tile(np.arange(len(self)), 2)
        jets = np.concatenate([self.cells.jets, advance(self.cells.jets, half)])
        return self._on_cells(ClockPhases(self.cells.owner[twice], jets, half[twice]), twice)

    def at(self, x: Array | float, index: Any = slice(None)) -> Self:
        """Return the points at x (spans,) of their time, from 0 to 1, of the chosen spans."""
        cells = self.cells.select(index)
        jets = advance(cells.jets, x * cells.duration)
        return self._on_cells(ClockPhases(cells.owner, jets, 0.0 * cells.duration), index)

    @lazy
    def clock(self) -> ClockRates:
        """The rate s and its time derivatives, as lines over plan time.

        In h seconds, plan time deviates from its chord by ``h² |ṡ| / 8``, and s by ``h² |s̈| / 8``.
        """
        start = self.cells.jets
        end = self.cells.ends
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

        return ClockRates(
            rate=line(1, error * np.abs(start[:, 3])),
            slope=line(2, 0.0),
            curvature=Enclosed(start[:, 3:, None]),
        )

    def accelerated(self, velocity: Enclosed, acceleration: Enclosed) -> Enclosed:
        """Return the acceleration from derivatives with respect to plan time."""
        rate, slope, _ = self.clock
        return rate * rate * acceleration + slope * velocity


class DronesOnClock(OnClock, Drones):
    """Spans of drones on clocks: derivatives are by time, the rest is as in the checks."""

    @lazy
    def _motion_rates(self) -> tuple[Enclosed, Enclosed, Enclosed]:
        """Velocities [m/s], accelerations [m/s²] and jerks [m/s³]."""
        rate, slope, curvature = self.clock
        velocity, acceleration, jerk = (
            self.derivative(self.source.drones, order) for order in (1, 2, 3)
        )
        jerk_on_clock = rate * rate * rate * jerk + rate * slope * 3.0 * acceleration
        return (
            rate * velocity,
            self.accelerated(velocity, acceleration),
            jerk_on_clock + curvature * velocity,
        )

    def motion_rate(self, order: int) -> Enclosed:
        """Return a time derivative of the position, up to the third."""
        return self._motion_rates[order - 1] if order else super().motion_rate(0)

    def by_time(self, rate: Enclosed) -> Enclosed:
        """Return a time derivative, from that with respect to the plan's time."""
        return rate * self.clock.rate


@dataclass(frozen=True, eq=False)
class ClockLimit:
    """Limits of items that bound a clock's rates."""

    path: PiecewisePolynomial  # (items, 3) [m], paths of the items, on pieces of the plan
    orders: int  # Number of derivatives of the paths that enter
    over: type[OnClock]  # Type of the spans on which utilization is bounded
    source: Any  # Source of these spans
    norms_suffice: Callable[..., Flags]
    """Function that returns whether norms prove that limits hold (cells, items): norms of
    derivatives (orders, cells, items), pieces (cells,), and bounds (cells, 1) of the clock's rate
    and its two derivatives there."""

    # Function of spans that returns their largest fraction of a limit (spans,)
    utilization: Callable[[Any], Array]

    @lazy
    def sizes(self) -> Array:
        """(orders, pieces, items): bounds of the norms of derivatives with respect to plan time."""
        bounds = []
        for order in range(1, self.orders + 1):
            norms = column_lengths(derivative(self.path, order))
            bounds.append(np.max(norms, axis=-1) + derivative_margin(self.path, order))
        return np.stack(bounds) * (1.0 + SLACK)

    def decide(self, phases: ClockPhases, feasible: Flags) -> None:
        """Set ``feasible`` (owners,) to False unless phases provably keep the limits."""
        breaks = self.path.breaks
        all_cells, piece_of_all = phases.cut(breaks, 0.0)
        flown = (piece_of_all >= 0) & (piece_of_all < len(breaks) - 1)
        cells = all_cells.select(flown)
        piece = piece_of_all[flown]
        cells_per_batch = max(1, BATCH // self.sizes.shape[2])
        for first in range(0, len(piece), cells_per_batch):
            check_time()
            batch = np.arange(first, min(first + cells_per_batch, len(piece)))
            batch = batch[feasible[cells.owner[batch]]]
            rates = rates_of(cells.select(batch))
            sizes = self.sizes[:, piece[batch]]
            suffices = self.norms_suffice(sizes, piece[batch], *rates)
            undecided, item = np.nonzero(~suffices)
            cell = batch[undecided]
            spans = self.over.of_cells(self.source, breaks, cells.select(cell), piece[cell], item)
            self._refine(spans, feasible, HALVINGS)

    def _refine(self, spans: OnClock, feasible: Flags, halvings: int) -> None:
        """Set ``feasible`` to False where spans violate a limit, or stay undecided."""
        if len(spans):
            keeps_limits = self.utilization(spans.at(0.5)) <= 1.0  # nan does not
            feasible[spans.cells.owner[~keeps_limits]] = False
            spans = spans.take(feasible[spans.cells.owner])
        if len(spans):
            is_proven = self.utilization(spans) * (1.0 + SLACK) <= 1.0
            undecided = spans.take(~is_proven)
            if halvings:
                self._refine(undecided.halves(), feasible, halvings - 1)
            else:
                feasible[undecided.cells.owner] = False


class ClockLimits:
    """Limits of a flight's teams that bound clocks; ``carried`` are those of carried objects."""

    def __init__(self, flight: Flight) -> None:
        motions = [flown.motion for flown in flight.teams]
        with value_cache():
            carried = [path for motion in motions for path in carried_paths(motion)]
            self.carried = [_limit_of_inertia(path) for path in carried]
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


BOUNDED_BY_NORMS = frozenset({"acceleration", "jerk", "thrust", "tilt"})
"""Limits that norms of derivatives of the path may prove."""

OTHERS = tuple(
    rule for rule in LIMITS if rule.derivative >= 2 and rule.name not in BOUNDED_BY_NORMS
)
"""Other limits of drones that a clock may break; rates of at most 1 keep those of speeds."""


def _shares_of(rule: CheckRule, motion: Motion) -> list[Callable[[Drones], Array]]:
    """Return the functions of spans that return fractions of a limit; none without a limit."""
    limit = rule.limit_of(motion)
    formulas = (each.evaluate for each in rule.evaluators)
    return [
        partial(formula.shares, limit=limit)
        for formula in formulas
        if limit is not None and isinstance(formula, WorstOverSpans)
    ]


def _limit_of_drones(motion: Motion) -> ClockLimit:
    """Return the limits of a motion's drones."""
    limits = motion.requirements.limits
    others = [share for rule in OTHERS for share in _shares_of(rule, motion)]
    spare = _spare_acceleration(motion)

    def norms_suffice(
        sizes: Array, piece: Indices, rate: Array, slope: Array, curvature: Array
    ) -> Flags:
        if others:
            return np.zeros(sizes.shape[1:], dtype=np.bool_)
        velocity, acceleration, jerk = sizes
        on_clock = rate * rate * acceleration + slope * velocity
        jerk_on_clock = (
            rate * rate * rate * jerk + 3.0 * rate * slope * acceleration + curvature * velocity
        )
        suffices = on_clock <= np.minimum(spare[piece], limits.acceleration)
        return np.asarray(suffices & (jerk_on_clock <= limits.jerk))

    def utilization(spans: DronesOnClock) -> Array:
        """Return the largest fraction of a limit (spans,), by the formulas of the checks."""
        acceleration = spans.motion_rate(2).norm_upper.value
        jerk = spans.motion_rate(3).norm_upper.value
        shares = [acceleration / limits.acceleration, jerk / limits.jerk]
        shares += [share(spans) for share in others]
        if others or not np.all(acceleration <= spare[spans.piece, spans.item]):
            shares += [thrust_share(spans).value, tilt(spans).value / math.degrees(limits.tilt)]
        return np.asarray(np.max(shares, axis=0))

    return ClockLimit(motion.drones, 3, DronesOnClock, motion, norms_suffice, utilization)


def _spare_acceleration(motion: Motion) -> Array:
    """Return the spare acceleration of hovering drones in any direction (pieces, drones) [m/s²]."""
    spare = np.zeros((motion.drones.pieces, motion.team.drones))
    max_thrust = motion.team.max_thrust
    for spans in Hovering.of(motion):
        tilt_margin = math.degrees(motion.requirements.limits.tilt) - tilt(spans).value
        sines = np.sin(np.radians(np.clip(tilt_margin, -90.0, 90.0)))
        to_cone = spans.thrust.norm_lower.value * sines  # distance of the thrust from the cone
        to_sphere = max_thrust[spans.item] - spans.thrust.norm_upper.value
        spare[spans.piece, spans.item] = np.minimum(to_sphere, to_cone) / spans.mass[:, 0]
    return spare * (1.0 - SLACK)


class CarriedPaths(NamedTuple):
    """Paths of points of a carried object, and the accelerations that a clock may add to them."""

    paths: PiecewisePolynomial  # (items, 3) [m]
    slack: Array  # (pieces, items) [m/s²], the largest additional accelerations


def _limit_of_inertia(carried: CarriedPaths) -> ClockLimit:
    """Return the limit of additional accelerations of a carried object."""
    paths = carried.paths
    slack = np.maximum(np.nan_to_num(carried.slack), 0.0)

    def norms_suffice(sizes: Array, piece: Indices, rate: Array, slope: Array, _: Array) -> Flags:
        velocity, acceleration = sizes
        added = np.maximum(rate * rate, 1.0) * acceleration + slope * velocity
        return np.asarray(added <= slack[piece])

    def utilization(spans: OnClock) -> Array:
        velocity = spans.derivative(paths, 1)
        acceleration = spans.derivative(paths, 2)
        added = (spans.accelerated(velocity, acceleration) - acceleration).norm_upper.value
        return np.divide(added, slack[spans.piece, spans.item])

    return ClockLimit(paths, 2, OnClock, paths, norms_suffice, utilization)


@dataclass(frozen=True, eq=False)
class StopTable:
    """Stops that keep all limits, by the plan time at which they begin."""

    end: float  # [s] Plan time at which the plan ends at rest; infinite if it does not
    starts: Array  # (stops,) [s], increasing plan times at which stops begin
    durations: Array  # (stops,) [s], durations of the stops; infinite if no stop is feasible

    @property
    def longest(self) -> tuple[Array, Array]:
        """Longest times to rest [s] of commands in intervals, and the begins of these [s].

        Intervals lie between starts; the last one is from the last start to the end of the plan. A
        stop that is commanded in an interval may wait for any later start, or for the end of the
        plan: it takes what rests soonest. It takes longest if commanded right after the begin.
        """
        begins = np.concatenate([[min(0.0, self.starts[0])], self.starts])
        rest_times = np.append(self.starts + self.durations, self.end)
        soonest_rests = np.minimum.accumulate(rest_times[::-1])[::-1]
        return soonest_rests - begins, begins

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

    They begin where the flight can be cut. Each has the shortest of some candidate durations, by
    bisection; stops that end no sooner than a later one are skipped. The end counts as rest if the
    drones are at rest there. ``limits`` are those of the flight, if known.
    """
    limits = limits or ClockLimits(flight)
    starts = _stop_starts(flight)
    final_rates = [np.abs(flight.drones.ends(order)[1][-1]) for order in (1, 2)]
    rests_at_end = bool(np.max(final_rates) <= REST_RATE)
    end = float(flight.breaks[-1]) if rests_at_end else math.inf
    candidates = np.geomspace(MIN_STOP, MAX_STOP, STOP_COUNT)
    durations = np.full(len(starts), np.inf)
    # Indices of candidates for each stop: those between both are undecided
    longest_infeasible = np.full(len(starts), -1)
    shortest_feasible = np.full(len(starts), len(candidates))
    while True:
        # A stop that ends no sooner than a later one, or than the plan, is not needed
        rest_times = np.append(starts + durations, end)
        soonest_rests = np.minimum.accumulate(rest_times[::-1])[::-1]
        soonest_later_rests = soonest_rests[1:]
        first_unneeded = np.searchsorted(candidates, soonest_later_rests - starts)
        shortest_feasible = np.minimum(shortest_feasible, first_unneeded)

        undecided = np.flatnonzero(shortest_feasible - longest_infeasible > 1)
        if not len(undecided):
            return StopTable(end, starts, durations)
        infeasible, feasible = longest_infeasible[undecided], shortest_feasible[undecided]
        # With a carried object, longer stops may be infeasible: no bisection then.
        tried = infeasible + 1 if limits.carried else (infeasible + feasible) // 2
        succeeds = _feasible_stops(limits, starts[undecided], candidates[tried])
        durations[undecided[succeeds]] = candidates[tried[succeeds]]
        shortest_feasible[undecided[succeeds]] = tried[succeeds]
        longest_infeasible[undecided[~succeeds]] = tried[~succeeds]


def _stop_starts(flight: Flight) -> Array:
    """Return the plan times (stops,) [s] at which stops are sought."""
    begin, end = flight.breaks[[0, -1]].tolist()
    max_stops = max(MAX_STARTS // flight.team.drones, MIN_STOPS)
    stops = max(1, int(min(np.ceil((end - begin) / SPACING), max_stops)))
    starts = np.unique(flight.spaced(np.linspace(begin, end, stops + 1)[:-1]))
    before_end: Array = starts[starts < end]
    return before_end


def _feasible_stops(limits: ClockLimits, starts: Array, durations: Array) -> Flags:
    """Return which stops (m,) keep all limits, as do restarts with a carried object."""
    feasible = limits.keep(stop_phases(starts, durations), len(starts))
    rest_times = starts + 0.5 * durations
    carried = np.flatnonzero(feasible & limits.carries(rest_times))
    restarts = stop_phases(rest_times[carried], durations[carried], rate=0.0)
    feasible[carried] = limits.keep(restarts, len(carried))
    return feasible


def carried_paths(motion: Motion) -> Iterator[CarriedPaths]:
    """Yield the paths of all carried objects, on the pieces on which they move with their hold."""
    breaks = motion.drones.breaks
    for index, (name, body) in enumerate(motion.requirements.objects.items()):
        for by, paths_of in ((HoldBy.REST, _resting), (HoldBy.GRIP, _gripped)):
            is_carried = moving_objects(motion)[:, index] & held_pieces(motion, name, by)
            for first, last in true_runs(is_carried):
                if by is HoldBy.REST and body.rim is None:  # violates the check ``support``
                    continue
                phases = motion.overlapping(breaks[first], breaks[last])
                yield paths_of(motion.slice_pieces(slice(first, last), phases), index, body)


def _resting(motion: Motion, index: int, body: SolidObject) -> CarriedPaths:
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
    accelerations = points.differentiated(2).coefficients
    level = np.max(np.linalg.norm(accelerations[:, :, :2], axis=2), axis=-1)
    pressing = GRAVITY + np.min(accelerations[:, :, 2], axis=-1)
    sliding = (body.friction * pressing - level)[:, :-1] / (1.0 + body.friction)
    inside = SUPPORT.evaluators[0].evaluate(motion, 0.0).worst
    lean = height * (1.0 + level[:, -1] / pressing[:, -1])
    tipping = inside * pressing[:, -1] / (lean + inside)
    slack_of_clasps = np.minimum(bearing, sliding)
    slack_of_centre = np.minimum(tipping, np.min(bearing, axis=1))
    return CarriedPaths(points, np.column_stack([slack_of_clasps, slack_of_centre]))


def _gripped(motion: Motion, index: int, body: SolidObject) -> CarriedPaths:
    """Return the paths of centre and heading of a gripped object, and their slack.

    Edges push it as a whole. Friction carries it and turns it, one half for each.
    """
    pose = motion.poses.coefficients[:, index]
    heading = np.pad(pose[:, None, 3:], [(0, 0), (0, 0), (0, 1), (0, 0)])
    paths = joined_arrays([centre_path(pose, body)[:, None], heading], axis=1)
    clasp_forces = np.min(spare_forces(motion), axis=1)
    friction = 0.5 * spare_friction(motion, index)
    spare_force = np.minimum(clasp_forces, friction)
    spare_turning = friction / turning_reach(body)
    slack = np.column_stack([spare_force, spare_turning]) / body.mass
    return CarriedPaths(motion.drones.replaced(paths), slack)


def _longest_stop(flight: Flight) -> WorstCase:
    """Return the longest time to rest [s] over all times of a command, with that time."""
    longest, begins = stop_table(flight).longest
    worst = int(np.argmax(longest))
    return WorstCase(float(longest[worst]), float(begins[worst]))


STOPPABLE = FlightReport(
    "stoppable",
    "s",
    "max",
    _longest_stop,
    group="timing",
    proves="the longest time [s] from a command until all drones rest "
    "({doc}`/explanation/stopping`)",
    unproven="stops from another clock rate; that a half-tied hitch can stay",
)
