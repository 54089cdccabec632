"""The nonlinear program of a path: casadi and IPOPT with exact sparse derivatives.

Variables are the inner knots of a path; what is minimised is either the energy of all vertices' and
drones' travel, whose solution comes in a few steps from any guess, or, from there, the time that
the speed limits allow. Cost is linear in knots · n: one small function of the model is mapped over
all robots and knots, and every other row has a handful of entries.
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
from hitchopt.geometry import ConvexPolygon, differences, shortest_offset
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.model import planar
from hitchopt.hitch.pairs import SEPARATION, Bodies, end_combinations, limits_of
from hitchopt.hitch.requirements import Separation
from hitchopt.hitch.team import CLOSED, layout_of
from hitchopt.planners.optimise.knots import (
    KnotPath,
    Search,
    SolverStep,
    columns_of,
    variable_bounds,
)
from hitchopt.values import Array, Indices

BEND = 0.1
"""Weight of the knots' second differences in the energy: keeps the spline near its knots."""

TIME_BEND = 0.01
"""Weight of the second differences relative to the time; less leaves corners that cost more time
than they save."""

TIME_ENERGY = 1e-3
"""Weight of the energy relative to the time, which decides where the time is indifferent."""

TENSION_WEIGHT = 0.02
"""Weight of the tensions' squares where they are free, which gives thrust back to motion."""

TENSION_CHANGE = 0.01
"""Weight of the tensions' differences relative to their squares."""

LAGGING = 0.5
"""Share of the longest segment of a step below which others do not tell how long it takes."""

ITERATIONS, FASTEST_ITERATIONS = 100, 40
"""Largest numbers of IPOPT's iterations for the energy, and for the time: that converges in about
20 or, where all drones bind at once, not at all."""


@dataclass(frozen=True)
class Structure:
    """All that the expressions of programs depend on; their parameters hold the other numbers.

    Variables are ``x`` of the inner knots, a slack per soft row, and for the fastest path the time
    of every step. Parameters are the first and the last knot, the columns of ``planar`` that do not
    vary, a scale per pair of drones, and the linear rows' entries.

    Attributes
    ----------
    robots, steps: numbers of robots, and of steps between the knots.
    loaded, choice: as ``planar`` takes them.
    slowness: [s/m], of vertices and of drones.
    tensions: (n,) [N], the team's, where they may change; None where they are fixed.
    drones: variables x of the first and of the second drone of each pair; y follows x.
    linear: number of rows, and column pointers and row numbers of their compressed columns.
    soft: rows among those of drones, and among linear ones, that have a slack.
    segments: of vertices' and drones' x, flat over the steps, that the step's time exceeds; None
        for a path of least energy.
    """

    robots: int
    steps: int
    loaded: bool
    choice: bool
    slowness: tuple[float, float]
    tensions: tuple[float, ...] | None
    drones: tuple[tuple[int, ...], tuple[int, ...]]
    linear: tuple[int, tuple[int, ...], tuple[int, ...]]
    soft: tuple[tuple[int, ...], tuple[int, ...]]
    segments: tuple[int, ...] | None

    @property
    def iterations(self) -> int:
        """Number of iterations after which a program is given up."""
        return ITERATIONS if self.segments is None else FASTEST_ITERATIONS


@dataclass(frozen=True, eq=False)
class MorphProgram:
    """A program ``min f(x, p)`` over ``lbx ≤ x ≤ ubx`` and ``lbg ≤ g(x, p) ≤ ubg`` around a path.

    Attributes
    ----------
    path: around which it is, to read the solution.
    structure: that of its expressions.
    numbers: the start ``x0``, the parameters ``p``, and all bounds.
    """

    path: KnotPath
    structure: Structure
    numbers: dict[str, Array]


def build_program(path: KnotPath, search: Search, step: SolverStep) -> MorphProgram:
    """Return the program around a path: its near pairs and their normals are the path's."""
    columns, table, team, steps = path.columns, path.table, path.team, path.steps
    n, inner, limits = team.robots, table[1:-1].ravel(), search.requirements.limits
    drones, linear = _near_rows(path, search, step)
    rolled = team.loaded or path.roll is not None
    choice = team.cable_density > 0.0 if rolled else bool(np.ptp(team.tension) == 0.0)
    slowness, segments = (1.0 / limits.vertex_speed, 1.0 / limits.speed), None
    boxes = [(inner, *variable_bounds(path, search, step.stride))]
    rows = 5 * n * (steps - 1)
    ranges = [(np.zeros(rows), np.zeros(rows))]
    sharpest = min(np.min(ConvexPolygon(path.polygons[end]).exterior_angles) for end in (0, -1))
    flattest = math.sin(min(FLATTEST, 0.5 * float(sharpest)))
    ranges.append((np.full(rows // 5, flattest), np.full(rows // 5, np.inf)))
    # Rows that are broken now, as in a first guess, are kept as far as a step can.
    soft = []
    for *_, least, now in (drones, linear):
        short = np.flatnonzero(now < least)
        slack = np.zeros(len(short))
        boxes.append(((least - now)[short], slack, slack + np.inf))
        ranges.append((least, np.full(len(least), np.inf)))
        soft.append(tuple(short.tolist()))
    if step.fastest:  # every step takes as long as its longest segment
        scales = np.repeat(slowness, [n, 2 * n])[:, None]
        lengths = length(np.diff(table[:, columns.nodes] * scales, axis=0))
        longest = np.max(lengths, axis=1)
        boxes.append((1.01 * longest, np.zeros(steps), np.full(steps, np.inf)))
        flat = np.flatnonzero(lengths > LAGGING * longest[:, None])
        ranges.append((np.full(len(flat), -np.inf), np.zeros(len(flat))))
        segments = tuple((2 * flat).tolist())
    structure = Structure(
        n,
        steps,
        rolled,
        choice,
        slowness,
        None if search.tension is None else tuple(team.tension.tolist()),
        drones.structure,
        linear.structure,
        (soft[0], soft[1]),
        segments,
    )
    given = (table[0], table[-1], *_clasp_numbers(path, rolled), drones.numbers, linear.numbers)
    numbers = (
        np.concatenate(each) for each in (*zip(*boxes, strict=True), *zip(*ranges, strict=True))
    )
    named = dict(zip(("x0", "lbx", "ubx", "lbg", "ubg"), numbers, strict=True))
    return MorphProgram(path, structure, {**named, "p": np.concatenate(given)})


def _clasp_numbers(path: KnotPath, rolled: bool) -> Iterator[Array]:
    """Yield, flat, the columns of ``planar`` for all robots at the inner knots that do not vary.

    These are cables' lengths; where clasps carry weight or legs are rolled also rolls, loads and
    weights.
    """
    team, n, inner = path.team, path.team.robots, path.steps - 1
    if not rolled:
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
    """Return casadi's x, p, f and g of all programs of a structure."""
    n, steps, inner = structure.robots, structure.steps, structure.steps - 1
    columns, model = columns_of(n), planar(structure.loaded, structure.choice)
    widths = [model.size1_in(i) for i in range(3, model.n_in())]
    rows, pointers, indices = structure.linear
    slacks = [ca.MX.sym(f"slack{i}", len(short)) for i, short in enumerate(structure.soft)]
    sizes = [columns.size, columns.size, *(width * n * inner for width in widths)]
    sizes += [len(structure.drones[0]), len(indices)]
    p = [ca.MX.sym(f"p{i}", size) for i, size in enumerate(sizes)]
    x, times = ca.MX.sym("x", columns.size * inner), ca.MX.sym("t", steps)
    g = _tied_drones(structure, x, p[2:-2])
    first, second = (np.array(each, np.intp) for each in structure.drones)
    across, along = (x[(first + i).tolist()] - x[(second + i).tolist()] for i in (0, 1))
    pattern = ca.Sparsity(rows, columns.size * inner, list(pointers), list(indices))
    cost = ca.MX(0.0)
    for value, slack, short in zip(
        ((across**2 + along**2) * p[-2], ca.MX(pattern, p[-1]) @ x),
        slacks,
        structure.soft,
        strict=True,
    ):
        eased = value
        if short:
            count, ones = len(short), ca.DM.ones(len(short))
            eased += ca.DM.triplet(list(short), [*range(count)], ones, value.size1(), count) @ slack
            cost += PENALTY_WEIGHT * ca.sum1(slack)
        g.append(eased)
    # Places of vertices and drones at all knots (6n, steps + 1), in units of time.
    whole = ca.horzcat(p[0], ca.reshape(x, columns.size, inner), p[1])
    slowness = ca.DM(np.repeat(structure.slowness, [2 * n, 4 * n]))
    places = whole[columns.nodes.ravel().tolist(), :] * ca.repmat(slowness, 1, steps + 1)
    energy, bend = _roughness(places, n)
    if structure.tensions is not None:
        usual = ca.repmat(ca.DM(structure.tensions), 1, steps + 1)
        ratio = whole[columns.tensions.tolist(), :] / usual
        change, bent = _roughness(ratio, 1)
        eased = ca.sumsqr(ratio) / steps + TENSION_CHANGE * (change + BEND * bent)
        cost += TENSION_WEIGHT * eased / n
    if structure.segments is None:
        cost += energy + BEND * bend
        return {"x": ca.vertcat(x, *slacks), "p": ca.vertcat(*p), "f": cost, "g": ca.vertcat(*g)}
    flat, at = ca.vec(places[:, 1:] - places[:, :-1]), np.array(structure.segments)
    squared = flat[at.tolist()] ** 2 + flat[(at + 1).tolist()] ** 2
    g.append(squared - times[(at // (6 * n)).tolist()] ** 2)
    cost += ca.sum1(times) + TIME_ENERGY * energy + TIME_BEND * bend
    variables = ca.vertcat(x, *slacks, times)
    return {"x": variables, "p": ca.vertcat(*p), "f": cost, "g": ca.vertcat(*g)}


def _roughness(values: ca.MX, n: int) -> tuple[ca.MX, ca.MX]:
    """Return squares of first and second differences of values (size, J + 1), by n."""
    steps = values.size2() - 1
    change = values[:, 1:] - values[:, :-1]
    bend = change[:, 1:] - change[:, :-1]
    return steps * ca.sumsqr(change) / n, steps**3 * ca.sumsqr(bend) / n


FLATTEST = math.radians(3.0)
"""[rad] Smallest exterior angle on the path, or half of that at its ends if that is less."""


def _tied_drones(structure: Structure, x: ca.MX, constants: list[ca.MX]) -> list[ca.MX]:
    """Return rows that tie drones and r-legs to the flat outputs, and the turns at all vertices."""
    columns, n, inner = columns_of(structure.robots), structure.robots, structure.steps - 1
    starts = columns.size * np.arange(inner)[:, None, None]

    def at_knots(places: Indices) -> ca.MX:
        """Return the variables of columns (n, width) at all knots, as (width, inner · n)."""
        numbers = (starts + places).reshape(-1, places.shape[1])
        return ca.reshape(x[numbers.ravel().tolist()], *numbers.T.shape)

    around = np.concatenate([np.roll(columns.vertices, -k, axis=0) for k in (-1, 0, 1, 2)], axis=1)
    pulls = np.stack([np.roll(columns.tensions, -k) for k in (-1, 0, 1)], axis=1)
    legs = columns.q_legs[:, None]
    if structure.loaded:
        legs = np.stack([np.roll(columns.q_legs, -k) for k in (-1, 0, 1)], axis=1)
    own = [ca.reshape(each, -1, n * inner) for each in constants]
    model = planar(structure.loaded, structure.choice).map(n * inner)
    place, turn = model.call([*map(at_knots, (around, legs, pulls)), *own])
    tied = at_knots(np.column_stack([columns.drones.reshape(n, 4), columns.r_legs]))
    return [ca.vec(place - tied), ca.vec(turn)]


PENALTY_WEIGHT = 100.0
"""[1/m] Penalty weight of bodies that stay too near: more than any path gains by leaving them."""

BETWEEN = 0.3
"""Share of a step's reach within which pairs get rows between the knots: the knots keep them apart
otherwise."""


class NearPairs(NamedTuple):
    """Pairs of bodies that come near one another, each at one of K instants.

    Attributes
    ----------
    frame: (m,), the instant.
    first, second: (m, 2), nodes (of 3n) at the ends of each body; a drone's are the same.
    kind: (m,), as in ``hitch.pairs``.
    normal: (m, 2), unit vector from the second body to the first where they are closest.
    enforced: (m,) [m], the distance to enforce.
    """

    frame: Indices
    first: Indices
    second: Indices
    kind: Indices
    normal: Array
    enforced: Array

    def chosen(self, which: NDArray[np.bool_]) -> NearPairs:
        """Return the pairs where ``which`` (m,) holds."""
        return NearPairs._make(each[which] for each in self)


def _near_pairs(nodes: Array, separation: Separation, margins: Array, reach: Array) -> NearPairs:
    """Return the pairs of nodes (K, 3n, 2) [m] within ``reach`` (K,) [m] of margins (K,)."""
    bodies, limits = Bodies.of(layout_of(nodes.shape[1] // 3, CLOSED)), limits_of(separation)
    corners = nodes[:, bodies.nodes]
    cutoff = float(np.max(limits * np.max(margins)) + np.max(reach))
    frame, i, j, kind = bodies.near(corners.min(axis=2), corners.max(axis=2), limits, cutoff)
    one, other = (nodes[frame[:, None], bodies.nodes[body]] for body in (i, j))
    offset = shortest_offset(differences(one, other))
    normal = unit(offset, unit((one - other).mean(axis=1)), 1e-6)
    enforced = limits[kind] * margins[frame]
    pairs = NearPairs(frame, bodies.nodes[i], bodies.nodes[j], kind, normal, enforced)
    return pairs.chosen(length(offset) < enforced + reach[frame])


class SoftRows(NamedTuple):
    """Rows whose left sides, ``now`` (rows,), are to reach ``least`` (rows,).

    ``structure`` and ``numbers`` are theirs in the program's structure and parameters.
    """

    structure: Any
    numbers: Array
    least: Array
    now: Array


def _near_rows(path: KnotPath, search: Search, step: SolverStep) -> tuple[SoftRows, SoftRows]:
    """Return rows that keep near pairs apart: drones at the knots by squares, others by normals.

    Between the knots the path is its chord from knot to knot and a bow, which is taken to stay.
    """
    parts = step.parts
    columns, inner = path.columns, path.table[1:-1]
    places = np.arange(1, parts * path.steps) / parts
    there = inner if parts == 1 else path.at(places / path.steps).table
    at_knot = places % 1.0 == 0.0
    margins = search.margins(path.steps, places)
    reach = np.where(at_knot, 1.0, BETWEEN) * step.reach
    pairs = _near_pairs(there[:, columns.nodes], search.requirements.separation, margins, reach)
    by_squares = (pairs.kind == SEPARATION) & at_knot[pairs.frame]
    drones, others = pairs.chosen(by_squares), pairs.chosen(~by_squares)
    knot = columns.size * (drones.frame[:, None] // parts)
    first, second = (knot + columns.nodes[node[:, 0]] for node in (drones.first, drones.second))
    apart, scale = drones.enforced, 0.5 / drones.enforced  # of squares to about metres
    now = inner.ravel()
    squared = np.sum((now[first] - now[second]) ** 2, axis=1)
    variables = tuple(first[:, 0].tolist()), tuple(second[:, 0].tolist())
    squares = SoftRows(variables, scale, scale * apart**2, scale * squared)
    # Bodies whose ends all lie on their sides of a normal are apart by as much.
    pair, *ends = end_combinations(others.kind, others.first, others.second)
    nodes = np.concatenate([columns.nodes[end] for end in ends], axis=1)
    slopes = np.concatenate([others.normal[pair], -others.normal[pair]], axis=1)
    entries = (slopes.ravel(), (columns.size * others.frame[pair, None] + nodes).ravel())
    sums = sparse.csr_matrix((*entries, 4 * np.arange(len(pair) + 1)), (len(pair), there.size))
    share = np.maximum(1.0 - np.abs(places[:, None] - np.arange(1.0, path.steps)), 0.0)
    rows = sparse.csc_matrix(sums @ sparse.kron(share, sparse.eye(columns.size), "csr"))
    bow = sums @ there.ravel() - rows @ now
    pattern = len(pair), tuple(rows.indptr.tolist()), tuple(rows.indices.tolist())
    return squares, SoftRows(pattern, rows.data, others.enforced[pair] - bow, rows @ now)


TOLERANCE = 1e-3
"""Tolerance of the scaled conditions: paths are iterated and verified anyway."""

LINEAR_SOLVER = {"mumps_permuting_scaling": 0, "mumps_scaling": 0, "mumps_pivot_order": 0}
"""Rows and variables are of one size already, so that MUMPS need not permute or scale them. Pivots
are ordered by approximate minimum degree, as knots in a row suit it: for n = 100 orders that MUMPS
chooses itself make a solve take two and a half times as long."""

LEAST_TIME = 1e-3
"""[s] Least limit of time given to IPOPT, which must be positive."""

SETTLED = 0.3
"""Share of its stride: a step of the optimiser that moves no vertex by more is the last one."""


def iterates(
    path: KnotPath, search: Search, step: SolverStep, most: int, settled: float = SETTLED
) -> Iterator[KnotPath]:
    """Yield the paths that one after another are reached in steps of the optimiser.

    Every step has rows for the pairs that come near on it, along normals that fit. The iterator
    ends where a step fails, or after one that moves no vertex by ``settled`` times its stride.
    """
    for _ in range(most):
        moved = solve_program(build_program(path, search, step))
        if moved is None:
            return
        far = float(np.max(np.abs(moved.polygons - path.polygons)))
        path = moved
        yield path
        if far < settled * step.stride:
            return


STORED = 16
"""Number of solvers that are stored: those of a search or two."""


@lru_cache(maxsize=STORED)
def solver_of(structure: Structure, seconds: float = math.inf) -> ca.Function:
    """Return IPOPT for all programs of a structure, given up after so many ``seconds`` [s]."""
    ipopt: dict[str, int | float | str] = {
        **LINEAR_SOLVER,
        "fast_step_computation": "yes",
        "print_level": 0,
        "sb": "yes",
        "max_iter": structure.iterations,
        "tol": TOLERANCE,
        "mu_strategy": "adaptive",
        **({"max_wall_time": max(seconds, LEAST_TIME)} if math.isfinite(seconds) else {}),
    }
    return ca.nlpsol(
        "path",
        "ipopt",
        {**expressions(structure)},
        {"print_time": False, "no_nlp_grad": True, "calc_lam_p": False, "ipopt": ipopt},
    )


def solve_program(program: MorphProgram) -> KnotPath | None:
    """Return the path that IPOPT finds, or None where it does not converge.

    The solver's status proves no more than that: distances are measured on the path. Solvers are
    stored by their structure, but where there is a limit of time, which belongs to them.
    """
    left = time_left()
    build = solver_of.__wrapped__ if math.isfinite(left) else solver_of
    solver = build(program.structure, left)
    with answered_later():
        solution = solver(**program.numbers)
    check_time()  # what has been cut short is no solution
    x = np.asarray(solution["x"], dtype=np.float64).reshape(-1)
    if not solver.stats()["success"] or not np.all(np.isfinite(x)):
        return None
    table = program.path.table.copy()
    inner = table[1:-1]
    inner[:] = x[: inner.size].reshape(inner.shape)
    return program.path.with_table(table)


@contextmanager
def answered_later() -> Iterator[None]:
    """Answer Ctrl-C and SIGTERM at the end of the context: solvers keep them to themselves.

    Only where Python code answers them, and in the main thread: no other one ever does.
    """
    waiting: list[tuple[int, FrameType | None]] = []
    main = threading.current_thread() is threading.main_thread()
    handlers = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM) if main}
    answered = {n: handler for n, handler in handlers.items() if callable(handler)}
    try:
        for number in answered:
            signal.signal(number, lambda *arguments: waiting.append(arguments))
        yield
    finally:
        for number, handler in answered.items():
            signal.signal(number, handler)
        for arguments in waiting:  # also where the work has failed
            answered[signal.Signals(arguments[0])](*arguments)
