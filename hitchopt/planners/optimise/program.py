"""The quadratic program of a path around the current one: energy or time over linearised limits.

Variables are the changes of vertices, q-legs and tensions at the inner knots. Drones and r-legs
follow by casadi's exact derivatives of the model, evaluated at all robots and knots at once. The
objective is either the energy of the motion of all vertices and drones, which is quadratic, or the
duration within the limits of speed, acceleration, thrust and tilt, plus a custom cost. Rows
are sparse: the effort is linear in knots · n.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
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
from hitchopt.hitch.team import Layout
from hitchopt.planners.candidates import Effort
from hitchopt.planners.morph.morph import exterior_angles
from hitchopt.planners.optimise.knots import (
    KnotPath,
    QuadraticTerms,
    SearchLimits,
    SolverStep,
    variable_bounds,
)
from hitchopt.planners.optimise.times import (
    TimedRows,
    TimeEntries,
    acceleration_rows,
    segment_times,
    speed_rows,
    step_times,
)
from hitchopt.values import Array, Indices

if TYPE_CHECKING:
    import casadi as ca


@dataclass(frozen=True)
class ProgramTuning:
    """Weights and ranges of the program; ``python -m benchmarks morphs`` shows their effect."""

    bend_weight: float = 0.1
    """Weight of the knots' second differences in the energy, which keeps splines near their knots.
    """

    time_bend_weight: float = 0.02
    """[s] Weight of the second differences relative to the time, times the path's time at the speed
    limits: bends cost more of a short flight, whose accelerations bound it."""

    # Weight of the energy relative to the time, which makes the solution unique
    time_energy_weight: float = 1e-3
    # Weight of the squares of variable tensions, which leaves thrust for motion
    tension_weight: float = 0.02
    # Weight of the tensions' differences relative to their squares
    tension_change_weight: float = 0.01
    max_time_saved: float = 0.3  # Largest decrease of a step's time in one program, over that time
    # [rad] Smallest exterior angle on the path, or half of that at its ends if that is less
    min_angle: float = math.radians(3.0)
    # [1/m] Penalty weight of violated rows, which exceeds any gain by violating them
    penalty_weight: float = 100.0
    slack_scale: float = 0.01  # Unit of slacks, in strides, which scales the program
    # Fraction of a step's reach up to which pairs have rows between the knots
    between_knots_share: float = 0.2
    # Distance to its bound, in strides, below which a row is enforced at first
    near_range: float = 0.5
    # Distance to its bound, in strides, below which a row is added together with violated rows
    added_range: float = 0.1


TUNING = ProgramTuning()


ENTRY_COST = 0.012
"""Cost of an entry of a program's matrices, in the unit of ``Effort``, by regression."""

MIN_PROGRESS = 0.3
"""Motion of vertices in a step over its stride, below which the optimiser has converged."""


def iterates(
    path: KnotPath,
    search: SearchLimits,
    step: SolverStep,
    max_steps: int,
    progress: float = MIN_PROGRESS,
) -> Iterator[KnotPath]:
    """Yield the paths after each step of the optimiser.

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

    path: KnotPath  # The current path
    stride: float  # [m] Trust radius of coordinates, the unit of changes
    tangent: sp.csr_array[np.float64]
    """(inner knots · size, changes): changes of the table's inner rows caused by those of the free
    columns."""

    program: QuadraticProgram  # The program; its solution has the units of the variables

    def solve(self, effort: Effort) -> KnotPath | None:
        """Return the path of the solution, or None without one; drones follow by the model.

        Rows near their bounds are enforced at first, and others when they are violated.
        """
        program = self.program
        rows = sp.csr_array(program.A)
        enforced = np.minimum(-program.lower, program.upper) < TUNING.near_range
        while True:
            A = sp.csc_array(rows[enforced])
            if not effort.spend(ENTRY_COST * float(program.P.nnz + A.nnz)):
                return None
            lower = program.lower[enforced]
            upper = program.upper[enforced]
            solution = solve_qp(replace(program, A=A, lower=lower, upper=upper))
            if solution is None:
                return None
            values = rows @ solution
            excess = np.maximum(program.lower - values, values - program.upper)
            if not np.any(excess[~enforced] > 0.0):
                break
            enforced |= excess > -TUNING.added_range
        changes = np.asarray(self.tangent @ solution[: self.tangent.shape[1]])
        table = self.path.table.copy()
        table[1:-1] += self.stride * changes.reshape(len(table) - 2, -1)
        return self.path.with_table(table)


@dataclass(frozen=True, eq=False)
class RowBlock:
    """Rows of the program with bounds of their values; they are 0 on the current path."""

    by_changes: sp.csr_array[np.float64]  # (rows, changes)
    lower: Array  # (rows,)
    upper: Array  # (rows,)
    # Entries of the steps' times; None if the rows do not depend on them
    by_times: TimeEntries | None = None


def build_program(path: KnotPath, search: SearchLimits, step: SolverStep) -> MorphProgram:
    """Return the program around a path, with near pairs and normals of that path."""
    linear = _linearised(path, free_tensions=search.tension is not None)
    distances_by_table, smallest_changes = _near_rows(path, search, step)
    no_upper = np.full(len(smallest_changes), np.inf)
    blocks = [
        _bound_rows(path, search, step, linear.tangent),
        _turn_rows(path, linear),
        RowBlock(distances_by_table @ linear.tangent, smallest_changes, no_upper),
    ]
    objective = _energy(path, search, fastest=step.fastest)
    times = np.zeros(0)
    if step.fastest:
        limits = search.requirements.limits
        times = step_times(path, limits)
        if search.cost is not None:
            objective = objective.plus(search.cost.terms(path, float(np.sum(times))))
        blocks += [
            _timed_block(speed_rows(path, limits, times), path, linear.tangent),
            _timed_block(acceleration_rows(path, limits, times), path, linear.tangent),
        ]
    program = _assembled(blocks, objective, linear.tangent, times, step.stride)
    return MorphProgram(path, step.stride, linear.tangent, program)


def _bound_rows(
    path: KnotPath, search: SearchLimits, step: SolverStep, tangent: sp.csr_array[np.float64]
) -> RowBlock:
    """Return the rows of bounded columns of the table's inner rows that can change."""
    current = path.table[1:-1].ravel()
    smallest, largest = variable_bounds(path, search, step.stride)
    lower = smallest - current
    upper = largest - current
    can_change = np.diff(tangent.indptr) > 0
    is_bounded = (lower > -np.inf) | (upper < np.inf)
    bounded = np.flatnonzero(can_change & is_bounded)
    return RowBlock(tangent[bounded], lower[bounded], upper[bounded])


def _turn_rows(path: KnotPath, linear: Linearisation) -> RowBlock:
    """Return the rows of the sines of exterior angles at inner knots."""
    smallest = float(np.min(exterior_angles(path.team.layout, path.edges[[0, -1]])))
    min_sine = math.sin(min(TUNING.min_angle, 0.5 * smallest))
    no_upper = np.full(len(linear.turns), np.inf)
    return RowBlock(linear.turn_slopes, min_sine - linear.turns, no_upper)


def _timed_block(timed: TimedRows, path: KnotPath, tangent: sp.csr_array[np.float64]) -> RowBlock:
    """Return the rows of limits that depend on the steps' times too."""
    no_lower = np.full(len(timed.spare), -np.inf)
    by_changes = timed.by_table(path) @ tangent
    return RowBlock(by_changes, no_lower, timed.spare, timed.by_times(path.steps))


def _assembled(
    blocks: Sequence[RowBlock],
    objective: QuadraticTerms,
    tangent: sp.csr_array[np.float64],
    times: Array,
    stride: float,
) -> QuadraticProgram:
    """Return the program of changes, then of the ``times`` (J,) [s], then of slacks.

    Violated rows have slacks, so that the program is always feasible. Without times the duration is
    not minimised.
    """
    lower = np.concatenate([block.lower for block in blocks])
    upper = np.concatenate([block.upper for block in blocks])
    changes = tangent.shape[1]
    violated = np.flatnonzero((lower > 0.0) | (upper < 0.0))
    slacks = len(violated)
    variables = changes + len(times) + slacks

    by_changes = sp.coo_array(sp.vstack([block.by_changes for block in blocks]))
    rows: list[Indices] = [np.asarray(by_changes.row, dtype=np.intp)]
    columns: list[Indices] = [np.asarray(by_changes.col, dtype=np.intp)]
    entries = [by_changes.data]
    first_row = 0
    for block in blocks:
        if block.by_times is not None:
            rows.append(first_row + block.by_times.row)
            columns.append(changes + block.by_times.step)
            entries.append(block.by_times.entry)
        first_row += len(block.lower)
    rows.append(violated)
    columns.append(np.arange(variables - slacks, variables))
    entries.append(np.where(lower[violated] > 0.0, TUNING.slack_scale, -TUNING.slack_scale))
    indices = (np.concatenate(rows), np.concatenate(columns))

    gradient_by_changes = np.asarray(tangent.T @ objective.gradient)
    penalties = np.full(slacks, TUNING.penalty_weight * TUNING.slack_scale)
    gradient = np.concatenate([gradient_by_changes, np.ones(len(times)), penalties])
    half_hessian = 0.5 * stride**2 * (tangent.T @ (objective.hessian @ tangent))
    hessian = sp.coo_array(half_hessian + half_hessian.T)  # whose pattern is symmetric too
    smallest_changes = np.full(changes, -np.inf)
    smallest_time_changes = -TUNING.max_time_saved / stride * times
    return QuadraticProgram(
        P=sp.csc_array((hessian.data, (hessian.row, hessian.col)), (variables, variables)),
        q=stride * gradient,
        A=sp.csc_array((np.concatenate(entries), indices), (first_row, variables)),
        lower=lower / stride,
        upper=upper / stride,
        x_min=np.concatenate([smallest_changes, smallest_time_changes, np.zeros(slacks)]),
    )


class Linearisation(NamedTuple):
    """Derivatives by the changes of the free columns at the inner knots."""

    # (inner knots · size, changes): derivatives of the table's inner rows
    tangent: sp.csr_array[np.float64]
    turn_slopes: sp.csr_array[np.float64]  # (inner knots · n, changes): derivatives of ``turns``
    turns: Array  # (inner knots · n,): sines of exterior angles


def _linearised(path: KnotPath, *, free_tensions: bool) -> Linearisation:
    """Return the derivatives at a path, whose free columns are vertices and q-legs.

    With ``free_tensions`` tensions are free too.
    """
    columns = path.columns
    arguments = ClaspColumns.of(path)
    team = path.team
    n = team.robots
    knot = np.arange(path.steps - 1)
    knots = path.table[1:-1]
    count = n * len(knot)
    inner_size = columns.size * len(knot)

    def of_all(values: Array) -> Array:
        """Return values (knots, n, rows) or (n, rows) as columns (rows, knots · n)."""
        rows = values.shape[-1]
        return np.broadcast_to(values, (len(knots), n, rows)).reshape(count, rows).T

    roll = np.zeros((n, 1)) if path.roll is None else path.roll[1:-1, :, None]
    function = _slopes_function(
        weighted=team.cable_density > 0.0,
        loaded=bool(np.any(team.load)),
        rolled=path.roll is not None,
        equal=bool(np.ptp(team.tension) == 0.0),
    )
    outputs = function.map(count)(
        points=of_all(knots[:, arguments.points]),
        q_legs=of_all(knots[:, arguments.q_legs]),
        tensions=of_all(knots[:, arguments.tensions]),
        roll=of_all(roll),
        cable_length=of_all(team.cable_length[team.layout.behind, None]),
        load=of_all(GRAVITY * team.load[:, None]),
        weight=GRAVITY * team.cable_density,
    )
    by_arguments = np.asarray(outputs["slopes"]).reshape(6, count, -1).transpose(1, 0, 2)

    free_columns = [columns.vertices.ravel(), columns.q_legs]
    if free_tensions:
        free_columns.append(columns.tensions)
    free = columns.flat_index(knot[:, None], np.concatenate(free_columns)).ravel()
    change_of_entry = np.full(inner_size, -1)
    change_of_entry[free] = np.arange(len(free))

    # Every clasp has rows in the table, and one of its turn after the table
    in_table = columns.flat_index(knot[:, None, None], arguments.results).reshape(count, -1)
    in_turns = inner_size + np.arange(count)
    result_rows = np.column_stack([in_table, in_turns])
    argument_entries = columns.flat_index(knot[:, None, None], arguments.all).reshape(count, -1)
    argument_changes = change_of_entry[argument_entries]
    rows, changes = np.broadcast_arrays(result_rows[:, :, None], argument_changes[:, None, :])
    is_free = changes >= 0
    all_rows = np.append(rows[is_free], free)
    all_changes = np.append(changes[is_free], np.arange(len(free)))
    entries = np.append(by_arguments[is_free], np.ones(len(free)))
    shape = (inner_size + count, len(free))
    slopes = sp.csr_array((entries, (all_rows, all_changes)), shape)
    turns = np.asarray(outputs["turn"]).ravel()
    return Linearisation(slopes[:inner_size], slopes[inner_size:], turns)


PLAN_VIEW = [0, 1, 3, 4, 6, 7]  # Rows of the plan view in the coordinates of three points


@lru_cache
def _slopes_function(*, weighted: bool, loaded: bool, rolled: bool, equal: bool) -> ca.Function:
    """Return the function of the derivatives of a clasp of a level hitch in plan view.

    Its inputs are those of ``clasp_function`` with points (6, 1) in plan view. Its outputs are
    ``slopes`` (6, 10), the derivatives of r_{k-1} and q_k in plan view, of e_{k-1} and of ``turn``
    by points, q-legs and tensions; and ``turn`` itself.
    """
    import casadi as ca

    clasp = clasp_function(weighted=weighted, loaded=loaded, rolled=rolled, equal=equal)
    symbols = {name: ca.SX.sym(name, size) for name, size in CLASP_INPUTS.items()}
    plan_view = ca.SX.sym("points", len(PLAN_VIEW))
    symbols["points"] = plan_view
    points = ca.SX(CLASP_INPUTS["points"], 1)
    points[PLAN_VIEW] = plan_view
    outputs = clasp(**{**symbols, "points": points})
    values = ca.vertcat(outputs["r"][:2], outputs["q"][:2], outputs["e"], outputs["turn"])
    variables = ca.vertcat(plan_view, symbols["q_legs"], symbols["tensions"])
    slopes = ca.densify(ca.jacobian(values, variables))
    return ca.Function(
        "derivatives",
        [*symbols.values()],
        [slopes, outputs["turn"]],
        [*symbols],
        ["slopes", "turn"],
        {"cse": True},
    )


class ClaspColumns(NamedTuple):
    """Columns of the table that the model of a clasp takes and returns, by clasps."""

    points: Indices  # (n, 6): the previous vertex, the clasp's and the next one in plan view
    q_legs: Indices  # (n, 2), of the cables behind and ahead
    tensions: Indices  # (n, 2), of the cables behind and ahead
    results: Indices  # (n, 5): drones r_{k-1} and q_k in plan view, and e_{k-1}

    @classmethod
    def of(cls, path: KnotPath) -> ClaspColumns:
        """Return the columns for a path."""
        columns = path.columns
        layout = path.team.layout
        behind = layout.behind
        ahead = layout.ahead
        vertices = np.column_stack([layout.starts[behind], layout.clasps, layout.ends[ahead]])
        cables = np.column_stack([behind, ahead])
        drones = columns.drones.reshape(2 * path.team.robots, 2)
        return cls(
            points=columns.vertices[vertices].reshape(path.team.robots, -1),
            q_legs=columns.q_legs[cables],
            tensions=columns.tensions[cables],
            results=np.column_stack(
                [drones[2 * behind + 1], drones[2 * ahead], columns.r_legs[behind]]
            ),
        )

    @property
    def all(self) -> Indices:
        """(n, 10): columns of all arguments."""
        return np.concatenate([self.points, self.q_legs, self.tensions], axis=1)


def _energy(path: KnotPath, search: SearchLimits, *, fastest: bool) -> QuadraticTerms:
    """Return the energy of the path, with its small weight if the path is to be ``fastest``."""
    columns = path.columns
    limits = search.requirements.limits
    # Integrals over s of the squares of a function, its slope and its bend, as quadratic forms of
    # its values at J + 1 knots, by differences
    steps = path.steps
    difference = np.diff(np.eye(steps + 1), axis=0)
    second_difference = np.diff(difference, axis=0)
    values = np.eye(steps + 1) / steps
    slopes = steps * (difference.T @ difference)
    bends = steps**3 * (second_difference.T @ second_difference)
    energy_weight = 1.0
    bend_weight = TUNING.bend_weight
    if fastest:
        time = float(np.sum(np.max(segment_times(path, limits), axis=1)))
        energy_weight = TUNING.time_energy_weight
        bend_weight = TUNING.time_bend_weight / time
    scale = np.zeros(columns.size)  # to units of time
    scale[columns.vertices] = 1.0 / limits.vertex_speed
    scale[columns.drones] = 1.0 / limits.speed
    robots = path.team.robots
    motion_form = 2.0 / robots * (energy_weight * slopes + bend_weight * bends)
    energy = _quadratic(path, motion_form, scale)
    if search.tension is None:
        return energy
    scale = np.zeros(columns.size)  # to fractions of the team's tensions
    scale[columns.tensions] = 1.0 / path.team.tension
    changes = TUNING.tension_change_weight * (slopes + TUNING.bend_weight * bends)
    tension_form = 2.0 / robots * TUNING.tension_weight * (values + changes)
    return energy.plus(_quadratic(path, tension_form, scale))


def _quadratic(path: KnotPath, form: Array, scale: Array) -> QuadraticTerms:
    """Return the terms of half a form (J + 1, J + 1) of every column, scaled by ``scale`` (size,).

    The ends of the path are constant.
    """
    hessian = _blockwise(form[1:-1, 1:-1], scale**2)
    gradient = form[1:-1] @ path.table * scale**2
    return QuadraticTerms(hessian, gradient.ravel())


def _blockwise(matrix: Array, weights: Array) -> sp.csr_array[np.float64]:
    """Return the Kronecker product of a matrix (K, J) with the diagonal one of weights (size,)."""
    row, column = np.nonzero(matrix)
    (used,) = np.nonzero(weights)
    size = len(weights)
    entries = np.multiply.outer(matrix[row, column], weights[used])
    rows = (size * row[:, None] + used).ravel()
    columns = (size * column[:, None] + used).ravel()
    shape = (size * matrix.shape[0], size * matrix.shape[1])
    return sp.csr_array((entries.ravel(), (rows, columns)), shape)


class NearPairs(NamedTuple):
    """Pairs of close bodies, each in one of K frames."""

    frame: Indices  # (m,): index of the frame
    first: Indices  # (m, 2): nodes at the ends of the first body; a drone's are the same
    second: Indices  # (m, 2): those of the second body
    kind: Indices  # (m,), as in ``hitch.pairs``.
    gradient: Array
    """(m, 3): derivative of the distance with respect to the first body's position.

    It is the unit normal along the shortest offset from the second body, with heights scaled."""

    enforced: Array  # (m,) [m]: enforced distance


MIN_OFFSET = 1e-6  # [m] Smallest offset of two bodies whose direction is their normal


def near_pairs(
    layout: Layout, nodes: Array, requirements: Requirements, margins: Array, reach: Array
) -> NearPairs:
    """Return the pairs of bodies that are closer than their enforced distance plus a reach.

    Parameters
    ----------
    nodes: (K, nodes, 3) [m], those of ``Layout.routes`` in K frames.
    margins: (K,), enforced distances over the limits.
    reach: (K,) [m], distance beyond the enforced one.
    """
    bodies = TautBodies.of(layout)
    limits = limits_of(requirements.separation)
    scales = scales_of(requirements)
    # A coarse selection first: distances in plan view are lower bounds
    corners = nodes[:, bodies.nodes, :2]
    cutoff = float(np.max(limits * np.max(margins)) + np.max(reach))
    frame, i, j, kind = bodies.near(corners.min(axis=2), corners.max(axis=2), limits, cutoff)
    scale = scales[kind][:, None]
    first = nodes[frame[:, None], bodies.nodes[i]] * scale
    second = nodes[frame[:, None], bodies.nodes[j]] * scale
    offset = shortest_offset(differences(first, second))
    from_middle_to_middle = unit((first - second).mean(axis=1))  # the normal of touching bodies
    normal = unit(offset, from_middle_to_middle, MIN_OFFSET)
    enforced = limits[kind] * margins[frame]
    near = length(offset) < enforced + reach[frame]
    return NearPairs(
        frame=frame[near],
        first=bodies.nodes[i][near],
        second=bodies.nodes[j][near],
        kind=kind[near],
        gradient=(normal * scales[kind])[near],
        enforced=enforced[near],
    )


def _near_rows(
    path: KnotPath, search: SearchLimits, step: SolverStep
) -> tuple[sp.csr_array[np.float64], Array]:
    """Return the distances' derivatives by the table's inner rows, and their least changes [m].

    Distances are those in space of close pairs along normals: bodies are separated by as much as
    all their ends are. Heights are constant within a step. Between the knots the path is the chord
    of two knots and a constant deviation.
    """
    columns = path.columns
    # Places on the path in steps between knots: inner knots, or inner ends of parts of every step
    indices = np.arange(1, step.parts * path.steps) / step.parts
    table, heights = path.table[1:-1], path.node_heights[1:-1]
    if step.parts > 1:
        hitches = path.at(indices / path.steps)
        table, heights = hitches.table, hitches.node_heights
    nodes = np.concatenate([table[:, columns.nodes], heights[..., None]], axis=-1)
    margins = search.margins(path.steps, indices)
    is_knot = indices % 1.0 == 0.0
    reach = np.where(is_knot, 1.0, TUNING.between_knots_share) * step.reach
    pairs = near_pairs(path.team.layout, nodes, search.requirements, margins, reach)

    pair, first, second = end_combinations(pairs.kind, pairs.first, pairs.second)
    frame = pairs.frame[pair]
    gradient = pairs.gradient[pair]
    columns_of_ends = np.concatenate([columns.nodes[first], columns.nodes[second]], axis=1)
    slopes = np.concatenate([gradient[:, :2], -gradient[:, :2]], axis=1)
    entries = columns.flat_index(frame[:, None], columns_of_ends)
    row_starts = slopes.shape[1] * np.arange(len(pair) + 1)
    shape = (len(pair), table.size)
    by_frames = sp.csr_array((slopes.ravel(), entries.ravel(), row_starts), shape)
    rise = heights[frame, first] - heights[frame, second]
    distances_in_plan = by_frames @ table.ravel()
    smallest_changes = pairs.enforced[pair] - gradient[:, 2] * rise - distances_in_plan
    if step.parts == 1:
        return by_frames, smallest_changes
    inner_knots = np.arange(1.0, path.steps)
    shares_of_knots = np.maximum(1.0 - np.abs(indices[:, None] - inner_knots), 0.0)  # in chords
    by_knots = _blockwise(shares_of_knots, np.ones(columns.size))
    return sp.csr_array(by_frames @ by_knots), smallest_changes
