"""The nonlinear program of a path, for casadi and IPOPT with exact sparse derivatives.

Variables are the inner knots of a path. The objective is either the energy of the motion of all
vertices and drones, which converges in a few steps from any guess, or afterwards the duration
within the speed limits. The cost is linear in knots · n: one small function of the model is mapped
over all robots and knots, and all other rows have few entries.
"""

from __future__ import annotations

import math
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from types import FrameType
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from hitchopt.errors import check_time, time_left
from hitchopt.geometry import differences, shortest_offset
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.model import planar
from hitchopt.hitch.pairs import SEPARATION, TautBodies, end_combinations, limits_of
from hitchopt.hitch.requirements import Separation
from hitchopt.hitch.team import CLOSED, layout_of
from hitchopt.planners.morph.morph import exterior_angles
from hitchopt.planners.optimise.knots import (
    KnotPath,
    SearchLimits,
    SolverStep,
    columns_of,
    variable_bounds,
)
from hitchopt.values import Array, Indices

BEND_WEIGHT = 0.1
"""Weight of the knots' second differences in the energy, which keeps splines near their knots."""

TIME_BEND_WEIGHT = 0.01
"""Weight of the second differences relative to the time; smaller weights leave corners that cost
more time than they save."""

TIME_ENERGY_WEIGHT = 1e-3
"""Weight of the energy relative to the time, which makes the solution unique."""

TENSION_WEIGHT = 0.02
"""Weight of the squares of variable tensions, which leaves thrust for motion."""

TENSION_CHANGE_WEIGHT = 0.01
"""Weight of the tensions' differences relative to their squares."""

MIN_SEGMENT_SHARE = 0.5
"""Length of a segment over the longest one of its step, below which it does not bound the time."""

MAX_ITERATIONS, MAX_FASTEST_ITERATIONS = 100, 40
"""Maximum iterations of IPOPT for the energy and for the time. The latter converges in about 20 or,
if the limits of all drones bind at once, not at all."""


ROW_COST = 0.02
"""Cost of a row in an iteration over that of a robot at a knot, by regression."""


@dataclass(frozen=True)
class Structure:
    """The structure of a program's expressions; all other numbers are parameters.

    Variables are ``x`` of the inner knots, a slack per soft row, and for the fastest path the time
    of every step. Parameters are the first and the last knot, the constant inputs of ``planar``, a
    scale per pair of drones, and the linear rows' entries.
    """

    robots: int  # number of robots
    steps: int  # number of steps between the knots
    loaded: bool  # argument of ``planar``
    choice: bool  # argument of ``planar``
    slowness: tuple[float, float]  # [s/m], of vertices and of drones
    # (n,) [N], the team's, if tensions are variable; None if they are fixed
    tensions: tuple[float, ...] | None
    # variables x of the first and of the second drone of each pair; y follows x
    drones: tuple[tuple[int, ...], tuple[int, ...]]
    # number of rows, and column pointers and row numbers of their compressed columns
    linear: tuple[int, tuple[int, ...], tuple[int, ...]]
    # rows with a slack, among those of drones and among linear ones
    soft: tuple[tuple[int, ...], tuple[int, ...]]
    # indices of vertices' and drones' x, flat over the steps, of segments that bound the time of
    # their step; None for a path of minimum energy
    segments: tuple[int, ...] | None

    @property
    def iterations(self) -> int:
        """Maximum number of iterations."""
        return MAX_ITERATIONS if self.segments is None else MAX_FASTEST_ITERATIONS


@dataclass(frozen=True, eq=False)
class MorphProgram:
    """A program ``min f(x, p)`` over ``lbx ≤ x ≤ ubx`` and ``lbg ≤ g(x, p) ≤ ubg`` at a path."""

    path: KnotPath  # the current path
    structure: Structure  # of the expressions
    numbers: dict[str, Array]  # the initial guess ``x0``, the parameters ``p``, and all bounds

    @property
    def size(self) -> float:
        """Cost of an iteration, in that of a robot at a knot without near pairs."""
        return self.path.size + ROW_COST * len(self.numbers["lbg"])


def build_program(path: KnotPath, search: SearchLimits, step: SolverStep) -> MorphProgram:
    """Return the program around a path, with near pairs and normals of that path."""
    columns, table, team, steps = path.columns, path.table, path.team, path.steps
    n, inner, limits = team.robots, table[1:-1].ravel(), search.requirements.limits
    drones, linear = _near_rows(path, search, step)
    loaded = team.loaded or path.roll is not None
    choice = team.cable_density > 0.0 if loaded else bool(np.ptp(team.tension) == 0.0)
    slowness, segments = (1.0 / limits.vertex_speed, 1.0 / limits.speed), None
    boxes = [(inner, *variable_bounds(path, search, step.stride))]
    rows = 5 * n * (steps - 1)
    ranges = [(np.zeros(rows), np.zeros(rows))]
    smallest = float(np.min(exterior_angles(team.layout, path.edges[[0, -1]])))
    min_sine = math.sin(min(MIN_ANGLE, 0.5 * smallest))
    ranges.append((np.full(rows // 5, min_sine), np.full(rows // 5, np.inf)))
    # Rows that the current path violates, as in a guess, have slacks.
    soft = []
    for *_, lower, values in (drones, linear):
        violated = np.flatnonzero(values < lower)
        zero = np.zeros(len(violated))
        boxes.append(((lower - values)[violated], zero, zero + np.inf))
        ranges.append((lower, np.full(len(lower), np.inf)))
        soft.append(tuple(violated.tolist()))
    if step.fastest:  # the longest segment of a step defines its time
        scales = np.repeat(slowness, [n, 2 * n])[:, None]
        lengths = length(np.diff(table[:, columns.nodes] * scales, axis=0))
        longest = np.max(lengths, axis=1)
        boxes.append((1.01 * longest, np.zeros(steps), np.full(steps, np.inf)))
        indices = np.flatnonzero(lengths > MIN_SEGMENT_SHARE * longest[:, None])
        ranges.append((np.full(len(indices), -np.inf), np.zeros(len(indices))))
        segments = tuple((2 * indices).tolist())
    structure = Structure(
        n,
        steps,
        loaded,
        choice,
        slowness,
        None if search.tension is None else tuple(team.tension.tolist()),
        drones.structure,
        linear.structure,
        (soft[0], soft[1]),
        segments,
    )
    clasps = _clasp_parameters(path, loaded)
    parameters = (table[0], table[-1], *clasps, drones.numbers, linear.numbers)
    numbers = (
        np.concatenate(each) for each in (*zip(*boxes, strict=True), *zip(*ranges, strict=True))
    )
    named = dict(zip(("x0", "lbx", "ubx", "lbg", "ubg"), numbers, strict=True))
    return MorphProgram(path, structure, {**named, "p": np.concatenate(parameters)})


def _clasp_parameters(path: KnotPath, loaded: bool) -> Iterator[Array]:
    """Yield the constant inputs of ``planar``, flat over all robots and inner knots.

    These are cable lengths and, if loaded, rolls, loads and weights.
    """
    team, n, inner = path.team, path.team.robots, path.steps - 1
    if not loaded:
        yield np.tile(team.cable_length, inner)
        return
    ends = np.column_stack([team.layout.starts, team.layout.ends])
    roll = np.zeros((inner, n)) if path.roll is None else path.roll[1:-1]
    loads = np.zeros((n, 2, 3))
    loads[..., 2] = -GRAVITY * team.load[ends]
    yield np.tile(team.cable_length[team.layout.neighbours[:, :2]].ravel(), inner)
    yield roll[:, ends].ravel()
    yield np.tile(loads.ravel(), inner)
    yield np.full(n * inner, GRAVITY * team.cable_density)


def expressions(structure: Structure) -> dict[str, ca.MX]:
    """Return casadi expressions x, p, f and g for all programs of a structure."""
    n, steps, inner = structure.robots, structure.steps, structure.steps - 1
    columns, model = columns_of(n), planar(structure.loaded, structure.choice)
    widths = [model.size1_in(i) for i in range(3, model.n_in())]
    rows, pointers, indices = structure.linear
    slacks = [ca.MX.sym(f"slack{i}", len(soft)) for i, soft in enumerate(structure.soft)]
    sizes = [columns.size, columns.size, *(width * n * inner for width in widths)]
    sizes += [len(structure.drones[0]), len(indices)]
    p = [ca.MX.sym(f"p{i}", size) for i, size in enumerate(sizes)]
    x, times = ca.MX.sym("x", columns.size * inner), ca.MX.sym("t", steps)
    g = _drone_rows(structure, x, p[2:-2])
    first, second = (np.array(each, np.intp) for each in structure.drones)
    across, along = (x[(first + i).tolist()] - x[(second + i).tolist()] for i in (0, 1))
    pattern = ca.Sparsity(rows, columns.size * inner, list(pointers), list(indices))
    cost = ca.MX(0.0)
    for value, slack, soft in zip(
        ((across**2 + along**2) * p[-2], ca.MX(pattern, p[-1]) @ x),
        slacks,
        structure.soft,
        strict=True,
    ):
        row = value
        if soft:
            count, ones = len(soft), ca.DM.ones(len(soft))
            row += ca.DM.triplet(list(soft), [*range(count)], ones, value.size1(), count) @ slack
            cost += PENALTY_WEIGHT * ca.sum1(slack)
        g.append(row)
    # Positions of vertices and drones at all knots (6n, steps + 1), in units of time.
    table = ca.horzcat(p[0], ca.reshape(x, columns.size, inner), p[1])
    slowness = ca.DM(np.repeat(structure.slowness, [2 * n, 4 * n]))
    nodes = table[columns.nodes.ravel().tolist(), :] * ca.repmat(slowness, 1, steps + 1)
    energy, bend = _roughness(nodes, n)
    if structure.tensions is not None:
        nominal = ca.repmat(ca.DM(structure.tensions), 1, steps + 1)
        ratio = table[columns.tensions.tolist(), :] / nominal
        change, tension_bend = _roughness(ratio, 1)
        change_cost = TENSION_CHANGE_WEIGHT * (change + BEND_WEIGHT * tension_bend)
        cost += TENSION_WEIGHT * (ca.sumsqr(ratio) / steps + change_cost) / n
    if structure.segments is None:
        cost += energy + BEND_WEIGHT * bend
        return {"x": ca.vertcat(x, *slacks), "p": ca.vertcat(*p), "f": cost, "g": ca.vertcat(*g)}
    changes, at = ca.vec(nodes[:, 1:] - nodes[:, :-1]), np.array(structure.segments)
    squared = changes[at.tolist()] ** 2 + changes[(at + 1).tolist()] ** 2
    g.append(squared - times[(at // (6 * n)).tolist()] ** 2)
    cost += ca.sum1(times) + TIME_ENERGY_WEIGHT * energy + TIME_BEND_WEIGHT * bend
    variables = ca.vertcat(x, *slacks, times)
    return {"x": variables, "p": ca.vertcat(*p), "f": cost, "g": ca.vertcat(*g)}


def _roughness(values: ca.MX, n: int) -> tuple[ca.MX, ca.MX]:
    """Return sums of squared first and second differences of values (size, J + 1), over n."""
    steps = values.size2() - 1
    change = values[:, 1:] - values[:, :-1]
    bend = change[:, 1:] - change[:, :-1]
    return steps * ca.sumsqr(change) / n, steps**3 * ca.sumsqr(bend) / n


MIN_ANGLE = math.radians(3.0)
"""[rad] Smallest exterior angle on the path, or half of that at its ends if that is less."""


def _drone_rows(structure: Structure, x: ca.MX, constants: list[ca.MX]) -> list[ca.MX]:
    """Return the equations of drones and r-legs, and the turns at all vertices."""
    columns, n, inner = columns_of(structure.robots), structure.robots, structure.steps - 1
    starts = columns.size * np.arange(inner)[:, None, None]

    def at_knots(columns: Indices) -> ca.MX:
        """Return the variables of columns (n, width) at all knots, as (width, inner · n)."""
        indices = (starts + columns).reshape(-1, columns.shape[1])
        return ca.reshape(x[indices.ravel().tolist()], *indices.T.shape)

    points = np.concatenate([np.roll(columns.vertices, -k, axis=0) for k in (-1, 0, 1, 2)], axis=1)
    tensions = np.stack([np.roll(columns.tensions, -k) for k in (-1, 0, 1)], axis=1)
    legs = columns.q_legs[:, None]
    if structure.loaded:
        legs = np.stack([np.roll(columns.q_legs, -k) for k in (-1, 0, 1)], axis=1)
    own = [ca.reshape(each, -1, n * inner) for each in constants]
    model = planar(structure.loaded, structure.choice).map(n * inner)
    place, turn = model.call([*map(at_knots, (points, legs, tensions)), *own])
    drones = at_knots(np.column_stack([columns.drones.reshape(n, 4), columns.r_legs]))
    return [ca.vec(place - drones), ca.vec(turn)]


PENALTY_WEIGHT = 100.0
"""[1/m] Penalty weight of violated distances, which exceeds any gain by violating them."""

BETWEEN_KNOTS_SHARE = 0.3
"""Share of a step's reach up to which pairs have rows between the knots."""


class NearPairs(NamedTuple):
    """Pairs of close bodies, each in one of K frames."""

    frame: Indices  # (m,), index of the frame
    first: Indices  # (m, 2), nodes (of 3n) at the ends of each body; a drone's are the same
    second: Indices  # (m, 2), nodes (of 3n) at the ends of each body; a drone's are the same
    kind: Indices  # (m,), as in ``hitch.pairs``
    normal: Array  # (m, 2), unit vector along the shortest offset from the second body to the first
    enforced: Array  # (m,) [m], enforced distance

    def select(self, mask: NDArray[np.bool_]) -> NearPairs:
        """Return the pairs of a mask (m,)."""
        return NearPairs._make(each[mask] for each in self)


def _near_pairs(nodes: Array, separation: Separation, margins: Array, reach: Array) -> NearPairs:
    """Return the pairs of nodes (K, 3n, 2) [m] with distances up to margins and reach (K,) [m]."""
    bodies, limits = TautBodies.of(layout_of(nodes.shape[1] // 3, CLOSED)), limits_of(separation)
    corners = nodes[:, bodies.nodes]
    cutoff = float(np.max(limits * np.max(margins)) + np.max(reach))
    frame, i, j, kind = bodies.near(corners.min(axis=2), corners.max(axis=2), limits, cutoff)
    one, other = (nodes[frame[:, None], bodies.nodes[body]] for body in (i, j))
    offset = shortest_offset(differences(one, other))
    normal = unit(offset, unit((one - other).mean(axis=1)), 1e-6)
    enforced = limits[kind] * margins[frame]
    pairs = NearPairs(frame, bodies.nodes[i], bodies.nodes[j], kind, normal, enforced)
    return pairs.select(length(offset) < enforced + reach[frame])


class SoftRows(NamedTuple):
    """Rows, with lower bounds and current values (rows,)."""

    structure: Any  # in the program's structure
    numbers: Array  # in the program's parameters
    lower: Array
    values: Array


def _near_rows(path: KnotPath, search: SearchLimits, step: SolverStep) -> tuple[SoftRows, SoftRows]:
    """Return the rows of close pairs: of drones at the knots by squares, of others by normals.

    Between the knots the path is the chord of two knots and a deviation, which is constant.
    """
    parts = step.parts
    columns, inner = path.columns, path.table[1:-1]
    indices = np.arange(1, parts * path.steps) / parts  # of frames, in steps between knots
    table = inner if parts == 1 else path.at(indices / path.steps).table
    at_knot = indices % 1.0 == 0.0
    margins = search.margins(path.steps, indices)
    reach = np.where(at_knot, 1.0, BETWEEN_KNOTS_SHARE) * step.reach
    pairs = _near_pairs(table[:, columns.nodes], search.requirements.separation, margins, reach)
    by_squares = (pairs.kind == SEPARATION) & at_knot[pairs.frame]
    drones, others = pairs.select(by_squares), pairs.select(~by_squares)
    knot = columns.size * (drones.frame[:, None] // parts)
    first, second = (knot + columns.nodes[node[:, 0]] for node in (drones.first, drones.second))
    enforced, scale = drones.enforced, 0.5 / drones.enforced  # of squares to about metres
    x = inner.ravel()
    squared = np.sum((x[first] - x[second]) ** 2, axis=1)
    variables = tuple(first[:, 0].tolist()), tuple(second[:, 0].tolist())
    squares = SoftRows(variables, scale, scale * enforced**2, scale * squared)
    # Bodies are separated by as much as all their ends are along a normal.
    pair, *ends = end_combinations(others.kind, others.first, others.second)
    nodes = np.concatenate([columns.nodes[end] for end in ends], axis=1)
    slopes = np.concatenate([others.normal[pair], -others.normal[pair]], axis=1)
    entries = (slopes.ravel(), (columns.size * others.frame[pair, None] + nodes).ravel())
    sums = sparse.csr_matrix((*entries, 4 * np.arange(len(pair) + 1)), (len(pair), table.size))
    share = np.maximum(1.0 - np.abs(indices[:, None] - np.arange(1.0, path.steps)), 0.0)
    rows = sparse.csc_matrix(sums @ sparse.kron(share, sparse.eye(columns.size), "csr"))
    deviation = sums @ table.ravel() - rows @ x
    pattern = len(pair), tuple(rows.indptr.tolist()), tuple(rows.indices.tolist())
    return squares, SoftRows(pattern, rows.data, others.enforced[pair] - deviation, rows @ x)


SOLVER_TOLERANCE = 1e-3
"""Tolerance of IPOPT's scaled conditions, which suffices for iterated and verified paths."""

LINEAR_SOLVER = {"mumps_permuting_scaling": 0, "mumps_scaling": 0, "mumps_pivot_order": 0}
"""Options of MUMPS. Rows and variables are scaled, and need no permutation. Pivots are ordered by
approximate minimum degree, which suits a chain of knots: for n = 100 the default order makes a
solve take two and a half times as long."""

MIN_TIME_LIMIT = 1e-3
"""[s] Smallest time limit for IPOPT, which must be positive."""

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
        program = build_program(path, search, step)
        if not search.effort.allows(program.size):
            return
        moved, iterations = solve_program(program)
        search.effort.spend(iterations, program.size)
        if moved is None:
            return
        distance = float(np.max(np.abs(moved.polygons - path.polygons)))
        path = moved
        yield path
        if distance < progress * step.stride:
            return


MAX_CACHED_SOLVERS = 16
"""Number of cached solvers, enough for a search or two."""


@lru_cache(maxsize=MAX_CACHED_SOLVERS)
def solver_of(structure: Structure, seconds: float = math.inf) -> ca.Function:
    """Return IPOPT for all programs of a structure, with a time limit [s]."""
    ipopt: dict[str, int | float | str] = {
        **LINEAR_SOLVER,
        "fast_step_computation": "yes",
        "print_level": 0,
        "sb": "yes",
        "max_iter": structure.iterations,
        "tol": SOLVER_TOLERANCE,
        "mu_strategy": "adaptive",
        **({"max_wall_time": max(seconds, MIN_TIME_LIMIT)} if math.isfinite(seconds) else {}),
    }
    return ca.nlpsol(
        "path",
        "ipopt",
        {**expressions(structure)},
        {"print_time": False, "no_nlp_grad": True, "calc_lam_p": False, "ipopt": ipopt},
    )


class ProgramResult(NamedTuple):
    """Result of a program."""

    path: KnotPath | None  # the path, or None if IPOPT did not converge
    iterations: int  # number of iterations


def solve_program(program: MorphProgram) -> ProgramResult:
    """Solve a program with IPOPT.

    The solver's status is not trusted otherwise: distances are recomputed. Solvers are cached by
    structure, except those with a time limit.
    """
    remaining = time_left()
    build = solver_of.__wrapped__ if math.isfinite(remaining) else solver_of
    solver = build(program.structure, remaining)
    with deferred_signals():
        solution = solver(**program.numbers)
    check_time()  # an interrupted solve has no solution
    x, stats = np.asarray(solution["x"], dtype=np.float64).reshape(-1), solver.stats()
    if not stats["success"] or not np.all(np.isfinite(x)):
        return ProgramResult(None, stats["iter_count"])
    table = program.path.table.copy()
    inner = table[1:-1]
    inner[:] = x[: inner.size].reshape(inner.shape)
    return ProgramResult(program.path.with_table(table), stats["iter_count"])


@contextmanager
def deferred_signals() -> Iterator[None]:
    """Defer SIGINT and SIGTERM, which solvers would swallow, to the end of the context.

    This applies to Python handlers in the main thread.
    """
    pending: list[tuple[int, FrameType | None]] = []
    main = threading.current_thread() is threading.main_thread()
    handlers = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM) if main}
    deferred = {n: handler for n, handler in handlers.items() if callable(handler)}
    try:
        for number in deferred:
            signal.signal(number, lambda *arguments: pending.append(arguments))
        yield
    finally:
        for number, handler in deferred.items():
            signal.signal(number, handler)
        for arguments in pending:
            deferred[signal.Signals(arguments[0])](*arguments)
