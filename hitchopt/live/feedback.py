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
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.checks.spans import positions
from hitchopt.errors import InputError, OneLine, UnsupportedError
from hitchopt.geometry.vectors import differences, shortest_offset
from hitchopt.hitch.pairs import SEPARATION, Bodies, end_combinations, limits_of, scales_of
from hitchopt.live.player import Sampler, Setpoints
from hitchopt.motion.motion import HITCHED_STATE, Motion
from hitchopt.statics.settle import conditions_of, energy_of, samples_of
from hitchopt.statics.tolerance import responses
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array, as_array, finite, nonnegative, per_robot, positive

# Gains [1], [1/s]. Setpoints of drones of 4.75 N/m take 0.3 s to move vertices, measurements and
# their filter as long again: the loop has a phase margin of some 50°
PROPORTIONAL, INTEGRAL = 1.2, 2.5

LEAD = 0.4  # setpoints lead the plan of a vertex by so long, as friction is to be overcome [s]
UNWINDING = 0.5  # time constant with which the integral forgets what could not be commanded [s]
SMOOTHING = 0.2  # time constant of the filter: 1 cm of white noise at 100 Hz leaves 2 mm [s]
HELD, FADING = 0.3, 2.0  # a vertex not measured so long loses its correction; time constant [s]
HANDOVER = 2.0  # corrections fade so long before the hitch is untied, grow after it is tied [s]
FAR = 0.15  # corrections do not grow while a drone is farther from its corrected setpoint [m]
GAIN = 36.0  # stiffness over mass of drones of which none is stated [1/s²]

# Larger measured errors are false measurements; and the largest correction that is asked for [m]
LARGEST_ERROR = 0.5

# Singular value of the response below which a mode is corrected by less than half: to move the
# vertices there takes setpoints more than three times as far
DAMPING = 0.3

# Cells are so short that no drone's curve is longer [m]: directions stay what they are; and how
# many a piece has at most
TRAVEL, MOST_CELLS = 0.05, 64

# Largest offset of a drone relative to a common shift of all drones, and largest common shift [m]
LARGEST, FARTHEST = 0.25, 0.4

PASSES = 2  # projections onto broken half-spaces, before all is scaled to hold certainly
ONES = np.ones(3)  # sums the squares of vectors: faster than ``einsum`` where they are few


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
    delay: age of the measurements, unless ``step`` receives it [s].
    stiffness: of the drones' position loops [N/m], one, one per drone, or by axis (2n, 3); None for
        the team's, or 36/s² times their masses where these are rigid.

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
        if not isinstance(motion, Motion) or not motion.has_cables:
            raise InputError("plan", plan, "a Plan or Motion of a hitch", "solve or load one")
        motion.refuse_several("feedback")
        if motion.requirements.keep_out or motion.requirements.objects:
            words = "feedback keeps no distance to keep-outs and objects: fly without them"
            raise UnsupportedError(words)
        self.motion, team = motion, motion.team
        self._rate, self._delay = positive("rate", rate), nonnegative("delay", delay)
        own = np.where(np.isfinite(team.stiffness), team.stiffness, GAIN * team.mass[:, None])
        stiff = own if stiffness is None else as_array(stiffness)
        if stiff.shape != own.shape:
            stiff = per_robot("stiffness", stiffness, team.drones, owner="drone")  # type: ignore[arg-type]
        breaks, self._cells = cells_of(motion, nonnegative("reserve", reserve), stiff)
        self._breaks, self._end = breaks.tolist(), float(breaks[-1])
        self._spans = [s.drones.breaks[[0, -1]].tolist() for s in motion.spans(HITCHED_STATE)]
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

        Raises
        ------
        InputError: measurements of another shape, or a time that is not finite.
        """
        seconds = nonnegative("seconds", seconds)
        time = min(max(finite("time", time), 0.0), self._end)
        planned, cell = self._drones.values(time), self._cell(time)
        if seconds > 0.0:
            if vertices is not None:
                then = time - self._delay if measured is None else finite("measured", measured)
                self._measure(_shaped("vertices", vertices, self._error.shape), then)
            self._age += seconds
            growing = True
            if drones is not None:
                away = _shaped("drones", drones, self._offsets.shape) - planned[0] - self._offsets
                growing = bool(np.fmax.reduce((away * away) @ ONES) <= FAR * FAR)
            wanted = self._wanted(seconds, growing=growing)
            self._correct(cell, self._authority(time) * wanted, seconds)
        planned[0] += self._offsets
        planned[1] += self._velocities
        return Setpoints(time, 1.0, *planned)

    def _cell(self, time: float) -> Cell | None:
        return self._cells[min(max(bisect_right(self._breaks, time) - 1, 0), len(self._cells) - 1)]

    def _measure(self, vertices: Array, time: float) -> None:
        """Filter the errors of the vertices that a measurement of a plan time holds."""
        if self._cell(time) is None:
            return
        place, self._speed, *_ = self._vertices.values(min(max(time, 0.0), self._end))
        error = place - vertices
        good = (error * error) @ ONES <= LARGEST_ERROR * LARGEST_ERROR  # false for nan
        weight = np.where(self._age > HELD, 1.0, -np.expm1(self._age / -SMOOTHING))
        self._error[good] += (weight[:, None] * (error - self._error))[good]
        self._age[good] = 0.0

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

    def _correct(self, cell: Cell | None, wanted: Array, seconds: float) -> None:
        """Lead the offsets to those that are wanted, and the integral to what they allow."""
        free = goal = np.zeros_like(self._offsets)
        if cell is not None:
            free = (cell.inverse @ wanted.ravel()).reshape(-1, 3)
            goal = cell.within(free)
        change = goal - self._offsets
        largest, reach = math.sqrt(((change * change) @ ONES).max()), self._rate * seconds
        if largest > reach:
            change *= reach / largest
        offsets = self._offsets + change
        if cell is not None:
            if cell is not self._here:  # else between two offsets that it holds
                offsets = cell.within(offsets)
            missed = (cell.forward @ (offsets - free).ravel()).reshape(-1, 3)
            self._integral += min(seconds / UNWINDING, 1.0) * missed
        self._velocities = (offsets - self._offsets) / seconds
        self._offsets, self._here = offsets, cell

    def _authority(self, time: float) -> float:
        """Return the share of the correction that applies: it fades where the hitch is untied."""
        for first, last in self._spans:
            if first <= time <= last:
                grown = 1.0 if first <= 0.0 else (time - first) / HANDOVER
                left = 1.0 if last >= self._end else (last - time) / HANDOVER
                return min(1.0, grown, left)
        return 0.0


def _shaped(key: str, values: object, shape: tuple[int, ...]) -> Array:
    """Return an array of a shape; nan is allowed."""
    if (array := as_array(values)).shape != shape:
        bound = f"numbers of shape {shape}"
        raise InputError(key, values, bound, "give a row of nan where one is missing")
    return array


def vertex_responses(
    motion: Motion, times: ArrayLike, stiffness: Array
) -> list[tuple[Array, Array]]:
    """Return how vertices move with setpoints, (3 clasps, 6n), and the damped inverse of that.

    At times (k,) [s] of a hitch, for drones' position loops of a stiffness (2n,) or (2n, 3) [N/m].
    """
    team = motion.team
    clasps = 3 * team.layout.clasps[:, None] + np.arange(3) + team.robots
    conditions = conditions_of(team, stiffness=stiffness, integral=False)
    matrices = []
    for time in np.atleast_1d(as_array(times)).tolist():
        energy = energy_of(team, conditions, samples_of(motion, [time], conditions)[1])
        arcs = energy.forces(energy.start[:, energy.nodes], energy.reference)[1]
        energy = replace(energy, lengths=arcs)  # of planned tension
        by_setpoints = slice(team.robots, 3 * team.robots)
        rows = responses(energy, energy.start)[clasps.ravel(), by_setpoints]
        forward = rows.reshape(len(rows), -1)
        gram = forward @ forward.T + DAMPING**2 * np.eye(len(forward))
        matrices.append((forward, np.ascontiguousarray(np.linalg.solve(gram, forward).T)))
    return matrices


@dataclass(frozen=True, eq=False)
class Cell:
    """A span of the plan in which directions stay what they are.

    Half-spaces ``rows · offsets ≤ bounds`` keep all distances in it and in the next one. Rows have
    length 1 and are orthogonal to common shifts, bounds are not negative.
    """

    rows: Array
    bounds: Array
    lower: Array  # (3,) [m], the range, up to ``upper``, that the arena leaves a common shift
    upper: Array
    forward: Array  # response and damped ``inverse``, see ``vertex_responses``
    inverse: Array

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
        nearest: Array = each + np.minimum(np.maximum(common, self.lower), self.upper)
        return nearest


def cells_of(motion: Motion, reserve: float, stiffness: Array) -> tuple[Array, list[Cell | None]]:
    """Return breaks (cells + 1,) [s] and all cells, None without a hitch."""
    c, breaks = motion.drones.coefficients, motion.drones.breaks
    travel = np.sum(np.linalg.norm(np.diff(c, axis=-1), axis=2), axis=-1).max(axis=1)
    counts = np.clip(np.ceil(travel / TRAVEL), 1, MOST_CELLS).astype(int).tolist()
    nodes = np.concatenate(positions(motion)[::-1], axis=1)
    distances, times, spaces = _Distances(motion, reserve), [], list[tuple[Array, ...] | None]()
    for piece, (count, there) in enumerate(zip(counts, motion.formed, strict=True)):
        times.append(np.linspace(breaks[piece], breaks[piece + 1], count + 1)[:-1])
        for k in range(count):
            part = bernstein.restrict(nodes[piece], k / count, (k + 1) / count)
            spaces.append(distances.half_spaces(part) if there else None)
    edges = np.append(np.concatenate(times), breaks[-1])
    middles = 0.5 * (edges[1:] + edges[:-1])[[each is not None for each in spaces]]
    responses = iter(vertex_responses(motion, middles, stiffness))
    cells: list[Cell | None] = []
    for here, following in pairwise([*spaces, None]):
        if here is None:
            cells.append(None)
            continue
        rows, bounds, lower, upper = zip(here, following or here, strict=True)
        both = np.concatenate(rows), np.concatenate(bounds)
        arena = np.maximum(*lower), np.minimum(*upper)
        cells.append(Cell(*both, *arena, *next(responses)))
    return edges, cells


class _Distances:
    """The distances that the certificate keeps while the hitch holds, of pairs as in ``Bodies``."""

    def __init__(self, motion: Motion, reserve: float) -> None:
        layout, need = motion.team.layout, motion.requirements
        bodies = Bodies.of(layout)
        i, j = np.triu_indices(len(bodies.nodes), 1)
        kind = bodies.kind(i, j)
        i, j, kind = i[kind >= 0], j[kind >= 0], kind[kind >= 0]
        legs = np.flatnonzero(layout.has_leg)  # pairs of a drone and a point as well
        ends = [np.stack([x, x], axis=1) for x in (legs + layout.points, layout.anchors[legs])]
        first = np.concatenate([bodies.nodes[i], ends[0]])
        second = np.concatenate([bodies.nodes[j], ends[1]])
        self._scale = np.ones((len(first), 3))
        self._scale[: len(kind)] = scales_of(need.separation)[kind]
        kinds = np.append(kind, np.full(len(legs), SEPARATION))
        self._limit = np.append(
            limits_of(need.separation)[kind], np.full(len(legs), need.limits.leg)
        )
        self._first, self._second, self._reserve = first, second, reserve
        self._nodes = end_combinations(kinds, first, second)
        self._points, self._arena = layout.points, need.arena

    def half_spaces(self, nodes: Array) -> tuple[Array, Array, Array, Array]:
        """Return rows, bounds, lower and upper of a cell, from its nodes (…, 3, N + 1)."""
        drones, scale = nodes[self._points :], self._scale
        middle = bernstein.evaluate(nodes, 0.5)
        ends = (middle[each] * scale[:, None] for each in (self._first, self._second))
        offset = shortest_offset(differences(*ends))
        size = np.linalg.norm(offset, axis=-1)
        near = (size < self._limit + 4.0 * LARGEST * scale.max(axis=1)) & (size > 0.0)
        pair, a, b = (each[near[self._nodes[0]]] for each in self._nodes)
        n = offset[pair] / size[pair, None] * scale[pair]
        along = np.einsum("pd,pdk->pk", n, nodes[a] - nodes[b]).min(axis=-1)
        bound = along - self._limit[pair] - 2.0 * self._reserve * np.linalg.norm(n, axis=-1)
        row, each = np.zeros((len(pair), len(nodes), 3)), np.arange(len(pair))
        row[each, b] += n
        row[each, a] -= n
        row = row[:, self._points :]
        own = (row - row.mean(axis=1, keepdims=True)).reshape(len(pair), -1)
        length, bound = np.linalg.norm(own, axis=1), np.maximum(bound, 0.0)
        some = (length > 0.0) & (bound < np.sqrt(2.0) * LARGEST * length)
        rows, bounds = own[some] / length[some, None], bound[some] / length[some]
        lower, upper = np.full(3, -FARTHEST), np.full(3, FARTHEST)
        if self._arena is not None:
            inner = self._reserve + LARGEST
            lower = np.clip(self._arena.lower - drones.min(axis=(0, 2)) + inner, lower, 0.0)
            upper = np.clip(self._arena.upper - drones.max(axis=(0, 2)) - inner, 0.0, upper)
        return rows, bounds, lower, upper
