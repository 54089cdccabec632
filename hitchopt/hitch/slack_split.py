"""The slack split: leg lengths of every cable that separate drones and cables.

On a given polygon every drone slides along a fixed line, so positions are affine in ``d``. Linear
lower bounds of distances then give a convex QP, an inner approximation: true distances are at least
its bounds. In repeated solutions the penalized deviation never increases (Marks and Wright 1978).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InfeasibleError, check_time
from hitchopt.geometry import Outline, differences, shortest_offset
from hitchopt.geometry.vectors import EAST, dot, first_smallest, length, unit
from hitchopt.hitch.forces import (
    cable_slack_of,
    clasp_loads,
    leg_directions,
    leg_vectors,
    sag_factors,
)
from hitchopt.hitch.pairs import (
    CROSSING,
    SEPARATION,
    TautBodies,
    end_combinations,
    limits_of,
    scales_of,
)
from hitchopt.hitch.quadratic_program import QuadraticProgram, Rows, solve_qp
from hitchopt.hitch.requirements import Arena, Requirements
from hitchopt.hitch.team import Team
from hitchopt.values import Array, Indices

if TYPE_CHECKING:
    import scipy.sparse as sp

SPREAD_MARGIN = 1.5  # Margin, distance over its limit, of the leg lengths called ``spread``
LIMIT_MARGIN = 1.001  # Margin of all other leg lengths, which allows for small errors of a plan

CROSSING_MARGIN = 1.005
"""Largest margin of cables without a common clasp, since ``spread`` concerns drones."""


@dataclass(frozen=True, eq=False)
class LegLengths:
    """Leg lengths ``d`` (J, n) [m], their smallest margin, and ``Σ (d - reference)²`` [m²]."""

    q_legs: Array
    margin: float
    deviation: float


PENALTY = 1e3
"""[m²] Penalty weight per robot and unit of margin: distances have priority over deviation."""

MAX_WEIGHT_SHIFT = 0.02  # [m] Largest lateral shift of drones as the weight of their legs changes


MAX_POLYGON_ITERATIONS = 60
"""Maximum number of convex programs from one initial guess on one polygon."""

MAX_PATH_ITERATIONS = 20
"""Maximum number of convex programs along a path, which converges within ten iterations or not at
all."""

MIN_GAIN = 1e-6  # Smallest relative improvement of merit; mirror images differ by less

STEP_TOLERANCE = 1e-9
"""[m] Largest change of a leg in the last iteration."""

COARSE_STEP_TOLERANCE = 1e-5
"""[m] The same if the first split with the margin suffices, since smaller steps do not increase the
margin noticeably."""

MAX_CYCLE = 4
"""Iterations without improvement of merit after which the search cycles. Level legs that cross each
other make it cycle."""

CYCLE_STEP = 1e-3
"""[m] Smallest step of a search that cycles."""

ROLL_CANDIDATES = tuple(
    math.radians(angle) for angle in (5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0)
)
"""[rad] Rolls in ascending order, of which the first sufficient one is refined. Simulated clasps
hold up to 60°."""

RESPLIT_CANDIDATES = (ROLL_CANDIDATES[3], ROLL_CANDIDATES[5])
"""[rad] Rolls at which other leg lengths are searched if no roll suffices for the reference."""

RESPLIT_RATIO = 0.9
"""Roll at which other leg lengths must suffice, over the one that the reference needs."""


@dataclass(frozen=True, eq=False)
class LegTask:
    """A problem for the leg lengths of a team on J polygons: one, or the knots of a path."""

    team: Team  # with the cables to be split
    requirements: Requirements  # distances, and the arena
    polygons: Array  # (J, points, 2) [m]
    reference: Array  # (J, n) [m], ``d`` whose deviation is minimized
    shortest_leg: float  # [m], for both legs of every cable
    margin: float | Array  # lower bound of each distance over its limit; one, or one per knot (J,)
    # [m²], weight of the fractions' second differences along the knots; 0 for none
    roughness: float = 0.0
    fixed: NDArray[np.bool_] | None = None  # (J,), mask of knots whose legs equal the reference
    # one or (J, clasps) [rad], of the legs out of their plane; None for none
    roll: Array | float | None = None

    @classmethod
    def at_rest(
        cls,
        team: Team,
        polygon: Outline,
        reference: Array,
        requirements: Requirements,
        margin: float,
        roll: Array | None = None,
    ) -> LegTask:
        """Return the task of one polygon and reference (n,), with LIMIT_MARGIN for short legs."""
        one, shortest = (polygon.vertices[None], reference[None]), requirements.limits.leg
        return cls(team, requirements, *one, LIMIT_MARGIN * shortest, margin, roll=roll)

    @property
    def level(self) -> bool:
        """Whether all legs are horizontal: without weight and roll."""
        return not self.team.loaded and (self.roll is None or not np.any(self.roll))

    @cached_property
    def margins(self) -> Array:
        """(3, J): margin of every knot, by kind of pair."""
        each = np.broadcast_to(np.asarray(self.margin, dtype=np.float64), len(self.reference))
        return np.stack([each, each, np.minimum(each, CROSSING_MARGIN)])

    @cached_property
    def largest_margin(self) -> float:
        """The largest of all margins."""
        return float(np.max(self.margins))

    @cached_property
    def slack(self) -> Array:
        """(J, n) [m]: slack of each cable for its two legs."""
        return cable_slack_of(self.team, self.team.layout.edges(self.polygons))

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """The smallest and largest ``d`` (J, n) with which both legs are long enough.

        They are equal at the ends of a chain, where a cable has only one leg.
        """
        slack, layout = self.slack, self.team.layout
        shortest = np.minimum(self.shortest_leg, 0.5 * slack)
        lower = layout.q_legs_of(shortest, slack)
        upper = layout.q_legs_of(slack - shortest, slack)
        if self.fixed is not None:
            lower[self.fixed] = upper[self.fixed] = self.reference[self.fixed]
        return lower, upper

    def split(self, *, first: bool = False) -> LegLengths:
        """Return the leg lengths nearest to the reference that keep the margin, else the best ones.

        The search is local. It starts from the reference and, if that fails on a single polygon,
        also from a few uneven splits. Its cost is linear in J·n. With ``first`` it ends at the
        first lengths that keep the margin, which is much faster.
        """
        bodies = LegBodies(self, (*self.bounds, np.clip(self.reference, *self.bounds)))
        best = bodies.reference_kept() or bodies.refined(self.reference, first)
        if len(self.reference) > 1 or (self._kept_by(best) and (first or best.deviation <= 1e-12)):
            return best
        for fractions in self._uneven_fractions:
            split = bodies.refined(fractions * self.slack, first)
            if self.merit(split) < (1.0 - MIN_GAIN) * self.merit(best):
                best = split
            if first and self._kept_by(best):
                break
        return best

    def reference_margin(self) -> float:
        """Return the smallest margin of the reference; infinite if all pairs are far apart."""
        return float(np.min(self.reference_margins()))

    def reference_margins(self) -> Array:
        """Return the smallest margin (J,) of the reference on every polygon."""
        bodies = LegBodies(self, (self.reference,))
        return bodies.margins(bodies.offsets(bodies.ends[-1]))

    @property
    def _uneven_fractions(self) -> Array:
        """Fractions (4 or 6, n): equal ones, or alternating ones from the sharpest clasp on.

        Counting from there makes them independent of numbering and mirroring.
        """
        layout = self.team.layout
        along = unit(layout.edges(self.polygons[0]))
        cosines = dot(along[layout.ahead], along[layout.behind])
        sharpest = layout.clasps[int(first_smallest(cosines, 1.0))]
        k = np.arange(layout.robots)
        onward = (k - sharpest) % layout.robots % 2 == 0
        back = (sharpest - 1 - k) % layout.robots % 2 == 1
        equal = np.ones_like(onward)
        return np.unique(np.where([equal, ~equal, onward, ~onward, back, ~back], 0.3, 0.7), axis=0)

    def _kept_by(self, split: LegLengths) -> bool:
        return split.margin >= self.largest_margin * (1.0 - 1e-9)

    def merit(self, split: LegLengths) -> float:
        """Return the penalized deviation [m²], which repeated approximation decreases."""
        deficit = max(0.0, self.largest_margin - split.margin)
        penalty = PENALTY * self.team.robots * (deficit if deficit > 1e-7 else 0.0)
        return penalty + 0.5 * split.deviation

    def split_with_least_roll(self) -> tuple[LegLengths, Array | float]:
        """Return leg lengths on one polygon and their roll [rad].

        The task's initial roll, or none, applies if the limits hold with it. Otherwise the smallest
        candidate applies that keeps the task's margin, or else the limits, with the reference
        lengths or others; without such a candidate, the initial roll. Candidates have the sign of
        the initial roll, positive without one.
        """
        initial = 0.0 if self.roll is None else self.roll
        split = self.split()
        if split.margin >= 1.0:
            return split, initial
        sign = -1.0 if np.sum(initial) < 0.0 else 1.0
        for margin in dict.fromkeys((self.largest_margin, LIMIT_MARGIN)):
            subtask = replace(self, margin=margin)
            of_reference = subtask.least_roll(sign)
            scaled = None if of_reference is None else (RESPLIT_RATIO * abs(of_reference),)
            candidates = scaled or RESPLIT_CANDIDATES
            of_split = subtask.least_roll(sign, _margin_near_reference, candidates, 3)
            roll = of_reference if of_split is None else of_split
            if roll is not None:
                return replace(subtask, roll=roll).split(), roll
        return split, initial

    def least_roll(
        self,
        sign: float = 1.0,
        margin_of: Callable[[LegTask], float] = reference_margin,
        candidates: tuple[float, ...] = ROLL_CANDIDATES,
        bisections: int = 7,
    ) -> float | None:
        """Return the smallest roll [rad] of the search that keeps the task's margins, or None.

        It is the first sufficient candidate, refined by bisection down to the one before. Rolls
        with which clasps have no balance do not suffice.
        """

        def suffices(angle: float) -> bool:
            try:
                rolled = replace(self, roll=sign * angle)
                return margin_of(rolled) >= self.largest_margin * (1.0 - 5e-7)
            except InfeasibleError:
                return False

        upper = next((angle for angle in candidates if suffices(angle)), None)
        if upper is None:
            return None
        lower = max((angle for angle in candidates if angle < upper), default=0.0)
        for _ in range(bisections):
            middle = 0.5 * (lower + upper)
            lower, upper = (lower, middle) if suffices(middle) else (middle, upper)
        return sign * upper

    def hessian(self, size: int) -> sp.csc_array[np.float64]:
        """Return the Hessian of half the sum of squared lengths and of the fractions' roughness."""
        import scipy.sparse as sp

        squares = np.append(np.ones(size - 2), [0.0, 0.0])
        diagonal = sp.csc_array((squares, np.arange(size), np.arange(size + 1)), shape=(size, size))
        J, n = self.reference.shape
        if self.roughness == 0.0 or J < 3:
            return diagonal
        second = sp.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(J - 2, J))
        fractions = sp.diags_array(1.0 / self.slack.reshape(-1))
        bend = sp.kron(second, sp.eye_array(n)) @ fractions
        rough = sp.block_diag([self.roughness * (bend.T @ bend), sp.csc_array((2, 2))])
        return sp.csc_array(diagonal + rough)


def _margin_near_reference(task: LegTask) -> float:
    """Return the margin of the leg lengths found from the reference, at most the task's."""
    bodies = LegBodies(task, (*task.bounds, np.clip(task.reference, *task.bounds)))
    return bodies.refined(task.reference, first=True).margin


@dataclass(frozen=True, eq=False)
class LegBodies:
    """Nodes and pairs of a task, flat over its J polygons.

    Horizontal legs need two coordinates; others need three, with heights scaled by kind of pair.
    The directions of heavy legs depend on the leg lengths at which they are evaluated. Pairs that
    are never close for leg lengths between the given ones (J, n) are omitted; the last ones are the
    initial guess.
    """

    task: LegTask
    lengths: tuple[Array, ...]

    @cached_property
    def ends(self) -> Array:
        """(lengths, J·count, 2 or 3) [m]: positions of the nodes at the given lengths."""
        return self.nodes(np.stack(self.lengths))

    @cached_property
    def points(self) -> Array:
        """(J, points, 2 or 3) [m]: of the polygons."""
        points = np.zeros((*self.task.polygons.shape[:2], 2 if self.task.level else 3))
        points[..., :2] = self.task.polygons
        return points

    @cached_property
    def edges(self) -> Array:
        """(J, n, 2 or 3): unit vectors along the edges."""
        return unit(self.task.team.layout.edges(self.points))

    @cached_property
    def variable(self) -> Indices:
        """(J, count): index of the leg length with which each node slides, points, then drones."""
        J, n = self.task.reference.shape
        cable = np.append(np.zeros(self.points.shape[1], np.intp), np.repeat(np.arange(n), 2))
        variable: Indices = n * np.arange(J)[:, None] + cable
        return variable

    @property
    def drones(self) -> Indices:
        """(J·2n,): the nodes that are drones."""
        nodes = np.arange(self.variable.size).reshape(self.variable.shape)
        return nodes[:, self.points.shape[1] :].reshape(-1)

    @cached_property
    def pairs(self) -> tuple[Indices, Indices, Indices, Indices]:
        """Polygon (pairs,), nodes of both bodies (pairs, 2) each, and kind (pairs,)."""
        task, (J, count) = self.task, self.variable.shape
        bodies, limits = TautBodies.of(task.team.layout), limits_of(task.requirements.separation)
        # Distances in plan view are lower bounds.
        swept = self.ends[..., :2].reshape(-1, J, count, 2)[:, :, bodies.nodes]
        # Pairs beyond the cutoff always have their margin.
        cutoff = max(task.largest_margin, 1.0) * float(np.max(limits)) * (1.0 + 1e-9)
        cutoff += MAX_WEIGHT_SHIFT if task.team.cable_density > 0.0 else 0.0
        near = bodies.near(np.min(swept, axis=(0, 3)), np.max(swept, axis=(0, 3)), limits, cutoff)
        if task.fixed is not None:  # fixed knots cannot change
            near = near[:, ~task.fixed[near[0]]]
        frame, i, j, kind = near
        first, second = (bodies.nodes[each] + count * frame[:, None] for each in (i, j))
        return frame, first, second, kind

    @cached_property
    def _fixed(self) -> tuple[Array, Array] | None:
        return None if self.task.team.cable_density > 0.0 else self._lines(self.task.reference)

    def lines(self, d: Array) -> tuple[Array, Array]:
        """Return base points [m] and slopes (…, J·count, 2 or 3) of the lines of sliding nodes.

        Nodes are ``base + slope d``; heavy legs have their directions at lengths d (…, J, n) [m].
        """
        return self._fixed or self._lines(d)

    def _lines(self, d: Array) -> tuple[Array, Array]:
        task, team, layout = self.task, self.task.team, self.task.team.layout
        slack, shape = task.slack, d.shape[:-2]
        points = np.broadcast_to(self.points, (*shape, *self.points.shape))
        edges = np.broadcast_to(self.edges, (*shape, *self.edges.shape))
        loads = None if task.level else clasp_loads(team, d, slack, task.roll)
        to_q, to_r = leg_directions(edges, team.tension, team.topology, loads)
        if team.cable_density > 0.0:  # chords of sagging legs, per length of cable
            sag = sag_factors(team, team.tension)
            to_q = leg_vectors(np.ones_like(d), to_q, sag * d**2)
            r_legs = slack - d
            to_r = leg_vectors(np.ones_like(r_legs), to_r, sag * r_legs**2)
        ends = points[..., layout.starts, :], points[..., layout.ends, :] + slack[..., None] * to_r
        return self._flat(points, ends), self._flat(np.zeros_like(points), (to_q, -to_r))

    @staticmethod
    def _flat(points: Array, drones: Sequence[Array]) -> Array:
        """Return values of points (…, J, points, k), then of both drones of cables (…, J, n, k)."""
        shape = (*points.shape[:-2], -1, points.shape[-1])
        nodes = np.concatenate([points, np.stack(drones, axis=-2).reshape(shape)], axis=-2)
        return nodes.reshape(*shape[:-3], -1, shape[-1])

    def nodes(self, d: Array) -> Array:
        """Return the positions (…, J·count, 2 or 3) [m] of the nodes at lengths d (…, J, n) [m]."""
        base, slope = self.lines(d)
        lengths = d.reshape(*d.shape[:-2], -1)[..., self.variable.reshape(-1)]
        nodes: Array = base + slope * lengths[..., None]
        return nodes

    def offsets(self, nodes: Array) -> Array:
        """Return the shortest vectors (pairs, 2 or 3) [m], heights scaled, to the first bodies."""
        _, first, second, kind = self.pairs
        between = differences(nodes[first], nodes[second])
        scale = scales_of(self.task.requirements)[:, : nodes.shape[-1]]
        return shortest_offset(between * scale[kind][:, None])

    def margins(self, offsets: Array) -> Array:
        """Return the minimum distance over its limit (J,), relative to the margins of the knots.

        Crossings at their margin do not count.

        Parameters
        ----------
        offsets: (pairs, 2 or 3) [m], of all pairs, heights scaled.
        """
        task, (frame, _, _, kind) = self.task, self.pairs
        limits = limits_of(task.requirements.separation)[kind]
        ratios = length(offsets) / limits
        crossing_margins = task.margins[CROSSING, frame] * (1.0 - 1e-9)
        inactive = (kind == CROSSING) & (ratios >= crossing_margins)
        relative = np.where(inactive, np.inf, ratios) / task.margins[SEPARATION, frame]
        smallest = np.full(len(self.points), np.inf)
        np.minimum.at(smallest, frame, relative)
        return task.largest_margin * smallest

    def program(self, d: Array, nodes: Array, offsets: Array) -> QuadraticProgram:
        """Return the convex QP around ``d``; variables are d, then two slacks of the margins.

        For a pair of bodies and any unit vector ν, the smallest ``ν·(a - b)`` over their ends is a
        lower bound of their distance and linear in ``d``. It is exact at the current leg lengths,
        from which ν is computed. One slack belongs to the distances of drones, the other one to
        crossings and walls, so that infeasible crossings or walls leave the distances of drones
        determined.

        Parameters
        ----------
        d: (J, n) [m], leg lengths.
        nodes, offsets: (J·count, 2 or 3) and (pairs, 2 or 3) [m], at these lengths.
        """
        task, size = self.task, d.size + 2
        lines = self.lines(d)
        rows = Rows(size)
        self._add_pairs(rows, lines, nodes, offsets)
        if task.requirements.arena is not None:
            self._add_walls(rows, lines, task.requirements.arena)
        lowest, highest = task.bounds
        lower = np.append(lowest.reshape(-1), [0.0, 0.0])
        upper = np.append(highest.reshape(-1), [np.inf, np.inf])
        penalty = np.full(2, PENALTY * task.team.robots)
        gradient = np.append(-task.reference.reshape(-1), penalty)
        return QuadraticProgram(task.hessian(size), gradient, *rows.compressed(), lower, upper)

    def _add_pairs(
        self, rows: Rows, lines: tuple[Array, Array], nodes: Array, offsets: Array
    ) -> None:
        """Add the rows of pairs of bodies, with a slack for drones and one for crossings."""
        task, variable, (base, slope) = self.task, self.variable.reshape(-1), lines
        size, dimensions = rows.variables, self.points.shape[-1]
        frame, first, second, kind = self.pairs
        middles = nodes[first].mean(axis=1) - nodes[second].mean(axis=1)
        normal = unit(offsets, unit(middles, EAST[:dimensions]), 1e-9)
        pair, a, b = end_combinations(kind, first, second)
        kind = kind[pair]
        limit = limits_of(task.requirements.separation)[kind]
        nu = normal[pair] * scales_of(task.requirements)[kind, :dimensions]
        slacks = np.where(kind == CROSSING, size - 1, size - 2)
        # Slightly more than required, to allow for rounding.
        required = task.margins[kind, frame[pair]] * (1.0 + 1e-7) * limit
        lower = required - np.sum(nu * (base[a] - base[b]), axis=1)
        columns = np.stack([variable[a], variable[b]])
        slopes = np.stack([np.sum(nu * slope[a], axis=1), -np.sum(nu * slope[b], axis=1)])
        # Rows that hold for all lengths within the bounds are omitted.
        extremes = [slopes * bound.reshape(-1)[columns] for bound in task.bounds]
        used = np.sum(np.minimum(*extremes), axis=0) < lower
        columns = np.concatenate([columns[:, used].ravel(), slacks[used]])
        entries = np.concatenate([slopes[:, used].ravel(), limit[used]])
        rows.add(np.tile(np.arange(len(lower[used])), 3), columns, entries, lower[used])

    def _add_walls(self, rows: Rows, lines: tuple[Array, Array], arena: Arena) -> None:
        """Add the rows of drones between the upright walls, with the slack of crossings."""
        base, slope = (values[self.drones, :2] for values in lines)
        entries = np.concatenate([slope, -slope], axis=1).T.ravel()
        beyond = np.concatenate([arena.lower[:2] - base, base - arena.upper[:2]], axis=1)
        lower = beyond.T.ravel()
        # Drones that slide parallel to a wall are omitted: their distance to it is constant.
        oblique = np.abs(entries) > 1e-9
        columns = np.tile(self.variable.reshape(-1)[self.drones], 4)[oblique]
        row = np.arange(len(columns))
        start = rows.add(row, columns, entries[oblique], lower[oblique])
        rows.extend(start + row, np.full(len(row), rows.variables - 1), 1.0)

    def reference_kept(self) -> LegLengths | None:
        """Return the reference if it keeps the margin and exactly all bounds, else None."""
        task, arena = self.task, self.task.requirements.arena
        start, nodes = self.lengths[-1], self.ends[-1]
        if task.roughness > 0.0 or not np.array_equal(start, task.reference):
            return None
        margin, drones = float(np.min(self.margins(self.offsets(nodes)))), nodes[self.drones, :2]
        if margin < task.largest_margin or (
            arena and np.any((drones < arena.lower[:2]) | (drones > arena.upper[:2]))
        ):
            return None
        return LegLengths(start, margin, 0.0)

    def refined(self, start: Array, first: bool) -> LegLengths:
        """Return the limit of repeated convex approximation from ``start``.

        With ``first`` return the first iterate that keeps the margin. The repetition ends if it
        cycles: if steps are not small, and the merit has not improved for several iterations.
        """
        task = self.task
        enough = task.largest_margin * (1.0 - 1e-9)
        tolerance = COARSE_STEP_TOLERANCE if first else STEP_TOLERANCE
        d = np.clip(start, *task.bounds)
        nodes = self.nodes(d)
        offsets = self.offsets(nodes)
        split = self._split(d, offsets)
        best, since_best = math.inf, 0
        for _ in range(MAX_POLYGON_ITERATIONS if len(d) == 1 else MAX_PATH_ITERATIONS):
            check_time()
            x = solve_qp(self.program(d, nodes, offsets))
            if x is None:
                break
            before, d = d, x[: d.size].reshape(d.shape)
            nodes = self.nodes(d)
            offsets = self.offsets(nodes)
            split = self._split(d, offsets)
            step = float(np.max(np.abs(d - before)))
            if step < tolerance or (first and split.margin >= enough):
                break
            merit = task.merit(split)
            since_best = 0 if merit < (1.0 - MIN_GAIN) * best else since_best + 1
            best = min(best, merit)
            if since_best >= MAX_CYCLE and (first or step > CYCLE_STEP):
                break
        return split

    def _split(self, d: Array, offsets: Array) -> LegLengths:
        """Return leg lengths (J, n) [m] with their margin and deviation."""
        deviation = float(np.sum((d - self.task.reference) ** 2))
        return LegLengths(d, float(np.min(self.margins(offsets))), deviation)
