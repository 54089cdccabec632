"""Correct the setpoints of a plan in flight by feedback from measured vertices.

The filtered error of the measured vertices enters a proportional-integral law.
``hitchopt.lab.statics`` computes the linear response S of vertices to setpoints, for a hitch whose
drones are springs to their setpoints. The damped inverse of S gives the drones' desired offsets.

The commanded offsets are the projection of the desired ones onto those that keep every distance at
all times of a cell of the plan. Two bodies (a drone, or a straight part of a cable) with minimum
distance D are separated along a direction n; the coefficients of their ends' polynomials a(t), b(t)
give a lower bound ``m ≤ n·(a - b)`` for all t. With the ends offset by ``ρ_a``, ``ρ_b`` they keep D
if ``n·(ρ_a - ρ_b) ≥ D - m`` for all pairs of ends: half-spaces of offsets. A common shift of all
drones and vertices changes no distance. Vertices are assumed to be within the reserve of the plan.
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
from hitchopt.errors import InputError, OneLine
from hitchopt.geometry.vectors import differences, shortest_offset
from hitchopt.hitch.energy import energy_of
from hitchopt.hitch.pairs import SEPARATION, TautBodies, end_combinations, limits_of, scales_of
from hitchopt.hitch.rest_errors import responses
from hitchopt.lab.statics.equilibrium import conditions_of, samples_of
from hitchopt.live.player import Sampler, Setpoints
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import HITCHED_STATE, Motion
from hitchopt.support import Feature, Neighbour, refused_value, unsupported
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array, as_array, counted, finite, nonnegative, per_robot, positive
from hitchopt.values.fields import suggest_keywords

# Proportional gain. The response of vertices to setpoints of drones of 4.75 N/m takes 0.3 s, and
# measurements with their filter another 0.3 s: the phase margin is about 50°
PROPORTIONAL = 1.2
INTEGRAL = 2.5  # Integral gain [1/s]

LEAD = 0.4  # lead of the setpoints of a moving vertex, which compensates friction [s]
UNWINDING = 0.5  # time constant of the anti-windup [s]
SMOOTHING = 0.2  # time constant of the filter: 1 cm of white noise at 100 Hz becomes 2 mm [s]
MAX_AGE = 0.3  # age of a vertex's last measurement after which its correction fades [s]
FADING = 2.0  # time constant with which it fades [s]
RAMP = 2.0  # time in which corrections fade in after the hitch is tied, and out before it ends [s]
MAX_DRONE_ERROR = 0.15  # error of a drone beyond which the integral is stopped [m]
STIFFNESS_PER_MASS = 36.0  # Stiffness of drones that state none [1/s²]

# Error beyond which measurements are rejected, and limit of the integral [m]
MAX_VERTEX_ERROR = 0.5

# Damping: modes of the response with smaller singular values are corrected by less than half,
# because they need setpoint offsets of more than three times the vertices'
DAMPING = 0.3

# Maximum length of a drone's path in a cell, for which directions are nearly constant [m]
MAX_CELL_TRAVEL = 0.05
MAX_CELLS = 64  # Maximum number of cells of a piece

MAX_OFFSET = 0.25  # Maximum offset of a drone relative to a common shift of all drones [m]
MAX_SHIFT = 0.4  # Maximum common shift [m]

PROJECTIONS = 2  # iterations of projecting onto violated half-spaces, before offsets are scaled
ONES = np.ones(3)  # to sum squares of vectors, which is faster than ``einsum`` for few vectors


class Feedback(OneLine):
    """Corrections of a plan by measured vertices, for one flight.

    Distances keep their limits at all times while drones are within ``reserve`` of their corrected
    setpoints, and vertices within ``reserve`` of the plan, if the plan itself has that margin:
    corrected setpoints stay within half-spaces computed from the plan's polynomials for whole
    intervals. A common shift of all drones is limited only by the arena. Drones are in the order of
    the problem.

    Parameters
    ----------
    plan: a plan of a hitch, or its motion.
    rate: maximum speed of changes of the corrections [m/s].
    reserve: maximum error of drones and vertices that is allowed for [m].
    delay: age of the measurements, unless ``step`` receives their time [s].
    stiffness: of the drones' position loops [N/m]: a number, one per drone, or per axis (2n, 3);
        None for the team's, or 36/s² times the mass of drones that are rigid there.

    Raises
    ------
    InputError: the plan has no cables, or a number is out of range.
    UnsupportedError: the plan has objects or keep-outs, to which corrections keep no distance.
    """

    @suggest_keywords
    def __init__(
        self,
        plan: object,
        *,
        rate: float = 0.1,
        reserve: float = 0.01,
        delay: float = 0.05,
        stiffness: ArrayLike | None = None,
    ) -> None:
        flown = getattr(plan, "flight", plan)
        flight = Flight.of(flown) if isinstance(flown, Flight | Motion) else None
        if flight is None or not flight.has_cables:
            raise refused_value(Feature.FEEDBACK, Neighbour.SINGLE_DRONES, plan)
        motion = flight.of_one_team(Feature.FEEDBACK)
        if motion.requirements.keep_out:
            raise unsupported(Feature.FEEDBACK, Neighbour.KEEP_OUTS)
        if motion.requirements.objects:
            raise unsupported(Feature.FEEDBACK, Neighbour.OBJECTS)
        self.motion = motion
        team = motion.team
        self._rate, self._delay = positive("rate", rate), nonnegative("delay", delay)
        default = STIFFNESS_PER_MASS * team.mass[:, None]
        own = np.where(np.isfinite(team.stiffness), team.stiffness, default)
        stiff = own if stiffness is None else as_array("stiffness", stiffness)
        self._listed = team.listed
        numbers = np.argsort(team.listed)
        if stiff.shape != own.shape:
            stiff = per_robot("stiffness", stiffness, team.drones, owner="drone")  # type: ignore[arg-type]
        stiff = own if stiffness is None else stiff[numbers]
        breaks, self._cells = cells_of(motion, nonnegative("reserve", reserve), stiff)
        self._breaks = breaks.tolist()
        self._end = float(breaks[-1])
        self._spans = [s.drones.breaks[[0, -1]].tolist() for s in motion.spans(HITCHED_STATE)]
        clasps = motion.vertices.coefficients[:, team.layout.clasps]
        self._drones = Sampler(motion.drones)
        self._vertices = Sampler(PiecewisePolynomial(motion.vertices.breaks, clasps))
        self.reset()

    def _parts(self) -> Iterator[str]:
        yield counted(self.motion.team.drones, "drone")
        yield f"{self.motion.duration:.4g} s, cells: {len(self._cells)}"

    def reset(self) -> None:
        """Discard all measurements and corrections."""
        clasps = len(self.motion.team.layout.clasps)
        self._error, self._lead, self._integral = np.zeros((3, clasps, 3))
        self._age = np.full(clasps, math.inf)  # of the last measurements [s]
        self._offsets, self._velocities = np.zeros((2, self.motion.team.drones, 3))
        self._last_cell: Cell | None = None  # of the last step

    @property
    def offsets(self) -> Array:
        """Current corrections of the drones' setpoints (2n, 3) [m]."""
        offsets: Array = self._offsets[self._listed]
        return offsets

    @property
    def velocities(self) -> Array:
        """Rates of change of the corrections (2n, 3) [m/s]."""
        velocities: Array = self._velocities[self._listed]
        return velocities

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
        vertices: measured clasps (clasps, 3) [m], a row of nan for a missing one; None without a
            new measurement.
        drones: measured drones (2n, 3) [m], nan for missing ones; or None.
        measured: plan time of the measurement [s]; by default ``delay`` before ``time``.

        Raises
        ------
        InputError: measurements have another shape, or a time is not finite.
        """
        seconds = nonnegative("seconds", seconds)
        time = min(max(finite("time", time), 0.0), self._end)
        setpoints = self._drones.values(time)
        cell = self._cell(time)
        if seconds > 0.0:
            if vertices is not None:
                at = time - self._delay if measured is None else finite("measured", measured)
                self._measure(_checked_array("vertices", vertices, self._error.shape), at)
            self._age += seconds
            integrate = True
            if drones is not None:
                positions = _checked_array("drones", drones, self._offsets.shape)
                error = positions - (setpoints[0] + self._offsets)[self._listed]
                integrate = bool(np.fmax.reduce((error * error) @ ONES) <= MAX_DRONE_ERROR**2)
            correction = self._correction(seconds, integrate=integrate)
            self._update_offsets(cell, self._authority(time) * correction, seconds)
        setpoints[0] += self._offsets
        setpoints[1] += self._velocities
        return Setpoints(time, 1.0, *(each[self._listed] for each in setpoints))

    def _cell(self, time: float) -> Cell | None:
        return self._cells[min(max(bisect_right(self._breaks, time) - 1, 0), len(self._cells) - 1)]

    def _measure(self, vertices: Array, time: float) -> None:
        """Filter the errors of the measured vertices at a plan time."""
        if self._cell(time) is None:
            return
        time = min(max(time, 0.0), self._end)
        planned, speed, *_ = self._vertices.values(time)
        ends = (end for start, end in self._spans if start <= time <= end)
        later = self._vertices.values(min(time + LEAD, next(ends, time)))[0]
        self._lead = shorter(LEAD * speed, later - planned)
        error = planned - vertices
        valid = (error * error) @ ONES <= MAX_VERTEX_ERROR**2  # false for nan
        weight = np.where(self._age > MAX_AGE, 1.0, -np.expm1(self._age / -SMOOTHING))
        self._error[valid] += (weight[:, None] * (error - self._error))[valid]
        self._age[valid] = 0.0

    def _correction(self, seconds: float, *, integrate: bool) -> Array:
        """Return the desired displacement of vertices (clasps, 3) [m], and advance the integral."""
        error, lead = self._error, self._lead
        recent = self._age <= MAX_AGE
        if not recent.all():
            error, lead = recent[:, None] * error, recent[:, None] * lead
            self._integral[~recent] *= math.exp(-seconds / FADING)
        if integrate:
            self._integral += INTEGRAL * seconds * error
        bounded = np.maximum(self._integral, -MAX_VERTEX_ERROR)
        self._integral = np.minimum(bounded, MAX_VERTEX_ERROR)
        correction: Array = PROPORTIONAL * error + self._integral + lead
        return correction

    def _update_offsets(self, cell: Cell | None, correction: Array, seconds: float) -> None:
        """Move the offsets toward those of a correction of the vertices, with anti-windup."""
        desired = goal = np.zeros_like(self._offsets)
        if cell is not None:
            desired = (cell.inverse @ correction.ravel()).reshape(-1, 3)
            goal = cell.projected(desired)
        change = goal - self._offsets
        largest = math.sqrt(((change * change) @ ONES).max())
        max_change = self._rate * seconds
        if largest > max_change:
            change *= max_change / largest
        offsets = self._offsets + change
        if cell is not None:
            if cell is not self._last_cell:  # else both ends of the change are feasible
                offsets = cell.projected(offsets)
            missing = (cell.forward @ (offsets - desired).ravel()).reshape(-1, 3)
            self._integral += min(seconds / UNWINDING, 1.0) * missing
        self._velocities = (offsets - self._offsets) / seconds
        self._offsets, self._last_cell = offsets, cell

    def _authority(self, time: float) -> float:
        """Return the weight of the corrections, from 0 without a hitch to 1."""
        for start, end in self._spans:
            if start <= time <= end:
                fade_in = 1.0 if start <= 0.0 else (time - start) / RAMP
                fade_out = 1.0 if end >= self._end else (end - time) / RAMP
                return min(1.0, fade_in, fade_out)
        return 0.0


def shorter(one: Array, other: Array) -> Array:
    """Return the shorter vector of each row (k, 3).

    For a vertex that slows down, the lead is the path to its later position, which ends where it
    stops.
    """
    is_shorter = (one * one) @ ONES <= (other * other) @ ONES
    return np.where(is_shorter[:, None], one, other)


def _checked_array(key: str, values: object, shape: tuple[int, ...]) -> Array:
    """Return an array of a shape, which may contain nan, or raise InputError."""
    if (array := as_array(key, values)).shape != shape:
        bound = f"numbers of shape {shape}"
        raise InputError(key, values, bound, "pass a row of nan where one is missing")
    return array


def vertex_responses(
    motion: Motion, times: ArrayLike, stiffness: Array
) -> list[tuple[Array, Array]]:
    """Return the responses of vertices to setpoints (3 clasps, 6n), and their damped inverses.

    They are at times (k,) [s] of a hitch, for position loops of a stiffness (2n,) or (2n, 3) [N/m].
    """
    team = motion.team
    clasps = 3 * team.layout.clasps[:, None] + np.arange(3) + team.robots
    conditions = conditions_of(team, stiffness=stiffness, integral=False)
    matrices = []
    for time in np.atleast_1d(times).tolist():
        energy = energy_of(team, conditions, samples_of(motion, [time], conditions)[1])
        arcs = energy.forces(energy.start[:, energy.nodes], energy.reference).lengths
        energy = replace(energy, lengths=arcs)  # with the planned tensions
        by_setpoints = slice(team.robots, 3 * team.robots)
        rows = responses(energy, energy.start)[clasps.ravel(), by_setpoints]
        forward = rows.reshape(len(rows), -1)
        gram = forward @ forward.T + DAMPING**2 * np.eye(len(forward))
        matrices.append((forward, np.ascontiguousarray(np.linalg.solve(gram, forward).T)))
    return matrices


@dataclass(frozen=True, eq=False)
class Cell:
    """A span of the plan with constant directions of the distances.

    Half-spaces ``rows · offsets ≤ bounds`` keep all distances in this cell and the next one. Rows
    have length 1 and are orthogonal to common shifts, bounds are not negative.
    """

    rows: Array
    bounds: Array
    lower: Array  # (3,) [m], bounds of a common shift within the arena
    upper: Array
    forward: Array  # response and damped inverse, see ``vertex_responses``
    inverse: Array

    def projected(self, offsets: Array) -> Array:
        """Return feasible offsets (2n, 3) [m] close to the given ones."""
        shift = np.add.reduce(offsets, 0) / len(offsets)
        relative = (offsets - shift).ravel()
        excess = self.rows @ relative - self.bounds
        if excess.size and excess.max() > 0.0:
            for _ in range(PROJECTIONS):
                relative = relative - np.maximum(excess, 0.0) @ self.rows
                excess = self.rows @ relative - self.bounds
            if excess.max() > 0.0:
                violated = excess > 0.0
                bounds = self.bounds[violated]
                relative = relative * float((bounds / (excess[violated] + bounds)).min())
        each = relative.reshape(-1, 3)
        largest = math.sqrt(((each * each) @ ONES).max())
        if largest > MAX_OFFSET:
            each = each * (MAX_OFFSET / largest)
        feasible: Array = each + np.minimum(np.maximum(shift, self.lower), self.upper)
        return feasible


def cells_of(motion: Motion, reserve: float, stiffness: Array) -> tuple[Array, list[Cell | None]]:
    """Return breaks (cells + 1,) [s] and all cells, None for spans without a hitch."""
    c, breaks = motion.drones.coefficients, motion.drones.breaks
    travel = np.sum(np.linalg.norm(np.diff(c, axis=-1), axis=2), axis=-1).max(axis=1)
    counts = np.clip(np.ceil(travel / MAX_CELL_TRAVEL), 1, MAX_CELLS).astype(int).tolist()
    nodes = np.concatenate(positions(motion)[::-1], axis=1)
    distances = _Distances(motion, reserve)
    times = []
    spaces = list[tuple[Array, ...] | None]()
    for piece, (count, is_formed) in enumerate(zip(counts, motion.formed, strict=True)):
        times.append(np.linspace(breaks[piece], breaks[piece + 1], count + 1)[:-1])
        for k in range(count):
            part = bernstein.restrict(nodes[piece], k / count, (k + 1) / count)
            spaces.append(distances.half_spaces(part) if is_formed else None)
    edges = np.append(np.concatenate(times), breaks[-1])
    midpoints = 0.5 * (edges[1:] + edges[:-1])[[each is not None for each in spaces]]
    responses = iter(vertex_responses(motion, midpoints, stiffness))
    cells: list[Cell | None] = []
    for current, following in pairwise([*spaces, None]):
        if current is None:
            cells.append(None)
            continue
        rows, bounds, lower, upper = zip(current, following or current, strict=True)
        half_spaces = np.concatenate(rows), np.concatenate(bounds)
        arena = np.maximum(*lower), np.minimum(*upper)
        cells.append(Cell(*half_spaces, *arena, *next(responses)))
    return edges, cells


class _Distances:
    """The certificate's distances while the hitch holds, of pairs as in ``TautBodies``."""

    def __init__(self, motion: Motion, reserve: float) -> None:
        layout = motion.team.layout
        need = motion.requirements
        bodies = TautBodies.of(layout)
        i, j = np.triu_indices(len(bodies.nodes), 1)
        kind = bodies.kind(i, j)
        i, j, kind = i[kind >= 0], j[kind >= 0], kind[kind >= 0]
        legs = np.flatnonzero(layout.has_leg)  # also pairs, of a drone and a point
        ends = [np.stack([x, x], axis=1) for x in (legs + layout.points, layout.anchors[legs])]
        first = np.concatenate([bodies.nodes[i], ends[0]])
        second = np.concatenate([bodies.nodes[j], ends[1]])
        self._scale = np.ones((len(first), 3))
        self._scale[: len(kind)] = scales_of(need)[kind]
        kinds = np.append(kind, np.full(len(legs), SEPARATION))
        self._limit = np.append(
            limits_of(need.separation)[kind], np.full(len(legs), need.limits.leg)
        )
        self._first, self._second, self._reserve = first, second, reserve
        self._nodes = end_combinations(kinds, first, second)
        self._points, self._arena = layout.points, need.arena

    def half_spaces(self, nodes: Array) -> tuple[Array, Array, Array, Array]:
        """Return rows, bounds, lower and upper of a cell, from its nodes (…, 3, N + 1)."""
        drones = nodes[self._points :]
        scale = self._scale
        midpoints = bernstein.evaluate(nodes, 0.5)
        ends = (midpoints[each] * scale[:, None] for each in (self._first, self._second))
        offset = shortest_offset(differences(*ends))
        distance = np.linalg.norm(offset, axis=-1)
        max_distance = self._limit + 4.0 * MAX_OFFSET * scale.max(axis=1)
        near = (distance < max_distance) & (distance > 0.0)
        pair, a, b = (each[near[self._nodes[0]]] for each in self._nodes)
        n = offset[pair] / distance[pair, None] * scale[pair]
        projection = np.einsum("pd,pdk->pk", n, nodes[a] - nodes[b]).min(axis=-1)
        bound = projection - self._limit[pair] - 2.0 * self._reserve * np.linalg.norm(n, axis=-1)
        row = np.zeros((len(pair), len(nodes), 3))
        each = np.arange(len(pair))
        row[each, b] += n
        row[each, a] -= n
        row = row[:, self._points :]
        relative = (row - row.mean(axis=1, keepdims=True)).reshape(len(pair), -1)
        length = np.linalg.norm(relative, axis=1)
        bound = np.maximum(bound, 0.0)
        used = (length > 0.0) & (bound < np.sqrt(2.0) * MAX_OFFSET * length)
        rows = relative[used] / length[used, None]
        bounds = bound[used] / length[used]
        lower = np.full(3, -MAX_SHIFT)
        upper = np.full(3, MAX_SHIFT)
        if self._arena is not None:
            margin = self._reserve + MAX_OFFSET
            lower = np.clip(self._arena.lower - drones.min(axis=(0, 2)) + margin, lower, 0.0)
            upper = np.clip(self._arena.upper - drones.max(axis=(0, 2)) - margin, 0.0, upper)
        return rows, bounds, lower, upper
