"""Stops of the common clock, and the report ``stoppable``: how long until all drones rest.

With x(τ) the plan, D its derivatives by plan time and s = dτ/dt, a clock makes the acceleration
``s² D²x + ṡ Dx`` and the jerk ``s³ D³x + 3 s ṡ D²x + s̈ Dx``, and the thrust ``m (a + g ẑ)`` less
the cable's force, which depends on the place alone. What is carried is pulled along by forces that
fit the plan's own rate: ``(s² - 1) D²x + ṡ Dx`` times its mass is left unbalanced, and has to stay
within what checks ``equilibrium``, ``support`` and ``grip`` leave of their limits.

On a cell, a phase of constant s̈ within one piece, norms bound them: ``s² |D²x| + |ṡ| |Dx|`` and
the like. Where that does not do, curves are taken for their chords by time, off them by an eighth
of the square of the cell's length times ``s² |D⁴x| + |ṡ| |D³x|`` and the like; the formulas are
enclosed, and cells halved until that decides.

A stop of duration T slows the clock's rate from 1 to 0 by two phases of constant jerk ∓4/T², the
shortest that a bound of that jerk allows; it takes 1/2 T of plan time. A command may wait, the plan
running on, until a stop can begin; a plan that ends at rest has reached rest there in any case.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.clasps import spare_forces
from hitchopt.checks.drones import Hovering
from hitchopt.checks.objects import SUPPORT, heading_error, spare_friction, turning_reach
from hitchopt.checks.rule import Finding, Findings, ReportRule
from hitchopt.checks.spans import derivative_margin
from hitchopt.errors import check_time
from hitchopt.geometry.vectors import column_lengths
from hitchopt.hitch import GRAVITY
from hitchopt.motion.loads import centre_path, held_pieces, supports_of
from hitchopt.motion.motion import HoldBy, Motion
from hitchopt.motion.retiming import REST
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import STILL
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.clock_phases import ClockPhases, advanced
from hitchopt.trajectory.enclosed import Enclosed
from hitchopt.values import Array, Indices

Flags = NDArray[np.bool_]

HALVINGS = 7
"""Halvings of a cell in which a bound is decided; what is undecided then counts as broken."""

BATCH = 20_000
"""Pairs of a cell and a drone that are looked at in one go."""

ORDER = 8
"""Degree in which forces at rest are written; what that loses is in their radius."""

SLACK = 1e-9
"""Relative margin for the clock's rounding."""

SHORTEST, LONGEST, SLOWEST = 0.1, 2.5, 20.0
"""[s] Durations of stops: the shortest and longest that are tried, and the longest with a reserve
or something that is carried, which allow no shorter ones."""

RATIO, CARRIED_RATIO = 1.25, 1.5
"""Ratios of neighbouring durations that are tried, about; the second while something is carried."""

SPACING, STARTS = 0.1, 10_000
"""[s] Distance of stops, and how many there are at most."""

LATEST = 1.5
"""Longest stops, relative to the time until the plan rests by itself."""


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


V = TypeVar("V", Array, Enclosed)


def _acceleration(s: V, slope: V, v: V, a: V) -> V:
    return s * s * a + slope * v


def _jerk(s: V, slope: V, jerk: V, v: V, a: V, j: V) -> V:
    return s * s * s * j + s * slope * 3.0 * a + jerk * v


@dataclass(frozen=True, eq=False)
class _Spans:
    """Cells of clocks within one piece of the plan, and an item (a drone, a path) each."""

    cells: ClockPhases
    piece: Indices
    item: Indices

    def taken(self, index: Flags | Indices) -> _Spans:
        return _Spans(self.cells.taken(index), self.piece[index], self.item[index])

    def halves(self) -> _Spans:
        half = 0.5 * self.cells.duration
        jets = np.concatenate([self.cells.jets, advanced(self.cells.jets, half)])
        cells = ClockPhases(np.tile(self.cells.owner, 2), jets, np.tile(half, 2))
        return _Spans(cells, np.tile(self.piece, 2), np.tile(self.item, 2))

    @cached_property
    def clock(self) -> tuple[Enclosed, Enclosed, Enclosed]:
        """The rate and its two derivatives."""
        (s, a, j), t = self.cells.jets.T[1:], self.cells.duration
        rate = [s, s + 0.5 * t * a, s + t * (a + 0.5 * t * j)], [a, a + t * j], [j]
        s, a, j = (Enclosed(np.stack(each, axis=-1)[:, None]) for each in rate)
        return s, a, j


class _Curves:
    """Vectors (pieces, items) that are polynomials of plan time, several of each item."""

    def __init__(self, breaks: Array, vectors: Sequence[Enclosed]) -> None:
        self.breaks = breaks
        order, h = max(each.degree for each in vectors), np.diff(breaks)[:, None]
        self._rows = np.cumsum([0, *(each.c.shape[2] for each in vectors)]).tolist()
        self._c = np.concatenate([bernstein.elevate(each.c, order) for each in vectors], axis=2)
        self._margins = np.stack([np.broadcast_to(each.r, self._c.shape[:2]) for each in vectors])
        slopes = [Enclosed(bernstein.differentiate(each.c)) for each in vectors]
        bends = [Enclosed(bernstein.differentiate(each.c)) for each in slopes]
        self._slopes = np.stack([each.size / h for each in slopes])
        self._bends = np.stack([each.size / h**2 for each in bends])
        self.sizes = np.stack([each.size + each.r for each in vectors]) * (1.0 + SLACK)
        """(vectors, pieces, items), bounds of norms."""

    @classmethod
    def of(cls, path: PiecewisePolynomial, count: int) -> _Curves:
        """Return the first derivatives of paths (items, d)."""
        each = [(path.differentiated(k), derivative_margin(path, k)) for k in range(1, count + 1)]
        return cls(path.breaks, [Enclosed(part.coefficients, margin) for part, margin in each])

    def along(self, spans: _Spans) -> list[Enclosed]:
        """Return the vectors by time: chords, and how far curves are off them."""
        begin, at = self.breaks[spans.piece], (spans.piece, spans.item)
        times = np.stack([spans.cells.jets[:, 0], spans.cells.ends[:, 0]], axis=-1)
        x = (times - begin[:, None]) / (self.breaks[spans.piece + 1] - begin)[:, None]
        weights = bernstein.basis(np.clip(x, 0.0, 1.0), bernstein.degree(self._c))
        ends = self._c[at] @ np.swapaxes(weights, 1, 2)
        s, slope, eighth = *(each.size for each in spans.clock[:2]), spans.cells.duration**2 / 8.0
        curved = s * s * self._bends[:, *at] + slope * self._slopes[:, *at]
        off = eighth * (1.0 + SLACK) * curved + self._margins[:, *at]
        rows = pairwise(self._rows)
        return [Enclosed(ends[:, slice(*row)], r) for row, r in zip(rows, off, strict=True)]


Judged = tuple[Flags, Flags]
"""Whether limits are broken, and whether all are shown to be kept (spans,)."""


def _within(value: Enclosed, measure: Callable[[Array], Array], limit: Array | float) -> Judged:
    """Judge a convex measure, no more than a ball's radius larger within it than at its middle."""
    sizes = measure(value.c)
    broken = ~(np.maximum(sizes[:, 0], sizes[:, -1]) <= limit)
    fine: Flags = np.max(sizes, axis=1) * (1.0 + SLACK) + value.r <= limit
    return broken, fine


def _turning(thrust: Enclosed, rate: Enclosed, limit: float) -> Judged:
    """Judge the turning rate ``f × ḟ / f²``."""
    across = thrust.cross(rate)
    sizes, most = (column_lengths(each.c)[:, [0, -1]] for each in (thrust, across))
    least = thrust.norm_below.value
    fine: Flags = across.norm_above.value * (1.0 + SLACK) <= limit * least**2
    return ~np.all(most <= limit * sizes**2, axis=1), fine


class _Limited:
    """Items that limit what a clock may do."""

    _curves: _Curves

    def _quick(self, s: Array, slope: Array, jerk: Array, piece: Indices) -> Flags:
        """Return (cells, items) whether norms show that limits are kept."""
        raise NotImplementedError

    def _judged(self, spans: _Spans) -> Judged:
        raise NotImplementedError

    def look(self, cells: ClockPhases, piece: Indices, kept: Flags) -> None:
        """Set ``kept`` (owners,) to False where cells, in pieces, are not shown to keep limits."""
        count = max(1, BATCH // self._curves.sizes.shape[2])
        for first in range(0, len(piece), count):
            check_time()
            row = np.arange(first, min(first + count, len(piece)))
            row = row[kept[cells.owner[row]]]
            whole = _Spans(cells.taken(row), piece[row], row)
            s, slope, jerk = (each.size[:, None] for each in whole.clock)
            where, item = np.nonzero(~self._quick(s, slope, jerk, piece[row]))
            spans = _Spans(whole.cells.taken(where), piece[row[where]], item)
            for _ in range(HALVINGS + 1):
                if not len(spans.piece):
                    break
                broken, fine = self._judged(spans)
                kept[spans.cells.owner[broken]] = False
                spans = spans.taken(np.flatnonzero(~fine & kept[spans.cells.owner])).halves()
            else:
                kept[spans.cells.owner] = False


class ClockLimits(_Limited):
    """The limits of a motion, for clocks.

    Attributes
    ----------
    reserved: whether the plan leaves something of them, so that stops can begin anywhere.
    sizes: (3, pieces, drones), bounds of the derivatives' norms by plan time.
    inertia: what is carried; None where nothing is.
    """

    def __init__(self, motion: Motion) -> None:
        self.motion, drones, limits = motion, motion.drones, motion.requirements.limits
        self.breaks, self.reserved = drones.breaks, limits.reserve < 1.0
        self._curves = _Curves.of(drones, 3)
        self.sizes = self._curves.sizes
        forces = [_hovering(motion, lambda spans: spans.thrust)]
        if limits.body_rate is not None:
            turned = motion.team.has_cables
            rate = _hovering(motion, lambda spans: spans.load_rate) if turned else 0.0 * forces[0]
            forces.append(rate)
        self._forces = _Curves(self.breaks, forces)
        team, beyond = motion.team, np.max(self._beyond(forces[0].c), axis=-1) + forces[0].r
        self._spare = np.minimum(team.max_thrust - self._forces.sizes[0], -beyond) / team.mass
        """(pieces, drones), acceleration that a drone can have in any direction."""
        self.inertia = CarriedInertia.of(motion)

    def keep(self, phases: ClockPhases, owners: int) -> Flags:
        """Return (owners,) whether phases of each clock, with rates from -1 to 1, keep limits."""
        cells, piece = phases.cut(self.breaks, 0.0)
        flown = (piece >= 0) & (piece < len(self.breaks) - 1)
        cells, piece = cells.taken(flown), piece[flown]
        kept = np.ones(owners, dtype=np.bool_)
        for each in (self.inertia, self):
            if each is not None:
                each.look(cells, piece, kept)
        return kept

    def _quick(self, s: Array, slope: Array, jerk: Array, piece: Indices) -> Flags:
        limits, (v, a, j) = self.motion.requirements.limits, self.sizes[:, piece]
        spare = np.minimum(self._spare[piece], limits.acceleration)
        fine: Flags = _acceleration(s, slope, v, a) <= spare
        fine &= _jerk(s, slope, jerk, v, a, j) <= limits.jerk
        return fine & (limits.body_rate is None)  # of turning no quick bound comes close

    def _judged(self, spans: _Spans) -> Judged:
        limits, team = self.motion.requirements.limits, self.motion.team
        (s, slope, jerk), (v, a, j) = spans.clock, self._curves.along(spans)
        acceleration, jerk = _acceleration(s, slope, v, a), _jerk(s, slope, jerk, v, a, j)
        found = [_within(acceleration, column_lengths, limits.acceleration)]
        found.append(_within(jerk, column_lengths, limits.jerk))
        spare = self._spare[spans.piece, spans.item]
        if limits.body_rate is not None or not np.all(acceleration.norm_above.value <= spare):
            mass = team.mass[spans.item, None]
            force, *rate = self._forces.along(spans)
            thrust = acceleration * mass + force
            found.append(_within(thrust, column_lengths, team.max_thrust[spans.item]))
            found.append(_within(thrust, self._beyond, 0.0))
            if limits.body_rate is not None:
                found.append(_turning(thrust, jerk * mass + s * rate[0], limits.body_rate))
        broken, fine = zip(*found, strict=True)
        return np.any(broken, axis=0), np.all(fine, axis=0)

    def _beyond(self, force: Array) -> Array:
        """Return how far forces (…, 3, m) are beyond the cone of the tilt."""
        tilt = self.motion.requirements.limits.tilt
        level = np.hypot(force[..., 0, :], force[..., 1, :])
        beyond: Array = level * np.cos(tilt) - force[..., 2, :] * np.sin(tilt)
        return beyond


def _hovering(motion: Motion, value: Callable[[Hovering], Enclosed]) -> Enclosed:
    """Return a vector of every drone where it hovers, (pieces, drones)."""
    found = [value(spans).reduced(ORDER) for spans in Hovering.of(motion)]
    order, shape = max(each.degree for each in found), (motion.drones.pieces, motion.team.drones)
    c = np.concatenate([bernstein.elevate(each.c, order) for each in found])
    r = np.concatenate([np.broadcast_to(each.r, len(each.c)) for each in found])
    return Enclosed(c.reshape(*shape, *c.shape[1:]), r.reshape(shape))


class CarriedInertia(_Limited):
    """Paths (m, 3) whose additional accelerations a clock has to keep within a slack.

    Parameters
    ----------
    parts: of the motion, on which something is carried, as of ``carried_paths``.
    """

    def __init__(self, motion: Motion, parts: list[tuple[slice, Array, Array]]) -> None:
        items = max(path.shape[1] for _, path, _ in parts)
        order = max(bernstein.degree(path) for _, path, _ in parts)
        paths = np.zeros((motion.drones.pieces, items, 3, order + 1))
        self.slack = np.full(paths.shape[:2], np.inf)
        for run, path, slack in parts:
            count, known = path.shape[1], np.all(np.isfinite(path), axis=(2, 3))
            paths[run, :count] = np.nan_to_num(bernstein.elevate(path, order))
            self.slack[run, :count] = np.where(known, np.maximum(slack, 0.0), 0.0)
        self.breaks = motion.drones.breaks
        self._curves = _Curves.of(PiecewisePolynomial(self.breaks, paths), 2)
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

    def _quick(self, s: Array, slope: Array, _: Array, piece: Indices) -> Flags:
        v, a = self._curves.sizes[:, piece]
        found: Flags = np.maximum(s * s, 1.0) * a + slope * v <= self.slack[piece]
        return found

    def _judged(self, spans: _Spans) -> Judged:
        (s, slope, _), (v, a) = spans.clock, self._curves.along(spans)
        added = _acceleration(s, slope, v, a) - a
        return _within(added, column_lengths, self.slack[spans.piece, spans.item])


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


def stop_table(motion: Motion, limits: ClockLimits | None = None) -> StopTable:
    """Return stops that are shown to keep all limits of a motion, SPACING [s] from each other.

    Each has the shortest duration of a ladder that bisection finds. The end counts as rest only if
    the drones rest there. ``limits`` are those of the motion, where they are known.
    """
    limits = limits or ClockLimits(motion)
    begin, end = (float(each) for each in motion.drones.breaks[[0, -1]])
    count = max(2, int(min(np.ceil((end - begin) / SPACING), STARTS)) + 1)
    starts = np.linspace(begin, end, count)[:-1]
    moving = max(np.max(np.abs(motion.drones.ends(order)[1][-1])) for order in (1, 2))
    rest = end if moving <= REST else np.inf
    carries = limits.inertia is not None
    longest, ratio = SLOWEST if limits.reserved or carries else LONGEST, (RATIO, CARRIED_RATIO)
    useful = np.inf if limits.reserved else LATEST * (rest - starts)
    rungs = 1 + round(np.log(longest / SHORTEST) / np.log(ratio[carries]))
    ladder = np.geomspace(SHORTEST, longest, rungs)
    durations, low = np.full(len(starts), np.inf), np.full(len(starts), -1)
    high = np.searchsorted(ladder, np.broadcast_to(useful, starts.shape))
    while len(left := np.flatnonzero(high - low > 1)):
        # What is carried may allow some stop and no longer one: no bisection then.
        rung = low[left] + 1 if carries else (low[left] + high[left]) // 2
        kept = _shown(limits, starts[left], ladder[rung])
        durations[left[kept]] = ladder[rung[kept]]
        high[left[kept]], low[left[~kept]] = rung[kept], rung[~kept]
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
    """Yield runs of pieces on which an object is carried, paths, and their slack [m/s²].

    Paths have the shape (pieces, items, 3, degree + 1) [m].
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
    """Return the paths of clasps below a rim and of the centre of mass, and their slack.

    Clasps carry shares of the mass, and what the centre, being higher, moves from clasp to clasp;
    friction carries the rim along with them; and the line of weight and inertia meets their plane
    within their polygon.
    """
    assert body.rim is not None
    pose = motion.object_poses.coefficients[:, index]
    places = motion.vertices.coefficients[:, motion.team.layout.clasps]
    centre = centre_path(pose, body)[:, None]
    order = max(bernstein.degree(centre), bernstein.degree(places))
    each = [bernstein.elevate(part, order) for part in (places, centre)]
    points = motion.vertices.alike(np.concatenate(each, axis=1))
    height = abs(body.centre_of_mass[2] - body.rim.height)
    supports = supports_of(motion, index, body)
    shifted = height * np.linalg.norm(supports.gains, axis=-1)
    shifted *= 1.0 + heading_error(Enclosed(pose[:, 3:]))[:, None]
    bearing = spare_forces(motion) / (body.mass * (supports.shares + shifted))
    pushed = points.differentiated(2).coefficients
    level = np.max(np.linalg.norm(pushed[:, :, :2], axis=2), axis=-1)
    pressing = GRAVITY + np.min(pushed[:, :, 2], axis=-1)
    sliding = (body.friction * pressing - level)[:, :-1] / (1.0 + body.friction)
    inside = SUPPORT.finders[0].find(motion, 0.0).worst
    lean = height * (1.0 + level[:, -1] / pressing[:, -1])
    tipping = inside * pressing[:, -1] / (lean + inside)
    whole = np.minimum(tipping, np.min(bearing, axis=1))
    slack = np.column_stack([np.minimum(bearing, sliding), whole])
    return points.coefficients, slack


def _gripped(motion: Motion, index: int, body: SolidObject) -> tuple[Array, Array]:
    """Return the paths of the centre and the heading of an object that edges grip, and their slack.

    Edges push it as a whole; friction bears it and turns it with them, half of it for each.
    """
    pose = motion.object_poses.coefficients[:, index]
    centre = centre_path(pose, body)
    order = max(bernstein.degree(pose), bernstein.degree(centre))
    paths = np.zeros((len(pose), 2, 3, order + 1))
    paths[:, 0] = bernstein.elevate(centre, order)
    paths[:, 1, :2] = bernstein.elevate(pose[:, 3:], order)
    forces, friction = np.min(spare_forces(motion), axis=1), 0.5 * spare_friction(motion, index)
    slack = [np.minimum(forces, friction), friction / turning_reach(body)]
    return paths, np.column_stack(slack) / body.mass


def _find(motion: Motion, found: Findings, gamma: float) -> Finding:
    """Return the longest time [s] over all times of the command, and about when that is."""
    del found, gamma
    with np.errstate(all="ignore"):  # coefficients may be anything; nan breaks a limit
        longest, begins = stop_table(motion).longest
    worst = int(np.argmax(longest))
    return Finding(float(longest[worst]), float(begins[worst]))


RULE = ReportRule("stoppable", "s", "max", _find, whole=True)
