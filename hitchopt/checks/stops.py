"""Stops of the common clock, and the report ``stoppable``: how long until all drones rest.

With x(τ) the plan, D its derivatives by plan time and s = dτ/dt, a clock makes the acceleration
``s² D²x + ṡ Dx`` and the jerk ``s³ D³x + 3 s ṡ D²x + s̈ Dx``, and the thrust ``m (a + g ẑ)`` less
the cable's force, which depends on the place alone. What is carried is pulled along by forces that
fit the plan's own rate: ``(s² - 1) D²x + ṡ Dx`` times its mass is left unbalanced, and has to stay
within what checks ``equilibrium``, ``support`` and ``grip`` leave of their limits.

All are sums of a function of the clock times one of the place. On a cell, a phase of constant s̈
within one piece, norms bound them, ``|D²x| s² + |Dx| |ṡ|`` and the like. Where that does not do,
each factor lies near the chord between its ends, off it by a part of its second derivative, and a
convex measure is largest at one of the four pairs of ends; cells are halved until that decides.

A stop of duration T slows the clock's rate from 1 to 0 by two phases of constant jerk ∓4/T², the
shortest that a bound of that jerk allows; it takes 1/2 T of plan time. A command may wait, the plan
running on, until a stop can begin; a plan that ends at rest has reached rest there in any case.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.carried_paths import ROWS, carried_paths
from hitchopt.checks.bounds.rounding_margins import ROUNDING, derivative_margin
from hitchopt.checks.bounds.static_thrust import StaticThrust
from hitchopt.checks.rule import Finding, Findings, ReportRule
from hitchopt.geometry.vectors import column_lengths
from hitchopt.motion.cutting import REST
from hitchopt.motion.motion import Motion
from hitchopt.time_limit import check_time
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.clock_phases import ClockPhases, advanced
from hitchopt.values import Array, Indices

Flags = NDArray[np.bool_]

HALVINGS = 7
"""Halvings of a cell in which a bound is decided; what is undecided then counts as broken."""

BATCH = 20_000
"""Pairs of a cell and a drone that are looked at in one go."""

SLACK = 1e-9
"""Relative margin for the clock's rounding."""

SHORTEST, LONGEST, SLOWEST = 0.1, 2.5, 20.0
"""[s] Durations of stops: the shortest and longest that are tried, and the longest with a reserve
or something that is carried, which allow no shorter ones."""

SPACING, STARTS = 0.05, 10_000
"""[s] Distance of stops, for plans of up to ``SPACING * STARTS``."""

BISECTIONS = 6
"""Bisections of the logarithm of the least duration that samples allow."""

LONGER = ((1.02,), (1.1, 1.2, 1.6))
"""Multiples of that which are tried, some together."""

LATEST = 1.5
"""Longest stops, relative to the time until the plan rests by itself."""

STEP = 0.02
"""[s] Distance of samples of the plan."""

SHARES = np.arange(4) / 3.0
"""Shares of the phases of a stop at which samples are taken."""

SWITCH = 5.0 / 12.0
"""Plan time over duration at which a stop's jerk changes its sign."""

TINY = 1e-12
"""[N], [m/s²] Slack counts as at least this where values are divided by it."""


def stop_phases(start: Array, duration: Array) -> ClockPhases:
    """Return the phases of stops that begin at plan times ``start`` (m,) at rate 1."""
    return _between(start, duration, 1.0)


def start_phases(start: Array, duration: Array) -> ClockPhases:
    """Return the phases that lead from rest at plan times (m,) back to rate 1, as stops do."""
    return _between(start, duration, 0.0)


def _between(start: Array, duration: Array, rate: float) -> ClockPhases:
    """Return the phases from one of the rates 0 and 1 to the other."""
    start, duration = np.broadcast_arrays(np.asarray(start, float), np.asarray(duration, float))
    jerk = (4.0 - 8.0 * rate) / duration**2
    zero = np.zeros_like(start)
    first = np.stack([start, zero + rate, zero, jerk], axis=-1)
    second = advanced(first, 0.5 * duration)
    second[..., 3] = -jerk
    jets = np.stack([first, second], axis=1).reshape(-1, 4)
    return ClockPhases(np.repeat(np.arange(len(start)), 2), jets, np.repeat(0.5 * duration, 2))


class _Pairs(NamedTuple):
    """Cells of clocks within one piece of the plan, and an item (a drone, a path) each."""

    cells: ClockPhases
    piece: Indices
    item: Indices

    def taken(self, index: Flags | Indices | slice) -> _Pairs:
        return _Pairs(self.cells.taken(index), self.piece[index], self.item[index])

    def halves(self) -> _Pairs:
        half = 0.5 * self.cells.duration
        jets = np.concatenate([self.cells.jets, advanced(self.cells.jets, half)])
        cells = ClockPhases(np.tile(self.cells.owner, 2), jets, np.tile(half, 2))
        return _Pairs(cells, np.tile(self.piece, 2), np.tile(self.item, 2))


class _Factor(NamedTuple):
    """Values at both ends of cells (2, …, pairs), and how far between they are off the chord."""

    ends: Array
    off: Array


def _enclosed(*terms: tuple[_Factor, _Factor]) -> _Factor:
    """Return sums of products of numbers by time and vectors by place.

    Returns
    -------
    (4, d, pairs), the values at all pairs of ends, the first and last of them attained; and by how
    much sums may be off the hull of these.
    """
    ends, off = np.zeros(()), np.zeros(())
    for number, vector in terms:
        ends = ends + number.ends[:, None, None] * vector.ends
        most = np.max(np.abs(number.ends), axis=0) + number.off
        off = off + most * vector.off + number.off * np.max(column_lengths(vector.ends), axis=0)
    return _Factor(ends.reshape(4, *ends.shape[2:]), off)


class _Clock:
    """The rate and its derivatives at both ends of cells (2, cells), and their largest (cells,)."""

    def __init__(self, cells: ClockPhases) -> None:
        jets = np.stack([cells.jets.T, cells.ends.T])
        self.s, self.a, self.j = jets[:, 1], jets[:, 2], jets[:, 3]
        middle = self.s[0] + 0.5 * cells.duration * self.a[0]  # the hull of its coefficients
        self.most = np.max(np.abs(jets[:, 1:]), axis=0)
        np.maximum(self.most[0], np.abs(middle), out=self.most[0])
        self._bend = cells.duration**2 / 8.0

    def factor(self, ends: Array, curved: Array | float = 0.0) -> _Factor:
        """Return a function of the clock with a bound of its second derivative by time."""
        return _Factor(ends, self._bend * curved)

    def squared(self, less: float = 0.0) -> _Factor:
        """Return the rate's square, less a number."""
        s, a, j = self.most
        return self.factor(self.s**2 - less, 2.0 * (a**2 + s * j))


class _Curves:
    """Vectors that are polynomials of plan time, several of each item, on all pieces.

    Parameters
    ----------
    breaks: (pieces + 1,) [s]
    functions: of coefficients (pieces, items, d, degree + 1) each.
    margins: (pieces, items) each, what is added to their norms.
    """

    def __init__(self, breaks: Array, functions: Sequence[Array], margins: Sequence[Array]) -> None:
        self.breaks, self.margins = breaks, margins
        order = max(bernstein.degree(each) for each in functions)
        self.rows = np.cumsum([0, *(each.shape[2] for each in functions)])
        self.coefficients = np.concatenate([bernstein.elevate(c, order) for c in functions], axis=2)
        self.sizes = np.stack([np.max(column_lengths(c), axis=-1) for c in functions])
        """(functions, pieces, items), bounds of norms."""
        self.sizes = (self.sizes + margins) * (1.0 + SLACK)
        h = 8.0 * np.diff(breaks)[:, None] ** 2
        curved = [bernstein.differentiate(bernstein.differentiate(each)) for each in functions]
        self._bends = [np.max(column_lengths(c), axis=-1) * (1.0 + SLACK) / h for c in curved]

    @classmethod
    def of(cls, path: PiecewisePolynomial, count: int) -> _Curves:
        """Return the first derivatives of paths (items, d)."""
        orders = range(1, count + 1)
        functions = [path.differentiated(k).coefficients for k in orders]
        return cls(path.breaks, functions, [derivative_margin(path, k) for k in orders])

    def along(self, pairs: _Pairs) -> list[_Factor]:
        """Return the vectors over cells."""
        first, last = pairs.cells.jets[:, 0], pairs.cells.ends[:, 0]
        begin, at = self.breaks[pairs.piece], (pairs.piece, pairs.item)
        x = (np.stack([first, last], axis=-1) - begin[:, None]) / (
            self.breaks[pairs.piece + 1] - begin
        )[:, None]
        weights = bernstein.basis(np.clip(x, 0.0, 1.0), bernstein.degree(self.coefficients))
        ends = (weights @ np.swapaxes(self.coefficients[at], 1, 2)).transpose(1, 2, 0).copy()
        square = (last - first) ** 2
        return [
            _Factor(ends[:, row:until], square * bend[at] + margin[at])
            for row, until, bend, margin in zip(
                self.rows[:-1], self.rows[1:], self._bends, self.margins, strict=True
            )
        ]


Look = Callable[[_Pairs], tuple[Flags, Flags]]
"""Tells of pairs whether a limit is broken, and whether all are shown to be kept."""


def _decide(look: Look, pairs: _Pairs, kept: Flags, *, sampled: bool) -> None:
    """Set ``kept`` (owners,) to False where limits are not shown to be kept.

    Parameters
    ----------
    sampled: only where a value breaks one.
    """
    for first in range(0, len(pairs.piece), BATCH):
        check_time()
        part = pairs.taken(slice(first, first + BATCH))
        for _ in range(HALVINGS + 1):
            part = part.taken(kept[part.cells.owner])
            if not len(part.piece):
                break
            broken, fine = look(part)
            kept[part.cells.owner[broken]] = False
            if sampled:
                break
            part = part.taken(~fine).halves()
        else:
            kept[part.cells.owner] = False


def _within(sum_: _Factor, measure: Callable[[Array], Array], limit: Array) -> tuple[Flags, Flags]:
    """Return (pairs,) whether a convex measure breaks a limit, and whether it is shown to keep it.

    It is no more than a ball's radius larger within the ball than at its middle.
    """
    sizes = measure(sum_.ends)
    broken = ~(np.maximum(sizes[0], sizes[3]) <= limit)
    fine: Flags = np.max(sizes, axis=0) * (1.0 + SLACK) + sum_.off <= limit
    return broken, fine


class ClockLimits:
    """The limits of a motion, for clocks.

    Parameters
    ----------
    motion: the plan.
    """

    def __init__(self, motion: Motion) -> None:
        self.motion, drones = motion, motion.drones
        self.breaks = drones.breaks
        self.reserved = motion.requirements.limits.reserve < 1.0
        """Whether the plan leaves something of its limits, so that stops can begin anywhere."""
        self._curves = _Curves.of(drones, 3)
        self.sizes = self._curves.sizes
        """(3, pieces, drones), bounds of the derivatives' norms by plan time."""
        static = StaticThrust.of(motion)
        hover, beyond = static.largest, static.beyond_cone(motion.requirements.limits.tilt)
        functions, margins = [static.thrust.coefficients], [static.thrust.radius + ROUNDING * hover]
        if static.rate is not None:
            functions.append(static.rate.coefficients)
            margins.append(static.rate.radius)
        self._forces = _Curves(self.breaks, functions, margins)
        team = motion.team
        self._spare = np.minimum(team.max_thrust - hover - ROUNDING * hover, -beyond) / team.mass
        """(pieces, drones), acceleration that a drone can have in any direction."""
        self.inertia = CarriedInertia.of(motion)
        """What is carried; None where nothing is."""

    def keep(self, phases: ClockPhases, owners: int, *, sampled: bool = False) -> Flags:
        """Return (owners,) whether the phases of each clock keep all limits.

        Parameters
        ----------
        phases: with rates from -1 to 1.
        owners: how many clocks there are.
        sampled: look at samples only, as a first guess; otherwise bound all of the time.
        """
        cells, piece = phases.cut(self.breaks, 0.0)
        flown = (piece >= 0) & (piece < len(self.breaks) - 1)
        cells, piece = cells.taken(flown), piece[flown]
        kept = np.ones(owners, dtype=np.bool_)
        count = max(1, BATCH // len(self.motion.team.mass))
        for first in range(0, len(cells), count):
            row = np.arange(first, min(first + count, len(cells)))
            row = row[kept[cells.owner[row]]]
            where, drone = np.nonzero(~self._each(cells.taken(row), piece[row]))
            pairs = _Pairs(cells.taken(row[where]), piece[row[where]], drone)
            _decide(self._look, pairs, kept, sampled=sampled)
        if self.inertia is not None:
            self.inertia.look(cells, piece, kept, sampled=sampled)
        return kept

    def _each(self, cells: ClockPhases, piece: Indices) -> Flags:
        """Return (cells, drones) whether norms show that limits are kept."""
        limits = self.motion.requirements.limits
        s, a, j = _Clock(cells).most[..., None]
        V, A, J = self._curves.sizes[:, piece]
        acceleration = s * s * A + a * V
        fine: Flags = acceleration <= np.minimum(self._spare[piece], limits.acceleration)
        fine &= s * s * s * J + 3.0 * s * a * A + j * V <= limits.jerk
        return fine & (limits.body_rate is None)  # of turning no quick bound comes close

    def _look(self, pairs: _Pairs) -> tuple[Flags, Flags]:
        limits, team = self.motion.requirements.limits, self.motion.team
        clock = _Clock(pairs.cells)
        v, a, j = self._curves.along(pairs)
        s, a1, j1 = clock.most
        cubed = clock.factor(clock.s**3, 6.0 * s * a1**2 + 3.0 * s**2 * j1)
        mixed = clock.factor(3.0 * clock.s * clock.a, 9.0 * a1 * j1)
        acceleration = _enclosed((clock.squared(), a), (clock.factor(clock.a), v))
        jerk = _enclosed((cubed, j), (mixed, a), (clock.factor(clock.j), v))
        found = [_within(acceleration, column_lengths, np.asarray(limits.acceleration))]
        found.append(_within(jerk, column_lengths, np.asarray(limits.jerk)))
        spare = self._spare[pairs.piece, pairs.item]
        size = np.max(column_lengths(acceleration.ends), axis=0) + acceleration.off
        if limits.body_rate is not None or not np.all(size * (1.0 + SLACK) <= spare):
            mass, forces = team.mass[pairs.item], self._forces.along(pairs)
            force = _enclosed((clock.factor(np.ones_like(clock.s)), forces[0]))
            thrust = _plus(force, acceleration, mass)
            found.append(_within(thrust, column_lengths, team.max_thrust[pairs.item]))
            found.append(_within(thrust, self._beyond, np.zeros_like(mass)))
            if limits.body_rate is not None:
                turning = _enclosed((clock.factor(clock.s, j1), forces[1]))
                found.append(_turning(thrust, _plus(turning, jerk, mass), limits.body_rate))
        broken, fine = zip(*found, strict=True)
        return np.any(broken, axis=0), np.all(fine, axis=0)

    def _beyond(self, force: Array) -> Array:
        """Return how far forces (…, 3, pairs) are beyond the cone of the tilt."""
        tilt = self.motion.requirements.limits.tilt
        level = np.hypot(force[:, 0], force[:, 1])
        beyond: Array = level * np.cos(tilt) - force[:, 2] * np.sin(tilt)
        return beyond


def _plus(one: _Factor, other: _Factor, factor: Array) -> _Factor:
    off = one.off + factor * other.off * (1.0 + SLACK)
    return _Factor(one.ends + factor * other.ends, off)


def _turning(thrust: _Factor, rate: _Factor, limit: float) -> tuple[Flags, Flags]:
    """Return (pairs,) whether ``f × ḟ / f²`` breaks a limit, and whether it is shown to keep it.

    Both are the same combination of their values at pairs of ends: products of these two by two,
    each taken with the other way round, bound the product.
    """
    f, g = thrust.ends, rate.ends
    products = np.cross(f[:, None], g[None], axis=2)
    across = np.max(column_lengths(0.5 * (products + np.swapaxes(products, 0, 1))), axis=(0, 1))
    sizes, middle = column_lengths(f), np.mean(f, axis=0)
    own = column_lengths(products[[0, 3], [0, 3]])
    broken = ~np.all(own <= limit * sizes[[0, 3]] ** 2, axis=0)
    across += thrust.off * np.max(column_lengths(g), axis=0)
    across += rate.off * (np.max(sizes, axis=0) + thrust.off)
    along = np.sum(middle * f, axis=1) / column_lengths(middle)
    least = np.maximum(np.min(along, axis=0) - thrust.off, 0.0)
    fine: Flags = across * (1.0 + SLACK) <= limit * least**2
    return broken, fine


class CarriedInertia:
    """Paths whose additional accelerations a clock has to keep small.

    Parameters
    ----------
    motion: the plan.
    parts: of it, on which something is carried, as of ``carried_paths``.
    """

    def __init__(self, motion: Motion, parts: list[tuple[slice, Array, Array]]) -> None:
        pieces = motion.drones.pieces
        items = max(path.shape[1] for _, path, _ in parts)
        order = max(bernstein.degree(path) for _, path, _ in parts)
        paths = np.zeros((pieces, items, ROWS, order + 1))
        self.slack = np.full((pieces, items), np.inf)
        """(pieces, items), how large the norms of additional accelerations may be."""
        for run, path, slack in parts:
            count = path.shape[1]
            known = np.all(np.isfinite(path), axis=(2, 3))
            paths[run, :count] = np.nan_to_num(bernstein.elevate(path, order))
            self.slack[run, :count] = np.where(known, np.maximum(slack, 0.0), 0.0)
        self.breaks = motion.drones.breaks
        self.paths = PiecewisePolynomial(self.breaks, paths)
        self._curves = _Curves.of(self.paths, 2)
        edges = [(self.breaks[run.start], self.breaks[run.stop]) for run, _, _ in parts]
        self._spans = np.array(edges)

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

    def look(self, cells: ClockPhases, piece: Indices, kept: Flags, *, sampled: bool) -> None:
        """Set ``kept`` (owners,) to False where the balance is not shown to be kept.

        Parameters
        ----------
        cells: of clocks.
        piece: (cells,), those they lie in.
        sampled: only where a value breaks it.
        """
        s, a, _ = _Clock(cells).most[..., None]
        V, A = self._curves.sizes[:, piece]
        fine = (np.maximum(s * s, 1.0) * A + a * V) * (1.0 + SLACK) <= self.slack[piece]
        where, item = np.nonzero(~fine & kept[cells.owner][:, None])
        pairs = _Pairs(cells.taken(where), piece[where], item)
        _decide(self._look, pairs, kept, sampled=sampled)

    def _look(self, pairs: _Pairs) -> tuple[Flags, Flags]:
        clock, (v, a) = _Clock(pairs.cells), self._curves.along(pairs)
        added = _enclosed((clock.squared(less=1.0), a), (clock.factor(clock.a), v))
        return _within(added, column_lengths, self.slack[pairs.piece, pairs.item])


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
    def waits(self) -> Array:
        """(stops,) [s]: time from each start to the first rest, its own stop or a later one's."""
        rests = self.starts + self.durations
        first = np.minimum.accumulate(rests[::-1])[::-1]
        found: Array = np.minimum(first, self.end) - self.starts
        return found

    @property
    def longest(self) -> tuple[Array, Array]:
        """Longest time to rest [s] from each stretch between starts, (stops,), and its begin [s].

        The last stretch lies between the last start and the end of the plan.
        """
        begins = np.concatenate([[min(0.0, self.starts[0])], self.starts])
        reach = np.append(self.starts + self.waits, self.end)
        return reach - begins, begins

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
    """Return stops that keep all limits of a motion, one at each of many times.

    How long each has to take at least is read off samples; that and a little more is then shown to
    keep all limits, or longer ones where it is not. The end counts as rest only if the drones rest
    there.

    Parameters
    ----------
    motion: the plan.
    limits: of the motion, where they are known.
    """
    limits = limits or ClockLimits(motion)
    begin, end = (float(each) for each in motion.drones.breaks[[0, -1]])
    count = max(2, int(min(np.ceil((end - begin) / SPACING), STARTS)) + 1)
    starts = np.linspace(begin, end, count)[:-1]
    moving = max(np.max(np.abs(motion.drones.ends(order)[1][-1])) for order in (1, 2))
    rest = end if moving <= REST else np.inf
    sampled = _Samples(limits)
    least = sampled.least(starts)
    durations = np.full(len(starts), np.inf)
    for factors in LONGER:
        left = np.tile(np.flatnonzero(np.isinf(durations)), len(factors))
        tried = np.repeat(factors, len(left) // len(factors)) * least[left]
        useful = limits.reserved | (tried < LATEST * (rest - starts[left]))
        left, tried = left[useful], tried[useful]
        kept = sampled.keep(starts[left], tried)
        kept[kept] = _shown(limits, starts[left[kept]], tried[kept])
        np.minimum.at(durations, left[kept], tried[kept])
    return StopTable(rest, starts, durations)


class _Samples:
    """Derivatives of the drones that lead, and of what is carried, at equal distances of time."""

    def __init__(self, limits: ClockLimits) -> None:
        self._limits, drones = limits, limits.motion.drones
        count = int(min(np.ceil(drones.duration / STEP), 3 * STARTS)) + 1
        self._times = np.linspace(drones.breaks[0], drones.breaks[-1], count)
        leading = np.unique(np.argmax(limits.sizes, axis=2))
        parts = drones.alike(drones.coefficients[:, leading])
        self._jets = np.stack([parts.at(self._times, k) for k in (1, 2, 3)], axis=1)
        inertia = limits.inertia
        if inertia is not None:
            self._paths = np.stack([inertia.paths.at(self._times, k) for k in (1, 2)], axis=1)
            piece = np.searchsorted(drones.breaks[1:-1], self._times, side="right")
            self._slack = inertia.slack[piece]

    def least(self, starts: Array) -> Array:
        """Return durations (m,) [s] below which samples break a limit."""
        slow = self._limits.inertia is not None or self._limits.reserved
        low = np.full(len(starts), np.log(SHORTEST))
        high = np.full(len(starts), np.log(SLOWEST if slow else LONGEST))
        shortest = self.keep(starts, np.exp(low))
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            kept = self.keep(starts, np.exp(middle))
            high, low = np.where(kept, middle, high), np.where(kept, low, middle)
        return np.where(shortest, SHORTEST, np.exp(high))

    def keep(self, starts: Array, durations: Array) -> Flags:
        """Return (m,) whether stops keep accelerations, jerks and balances about the samples."""
        clocks = stop_phases(starts, durations)
        jets = advanced(clocks.jets[:, None], clocks.duration[:, None] * SHARES)
        time, s, a, j = np.moveaxis(jets.reshape(-1, 2 * len(SHARES), 4), -1, 0)
        s, a, j = (each[..., None, None] for each in (s, a, j))
        step = self._times[1] - self._times[0]
        node = np.rint((time - self._times[0]) / step).astype(np.intp)
        flown = node < len(self._times)
        node = np.minimum(node, len(self._times) - 1)
        x1, x2, x3 = np.moveaxis(self._jets[node], 2, 0)
        most = self._limits.motion.requirements.limits
        fine = _shorter(s**2 * x2 + a * x1, most.acceleration)
        fine &= _shorter(s**3 * x3 + 3.0 * s * a * x2 + j * x1, most.jerk)
        if self._limits.inertia is not None:
            x1, x2 = np.moveaxis(self._paths[node], 2, 0)
            fine &= _shorter((s**2 - 1.0) * x2 + a * x1, self._slack[node])
        kept: Flags = np.all(fine | ~flown, axis=1)
        return kept


def _shorter(vectors: Array, most: Array | float) -> Flags:
    """Return (m, samples) whether all vectors (m, samples, items, d) are no longer than limits."""
    squared = np.einsum("msix,msix->msi", vectors, vectors)
    fine: Flags = np.all(squared <= np.square(most), axis=-1)
    return fine


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


def _find(motion: Motion, found: Findings, gamma: float) -> Finding:
    """Return the longest time [s] over all times of the command, and about when that is."""
    del found, gamma
    with np.errstate(all="ignore"):  # coefficients may be anything; nan breaks a limit
        longest, begins = stop_table(motion).longest
    worst = int(np.argmax(longest))
    return Finding(float(longest[worst]), float(begins[worst]))


RULE = ReportRule("stoppable", "s", "max", _find, whole=True)
