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
from types import FrameType
from typing import NamedTuple

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
from hitchopt.planners.optimise.knots import KnotPath, Search, SolverStep, variable_bounds
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


class MorphProgram:
    """A program ``min f(x)`` over ``lbx ≤ x ≤ ubx`` and ``lbg ≤ g(x) ≤ ubg`` around a path.

    It is collected row by row. Its variables start with those of the inner knots, and it is given
    up after so many ``iterations``.
    """

    def __init__(self, path: KnotPath, iterations: int) -> None:
        self.path, self.iterations = path, iterations
        self._x: list[ca.MX] = []
        self._g: list[ca.MX] = []
        self._boxes: list[tuple[Array, Array, Array]] = []
        self._ranges: list[tuple[Array, Array]] = []
        self.cost = ca.MX(0.0)

    def variables(self, start: Array, lower: Array, upper: Array) -> ca.MX:
        """Add variables that start at ``start``; return their symbols."""
        self._x.append(ca.MX.sym(f"x{len(self._x)}", len(start)))
        self._boxes.append((start, lower, upper))
        return self._x[-1]

    def bound(self, value: ca.MX, least: Array, most: Array) -> None:
        """Add rows that keep a column of values between their bounds (rows,)."""
        self._g.append(value)
        self._ranges.append((least, most))

    def soft_bound(self, value: ca.MX, least: Array, now: Array) -> None:
        """Add rows that keep a column above its bounds (rows,), softly where it is not ``now``."""
        short, lack = np.flatnonzero(now < least), np.maximum(least - now, 0.0)
        if len(short):
            count = len(short)
            slack = self.variables(lack[short], np.zeros(count), np.full(count, np.inf))
            self.cost += PENALTY_WEIGHT * ca.sum1(slack)
            ones = ca.DM.ones(count)
            value += ca.DM.triplet(short.tolist(), [*range(count)], ones, len(least), count) @ slack
        self.bound(value, least, np.full(len(least), np.inf))

    @property
    def expressions(self) -> dict[str, ca.MX]:
        """Casadi's x, f and g."""
        return {"x": ca.vertcat(*self._x), "f": self.cost, "g": ca.vertcat(*self._g)}

    @property
    def numbers(self) -> dict[str, Array]:
        """The start ``x0`` and all bounds."""
        columns = (*zip(*self._boxes, strict=True), *zip(*self._ranges, strict=True))
        names = ("x0", "lbx", "ubx", "lbg", "ubg")
        return {name: np.concatenate(each) for name, each in zip(names, columns, strict=True)}


def build_program(path: KnotPath, search: Search, step: SolverStep) -> MorphProgram:
    """Return the program around a path: its near pairs and their normals are the path's."""
    columns, table, n, steps = path.columns, path.table, path.team.robots, path.steps
    program = MorphProgram(path, FASTEST_ITERATIONS if step.fastest else ITERATIONS)
    limits = search.requirements.limits
    x = program.variables(table[1:-1].ravel(), *variable_bounds(path, search, step.stride))
    _tie_drones(program, x)
    _keep_apart(program, x, search, step)
    # Places of vertices and drones at all knots (6n, steps + 1), in units of time.
    whole = ca.horzcat(ca.DM(table[0]), ca.reshape(x, columns.size, steps - 1), ca.DM(table[-1]))
    slowness = 1.0 / np.repeat([limits.vertex_speed, limits.speed], [2 * n, 4 * n])
    places = whole[columns.nodes.ravel().tolist(), :] * ca.repmat(ca.DM(slowness), 1, steps + 1)
    energy, bend = _roughness(places, n)
    if search.tension is not None:
        usual = ca.repmat(ca.DM(path.team.tension), 1, steps + 1)
        ratio = whole[columns.tensions.tolist(), :] / usual
        change, bent = _roughness(ratio, 1)
        eased = ca.sumsqr(ratio) / steps + TENSION_CHANGE * (change + BEND * bent)
        program.cost += TENSION_WEIGHT * eased / n
    if not step.fastest:
        program.cost += energy + BEND * bend
        return program
    # Every step takes as long as its longest segment.
    lengths = length(np.diff(table[:, columns.nodes] * slowness.reshape(-1, 2), axis=0))
    longest = np.max(lengths, axis=1)
    times = program.variables(1.01 * longest, np.zeros(steps), np.full(steps, np.inf))
    at_step, node = np.nonzero(lengths > LAGGING * longest[:, None])
    place = 2 * (3 * n * at_step + node)
    flat = ca.vec(places[:, 1:] - places[:, :-1])
    squared = flat[place.tolist()] ** 2 + flat[(place + 1).tolist()] ** 2
    lags = squared - times[at_step.tolist()] ** 2
    program.bound(lags, np.full(len(place), -np.inf), np.zeros(len(place)))
    program.cost += ca.sum1(times) + TIME_ENERGY * energy + TIME_BEND * bend
    return program


def _roughness(values: ca.MX, n: int) -> tuple[ca.MX, ca.MX]:
    """Return squares of first and second differences of values (size, J + 1), by n."""
    steps = values.size2() - 1
    change = values[:, 1:] - values[:, :-1]
    bend = change[:, 1:] - change[:, :-1]
    return steps * ca.sumsqr(change) / n, steps**3 * ca.sumsqr(bend) / n


FLATTEST = math.radians(3.0)
"""[rad] Smallest exterior angle on the path, or half of that at its ends if that is less."""


def _tie_drones(program: MorphProgram, x: ca.MX) -> None:
    """Tie drones and r-legs to the flat outputs, and keep every vertex a corner."""
    path = program.path
    layout, n, team, inner = path.columns, path.team.robots, path.team, path.steps - 1
    starts = layout.size * np.arange(inner)[:, None, None]

    def at_knots(places: Indices) -> ca.MX:
        """Return the variables of columns (n, width) at all knots, as (width, inner · n)."""
        numbers = (starts + places).reshape(-1, places.shape[1])
        return ca.reshape(x[numbers.ravel().tolist()], *numbers.T.shape)

    around = np.concatenate([np.roll(layout.vertices, -k, axis=0) for k in (-1, 0, 1, 2)], axis=1)
    pulls = np.stack([np.roll(layout.tensions, -k) for k in (-1, 0, 1)], axis=1)
    rolled, legs = team.loaded or path.roll is not None, layout.q_legs[:, None]
    own: tuple[Array, ...] = (np.tile(team.cable_length, inner)[None],)
    choice = bool(np.ptp(team.tension) == 0.0)
    if rolled:
        legs, own = layout.q_legs[team.layout.neighbours], _clasp_numbers(path)
        choice = team.cable_density > 0.0
    given = [*map(at_knots, (around, legs, pulls)), *(ca.MX(ca.DM(values)) for values in own)]
    place, turn = planar(rolled, choice).map(n * inner).call(given)
    tied = at_knots(np.column_stack([layout.drones.reshape(n, 4), layout.r_legs]))
    program.bound(ca.vec(place - tied), *np.zeros((2, 5 * n * inner)))
    sharpest = min(np.min(ConvexPolygon(path.polygons[end]).exterior_angles) for end in (0, -1))
    flattest = math.sin(min(FLATTEST, 0.5 * float(sharpest)))
    program.bound(ca.vec(turn), np.full(n * inner, flattest), np.full(n * inner, np.inf))


def _clasp_numbers(path: KnotPath) -> tuple[Array, ...]:
    """Return cables' lengths, rolls, loads and weights of all robots at the inner knots."""
    team, n, inner = path.team, path.team.robots, path.steps - 1
    columns, ends = n * inner, np.column_stack([team.layout.starts, team.layout.ends])
    roll = np.zeros((inner, n)) if path.roll is None else path.roll[1:-1]
    loads = np.zeros((n, 2, 3))
    loads[..., 2] = -GRAVITY * team.load[ends]
    return (
        np.tile(team.cable_length[team.layout.neighbours[:, :2]].T, inner),
        roll[:, ends].reshape(columns, 2).T,
        np.tile(loads.reshape(n, 6).T, inner),
        np.full((1, columns), GRAVITY * team.cable_density),
    )


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
    kind: (m,), as in ``hitch.parts``.
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
    found = NearPairs(frame, bodies.nodes[i], bodies.nodes[j], kind, normal, enforced)
    return found.chosen(length(offset) < enforced + reach[frame])


def _keep_apart(program: MorphProgram, x: ca.MX, search: Search, step: SolverStep) -> None:
    """Keep all near pairs apart: drones at the knots by squares, all others by their normals.

    Between the knots the path is its chord from knot to knot and a bow, which is taken to stay.
    Those that are too near now, as in a first guess, are parted as far as a step can.
    """
    path, parts = program.path, step.parts
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
    across, along = (x[first[:, i].tolist()] - x[second[:, i].tolist()] for i in (0, 1))
    now = inner.ravel()
    squared = np.sum((now[first] - now[second]) ** 2, axis=1)
    program.soft_bound((across**2 + along**2) * ca.DM(scale), scale * apart**2, scale * squared)
    # Bodies whose ends all lie on their sides of a normal are apart by as much.
    pair, *ends = end_combinations(others.kind, others.first, others.second)
    nodes = np.concatenate([columns.nodes[end] for end in ends], axis=1)
    slopes = np.concatenate([others.normal[pair], -others.normal[pair]], axis=1)
    entries = (slopes.ravel(), (columns.size * others.frame[pair, None] + nodes).ravel())
    sums = sparse.csr_matrix((*entries, 4 * np.arange(len(pair) + 1)), (len(pair), there.size))
    share = np.maximum(1.0 - np.abs(places[:, None] - np.arange(1.0, path.steps)), 0.0)
    rows = sparse.csc_matrix(sums @ sparse.kron(share, sparse.eye(columns.size), "csr"))
    bow = sums @ there.ravel() - rows @ now
    pattern = ca.Sparsity(*rows.shape, rows.indptr.tolist(), rows.indices.tolist())
    moved = ca.MX(ca.DM(pattern, rows.data)) @ x
    program.soft_bound(moved, others.enforced[pair] - bow, rows @ now)


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


def solve_program(program: MorphProgram) -> KnotPath | None:
    """Return the path that IPOPT finds, or None where it does not converge.

    The solver's status proves no more than that: distances are measured on the path.
    """
    left = time_left()
    ipopt: dict[str, int | float | str] = {
        **LINEAR_SOLVER,
        "fast_step_computation": "yes",
        "print_level": 0,
        "sb": "yes",
        "max_iter": program.iterations,
        "tol": TOLERANCE,
        "mu_strategy": "adaptive",
        **({"max_wall_time": max(left, LEAST_TIME)} if math.isfinite(left) else {}),
    }
    solver = ca.nlpsol(
        "path",
        "ipopt",
        {**program.expressions},
        {"print_time": False, "no_nlp_grad": True, "calc_lam_p": False, "ipopt": ipopt},
    )
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
