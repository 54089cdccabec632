"""Corrected setpoints of a plan in flight, from measured vertices.

The measured error of the vertices, filtered, enters a proportional and integral law. How vertices
move with the setpoints is a question of statics: ``hitchopt.statics`` gives the linear response S
of a hitch whose drones are springs to their setpoints, and the damped inverse of S the offsets of
the drones that are wanted.

What is commanded is that, projected onto offsets that keep every distance for all times of a cell
of the plan. Two bodies (a drone, or a straight part of a cable) with the distance D to keep are
parted by a direction n; the coefficients of their ends' polynomials a(t), b(t) give ``m ≤ n·(a -
b)`` for all t. With ends off by ``ρ_a``, ``ρ_b`` they keep D if ``n·(ρ_a - ρ_b) ≥ D - m`` for all
pairs of ends: half-spaces of the offsets. A common shift of all drones and vertices changes none of
them. Vertices are taken to be where they are planned, but for the reserve.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.checks.spans import part_points, positions
from hitchopt.errors import InputError, OneLine, UnsupportedError
from hitchopt.geometry.segments import differences, shortest_offset
from hitchopt.live.player import Sampler, Setpoints
from hitchopt.motion.motion import HITCHED_STATE, Motion
from hitchopt.statics.settle import Conditions, energy_of, samples_of
from hitchopt.statics.tolerance import Gradients
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array, Indices, as_array, finite, not_negative, per_robot, positive

PROPORTIONAL, INTEGRAL = 1.2, 2.5
"""Gains [1], [1/s]. Setpoints of drones of 4.75 N/m take 0.3 s to move vertices, measurements and
their filter as long again: the loop has a phase margin of some 50°."""

LEAD = 0.4
"""[s] Setpoints lead the plan of a vertex by so long, as friction is to be overcome first."""

UNWINDING = 0.5
"""[s] Time constant with which the integral forgets what could not be commanded."""

SMOOTHING = 0.2
"""[s] Time constant of the filter of errors: 1 cm of white noise at 100 Hz leaves 2 mm."""

LARGEST_ERROR = 0.5
"""[m] A larger measured error is no error of a vertex, but a false measurement; and the largest
correction of a vertex that is asked for."""

HELD, FADING = 0.3, 2.0
"""[s] A vertex not measured for HELD loses its correction with the time constant FADING."""

HANDOVER = 2.0
"""[s] Corrections fade over this time before the hitch is untied, and grow so after it is tied."""

FAR = 0.15
"""[m] Corrections do not grow while a measured drone is farther from its corrected setpoint."""

GAIN = 36.0
"""[1/s²] Stiffness over mass of drones of which none is stated."""

STEADY = (1.0, 0.0, 0.0)
"""Rate of the plan's own clock, and its derivatives."""

DAMPING = 0.3
"""Singular value of the response below which a mode is corrected by less than half: to move the
vertices there takes setpoints more than three times as far."""

TRAVEL, MOST_CELLS = 0.05, 64
"""[m] Cells are so short that no drone's curve is longer: directions stay what they are. A piece
has at most so many."""

LARGEST, FARTHEST = 0.25, 0.4
"""[m] Largest common shift of all drones, FARTHEST, and largest offset of a drone besides it."""

PASSES = 2
"""Rounds of projection onto broken half-spaces, before all is scaled to hold certainly."""

ONES = np.ones(3)
"""Sums the squares of vectors: faster than ``einsum`` where they are few."""

MISSING = "give a row of nan where one is missing"


class Feedback(OneLine):
    """Corrections of a plan by measured vertices, for one flight.

    Distances keep their limits at all times while every drone is within ``reserve`` of its
    corrected setpoint and every vertex within it of the plan, as far as the plan itself leaves so
    much: corrected setpoints stay within half-spaces that the plan's polynomials give for whole
    spans of time. A shift of all drones together is limited by the arena alone.

    Parameters
    ----------
    plan: a plan of a hitch, or its motion.
    rate: largest speed at which corrections change [m/s].
    reserve: [m], see above.
    delay: age of the measurements, where ``step`` is not told [s].
    stiffness: of the drones' position loops [N/m], one or one per drone; None for the team's, or
        36/s² times their masses where these are rigid.

    Raises
    ------
    InputError: a plan without cables, or a number out of its range.
    UnsupportedError: objects or keep-outs, to which corrections keep no distance.
    """

    def __init__(
        self,
        plan: object,
        *,
        rate: float = 0.1,
        reserve: float = 0.01,
        delay: float = 0.05,
        stiffness: ArrayLike | None = None,
    ) -> None:
        motion = getattr(plan, "motion", plan)
        if not isinstance(motion, Motion) or not motion.team.has_cables:
            raise InputError("plan", plan, "a Plan or Motion of a hitch", "solve or load one")
        if motion.requirements.keep_out or motion.requirements.objects:
            words = "feedback keeps no distance to keep-outs and objects: fly without them"
            raise UnsupportedError(words)
        self.motion, team = motion, motion.team
        self._rate, self._delay = positive("rate", rate), not_negative("delay", delay)
        own = np.where(np.isfinite(team.stiffness), team.stiffness, GAIN * team.mass)
        given = own if stiffness is None else stiffness
        stiff = per_robot("stiffness", given, team.drones, owner="drone")
        breaks, kept = covered_set(motion, not_negative("reserve", reserve))
        self._breaks, self._end = breaks.tolist(), float(breaks[-1])
        middles = 0.5 * (breaks[1:] + breaks[:-1])
        formed = [i for i, each in enumerate(kept) if each is not None]
        responses = dict(zip(formed, vertex_responses(motion, middles[formed], stiff), strict=True))
        self._cells: list[Cell | None] = []
        for i, (here, following) in enumerate(zip(kept, (*kept[1:], None), strict=True)):
            aimed = here if here is None or following is None else here.and_(following)
            cell = None
            if here is not None and aimed is not None:
                cell = Cell(here, aimed, *responses[i])
            self._cells.append(cell)
        self._spans = [
            (s.drones.breaks[0], s.drones.breaks[-1]) for s in motion.spans(HITCHED_STATE)
        ]
        clasps = motion.vertices.coefficients[:, team.layout.clasps]
        self._drones = Sampler(motion.drones)
        self._vertices = Sampler(PiecewisePolynomial(motion.vertices.breaks, clasps))
        self.reset()

    def _parts(self) -> Iterator[str]:
        yield f"{self.motion.team.drones} drones"
        yield f"{self.motion.duration:.4g} s, cells: {len(self._cells)}"

    def reset(self) -> None:
        """Forget all measurements and corrections."""
        clasps = len(self.motion.team.layout.clasps)
        self._error, self._speed, self._integral = np.zeros((3, clasps, 3))
        self._age = np.full(clasps, math.inf)  # [s], since each was measured
        self._offsets, self._velocities = np.zeros((2, self.motion.team.drones, 3))
        self._here: Cell | None = None  # of the last step

    @property
    def offsets(self) -> Array:
        """(2n, 3) [m]: corrections of the drones' setpoints in force."""
        return self._offsets.copy()

    @property
    def velocities(self) -> Array:
        """(2n, 3) [m/s]: how fast the corrections change."""
        return self._velocities.copy()

    def step(
        self,
        time: float,
        seconds: float,
        vertices: ArrayLike | None = None,
        drones: ArrayLike | None = None,
        *,
        measured: float | None = None,
        clock: tuple[float, float, float] = STEADY,
    ) -> Setpoints:
        """Return the corrected setpoints at a plan time.

        Parameters
        ----------
        time: plan time [s].
        seconds: time since the last step [s].
        vertices: measured clasps (clasps, 3) [m], a row of nan where one is missing; None where no
            measurement has come.
        drones: measured drones (2n, 3) [m], nan where one is missing; or None.
        measured: plan time of the measurement [s]; None for the delay before ``time``.
        clock: rate of the plan's clock, and its first and second derivatives.

        Raises
        ------
        InputError: measurements of another shape, or a time that is not finite.
        """
        seconds = not_negative("seconds", seconds)
        time = min(max(finite("time", time), 0.0), self._end)
        jet = clock
        if clock is not STEADY:
            jet = _shaped("clock", clock, (3,), "give a rate and its two derivatives").tolist()
        planned = self._drones.values(time, *jet)
        if seconds > 0.0:
            if vertices is not None:
                then = time - jet[0] * self._delay
                then = then if measured is None else finite("measured", measured)
                self._measure(_shaped("vertices", vertices, self._error.shape), then, jet[0])
            self._age += seconds
            growing = True
            if drones is not None:
                away = _shaped("drones", drones, self._offsets.shape) - planned[0] - self._offsets
                growing = bool(np.fmax.reduce((away * away) @ ONES) <= FAR * FAR)
            self._correct(time, seconds, growing=growing)
        planned[0] += self._offsets
        planned[1] += self._velocities
        return Setpoints(time, jet[0], *planned)

    def _cell(self, time: float) -> int:
        return min(max(bisect_right(self._breaks, time) - 1, 0), len(self._cells) - 1)

    def _measure(self, vertices: Array, time: float, rate: float) -> None:
        """Filter the errors of the vertices that a measurement of a plan time holds."""
        if self._cells[self._cell(time)] is None:
            return
        there = self._vertices.values(min(max(time, 0.0), self._end))
        self._speed = there[1] * rate
        error = there[0] - vertices
        good = (error * error) @ ONES <= LARGEST_ERROR * LARGEST_ERROR  # false for nan
        weight = -np.expm1(self._age / -SMOOTHING)
        weight[self._age > HELD] = 1.0
        if not good.all():
            weight[~good] = 0.0
            error[~good] = 0.0
        self._error += weight[:, None] * (error - self._error)
        self._age[good] = 0.0

    def _correct(self, time: float, seconds: float, *, growing: bool) -> None:
        """Advance the integral and the offsets by some time."""
        cell, share = self._cells[self._cell(time)], self._authority(time)
        wanted = self._wanted(seconds, growing=growing)
        asked = goal = np.zeros_like(self._offsets)
        if cell is not None and share > 0.0:
            asked = (cell.inverse @ (share * wanted).ravel()).reshape(-1, 3)
            goal = cell.aimed.within(asked)
        change = goal - self._offsets
        largest, reach = math.sqrt(((change * change) @ ONES).max()), self._rate * seconds
        if largest > reach:
            change *= reach / largest
        found = self._offsets + change
        if cell is not None and cell is not self._here:  # else between two offsets that it holds
            found = cell.kept.within(found)
        if cell is not None and share > 0.0:  # the integral forgets what is not commanded
            missed = (cell.forward @ (found - asked).ravel()).reshape(-1, 3)
            self._integral += min(seconds / UNWINDING, 1.0) * missed
        self._velocities = (found - self._offsets) / seconds
        self._offsets, self._here = found, cell

    def _wanted(self, seconds: float, *, growing: bool) -> Array:
        """Return by how much vertices are to be moved (clasps, 3) [m], and advance the integral."""
        error, speed = self._error, self._speed
        fresh = self._age <= HELD
        if not fresh.all():
            error, speed = fresh[:, None] * error, fresh[:, None] * speed
            self._integral[~fresh] *= math.exp(-seconds / FADING)
        if growing:
            self._integral += INTEGRAL * seconds * error
        np.minimum(np.maximum(self._integral, -LARGEST_ERROR), LARGEST_ERROR, out=self._integral)
        wanted: Array = PROPORTIONAL * error + self._integral + LEAD * speed
        return wanted

    def _authority(self, time: float) -> float:
        """Return the share of the correction that applies: it fades where the hitch is untied."""
        for first, last in self._spans:
            if first <= time <= last:
                grown = 1.0 if first <= 0.0 else (time - first) / HANDOVER
                left = 1.0 if last >= self._end else (last - time) / HANDOVER
                return min(1.0, grown, left)
        return 0.0


def _shaped(key: str, values: object, shape: tuple[int, ...], remedy: str = MISSING) -> Array:
    """Return an array of a shape; nan is allowed."""
    found = as_array(values)
    if found.shape != shape:
        raise InputError(key, values, f"numbers of shape {shape}", remedy)
    return found


def vertex_responses(
    motion: Motion, times: ArrayLike, stiffness: Array
) -> list[tuple[Array, Array]]:
    """Return how vertices move with setpoints, (3 clasps, 6n), and the damped inverse of that.

    Parameters
    ----------
    times: (k,) [s], at which there is a hitch.
    stiffness: (2n,) of the drones' position loops [N/m].
    """
    team = motion.team
    clasps = 3 * team.layout.clasps[:, None] + np.arange(3) + team.robots
    conditions = Conditions(stiffness=stiffness, integral=False)
    found = []
    for time in np.atleast_1d(as_array(times)).tolist():
        energy, x = energy_of(team, conditions, samples_of(motion, [time], conditions)[1])
        arcs = energy.law.forces(x[:, energy.nodes], energy.law.reference)[1]
        energy = replace(energy, law=replace(energy.law, lengths=arcs))  # of planned tension
        rows = Gradients.of(energy, x).position[clasps.ravel()]
        forward = rows.reshape(len(rows), -1)
        gram = forward @ forward.T + DAMPING**2 * np.eye(len(forward))
        found.append((forward, np.ascontiguousarray(np.linalg.solve(gram, forward).T)))
    return found


@dataclass(frozen=True, eq=False)
class HalfSpaces:
    """Half-spaces ``rows · offsets ≤ bounds`` of one cell, bounds not negative.

    Attributes
    ----------
    rows: (m, 6n), of length 1, orthogonal to common shifts.
    bounds: (m,)
    lower, upper: (3,) [m], the common shift's range that the arena leaves, besides LARGEST.
    """

    rows: Array
    bounds: Array
    lower: Array
    upper: Array

    def and_(self, other: HalfSpaces) -> HalfSpaces:
        """Return the offsets that are in both sets."""
        return HalfSpaces(
            np.concatenate([self.rows, other.rows]),
            np.concatenate([self.bounds, other.bounds]),
            np.maximum(self.lower, other.lower),
            np.minimum(self.upper, other.upper),
        )

    def within(self, offsets: Array) -> Array:
        """Return offsets (2n, 3) [m] of the set near the given ones."""
        common = np.add.reduce(offsets, 0) / len(offsets)
        own = (offsets - common).ravel()
        beyond = self.rows @ own - self.bounds
        if beyond.size and beyond.max() > 0.0:
            for _ in range(PASSES):
                own = own - np.maximum(beyond, 0.0) @ self.rows
                beyond = self.rows @ own - self.bounds
            if beyond.max() > 0.0:
                broken = beyond > 0.0
                bounds = self.bounds[broken]
                own = own * float((bounds / (beyond[broken] + bounds)).min())
        each = own.reshape(-1, 3)
        largest = math.sqrt(((each * each) @ ONES).max())
        if largest > LARGEST:
            each = each * (LARGEST / largest)
        found: Array = each + np.minimum(np.maximum(common, self.lower), self.upper)
        return found


@dataclass(frozen=True, eq=False)
class Cell:
    """A span of the plan in which directions stay what they are.

    Attributes
    ----------
    kept: offsets that keep all distances in it.
    aimed: those that keep them in the next cell as well.
    forward, inverse: see ``vertex_responses``.
    """

    kept: HalfSpaces
    aimed: HalfSpaces
    forward: Array
    inverse: Array


def covered_set(motion: Motion, reserve: float) -> tuple[Array, tuple[HalfSpaces | None, ...]]:
    """Return breaks (cells + 1,) [s] and the half-spaces of all cells, None without a hitch.

    Parameters
    ----------
    motion: the plan.
    reserve: how far every drone may be off its corrected setpoint, and every vertex off its plan,
        besides, wherever the plan itself leaves so much [m].
    """
    c, breaks = motion.drones.coefficients, motion.drones.breaks
    travel = np.sum(np.linalg.norm(np.diff(c, axis=-1), axis=2), axis=-1).max(axis=1)
    counts = np.clip(np.ceil(travel / TRAVEL), 1, MOST_CELLS).astype(int).tolist()
    points = np.concatenate(positions(motion), axis=1)
    pairs, times, cells = _pairs(motion), [], list[HalfSpaces | None]()
    for piece, count in enumerate(counts):
        times.append(np.linspace(breaks[piece], breaks[piece + 1], count + 1)[:-1])
        for k in range(count):
            part = bernstein.restrict(points[piece], k / count, (k + 1) / count)
            there = motion.formed[piece]
            cells.append(_half_spaces(motion, part, pairs, reserve) if there else None)
    return np.append(np.concatenate(times), breaks[-1]), tuple(cells)


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Pairs of bodies of one kind.

    Attributes
    ----------
    first, second: (pairs, ends) nodes, drones first, then points.
    limit: distance to keep [m], or 1 for drones' ellipsoids.
    scale: (3,), of the metric.
    """

    first: Indices
    second: Indices
    limit: float
    scale: Array


def _pairs(motion: Motion) -> tuple[_Pairs, ...]:
    """Return all pairs that the certificate keeps apart while the hitch holds."""
    team, layout, need = motion.team, motion.team.layout, motion.requirements
    count, part = team.drones, layout.parts
    before, after = part_points(part, layout)
    kind, cable = part % 3, part // 3
    outer = np.where(kind == 0, 2 * cable, 2 * cable + 1)
    begins = np.where(kind == 2, layout.ends[cable], layout.starts[cable]) + count
    ends = np.column_stack([begins, np.where(kind == 1, layout.ends[cable] + count, outer)])
    plain = np.ones(3)
    i, j = np.triu_indices(count, 1)
    drones = _Pairs(i[:, None], j[:, None], 1.0, need.separation.scale)
    drone, body = (x.ravel() for x in np.meshgrid(np.arange(count), np.arange(len(part))))
    on_leg = layout.has_leg.ravel()
    counted = (drone // 2 != cable[body]) | ((kind[body] == 1) & on_leg[drone])
    near = _Pairs(drone[counted, None], ends[body[counted]], need.separation.cable, plain)
    i, j = np.triu_indices(len(part), 1)
    shared = (before[i] == before[j]) | (before[i] == after[j])
    shared |= (after[i] == before[j]) | (after[i] == after[j])
    i, j = i[~shared], j[~shared]
    crossing = _Pairs(ends[i], ends[j], need.separation.crossing, plain)
    legs = layout.drones_with_legs
    anchors = layout.anchors[legs] + count
    return drones, near, crossing, _Pairs(legs[:, None], anchors[:, None], need.limits.leg, plain)


def _half_spaces(
    motion: Motion, points: Array, pairs: tuple[_Pairs, ...], reserve: float
) -> HalfSpaces:
    """Return the half-spaces of a cell, from the coefficients (nodes, 3, N + 1) of its points."""
    count = motion.team.drones
    middle = bernstein.evaluate(points, 0.5)
    rows, bounds = [], []
    for pair in pairs:
        shift = middle * pair.scale
        offset = shortest_offset(differences(shift[pair.first], shift[pair.second]))
        size = np.linalg.norm(offset, axis=-1)
        widest = float(np.max(pair.scale))
        near = np.flatnonzero((size < pair.limit + 4.0 * LARGEST * widest) & (size > 0.0))
        n = offset[near] / size[near, None] * pair.scale
        spare = 2.0 * reserve * np.linalg.norm(n, axis=-1)
        for a in pair.first[near].T:
            for b in pair.second[near].T:
                along = np.einsum("pd,pdk->pk", n, points[a] - points[b]).min(axis=-1)
                row, each = np.zeros((len(near), len(points), 3)), np.arange(len(near))
                row[each, b] += n
                row[each, a] -= n
                bound = np.maximum(along - pair.limit - spare, 0.0)
                row = row[:, :count] - np.mean(row[:, :count], axis=1, keepdims=True)
                own = row.reshape(len(near), 3 * count)
                length = np.linalg.norm(own, axis=1)
                kept = (length > 0.0) & (bound < np.sqrt(2.0) * LARGEST * length)
                rows.append(own[kept] / length[kept, None])
                bounds.append(bound[kept] / length[kept])
    lower, upper = np.full(3, -FARTHEST), np.full(3, FARTHEST)
    arena = motion.requirements.arena
    if arena is not None:
        hull, inner = points[:count], reserve + LARGEST
        lower = np.clip(arena.lower - hull.min(axis=(0, 2)) + inner, lower, 0.0)
        upper = np.clip(arena.upper - hull.max(axis=(0, 2)) - inner, 0.0, upper)
    return HalfSpaces(np.concatenate(rows), np.concatenate(bounds), lower, upper)
