"""The slack split: leg lengths of every cable that separate drones and cables.

On a given polygon every drone slides along a fixed line, so positions are affine in ``d``. Linear
lower bounds of distances then give a convex QP, an inner approximation: true distances are at least
its bounds. In repeated solutions the penalized deviation never increases (Marks and Wright 1978).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import check_time
from hitchopt.geometry import Outline, differences, shortest_offset
from hitchopt.geometry.vectors import EAST, dot, first_smallest, length, unit
from hitchopt.hitch.forces import (
    cable_slack_of,
    clasp_loads,
    leg_directions,
    leg_vectors,
    weight_ratios,
)
from hitchopt.hitch.pairs import (
    CABLE,
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

MARGIN_ROUNDING = 1e-9  # Relative rounding of margins: one that misses its bound by less is reached

PROGRAM_RESERVE = 1e-7
"""Reserve of margins in programs, which allows for their residuals: relative to a margin, and the
largest deficit that counts as none."""

PENALTY = 1e3
"""[m²] Penalty weight per robot and unit of margin: distances have priority over deviation."""

MAX_WEIGHT_SHIFT = 0.02  # [m] Largest lateral shift of drones as the weight of their legs changes

MAX_POLYGON_ITERATIONS = 60
"""Maximum number of convex programs from one initial guess on one polygon."""

MAX_PATH_ITERATIONS = 20
"""Maximum number of convex programs along a path, which converges within ten iterations or not at
all."""

MIN_GAIN = 1e-6  # Smallest relative improvement of merit; mirror images differ by less
STEP_TOLERANCE = 1e-9  # [m] Largest change of a leg in the last iteration

COARSE_STEP_TOLERANCE = 1e-5
"""[m] The same if the first split with the margin suffices, since smaller steps do not increase the
margin noticeably."""

MAX_CYCLE = 4
"""Iterations without improvement of merit after which the search cycles. Horizontal legs that cross
each other make it cycle."""

CYCLE_STEP = 1e-3  # [m] Smallest step of a search that cycles
MIN_DEVIATION = 1e-12  # [m²] Deviation below which leg lengths equal their reference

UNEVEN_FRACTION = 0.3
"""Fraction of a cable's slack in one of its legs, where a search starts from uneven splits."""

MIN_OFFSET = 1e-9
"""[m] Distance of two bodies below which they touch: the offset of their middles then separates
them."""

MIN_SLOPE = 1e-9
"""Smallest slope, along the normal of a wall, of drones that do not slide parallel to the wall."""


@dataclass(frozen=True, eq=False)
class LegLengths:
    """Leg lengths with their quality."""

    q_legs: Array  # (J, n) [m], ``d``
    margin: float  # Smallest margin of all distances
    deviation: float  # ``Σ (d - reference)²`` [m²]


@dataclass(frozen=True, eq=False)
class LegTask:
    """A problem for the leg lengths of a team on J polygons: one, or the knots of a path."""

    team: Team  # The team, with the cables to be split
    requirements: Requirements  # Distances, and the arena
    polygons: Array  # (J, points, 2) [m]
    reference: Array  # (J, n) [m], ``d`` whose deviation is minimised
    shortest_leg: float  # [m], for both legs of every cable
    margin: float | Array  # Lower bound of each distance over its limit; one, or one per knot (J,)
    # [m²], weight of the fractions' second differences along the knots; 0 for none
    roughness: float = 0.0
    fixed: NDArray[np.bool_] | None = None  # (J,), mask of knots whose legs equal the reference
    # One or (J, clasps) [rad], of the legs out of their plane; None if there is none
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
        return cls(
            team,
            requirements,
            polygons=polygon.vertices[None],
            reference=reference[None],
            shortest_leg=LIMIT_MARGIN * requirements.limits.leg,
            margin=margin,
            roll=roll,
        )

    @property
    def level(self) -> bool:
        """Return whether all legs are horizontal: without weight and roll."""
        return not self.team.loaded and (self.roll is None or not np.any(self.roll))

    @cached_property
    def margins(self) -> Array:
        """(3, J): margin of every knot, by kind of pair."""
        margin = np.asarray(self.margin, dtype=np.float64)
        of_knots = np.broadcast_to(margin, len(self.reference))
        margins = np.empty((3, len(of_knots)))
        margins[SEPARATION] = of_knots
        margins[CABLE] = of_knots
        margins[CROSSING] = np.minimum(of_knots, CROSSING_MARGIN)
        return margins

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
        layout = self.team.layout
        shortest = np.minimum(self.shortest_leg, 0.5 * self.slack)
        lower = layout.q_legs_of(shortest, self.slack)
        upper = layout.q_legs_of(self.slack - shortest, self.slack)
        if self.fixed is not None:
            lower[self.fixed] = self.reference[self.fixed]
            upper[self.fixed] = self.reference[self.fixed]
        return lower, upper

    def split(self, *, first: bool = False) -> LegLengths:
        """Return the leg lengths nearest to the reference that keep the margin, or the best ones.

        The search is local. It starts from the reference and, if that fails on a single polygon,
        also from a few uneven splits. Its cost is linear in J·n. With ``first`` it ends at the
        first lengths that keep the margin, which is much faster.
        """
        bodies = LegBodies.within_bounds(self)
        best = bodies.reference_kept() or bodies.refined(self.reference, first)
        along_path = len(self.reference) > 1
        if along_path:
            return best
        is_reference = best.deviation <= MIN_DEVIATION
        if self.kept_by(best) and (first or is_reference):
            return best
        for fractions in self._uneven_fractions:
            split = bodies.refined(fractions * self.slack, first)
            if self.merit(split) < (1.0 - MIN_GAIN) * self.merit(best):
                best = split
            if first and self.kept_by(best):
                break
        return best

    def margin_near_reference(self) -> float:
        """Return the margin of the leg lengths found from the reference, at most the task's."""
        return LegBodies.within_bounds(self).refined(self.reference, first=True).margin

    def reference_margin(self) -> float:
        """Return the smallest margin of the reference; infinite if all pairs are far apart."""
        return float(np.min(self.reference_margins()))

    def reference_margins(self) -> Array:
        """Return the smallest margin (J,) of the reference on every polygon."""
        bodies = LegBodies(self, self.reference)
        return bodies.margins(bodies.offsets(bodies.start_nodes))

    @property
    def _uneven_fractions(self) -> Array:
        """Fractions (4 or 6, n): equal ones, or alternating ones starting at the sharpest clasp.

        Counting from there makes them independent of numbering and mirroring.
        """
        layout = self.team.layout
        edges = unit(layout.edges(self.polygons[0]))
        cosines = dot(edges[layout.ahead], edges[layout.behind])
        sharpest = layout.clasps[int(first_smallest(cosines, 1.0))]
        cables = np.arange(layout.robots)
        steps_ahead = (cables - sharpest) % layout.robots
        steps_behind = (sharpest - 1 - cables) % layout.robots
        onward = steps_ahead % 2 == 0
        back = steps_behind % 2 == 1
        equal = np.ones_like(onward)
        has_short_q_leg = [equal, ~equal, onward, ~onward, back, ~back]
        fractions = np.where(has_short_q_leg, UNEVEN_FRACTION, 1.0 - UNEVEN_FRACTION)
        return np.unique(fractions, axis=0)

    def kept_by(self, split: LegLengths) -> bool:
        """Return whether leg lengths keep all margins."""
        return split.margin >= self.largest_margin * (1.0 - MARGIN_ROUNDING)

    def merit(self, split: LegLengths) -> float:
        """Return the penalized deviation [m²], which repeated approximation decreases."""
        deficit = max(0.0, self.largest_margin - split.margin)
        if deficit <= PROGRAM_RESERVE:
            deficit = 0.0
        penalty = PENALTY * self.team.robots * deficit
        return penalty + 0.5 * split.deviation

    def hessian(self, size: int) -> sp.csc_array[np.float64]:
        """Return the Hessian of half the sum of squared lengths and of the fractions' roughness.

        The last two of ``size`` variables are slacks, which do not enter.
        """
        import scipy.sparse as sp

        # A diagonal also in the rows of the slacks keeps the pattern of entries.
        diagonal = np.append(np.ones(size - 2), [0.0, 0.0])
        deviation = sp.csc_array(
            (diagonal, np.arange(size), np.arange(size + 1)), shape=(size, size)
        )
        J, n = self.reference.shape
        if self.roughness == 0.0 or J < 3:
            return deviation
        second_difference = sp.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(J - 2, J))
        fractions = sp.diags_array(1.0 / self.slack.reshape(-1))
        bend = sp.kron(second_difference, sp.eye_array(n)) @ fractions
        of_slacks = sp.csc_array((2, 2))
        roughness = sp.block_diag([self.roughness * (bend.T @ bend), of_slacks])
        return sp.csc_array(deviation + roughness)


class Lines(NamedTuple):
    """Lines on which nodes slide: ``base + slope d``."""

    base: Array  # (…, J·count, 2 or 3) [m]
    slope: Array  # (…, J·count, 2 or 3)


class BodyPairs(NamedTuple):
    """Pairs of bodies that may be close."""

    polygon: Indices  # (pairs,), index of their polygon
    first: Indices  # (pairs, 2), nodes at the ends of the first bodies
    second: Indices  # (pairs, 2), nodes at the ends of the second bodies
    kind: Indices  # (pairs,), kind of pair


@dataclass(frozen=True, eq=False)
class Iterate:
    """Leg lengths of an iteration, with the nodes and distances at these lengths."""

    split: LegLengths  # The leg lengths
    nodes: Array  # (J·count, 2 or 3) [m], positions
    # (pairs, 2 or 3) [m], shortest vectors between the bodies of pairs, heights scaled
    offsets: Array


@dataclass(frozen=True, eq=False)
class LegBodies:
    """Nodes and pairs of a task, flat over its J polygons.

    Horizontal legs need two coordinates; others need three, with heights scaled by kind of pair.
    The directions of heavy legs depend on the leg lengths at which they are evaluated. Pairs that
    are never close for leg lengths between ``start`` and the extremes are omitted.
    """

    task: LegTask  # The problem for the leg lengths
    start: Array  # (J, n) [m], leg lengths of the initial guess
    extremes: tuple[Array, ...] = ()  # (J, n) [m] each, extreme leg lengths

    @classmethod
    def within_bounds(cls, task: LegTask) -> LegBodies:
        """Return the bodies for all admissible lengths, with the reference as initial guess."""
        return cls(task, np.clip(task.reference, *task.bounds), task.bounds)

    @cached_property
    def swept_nodes(self) -> Array:
        """(lengths, J·count, 2 or 3) [m]: positions at the extremes, then at the start."""
        return self.nodes(np.stack([*self.extremes, self.start]))

    @property
    def start_nodes(self) -> Array:
        """(J·count, 2 or 3) [m]: positions of the nodes at the start."""
        start_nodes: Array = self.swept_nodes[-1]
        return start_nodes

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
        # Points do not slide: any variable will do.
        cable_of_point = np.zeros(self.points.shape[1], np.intp)
        cable_of_drone = np.repeat(np.arange(n), 2)
        first_variable = n * np.arange(J)[:, None]
        variable: Indices = first_variable + np.append(cable_of_point, cable_of_drone)
        return variable

    @property
    def drones(self) -> Indices:
        """(J·2n,): the nodes that are drones."""
        nodes = np.arange(self.variable.size).reshape(self.variable.shape)
        return nodes[:, self.points.shape[1] :].reshape(-1)

    @cached_property
    def pairs(self) -> BodyPairs:
        """Pairs that may be closer than their margin."""
        task = self.task
        J, count = self.variable.shape
        bodies = TautBodies.of(task.team.layout)
        limits = limits_of(task.requirements.separation)
        # Distances in plan view are lower bounds.
        plan_view = self.swept_nodes[..., :2].reshape(-1, J, count, 2)
        body_ends = plan_view[:, :, bodies.nodes]  # (lengths, J, bodies, 2, 2)
        lowest = np.min(body_ends, axis=(0, 3))
        highest = np.max(body_ends, axis=(0, 3))
        # Pairs beyond the cutoff always have their margin.
        cutoff = max(task.largest_margin, 1.0) * float(np.max(limits)) * (1.0 + 1e-9)
        if task.team.cable_density > 0.0:
            cutoff += MAX_WEIGHT_SHIFT
        near = bodies.near(lowest, highest, limits, cutoff)
        if task.fixed is not None:  # fixed knots cannot change
            near = near[:, ~task.fixed[near[0]]]
        polygon, first_body, second_body, kind = near
        first_node = count * polygon[:, None]
        return BodyPairs(
            polygon,
            first=bodies.nodes[first_body] + first_node,
            second=bodies.nodes[second_body] + first_node,
            kind=kind,
        )

    def lines(self, q_legs: Array) -> Lines:
        """Return the lines of the nodes; heavy legs have their sag at lengths (…, J, n)."""
        if self.task.team.cable_density > 0.0:
            return self._lines_at(q_legs)
        return self._constant_lines

    @cached_property
    def _constant_lines(self) -> Lines:
        """Lines of the nodes on weightless legs."""
        return self._lines_at(self.task.reference)

    @cached_property
    def _leg_directions(self) -> Array:
        """(2, J, n, 2 or 3): directions of q- and of r-legs at their points."""
        task = self.task
        team = task.team
        loads = None if task.level else clasp_loads(team, task.slack, task.roll)
        return np.stack(leg_directions(self.edges, team.tension, team.topology, loads))

    def _lines_at(self, q_legs: Array) -> Lines:
        """Return the lines of the nodes, with the sag of legs at lengths (…, J, n) [m]."""
        task = self.task
        team = task.team
        layout = team.layout
        leading = q_legs.shape[:-2]
        points = np.broadcast_to(self.points, (*leading, *self.points.shape))
        directions = self._leg_directions
        to_q, to_r = np.broadcast_to(
            directions[(slice(None), *[None] * len(leading))],
            (2, *leading, *directions.shape[1:]),
        )
        if team.cable_density > 0.0:  # chords of sagging legs, per length of cable
            lengths = np.stack([q_legs, task.slack - q_legs])
            ratios = weight_ratios(team, team.tension) * lengths
            to_q, to_r = leg_vectors(np.ones_like(lengths), np.stack([to_q, to_r]), ratios)
        q_base = points[..., layout.starts, :]
        r_base = points[..., layout.ends, :] + task.slack[..., None] * to_r
        return Lines(
            base=self._flat(points, q_base, r_base),
            slope=self._flat(np.zeros_like(points), to_q, -to_r),
        )

    @staticmethod
    def _flat(points: Array, q: Array, r: Array) -> Array:
        """Return values of points (…, J, points, k), then of both drones of cables (…, J, n, k)."""
        *leading, _, coordinates = points.shape
        drones = np.stack([q, r], axis=-2).reshape(*leading, -1, coordinates)
        nodes = np.concatenate([points, drones], axis=-2)
        return nodes.reshape(*leading[:-1], -1, coordinates)

    def nodes(self, q_legs: Array) -> Array:
        """Return the positions (…, J·count, 2 or 3) [m] of the nodes at lengths (…, J, n) [m]."""
        lines = self.lines(q_legs)
        flat_q_legs = q_legs.reshape(*q_legs.shape[:-2], -1)
        lengths = flat_q_legs[..., self.variable.reshape(-1)]
        nodes: Array = lines.base + lines.slope * lengths[..., None]
        return nodes

    def offsets(self, nodes: Array) -> Array:
        """Return the shortest vectors (pairs, 2 or 3) [m], heights scaled, to the first bodies."""
        pairs = self.pairs
        between = differences(nodes[pairs.first], nodes[pairs.second])
        scales = scales_of(self.task.requirements)[pairs.kind, : nodes.shape[-1]]
        return shortest_offset(between * scales[:, None])

    def margins(self, offsets: Array) -> Array:
        """Return the minimum distance over its limit (J,), relative to the margins of the knots.

        Crossings at their margin are ignored.

        Parameters
        ----------
        offsets: (pairs, 2 or 3) [m], of all pairs, heights scaled.
        """
        task = self.task
        polygon = self.pairs.polygon
        kind = self.pairs.kind
        ratios = length(offsets) / limits_of(task.requirements.separation)[kind]
        crossing_margins = task.margins[CROSSING, polygon] * (1.0 - MARGIN_ROUNDING)
        inactive = (kind == CROSSING) & (ratios >= crossing_margins)
        relative = np.where(inactive, np.inf, ratios) / task.margins[SEPARATION, polygon]
        smallest = np.full(len(self.points), np.inf)
        np.minimum.at(smallest, polygon, relative)
        return task.largest_margin * smallest

    def iterate(self, q_legs: Array) -> Iterate:
        """Return the iterate of leg lengths (J, n) [m]."""
        nodes = self.nodes(q_legs)
        offsets = self.offsets(nodes)
        margin = float(np.min(self.margins(offsets)))
        deviation = float(np.sum((q_legs - self.task.reference) ** 2))
        return Iterate(LegLengths(q_legs, margin, deviation), nodes, offsets)

    def program(self, iterate: Iterate) -> QuadraticProgram:
        """Return the convex QP around leg lengths; variables are d, then two slacks of the margins.

        For a pair of bodies and any unit vector ν, the smallest ``ν·(a - b)`` over their ends is a
        lower bound of their distance and linear in ``d``. It is exact at the current leg lengths,
        from which ν is computed. One slack belongs to the distances of drones, the other one to
        crossings and walls, so that infeasible crossings or walls leave the distances of drones
        determined.
        """
        task = self.task
        q_legs = iterate.split.q_legs
        size = q_legs.size + 2
        lines = self.lines(q_legs)
        rows = Rows(size)
        self._add_pairs(rows, lines, iterate)
        if task.requirements.arena is not None:
            self._add_walls(rows, lines, task.requirements.arena)
        A, lower, upper = rows.compressed()
        shortest, longest = task.bounds
        penalty = PENALTY * task.team.robots
        return QuadraticProgram(
            P=task.hessian(size),
            q=np.append(-task.reference.reshape(-1), [penalty, penalty]),
            A=A,
            lower=lower,
            upper=upper,
            x_min=np.append(shortest.reshape(-1), [0.0, 0.0]),
            x_max=np.append(longest.reshape(-1), [np.inf, np.inf]),
        )

    def _add_pairs(self, rows: Rows, lines: Lines, iterate: Iterate) -> None:
        """Add the rows of pairs of bodies, with a slack for drones and one for crossings."""
        task = self.task
        pairs = self.pairs
        nodes = iterate.nodes
        variable = self.variable.reshape(-1)
        dimensions = self.points.shape[-1]
        middles = nodes[pairs.first].mean(axis=1) - nodes[pairs.second].mean(axis=1)
        normals = unit(iterate.offsets, unit(middles, EAST[:dimensions]), MIN_OFFSET)
        pair, first, second = end_combinations(pairs.kind, pairs.first, pairs.second)
        kind = pairs.kind[pair]
        limits = limits_of(task.requirements.separation)[kind]
        gradients = normals[pair] * scales_of(task.requirements)[kind, :dimensions]
        margins = task.margins[kind, pairs.polygon[pair]] * (1.0 + PROGRAM_RESERVE)
        base_distances = np.sum(gradients * (lines.base[first] - lines.base[second]), axis=1)
        lower = margins * limits - base_distances
        columns = np.stack([variable[first], variable[second]])
        first_slopes = np.sum(gradients * lines.slope[first], axis=1)
        second_slopes = -np.sum(gradients * lines.slope[second], axis=1)
        slopes = np.stack([first_slopes, second_slopes])
        # Rows that hold for all lengths within the bounds are omitted.
        shortest, longest = (bound.reshape(-1)[columns] for bound in task.bounds)
        smallest_changes = np.sum(np.minimum(slopes * shortest, slopes * longest), axis=0)
        used = smallest_changes < lower
        drone_slack = rows.variables - 2
        crossing_slack = rows.variables - 1
        slacks = np.where(kind == CROSSING, crossing_slack, drone_slack)
        rows.add(
            np.tile(np.arange(np.count_nonzero(used)), 3),
            np.concatenate([columns[:, used].ravel(), slacks[used]]),
            np.concatenate([slopes[:, used].ravel(), limits[used]]),
            lower[used],
        )

    def _add_walls(self, rows: Rows, lines: Lines, arena: Arena) -> None:
        """Add the rows of drones between the vertical walls, with the slack of crossings."""
        base = lines.base[self.drones, :2]
        slope = lines.slope[self.drones, :2]
        # By wall, then by drone: the slope toward the inside, and how far the base is outside
        slopes = np.concatenate([slope, -slope], axis=1).T.ravel()
        outside = np.concatenate([arena.lower[:2] - base, base - arena.upper[:2]], axis=1)
        lower = outside.T.ravel()
        variables = np.tile(self.variable.reshape(-1)[self.drones], 4)
        # Drones that slide parallel to a wall are omitted: their distance to it is constant.
        oblique = np.abs(slopes) > MIN_SLOPE
        row = np.arange(np.count_nonzero(oblique))
        start = rows.add(row, variables[oblique], slopes[oblique], lower[oblique])
        crossing_slack = rows.variables - 1
        rows.extend(start + row, np.full(len(row), crossing_slack), 1.0)

    def reference_kept(self) -> LegLengths | None:
        """Return the reference if it keeps the margin and exactly all bounds, else None."""
        task = self.task
        if task.roughness > 0.0 or not np.array_equal(self.start, task.reference):
            return None
        margin = float(np.min(self.margins(self.offsets(self.start_nodes))))
        if margin < task.largest_margin:
            return None
        arena = task.requirements.arena
        drones = self.start_nodes[self.drones, :2]
        if arena and np.any((drones < arena.lower[:2]) | (drones > arena.upper[:2])):
            return None
        return LegLengths(self.start, margin, 0.0)

    def refined(self, start: Array, first: bool) -> LegLengths:
        """Return the limit of repeated convex approximation from leg lengths (J, n) [m].

        With ``first`` return the first iterate that keeps the margin. The repetition ends if it
        cycles: if steps are not small, and the merit has not improved for several iterations.
        """
        task = self.task
        tolerance = COARSE_STEP_TOLERANCE if first else STEP_TOLERANCE
        max_iterations = MAX_POLYGON_ITERATIONS if len(start) == 1 else MAX_PATH_ITERATIONS
        current = self.iterate(np.clip(start, *task.bounds))
        best_merit = math.inf
        iterations_since_best = 0
        for _ in range(max_iterations):
            check_time()
            solution = solve_qp(self.program(current))
            if solution is None:
                break
            q_legs = current.split.q_legs
            new_q_legs = solution[: q_legs.size].reshape(q_legs.shape)
            step = float(np.max(np.abs(new_q_legs - q_legs)))
            current = self.iterate(new_q_legs)
            if step < tolerance or (first and task.kept_by(current.split)):
                break
            merit = task.merit(current.split)
            improved = merit < (1.0 - MIN_GAIN) * best_merit
            iterations_since_best = 0 if improved else iterations_since_best + 1
            best_merit = min(best_merit, merit)
            if iterations_since_best >= MAX_CYCLE and (first or step > CYCLE_STEP):
                break
        return current.split
