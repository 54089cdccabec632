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
from collections import OrderedDict
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import check_time, time_left
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import GRAVITY
from hitchopt.model.planar import planar
from hitchopt.planners.optimise.knots import KnotPath, Search, SolverStep, variable_bounds
from hitchopt.planners.optimise.rows import Draft, Expression, Program, Symbols, keep_apart
from hitchopt.values import Array, Indices

BEND = 0.1
"""Weight of the knots' second differences in the energy: keeps the spline near its knots."""

TIME_BEND = 0.01
"""Weight of the second differences beside the time; less leaves corners that cost more time than
they save."""

TIME_ENERGY = 1e-3
"""Weight of the energy beside the time, where the time leaves something open."""

TENSION_WEIGHT = 0.02
"""Weight of the tensions' squares where they are free, which gives thrust back to motion."""

TENSION_CHANGE = 0.01
"""Weight of the tensions' differences beside their squares."""

LAGGING = 0.5
"""Share of the longest segment of a step below which others do not tell how long it takes."""

ITERATIONS = 100
"""Largest number of IPOPT's iterations for the energy."""

FASTEST_ITERATIONS = 40
"""Largest number for the time: it converges in about 20 or, where all drones bind at once, not at
all."""


@dataclass(frozen=True, eq=False)
class MorphProgram:
    """A program around a path.

    Attributes
    ----------
    program: its variables start with those of the inner knots.
    path: around which it is, to read the solution.
    iterations: after which it is given up.
    """

    program: Program
    path: KnotPath
    iterations: int


def build_program(path: KnotPath, search: Search, step: SolverStep) -> MorphProgram:
    """Return the program around a path: its near pairs and their normals are the path's."""
    columns, table, n = path.columns, path.table, path.team.robots
    draft = Draft()
    x = draft.variables(table[1:-1].ravel(), *variable_bounds(path, search, step.stride))
    tie_drones(draft, x, path)
    keep_apart(draft, x, path, search, step)

    limits = search.requirements.limits
    slowness = 1.0 / np.repeat([limits.vertex_speed, limits.speed], [2 * n, 4 * n])
    ends = draft.parameters(table[[0, -1]].ravel())
    draft.structure(slowness, path.steps, step.fastest)

    def whole(at: Symbols) -> ca.MX:
        """Return all knots (size, J + 1)."""
        first, last = ca.vertsplit(at.parameters[ends], columns.size)
        knots = ca.reshape(at.variables[x], columns.size, path.steps - 1)
        return ca.horzcat(first, knots, last)

    def scaled(at: Symbols) -> ca.MX:
        """Return the places of vertices and drones at all knots, in units of time."""
        places = whole(at)[columns.nodes.ravel().tolist(), :]
        return places * ca.repmat(ca.DM(slowness), 1, path.steps + 1)

    if search.tension is not None:
        draft.structure("tensions", path.team.tension)
        draft.cost(lambda at: _tension_cost(path, whole(at)))
    if step.fastest:
        moved = np.diff(table[:, columns.nodes] * slowness.reshape(-1, 2), axis=0)
        times = _times(draft, scaled, np.linalg.norm(moved, axis=-1))

        def time_cost(at: Symbols) -> ca.MX:
            _, energy, curvature = _roughness(scaled(at), n)
            total = ca.sum1(at.variables[times])
            return total + TIME_ENERGY * energy + TIME_BEND * curvature

        draft.cost(time_cost)
    else:

        def energy_cost(at: Symbols) -> ca.MX:
            _, energy, curvature = _roughness(scaled(at), n)
            return energy + BEND * curvature

        draft.cost(energy_cost)
    iterations = FASTEST_ITERATIONS if step.fastest else ITERATIONS
    return MorphProgram(draft.program(), path, iterations)


def _roughness(values: ca.MX, n: int) -> tuple[ca.MX, ca.MX, ca.MX]:
    """Return first differences of values (size, J + 1), and squares of first and second, by n."""
    steps = values.size2() - 1
    change = values[:, 1:] - values[:, :-1]
    bend = change[:, 1:] - change[:, :-1]
    return change, steps * ca.sumsqr(change) / n, steps**3 * ca.sumsqr(bend) / n


def _times(draft: Draft, scaled: Expression, lengths: Array) -> int:
    """Return variables that tell how long every step takes, by its longest segment.

    Parameters
    ----------
    draft: takes the rows.
    scaled: (6n, steps + 1), both coordinates of every node, in units of time.
    lengths: (steps, 3n), of the segments now.
    """
    steps, nodes = lengths.shape
    longest = np.max(lengths, axis=1)
    times = draft.variables(1.01 * longest, np.zeros(steps), np.full(steps, np.inf))
    at_step, node = np.nonzero(lengths > LAGGING * longest[:, None])
    place = 2 * (nodes * at_step + node)
    draft.structure("times", place)

    def lags(at: Symbols) -> ca.MX:
        values = scaled(at)
        flat = ca.vec(values[:, 1:] - values[:, :-1])
        squared = flat[place.tolist()] ** 2 + flat[(place + 1).tolist()] ** 2
        return squared - at.variables[times][at_step.tolist()] ** 2

    draft.bound(lags, np.full(len(place), -np.inf), np.zeros(len(place)))
    return times


def _tension_cost(path: KnotPath, whole: ca.MX) -> ca.MX:
    """Return the cost of free tensions: their squares and, to a lesser degree, their changes."""
    usual = ca.repmat(ca.DM(path.team.tension), 1, path.steps + 1)
    ratio = whole[path.columns.tensions.tolist(), :] / usual
    _, change, bend = _roughness(ratio, 1)
    cost = ca.sumsqr(ratio) / path.steps + TENSION_CHANGE * (change + BEND * bend)
    return TENSION_WEIGHT * cost / path.team.robots


FLATTEST = math.radians(3.0)
"""[rad] Smallest exterior angle on the path, or half of that at its ends if that is less."""


def tie_drones(draft: Draft, x: int, path: KnotPath) -> None:
    """Tie drones and r-legs to the flat outputs, and keep every vertex a corner.

    Parameters
    ----------
    x: the variables of the inner knots.
    """
    layout, n, team, inner = path.columns, path.team.robots, path.team, path.steps - 1
    lifted = np.column_stack([layout.drones.reshape(n, 4), layout.r_legs])
    around = np.concatenate([np.roll(layout.vertices, -k, axis=0) for k in (-1, 0, 1, 2)], axis=1)
    pulls = np.stack([np.roll(layout.tensions, -k) for k in (-1, 0, 1)], axis=1)
    rolled, equal = team.loaded or path.roll is not None, bool(np.ptp(team.tension) == 0.0)
    own: tuple[Array, ...]
    if rolled:
        legs, own = layout.q_legs[team.layout.neighbours], _clasp_numbers(path)
        choice = team.cable_density > 0.0
    else:
        legs, own = layout.q_legs[:, None], (np.tile(team.cable_length, inner)[None],)
        choice = equal
    draft.structure("tied", n, inner, rolled, choice, *own)

    def at_knots(places: NDArray[np.intp]) -> Indices:
        """Return the numbers (inner · n, width) of columns (n, width) at all knots."""
        starts = layout.size * np.arange(inner)[:, None, None]
        return (starts + places).reshape(-1, places.shape[1])

    inputs, tied = [at_knots(around), at_knots(legs), at_knots(pulls)], at_knots(lifted)

    def value(at: Symbols) -> ca.MX:
        """Return all places, less the variables tied to them, then all turns."""

        def columns(places: Indices) -> ca.MX:
            return ca.reshape(at.variables[x][places.ravel().tolist()], *places.T.shape)

        varied = [columns(places) for places in inputs]
        numbers = [ca.MX(ca.DM(values)) for values in own]
        place, turn = planar(rolled, choice).map(len(tied)).call([*varied, *numbers])
        return ca.vertcat(ca.vec(place - columns(tied)), ca.vec(turn))

    sharpest = min(np.min(ConvexPolygon(path.polygons[end]).exterior_angles) for end in (0, -1))
    flattest = math.sin(min(FLATTEST, 0.5 * float(sharpest)))
    zeros, corners = np.zeros(tied.size), np.full(len(tied), flattest)
    least, most = (np.append(zeros, end) for end in (corners, np.full(len(corners), np.inf)))
    draft.bound(value, least, most)


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


TOLERANCE = 1e-3
"""Tolerance of the scaled conditions: paths are iterated and verified anyway."""

LINEAR_SOLVER: dict[str, int | str] = {
    "mumps_permuting_scaling": 0,
    "mumps_scaling": 0,
    "mumps_pivot_order": 0,
    "fast_step_computation": "yes",
}
"""Options of IPOPT's linear algebra: rows and variables are of one size already, so that MUMPS need
not permute or scale them first, which takes a fifth of a solve; solutions are verified anyway.
Pivots are ordered by approximate minimum degree, as knots in a row suit it: for n = 100 orders that
MUMPS chooses itself make a solve take two and a half times as long."""

LEAST_TIME = 1e-3
"""[s] Least limit of time given to IPOPT, which must be positive."""

SETTLED = 0.3
"""Share of its stride: a step of the optimiser that moves no vertex by more is the last one."""

SMALL = 3000
"""Largest number of rows of programs whose solvers are stored: n = 6 or so."""

STORED = 8
"""Number of solvers that are stored: a search needs one or two for a team."""

_SOLVERS: OrderedDict[Hashable, ca.Function] = OrderedDict()
"""The last solvers, by the structure of their programs and the options."""

NUMBERS = tuple(int(number) for number in signal.valid_signals())


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
    numbers = program.program.numbers
    key = (program.iterations, program.program.structure)
    solver = _SOLVERS.pop(key, None) if math.isinf(time_left()) else None
    solver = solver or _new_solver(program.program, program.iterations)
    with answered_later():
        solution = solver(**numbers)
    check_time()  # what has been cut short is no solution
    stats = solver.stats()
    x = np.asarray(solution["x"], dtype=np.float64).reshape(-1)
    if not stats["success"] or not np.all(np.isfinite(x)):
        return None
    if len(numbers["lbg"]) <= SMALL and math.isinf(time_left()):
        _SOLVERS[key] = solver
        if len(_SOLVERS) > STORED:
            _SOLVERS.popitem(last=False)
    table = program.path.table.copy()
    inner = table[1:-1]
    inner[:] = x[: inner.size].reshape(inner.shape)
    return program.path.with_table(table)


def _new_solver(program: Program, iterations: int) -> ca.Function:
    """Return IPOPT with a program's expressions, for as long as there is time."""
    left = time_left()
    options: dict[str, int | float | str] = {
        "print_level": 0,
        "sb": "yes",
        "max_iter": iterations,
        "tol": TOLERANCE,
        "mu_strategy": "adaptive",
        **LINEAR_SOLVER,
        **({"max_wall_time": max(left, LEAST_TIME)} if math.isfinite(left) else {}),
    }
    return ca.nlpsol(
        "path",
        "ipopt",
        program.expressions(),
        {"print_time": False, "no_nlp_grad": True, "calc_lam_p": False, "ipopt": options},
    )


@contextmanager
def answered_later() -> Iterator[None]:
    """Answer signals that come within the context at its end, in their order.

    Only those that Python code answers, and in the main thread: no other one ever does.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers = {number: signal.getsignal(number) for number in NUMBERS}
    waiting: list[tuple[int, FrameType | None]] = []

    def wait(number: int, frame: FrameType | None) -> None:
        waiting.append((number, frame))

    changed = [number for number, handler in handlers.items() if callable(handler)]
    try:
        for number in changed:
            signal.signal(number, wait)
        yield
    finally:
        for number in changed:
            signal.signal(number, handlers[number])
        for number, frame in waiting:  # also where the work has failed
            handler = handlers[number]
            if callable(handler):
                handler(number, frame)
