"""The quadratic program of a path around the current one: energy or time over linearised limits.

Variables are the changes of vertices, q-legs and tensions at the inner knots. Drones and r-legs
follow by casadi's exact derivatives of the model, evaluated at all robots and knots at once. The
objective is either the energy of the motion of all vertices and drones, which is quadratic, or the
duration within the limits of speed, acceleration, thrust and tilt, plus a custom cost. Rows
are sparse: the effort is linear in knots · n.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.sparse as sp

from hitchopt.errors import check_time
from hitchopt.geometry import differences, shortest_offset
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.casadi_model import CLASP_INPUTS, clasp_function
from hitchopt.hitch.pairs import TautBodies, end_combinations, limits_of, scales_of
from hitchopt.hitch.quadratic_program import QuadraticProgram, solve_qp
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import CLOSED, layout_of
from hitchopt.planners.morph.morph import exterior_angles
from hitchopt.planners.optimise.knots import (
    Effort,
    KnotPath,
    SearchLimits,
    SolverStep,
    variable_bounds,
)
from hitchopt.planners.optimise.times import (
    acceleration_rows,
    segment_times,
    speed_rows,
    step_times,
)
from hitchopt.values import Array, Indices

if TYPE_CHECKING:
    import casadi as ca

BEND_WEIGHT = 0.1
"""Weight of the knots' second differences in the energy, which keeps splines near their knots."""

TIME_BEND_WEIGHT = 0.02
"""[s] Weight of the second differences relative to the time, times the path's time at the speed
limits: bends cost more of a short flight, whose accelerations bound it."""

TIME_ENERGY_WEIGHT = 1e-3
"""Weight of the energy relative to the time, which makes the solution unique."""

TENSION_WEIGHT = 0.02
"""Weight of the squares of variable tensions, which leaves thrust for motion."""

TENSION_CHANGE_WEIGHT = 0.01
"""Weight of the tensions' differences relative to their squares."""

MAX_TIME_SAVED = 0.3
"""Largest decrease of a step's time in one program, over that time."""

MIN_ANGLE = math.radians(3.0)
"""[rad] Smallest exterior angle on the path, or half of that at its ends if that is less."""

PENALTY_WEIGHT = 100.0
"""[1/m] Penalty weight of violated rows, which exceeds any gain by violating them."""

SLACK_SCALE = 0.01
"""Unit of slacks, in strides, which scales the program."""

BETWEEN_KNOTS_SHARE = 0.2
"""Fraction of a step's reach up to which pairs have rows between the knots."""

NEAR_RANGE = 0.5
"""Distance to its bound, in strides, below which a row is enforced at first."""

ADDED_RANGE = 0.1
"""Distance to its bound, in strides, below which a row is added together with violated rows."""

ENTRY_COST = 0.012
"""Cost of an entry of a program's matrices, in the unit of ``Effort``, by regression."""

MIN_PROGRESS = 0.3
"""Motion of vertices in a step over its stride, below which the optimizer has converged."""


def iterates(
    path: KnotPath,
    search: SearchLimits,
    step: SolverStep,
    max_steps: int,
    progress: float = MIN_PROGRESS,
) -> Iterator[KnotPath]:
    """Yield the paths after each step of the optimizer.

    Every step has rows and normals of the pairs that are close on the current path. The iterator
    ends if a step fails, or moves vertices by less than ``progress`` times its stride, or if the
    search has spent its effort.
    """
    for _ in range(max_steps):
        check_time()
        moved = build_program(path, search, step).solve(search.effort)
        if moved is None:
            return
        distance = float(np.max(np.abs(moved.polygons - path.polygons)))
        if search.cost is not None:  # which may depend on legs alone
            distance = max(distance, float(np.max(np.abs(moved.q_legs - path.q_legs))))
        path = moved
        yield path
        if distance < progress * step.stride:
            return


@dataclass(frozen=True, eq=False)
class MorphProgram:
    """A quadratic program around a path.

    Its variables are, in strides, the changes of the free columns of the table at the inner knots,
    for the fastest path the changes of all steps' times, and a slack per row that the path
    violates.
    """

    path: KnotPath  # the current path
    stride: float  # [m]
    # (inner knots · size, changes): changes of the table's inner rows by the free columns'
    tangent: sp.csr_array[np.float64]
    program: QuadraticProgram

    def solve(self, effort: Effort) -> KnotPath | None:
        """Return the path of the solution, or None without one; drones follow by the model.

        Rows near their bounds are enforced at first, and others when they are violated.
        """
        program, rows = self.program, sp.csr_array(self.program.A)
        lower, upper = program.lower, program.upper
        enforced = np.minimum(-lower, upper) < NEAR_RANGE
        while True:
            A = sp.csc_array(rows[enforced])
            part = replace(program, A=A, lower=lower[enforced], upper=upper[enforced])
            if not effort.spend(ENTRY_COST * float(program.P.nnz + A.nnz)):
                return None
            x = solve_qp(part)
            if x is None:
                return None
            values = rows @ x
            excess = np.maximum(lower - values, values - upper)
            if not np.any(excess[~enforced] > 0.0):
                break
            enforced |= excess > -ADDED_RANGE
        table = self.path.table.copy()
        change = np.asarray(self.tangent @ x[: self.tangent.shape[1]])
        table[1:-1] += self.stride * change.reshape(len(table) - 2, -1)
        return self.path.with_table(table)


def build_program(path: KnotPath, search: SearchLimits, step: SolverStep) -> MorphProgram:
    """Return the program around a path, with near pairs and normals of that path."""
    team, inner = path.team, path.table[1:-1].ravel()
    derivatives, turns = _derivatives(path, search.tension is not None)
    tangent = derivatives[: inner.size]
    lower, upper = (each - inner for each in variable_bounds(path, search, step.stride))
    bounded = np.flatnonzero((np.diff(tangent.indptr) > 0) & ((lower > -np.inf) | (upper < np.inf)))
    smallest = float(np.min(exterior_angles(team.layout, path.edges[[0, -1]])))
    min_sine = math.sin(min(MIN_ANGLE, 0.5 * smallest))
    distances, needed = _near_rows(path, search, step)
    blocks = [tangent[bounded], derivatives[inner.size :], distances @ tangent]
    lower = np.concatenate([lower[bounded], min_sine - turns, needed])
    upper = np.append(upper[bounded], np.full(len(turns) + len(needed), np.inf))
    hessian, gradient = _energy(path, search, step.fastest)
    if step.fastest and search.cost is not None:
        terms = search.cost.terms(path)
        hessian, gradient = hessian + terms.hessian, gradient + terms.gradient
    costs = [np.asarray(tangent.T @ gradient)]
    extra: list[tuple[Indices, Indices, Array]] = []  # entries of other variables than changes
    limits, changes = search.requirements.limits, tangent.shape[1]
    smallest_changes = np.full(changes, -np.inf)
    if step.fastest:
        times = step_times(path, limits)
        for timed in (speed_rows(path, limits, times), acceleration_rows(path, limits, times)):
            blocks.append(timed.by_table(path) @ tangent)
            row, by_step, entry = timed.by_times(path.steps)
            extra.append((len(lower) + row, by_step, entry))
            lower = np.append(lower, np.full(len(timed.spare), -np.inf))
            upper = np.append(upper, timed.spare)
        smallest_changes = np.append(smallest_changes, -MAX_TIME_SAVED / step.stride * times)
        costs.append(np.ones(path.steps))
    # Violated rows have slacks, so that the program is always feasible.
    violated = np.flatnonzero((lower > 0.0) | (upper < 0.0))
    others = path.steps if step.fastest else 0
    slacks = np.where(lower[violated] > 0.0, SLACK_SCALE, -SLACK_SCALE)
    extra.append((violated, others + np.arange(len(violated)), slacks))
    costs.append(np.full(len(violated), PENALTY_WEIGHT * SLACK_SCALE))
    q = step.stride * np.concatenate(costs)
    x_min = np.append(smallest_changes, np.zeros(len(violated)))
    rows, by, entries = (np.concatenate(part) for part in zip(*extra, strict=True))
    own = sp.coo_array(sp.vstack(blocks))
    rows, by = np.append(own.row, rows), np.append(own.col, changes + by)
    A = sp.csc_array((np.append(own.data, entries), (rows, by)), (len(lower), len(q)))
    half = 0.5 * step.stride**2 * (tangent.T @ (hessian @ tangent))
    whole = sp.coo_array(half + half.T)  # whose pattern is symmetric too
    P = sp.csc_array((whole.data, (whole.row, whole.col)), (len(q), len(q)))
    program = QuadraticProgram(P, q, A, lower / step.stride, upper / step.stride, x_min)
    return MorphProgram(path, step.stride, tangent, program)


PLAN_VIEW = [0, 1, 3, 4, 6, 7]  # Rows of the plan view in the coordinates of three points


@lru_cache
def _clasp_derivatives(*, weighted: bool, loaded: bool, rolled: bool, equal: bool) -> ca.Function:
    """Return the function of the derivatives of a clasp of a level hitch in plan view.

    Its inputs are those of ``clasp_function`` with points (6, 1) in plan view. Its outputs are
    ``slopes`` (6, 10), the derivatives of r_{k-1} and q_k in plan view, of e_{k-1} and of ``turn``
    by points, q-legs and tensions; and ``turn`` itself.
    """
    import casadi as ca

    clasp = clasp_function(weighted=weighted, loaded=loaded, rolled=rolled, equal=equal)
    symbols = {name: ca.SX.sym(name, size) for name, size in CLASP_INPUTS.items()}
    plan_view = symbols["points"] = ca.SX.sym("points", len(PLAN_VIEW))
    points = ca.SX(CLASP_INPUTS["points"], 1)
    points[PLAN_VIEW] = plan_view
    outputs = clasp(**{**symbols, "points": points})
    rows = ca.vertcat(outputs["r"][:2], outputs["q"][:2], outputs["e"], outputs["turn"])
    by = ca.vertcat(plan_view, symbols["q_legs"], symbols["tensions"])
    slopes = ca.densify(ca.jacobian(rows, by))
    return ca.Function(
        "derivatives",
        [*symbols.values()],
        [slopes, outputs["turn"]],
        [*symbols],
        ["slopes", "turn"],
        {"cse": True},
    )


def _derivatives(path: KnotPath, free_tensions: bool) -> tuple[sp.csr_array[np.float64], Array]:
    """Return derivatives by the free columns, of the table's inner rows and then of all turns.

    Turns (inner knots · n,), sines of exterior angles, are returned as well.
    """
    columns, team, layout, n = path.columns, path.team, path.team.layout, path.team.robots
    knots, size = path.table[1:-1], columns.size
    count, behind, ahead = n * len(knots), layout.behind, layout.ahead
    around = np.column_stack([layout.starts[behind], layout.clasps, layout.ends[ahead]])
    cables = np.column_stack([behind, ahead])
    points = columns.vertices[around].reshape(n, -1)  # columns of the table, by clasp
    q_legs, tensions = columns.q_legs[cables], columns.tensions[cables]

    def of_all(values: Array) -> Array:
        """Return values (knots, n, rows) or (n, rows) as columns (rows, knots · n)."""
        rows = values.shape[-1]
        return np.broadcast_to(values, (len(knots), n, rows)).reshape(count, rows).T

    roll = np.zeros((n, 1)) if path.roll is None else path.roll[1:-1, :, None]
    derivatives = _clasp_derivatives(
        weighted=team.cable_density > 0.0,
        loaded=bool(np.any(team.load)),
        rolled=path.roll is not None,
        equal=bool(np.ptp(team.tension) == 0.0),
    ).map(count)(
        points=of_all(knots[:, points]),
        q_legs=of_all(knots[:, q_legs]),
        tensions=of_all(knots[:, tensions]),
        roll=of_all(roll),
        cable_length=of_all(team.cable_length[behind, None]),
        load=of_all(GRAVITY * team.load[:, None]),
        weight=GRAVITY * team.cable_density,
    )
    turns = np.asarray(derivatives["turn"]).ravel()
    slopes = np.asarray(derivatives["slopes"]).reshape(6, count, -1).transpose(1, 0, 2)
    # Rows of drones and r-legs in the table, and of turns after it.
    start = size * np.arange(len(knots))[:, None, None]
    drones = columns.drones.reshape(2 * n, 2)
    own = np.column_stack([drones[2 * behind + 1], drones[2 * ahead], columns.r_legs[behind]])
    own = np.column_stack([(start + own).reshape(count, 5), size * len(knots) + np.arange(count)])
    changing = [columns.vertices.ravel(), columns.q_legs]
    changing += [columns.tensions] if free_tensions else []
    free = (start[..., 0] + np.concatenate(changing)).ravel()
    variable = np.full(knots.size, -1)
    variable[free] = np.arange(len(free))
    arguments = np.concatenate([points, q_legs, tensions], axis=1)
    by = variable[(start + arguments).reshape(count, -1)]
    row, by = np.broadcast_arrays(own[:, :, None], by[:, None, :])
    used = by >= 0
    rows, by = np.append(row[used], free), np.append(by[used], np.arange(len(free)))
    entries = np.append(slopes[used], np.ones(len(free)))
    shape = knots.size + count, len(free)
    return sp.csr_array((entries, (rows, by)), shape), turns


def _energy(
    path: KnotPath, search: SearchLimits, fastest: bool
) -> tuple[sp.csr_array[np.float64], Array]:
    """Return the Hessian and gradient of the energy by the table's inner rows."""
    columns, table, steps, n = path.columns, path.table, path.steps, path.team.robots
    limits = search.requirements.limits
    change = np.diff(np.eye(steps + 1), axis=0)
    bend = np.diff(change, axis=0)
    squares, bends = steps * (change.T @ change), steps**3 * (bend.T @ bend)
    own, bend_weight = 1.0, BEND_WEIGHT
    if fastest:
        time = float(np.sum(np.max(segment_times(path, limits), axis=1)))
        own, bend_weight = TIME_ENERGY_WEIGHT, TIME_BEND_WEIGHT / time
    scale = np.zeros(columns.size)  # units of time and, for tensions, fractions of the team's
    scale[columns.vertices], scale[columns.drones] = 1.0 / limits.vertex_speed, 1.0 / limits.speed
    of_nodes = 2.0 / n * (own * squares + bend_weight * bends)
    hessian = _blockwise(of_nodes[1:-1, 1:-1], scale**2)
    gradient = of_nodes[1:-1] @ table * scale**2
    if search.tension is not None:
        scale = np.zeros(columns.size)
        scale[columns.tensions] = 1.0 / path.team.tension
        even = TENSION_CHANGE_WEIGHT * (squares + BEND_WEIGHT * bends)
        of_tensions = 2.0 / n * TENSION_WEIGHT * (np.eye(steps + 1) / steps + even)
        hessian = hessian + _blockwise(of_tensions[1:-1, 1:-1], scale**2)
        gradient += of_tensions[1:-1] @ table * scale**2
    return hessian, gradient.ravel()


def _blockwise(matrix: Array, weights: Array) -> sp.csr_array[np.float64]:
    """Return the Kronecker product of a matrix (K, J) with the diagonal one of weights (size,)."""
    (row, by), (used,) = np.nonzero(matrix), np.nonzero(weights)
    size, entries = len(weights), np.multiply.outer(matrix[row, by], weights[used])
    places = ((size * index[:, None] + used).ravel() for index in (row, by))
    shape = size * matrix.shape[0], size * matrix.shape[1]
    return sp.csr_array((entries.ravel(), tuple(places)), shape)


class NearPairs(NamedTuple):
    """Pairs of close bodies, each in one of K frames."""

    frame: Indices  # (m,), index of the frame
    first: Indices  # (m, 2), nodes (of 3n) at the ends of each body; a drone's are the same
    second: Indices  # (m, 2), nodes (of 3n) at the ends of each body; a drone's are the same
    kind: Indices  # (m,), as in ``hitch.pairs``
    # (m, 3), derivative of the distance by the first body's position: the unit normal along the
    # shortest offset from the second body, with heights scaled
    gradient: Array
    enforced: Array  # (m,) [m], enforced distance


def _near_pairs(
    nodes: Array, requirements: Requirements, margins: Array, reach: Array
) -> NearPairs:
    """Return the pairs of nodes (K, 3n, 3) [m] with distances up to margins and reach (K,) [m]."""
    bodies = TautBodies.of(layout_of(nodes.shape[1] // 3, CLOSED))
    limits, scales = limits_of(requirements.separation), scales_of(requirements)
    corners = nodes[:, bodies.nodes, :2]  # distances in plan view are lower bounds
    cutoff = float(np.max(limits * np.max(margins)) + np.max(reach))
    frame, i, j, kind = bodies.near(corners.min(axis=2), corners.max(axis=2), limits, cutoff)
    scale = scales[kind][:, None]
    first, second = (nodes[frame[:, None], bodies.nodes[body]] * scale for body in (i, j))
    offset = shortest_offset(differences(first, second))
    normal = unit(offset, unit((first - second).mean(axis=1)), 1e-6)
    enforced = limits[kind] * margins[frame]
    ends = bodies.nodes[i], bodies.nodes[j]
    pairs = NearPairs(frame, *ends, kind, normal * scales[kind], enforced)
    near = length(offset) < enforced + reach[frame]
    return NearPairs._make(each[near] for each in pairs)


def _near_rows(
    path: KnotPath, search: SearchLimits, step: SolverStep
) -> tuple[sp.csr_array[np.float64], Array]:
    """Return the distances' derivatives by the table's inner rows, and their least changes [m].

    Distances are those in space of close pairs along normals: bodies are separated by as much as
    all their ends are. Heights are constant within a step. Between the knots the path is the chord
    of two knots and a constant deviation.
    """
    parts, columns = step.parts, path.columns
    indices = np.arange(1, parts * path.steps) / parts  # of frames, in steps between knots
    if parts == 1:
        table, heights = path.table[1:-1], path.node_heights[1:-1]
    else:
        frames = path.at(indices / path.steps)
        table, heights = frames.table, frames.node_heights
    nodes = np.concatenate([table[:, columns.nodes], heights[..., None]], axis=-1)
    margins = search.margins(path.steps, indices)
    reach = np.where(indices % 1.0 == 0.0, 1.0, BETWEEN_KNOTS_SHARE) * step.reach
    pairs = _near_pairs(nodes, search.requirements, margins, reach)
    pair, first, second = end_combinations(pairs.kind, pairs.first, pairs.second)
    frame, gradient = pairs.frame[pair], pairs.gradient[pair]
    moved = np.concatenate([columns.nodes[first], columns.nodes[second]], axis=1)
    slopes = np.concatenate([gradient[:, :2], -gradient[:, :2]], axis=1)
    entries = (slopes.ravel(), (columns.size * frame[:, None] + moved).ravel())
    rows = sp.csr_array((*entries, 4 * np.arange(len(pair) + 1)), (len(pair), table.size))
    rise = heights[frame, first] - heights[frame, second]
    needed = pairs.enforced[pair] - gradient[:, 2] * rise - rows @ table.ravel()
    if parts > 1:
        share = np.maximum(1.0 - np.abs(indices[:, None] - np.arange(1.0, path.steps)), 0.0)
        rows = sp.csr_array(rows @ _blockwise(share, np.ones(columns.size)))
    return rows, needed
