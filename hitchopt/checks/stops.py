"""Stops of the common clock, and the report ``stoppable``: how long until all drones rest.

With x(τ) the plan, D its derivatives by plan time and s = dτ/dt, a clock makes the acceleration
``s² D²x + ṡ Dx`` and the jerk ``s³ D³x + 3 s ṡ D²x + s̈ Dx``; the force of a cable depends on the
place alone, and changes s times as fast. With these, drones on a clock are spans like all others,
and the formulas of the checks hold of them. What is carried is pulled along by forces that fit the
plan's own rate: ``(s² - 1) D²x + ṡ Dx`` times its mass is left unbalanced, and has to stay within
what checks ``equilibrium``, ``support`` and ``grip`` leave of their limits.

On a cell, a phase of constant s̈ within one piece, norms bound the sums: ``s² |D²x| + |ṡ| |Dx|`` and
the like. Where that does not do, s and ṡ are taken for their chords over plan time, and cells are
halved until the formulas decide.

A stop of duration T slows the clock's rate from 1 to 0 by two phases of constant jerk ∓4/T², the
shortest that a bound of that jerk allows; it takes 1/2 T of plan time. A command may wait, the plan
running on, until a stop can begin; a plan that ends at rest has reached rest there in any case.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks import clasps, support
from hitchopt.checks.drones import Drones, Hovering, rate_norm, thrust_used, tilt, turning_rate
from hitchopt.checks.gripping import heading_error, spare_friction, turning_reach
from hitchopt.checks.rule import Finding, Findings, ReportRule
from hitchopt.checks.spans import Spans, derivative_margin
from hitchopt.checks.tables import concatenated
from hitchopt.errors import check_time
from hitchopt.hitch import GRAVITY
from hitchopt.motion.loads import centre_path, held_pieces, supports_of
from hitchopt.motion.motion import HoldBy, Motion
from hitchopt.motion.retiming import REST
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import STILL
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.clock_phases import ClockPhases, advanced
from hitchopt.trajectory.enclosed import Bound, Enclosed
from hitchopt.values import Array, Indices

Flags = NDArray[np.bool_]

HALVINGS = 4
"""Halvings of a cell in which a bound is decided; what is undecided then counts as broken."""

BATCH = 20_000
"""Pairs of a cell and a drone that are looked at in one go."""

ORDER = 8
"""Degree in which forces of cables are written; what that loses is in their radius."""

SAMPLES = 4
"""Number of parts of a phase, at the middles of which samples are taken."""

SLACK = 1e-9
"""Relative margin for the clock's rounding."""

SHORTEST, LONGEST, SLOWEST = 0.1, 2.5, 20.0
"""[s] Durations of stops: the shortest and longest that are tried, and the longest with a reserve
or something that is carried, which allow no shorter ones."""

STEP, STEPS = 1.1, (0, 1, 2, 4)
"""Ratio of neighbouring durations, and which are tried after the shortest that points allow."""

SPACING, QUICK_SPACING, STARTS = 0.05, 0.2, 10_000
"""[s] Distances of stops, also while steering, and how many there are at most."""

LATEST = 1.5
"""Longest stops, relative to the time until the plan rests by itself."""

SWITCH = 5.0 / 12.0
"""Plan time over duration at which a stop's jerk changes its sign."""

TINY = 1e-12
"""[N], [m/s²] Slack counts as at least this where values are divided by it."""

ROWS = 5
"""Number of coordinates of a carried path; those that it does not have are zero."""


def stop_phases(start: Array, duration: Array, rate: float = 1.0) -> ClockPhases:
    """Return the phases that lead from a rate, 1 or 0, at plan times (m,) to the other one."""
    start, duration = np.broadcast_arrays(np.asarray(start, float), np.asarray(duration, float))
    jerk, zero = (4.0 - 8.0 * rate) / duration**2, np.zeros_like(start)
    first = np.stack([start, zero + rate, zero, jerk], axis=-1)
    second = advanced(first, 0.5 * duration)
    second[..., 3] = -jerk
    jets = np.stack([first, second], axis=1).reshape(-1, 4)
    return ClockPhases(np.repeat(np.arange(len(start)), 2), jets, np.repeat(0.5 * duration, 2))


start_phases = partial(stop_phases, rate=0.0)
"""Phases that lead from rest back to rate 1, as stops do."""


class OnClock(Spans):
    """Spans of which each lies within one phase of a clock."""

    kept: _Kept
    cells: ClockPhases

    @classmethod
    def flown(cls, kept: _Kept, cells: ClockPhases, piece: Indices, item: Indices) -> Self:
        """Return the spans of items (spans,) in pieces while clocks pass their cells."""
        breaks = kept.breaks
        begin = breaks[piece]
        times = np.stack([cells.jets[:, 0], cells.ends[:, 0]])
        x = np.sort(np.clip((times - begin) / (breaks[piece + 1] - begin), 0.0, 1.0), axis=0)
        made = cls(kept.motion, breaks, piece, item, *x)
        made.kept, made.cells, made.points = kept, cells, not np.any(cells.duration)
        return made

    def chosen(self, index: Flags) -> Self:
        """Return the chosen spans."""
        return self.flown(self.kept, self.cells.taken(index), self.piece[index], self.item[index])

    def middles(self) -> Self:
        """Return the points at their mid times."""
        jets = advanced(self.cells.jets, 0.5 * self.cells.duration)
        cells = ClockPhases(self.cells.owner, jets, np.zeros(len(jets)))
        return self.flown(self.kept, cells, self.piece, self.item)

    def halved(self) -> Self:
        """Return all first halves by time, then all second ones."""
        half = 0.5 * self.cells.duration
        jets = np.concatenate([self.cells.jets, advanced(self.cells.jets, half)])
        cells = ClockPhases(np.tile(self.cells.owner, 2), jets, np.tile(half, 2))
        piece, item = np.tile(self.piece, 2), np.tile(self.item, 2)
        return self.flown(self.kept, cells, piece, item)

    @cached_property
    def clock(self) -> tuple[Enclosed, ...]:
        """The rate s, s², ṡ and s̈ over plan time.

        By plan time the second derivative of s is ``s̈/s² - ṡ²/s³``, that of s² is ``2 s̈/s`` and
        that of ṡ is ``-ṡ s̈/s³``: an eighth of it times the square of the span bounds what is
        between a curve and its chord.
        """
        ends, t = np.stack([self.cells.jets, self.cells.ends]), self.cells.duration
        ends = np.where(ends[0, :, :1] > ends[1, :, :1], ends[::-1], ends)
        _, s, a, j = np.moveaxis(ends, -1, 0)
        if self.points:
            return tuple(Enclosed(each[0, :, None, None]) for each in (s, s * s, a, j))
        rate, slope = self.cells.jets[:, 1:3].T
        control = np.abs([s[0], s[1], rate + 0.5 * t * slope])  # of one sign
        low, high, steep = (
            np.min(control, axis=0),
            np.max(control, axis=0),
            np.max(np.abs(a), axis=0),
        )
        eighth, jerk = (ends[1, :, 0] - ends[0, :, 0]) ** 2 / 8.0, np.abs(j[0])
        with np.errstate(all="ignore"):
            bends = jerk / low**2 + steep**2 / low**3, 2.0 * jerk / low, steep * jerk / low**3
        spreads = high - low, high**2 - low**2, np.abs(a[1] - a[0])
        each = zip((s, s * s, a), bends, spreads, strict=True)
        chords = [
            Enclosed(f.T[:, None], np.fmin(eighth * bend, spread) * (1.0 + SLACK))
            for f, bend, spread in each
        ]
        return chords[0], chords[1], chords[2], Enclosed(j[0][:, None, None])

    @cached_property
    def vectors(self) -> list[Enclosed]:
        """Derivatives by plan time, and what else there is a table of: their chords."""
        at, kept, (low, high) = (self.piece, self.item), self.kept, self._ends
        places = low[:, None] if self.points else np.stack([low, high], axis=-1)
        weights = bernstein.basis(places, bernstein.degree(kept.table))
        rows = np.split(kept.table[at] @ np.swapaxes(weights, 1, 2), len(kept.margins), axis=1)
        off = (1.0 + SLACK) / 8.0 * (high - low) ** 2 * kept.bends[:, *at] + kept.margins[:, *at]
        return [Enclosed(c, r) for c, r in zip(rows, off, strict=True)]


class FlownDrones(OnClock, Drones):
    """Spans of drones on a clock."""

    @cached_property
    def acceleration(self) -> Enclosed:
        """The second derivative of the position by time."""
        (_, squared, slope, _), (v, a, *_) = self.clock, self.vectors
        return squared * a + slope * v

    def moved(self, order: int) -> Enclosed:
        """Return the second or third derivative of the position by time."""
        if order == 2:
            return self.acceleration
        (s, squared, slope, jerk), (v, a, j, *_) = self.clock, self.vectors
        return s * squared * j + s * slope * 3.0 * a + jerk * v

    @cached_property
    def load(self) -> Enclosed:
        """[N] The force of the cable on the drone, its sign changed."""
        return self.vectors[3]

    @cached_property
    def load_rate(self) -> Enclosed:
        """[N/s] The derivative of the load by time."""
        return self.clock[0] * self.vectors[4]


Judged = tuple[Callable[[Any], Bound], Callable[[Any], Array | float]]
"""A formula of spans on a clock, and its limit on each of them."""


class _Kept:
    """Items that limit what a clock may do."""

    over: type[OnClock]
    formulas: list[Judged]

    def __init__(
        self, motion: Motion, part: PiecewisePolynomial, orders: int, further: list[Enclosed]
    ) -> None:
        self.motion, self.breaks = motion, part.breaks
        vectors = [
            Enclosed(part.differentiated(k).coefficients, derivative_margin(part, k))
            for k in range(1, orders + 1)
        ]
        self.sizes = np.stack([each.size + each.r for each in vectors]) * (1.0 + SLACK)
        """(orders, pieces, items), bounds of the norms of derivatives by plan time."""
        self.table = concatenated([each.c for each in (*vectors, *further)], axis=2)
        self.margins = np.stack([each.r for each in (*vectors, *further)])
        bends = [
            bernstein.differentiate(bernstein.differentiate(each.c))
            for each in (*vectors, *further)
        ]
        self.bends = np.stack([Enclosed(each).size for each in bends])
        self._leading = np.unique(np.argmax(self.sizes, axis=2))

    def allowed(self, s: Array, slope: Array, jerk: Array, piece: Indices) -> Flags:
        """Return (cells, items) whether norms of a clock's rates show that limits are kept."""
        raise NotImplementedError

    def _quick(self, cells: ClockPhases, piece: Indices) -> Flags:
        begin, end = cells.jets, cells.ends
        middle = begin[:, 1] + 0.5 * cells.duration * begin[:, 2]
        s = np.max(np.abs([begin[:, 1], middle, end[:, 1]]), axis=0)
        slope, jerk = np.maximum(np.abs(begin[:, 2]), np.abs(end[:, 2])), np.abs(begin[:, 3])
        return self.allowed(s[:, None], slope[:, None], jerk[:, None], piece)

    def _keeps(self, spans: OnClock) -> Flags:
        """Return (spans,) whether all limits are kept on the whole of each."""
        fine = np.ones(len(spans), dtype=np.bool_)
        for formula, limit in self.formulas:
            fine &= formula(spans).value * (1.0 + SLACK) <= limit(spans)
        return fine

    def seems(self, phases: ClockPhases, owners: int) -> Flags:
        """Return (owners,) whether items that lead somewhere keep limits at samples."""
        part = np.repeat(phases.duration / SAMPLES, SAMPLES)
        middles = part * np.tile(0.5 + np.arange(SAMPLES), len(phases))
        jets = advanced(np.repeat(phases.jets, SAMPLES, axis=0), middles)
        piece = np.searchsorted(self.breaks, jets[:, 0], side="right") - 1
        flown = np.flatnonzero((piece >= 0) & (piece < len(self.breaks) - 1))
        row, item = np.repeat(flown, len(self._leading)), np.tile(self._leading, len(flown))
        cells = ClockPhases(np.repeat(phases.owner, SAMPLES), jets, np.zeros(len(jets)))
        kept = np.ones(owners, dtype=np.bool_)
        for batch in np.array_split(np.arange(len(row)), len(row) // BATCH + 1):
            points = self.over.flown(self, cells.taken(row[batch]), piece[row[batch]], item[batch])
            kept[points.cells.owner[~self._keeps(points)]] = False
        return kept

    def keep(self, phases: ClockPhases, owners: int) -> Flags:
        """Return (owners,) whether phases of each clock, with rates from -1 to 1, keep limits."""
        cells, piece = phases.cut(self.breaks, 0.0)
        flown = (piece >= 0) & (piece < len(self.breaks) - 1)
        cells, piece = cells.taken(flown), piece[flown]
        kept = np.ones(owners, dtype=np.bool_)
        count = max(1, BATCH // self.sizes.shape[2])
        for first in range(0, len(piece), count):
            check_time()
            row = np.arange(first, min(first + count, len(piece)))
            row = row[kept[cells.owner[row]]]
            where, item = np.nonzero(~self._quick(cells.taken(row), piece[row]))
            spans = self.over.flown(self, cells.taken(row[where]), piece[row[where]], item)
            kept[spans.cells.owner[~self._keeps(spans.middles())]] = False
            for _ in range(HALVINGS + 1):
                spans = spans.chosen(kept[spans.cells.owner])
                if not len(spans):
                    break
                spans = spans.chosen(~self._keeps(spans)).halved()
            kept[spans.cells.owner] = False
        return kept


class ClockLimits(_Kept):
    """The limits of a motion, for clocks.

    Attributes
    ----------
    reserved: whether the plan leaves something of them, so that stops can begin anywhere.
    inertia: what is carried; None where nothing is.
    """

    over = FlownDrones

    def __init__(self, motion: Motion) -> None:
        team, limits = motion.team, motion.requirements.limits
        names = ["load"] if limits.body_rate is None else ["load", "load_rate"]
        loads = [_hovering(motion, name) for name in names if team.has_cables]
        super().__init__(motion, motion.drones, 3, loads)
        self.reserved, self.inertia = limits.reserve < 1.0, CarriedInertia.of(motion)
        rates = (2, limits.acceleration), (3, limits.jerk)
        self.formulas = [
            *((partial(rate_norm, order=k), partial(_constant, limit)) for k, limit in rates),
            (thrust_used, partial(_constant, 1.0)),
            (tilt, partial(_constant, np.degrees(limits.tilt))),
        ]
        if limits.body_rate is not None:
            self.formulas.append((turning_rate, partial(_constant, np.degrees(limits.body_rate))))
        force = _hovering(motion, "thrust")
        level = np.hypot(force.c[..., 0, :], force.c[..., 1, :])
        beyond = level * np.cos(limits.tilt) - force.c[..., 2, :] * np.sin(limits.tilt)
        left = np.minimum(team.max_thrust - force.size, -np.max(beyond, axis=-1)) - force.r
        self._spare = np.minimum(left / team.mass, limits.acceleration)
        """(pieces, drones), acceleration that a drone can have in any direction."""

    def seems(self, phases: ClockPhases, owners: int) -> Flags:
        """Return (owners,) the same of drones and of what is carried."""
        kept = super().seems(phases, owners)
        return kept if self.inertia is None else kept & self.inertia.seems(phases, owners)

    def keep(self, phases: ClockPhases, owners: int) -> Flags:
        """Return (owners,) the same of drones and of what is carried."""
        kept = super().keep(phases, owners)
        return kept if self.inertia is None else kept & self.inertia.keep(phases, owners)

    def allowed(self, s: Array, slope: Array, jerk: Array, piece: Indices) -> Flags:
        """Return (cells, drones) whether norms show that limits are kept, turning left out."""
        limits, (v, a, j) = self.motion.requirements.limits, self.sizes[:, piece]
        fine: Flags = s * s * a + slope * v <= self._spare[piece]
        fine &= s * s * s * j + 3.0 * s * slope * a + jerk * v <= limits.jerk
        return fine & (limits.body_rate is None)


def _constant(limit: float, _: OnClock) -> float:
    return limit


def _hovering(motion: Motion, name: str) -> Enclosed:
    """Return a property of hovering drones, (pieces, drones) in one degree."""
    found = [getattr(spans, name).reduced(ORDER) for spans in Hovering.of(motion)]
    order, shape = max(each.degree for each in found), (motion.drones.pieces, motion.team.drones)
    c = np.concatenate([bernstein.elevate(each.c, order) for each in found])
    r = np.concatenate([np.broadcast_to(each.r, len(each.c)) for each in found])
    return Enclosed(c.reshape(*shape, *c.shape[1:]), r.reshape(shape))


def _added(spans: OnClock) -> Bound:
    """Return the size of the acceleration that a clock adds to the plan's own."""
    (_, squared, slope, _), (v, a) = spans.clock, spans.vectors
    return ((squared - 1.0) * a + slope * v).norm_above


class CarriedInertia(_Kept):
    """Paths (m, ROWS) whose additional accelerations a clock has to keep within a slack.

    Parameters
    ----------
    parts: of the motion, on which something is carried, as of ``carried_paths``.
    """

    over = OnClock

    def __init__(self, motion: Motion, parts: list[tuple[slice, Array, Array]]) -> None:
        items = max(path.shape[1] for _, path, _ in parts)
        order = max(bernstein.degree(path) for _, path, _ in parts)
        paths = np.zeros((motion.drones.pieces, items, ROWS, order + 1))
        self.slack = np.full(paths.shape[:2], np.inf)
        for run, path, slack in parts:
            count, known = path.shape[1], np.all(np.isfinite(path), axis=(2, 3))
            paths[run, :count] = np.nan_to_num(bernstein.elevate(path, order))
            self.slack[run, :count] = np.where(known, np.maximum(slack, 0.0), 0.0)
        self.paths = PiecewisePolynomial(motion.drones.breaks, paths)
        super().__init__(motion, self.paths, 2, [])
        self.formulas = [(_added, lambda spans: self.slack[spans.piece, spans.item])]
        self._spans = np.array([self.breaks[[run.start, run.stop]] for run, _, _ in parts])

    @classmethod
    def of(cls, motion: Motion) -> CarriedInertia | None:
        """Return that of a motion; None where it carries nothing."""
        parts = list(carried_paths(motion))
        return cls(motion, parts) if parts else None

    def during(self, begin: Array, end: Array) -> Flags:
        """Return (m,) whether something is carried within spans of plan time (m,) [s]."""
        begins, ends = self._spans.T
        found: Flags = np.any((ends > begin[:, None]) & (begins < end[:, None]), axis=1)
        return found

    def least_rate(self, begin: float, end: float) -> float:
        """Return the least constant rate that keeps the balance within a span of plan time [s].

        It is found at samples, to tell what to ask for, and verifies nothing.
        """
        breaks = self.breaks
        times = np.concatenate([breaks, 0.5 * (breaks[1:] + breaks[:-1])])
        times = times[(times >= begin) & (times <= end)]
        added = np.linalg.norm(self.paths.at(times, 2), axis=-1)  # at rest
        slack = np.maximum(self.slack[np.searchsorted(breaks[1:-1], times, side="right")], TINY)
        over = max(1.0, float(np.max(added / slack, initial=0.0)))
        return float(np.sqrt(1.0 - 1.0 / over))

    def allowed(self, s: Array, slope: Array, jerk: Array, piece: Indices) -> Flags:
        """Return (cells, paths) whether norms show that the slack is kept."""
        del jerk
        v, a = self.sizes[:, piece]
        found: Flags = np.maximum(s * s, 1.0) * a + slope * v <= self.slack[piece]
        return found


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
    def longest(self) -> tuple[Array, Array]:
        """Longest time to rest [s] from each stretch between starts, (stops,), and its begin [s].

        The last stretch lies between the last start and the end of the plan.
        """
        begins = np.concatenate([[min(0.0, self.starts[0])], self.starts])
        rests = np.append(self.starts + self.durations, self.end)
        return np.minimum.accumulate(rests[::-1])[::-1] - begins, begins

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
    motion: Motion, limits: ClockLimits | None = None, spacing: float = SPACING
) -> StopTable:
    """Return stops that keep all limits of a motion, ``spacing`` [s] from each other.

    Each has the shortest duration that points allow, or is a little longer where that is not shown
    to keep all limits. The end counts as rest only if the drones rest there. ``limits`` are those
    of the motion, where they are known.
    """
    limits = limits or ClockLimits(motion)
    begin, end = (float(each) for each in motion.drones.breaks[[0, -1]])
    count = max(2, int(min(np.ceil((end - begin) / spacing), STARTS)) + 1)
    starts = np.linspace(begin, end, count)[:-1]
    moving = max(np.max(np.abs(motion.drones.ends(order)[1][-1])) for order in (1, 2))
    rest = end if moving <= REST else np.inf
    slow = limits.inertia is not None or limits.reserved
    tried = SHORTEST * STEP ** np.arange(
        np.log((SLOWEST if slow else LONGEST) / SHORTEST) / np.log(STEP)
    )
    low = np.zeros(len(starts), np.intp)
    high = np.where(limits.seems(stop_phases(starts, tried[:1]), len(starts)), 0, len(tried) - 1)
    while np.any(low < high):
        middle = (low + high) // 2
        seems = limits.seems(stop_phases(starts, tried[middle]), len(starts))
        low, high = (
            np.where(seems, low, np.minimum(middle + 1, high)),
            np.where(seems, middle, high),
        )
    durations = np.full(len(starts), np.inf)
    for more in STEPS:
        longer = tried[np.minimum(low + more, len(tried) - 1)]
        useful = limits.reserved | (longer < LATEST * (rest - starts))
        left = np.flatnonzero(np.isinf(durations) & useful)
        left = left[_shown(limits, starts[left], longer[left])]
        durations[left] = longer[left]
    return StopTable(rest, starts, durations)


def _shown(limits: ClockLimits, starts: Array, durations: Array) -> Flags:
    """Return (m,) whether stops are shown to keep all limits.

    While something is carried, the clock can also start again from their rests.
    """
    kept, inertia = limits.keep(stop_phases(starts, durations), len(starts)), limits.inertia
    if inertia is not None:
        rests = starts + 0.5 * durations
        left = np.flatnonzero(kept & inertia.during(rests, rests))
        kept[left] = limits.keep(start_phases(rests[left], durations[left]), len(left))
    return kept


def carried_paths(motion: Motion) -> Iterator[tuple[slice, Array, Array]]:
    """Yield runs of pieces on which an object is carried, paths, and their slack.

    Paths are places times masses (pieces, items, coordinates, degree + 1) [kg m], or places [m].
    """
    breaks = motion.drones.breaks
    for index, (name, body) in enumerate(motion.requirements.objects.items()):
        poses = motion.object_poses.coefficients[:, index]
        moving = np.any(np.ptp(poses, axis=-1) > STILL, axis=-1)
        for by, parts in ((HoldBy.REST, _resting), (HoldBy.GRIP, _gripped)):
            on = moving & held_pieces(motion, name, by)
            edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]])))
            for first, last in edges.reshape(-1, 2).tolist():
                run = slice(first, last)
                if by is HoldBy.REST and body.rim is None:  # which check support refuses
                    continue
                span = motion.taken(run, motion.overlapping(breaks[first], breaks[last]))
                yield run, *parts(span, index, body)


def _resting(motion: Motion, index: int, body: SolidObject) -> tuple[Array, Array]:
    """Return paths and slack of an object that rests on clasps all the time.

    Clasps carry shares of its mass; they take what its centre of mass, being higher, moves from
    clasp to clasp; friction carries the rim along with clasps; and the line of weight and inertia
    meets their plane within their polygon.
    """
    pose = motion.object_poses.coefficients[:, index]
    places = motion.vertices.coefficients[:, motion.team.layout.clasps]
    centre = centre_path(pose, body)
    order = max(bernstein.degree(centre), bernstein.degree(places))
    places, centre = bernstein.elevate(places, order), bernstein.elevate(centre, order)
    assert body.rim is not None
    height = abs(body.centre_of_mass[2] - body.rim.height)
    supports = supports_of(motion, index, body)
    mass = body.mass * supports.shares
    moving = body.mass * height * np.linalg.norm(supports.gains, axis=-1)
    moving *= 1.0 + heading_error(Enclosed(pose[:, 3:]))[:, None]
    # Both add up in z: |a + b|² is at most 2 (a² + b²).
    twice = np.sqrt(2.0)
    factors = np.stack([mass, mass, twice * mass, *[twice * moving] * 2], axis=2)
    rows = [places, np.broadcast_to(centre[:, None, :2], (*mass.shape, 2, order + 1))]
    loads = factors[..., None] * np.concatenate(rows, axis=2)
    points = np.zeros((len(mass), mass.shape[1] + 1, ROWS, order + 1))
    points[:, :-1, :3], points[:, -1, :3] = places, centre
    pushed = motion.vertices.alike(points).differentiated(2).coefficients
    level = np.max(np.linalg.norm(pushed[:, :, :2], axis=2), axis=-1)
    pressing = GRAVITY + np.min(pushed[:, :, 2], axis=-1)
    sliding = (body.friction * pressing - level)[:, :-1] / (1.0 + body.friction)
    inside = support.SUPPORT.finders[0].find(motion, 0.0).worst
    lean = height * (1.0 + level[:, -1:] / pressing[:, -1:])
    tipping = inside * pressing[:, -1:] / (lean + inside)
    slack = [clasps.spare_forces(motion), sliding, tipping]
    return np.concatenate([loads, points], axis=1), np.concatenate(slack, axis=1)


def _gripped(motion: Motion, index: int, body: SolidObject) -> tuple[Array, Array]:
    """Return paths and slack of an object that edges grip all the time.

    They push it as a whole; friction bears it and turns it with them.
    """
    pose = motion.object_poses.coefficients[:, index]
    centre = centre_path(pose, body)
    order = max(bernstein.degree(pose), bernstein.degree(centre))
    paths = np.zeros((len(pose), 2, ROWS, order + 1))
    paths[:, 0, :3] = body.mass * bernstein.elevate(centre, order)
    # |a| + |b| is at most the root of 2 (a² + b²).
    paths[:, 1, 0] = np.sqrt(2.0) * paths[:, 0, 2]
    turning = np.sqrt(2.0) * body.mass * turning_reach(body)
    paths[:, 1, 1:3] = turning * bernstein.elevate(pose[:, 3:], order)
    forces = np.min(clasps.spare_forces(motion), axis=1)
    return paths, np.stack([forces, spare_friction(motion, index)], axis=1)


def _find(motion: Motion, found: Findings, gamma: float, spacing: float = SPACING) -> Finding:
    """Return the longest time [s] over all times of the command, and about when that is."""
    del found, gamma
    with np.errstate(all="ignore"):  # coefficients may be anything; nan breaks a limit
        longest, begins = stop_table(motion, spacing=spacing).longest
    worst = int(np.argmax(longest))
    return Finding(float(longest[worst]), float(begins[worst]))


RULE = ReportRule("stoppable", "s", "max", _find, whole=True)

QUICK = replace(RULE, find=partial(_find, spacing=QUICK_SPACING))
"""The same of fewer stops, for plans of which many are made: it is larger by their distance."""
