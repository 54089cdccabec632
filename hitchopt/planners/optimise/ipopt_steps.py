"""Steps of IPOPT from path to path, until one settles."""

from __future__ import annotations

import math
import signal
import threading
from collections import OrderedDict
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from types import FrameType

import casadi as ca
import numpy as np

from hitchopt.planners.optimise.knot_path import KnotPath
from hitchopt.planners.optimise.model_rows import Program
from hitchopt.planners.optimise.morph_program import MorphProgram, build_program
from hitchopt.planners.optimise.search_task import SMALL, Effort, Search, SolverStep
from hitchopt.time_limit import check_time, time_left

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
        if search.effort.over:
            return
        moved = solve_program(build_program(path, search, step), search.effort)
        if moved is None:
            return
        far = farthest(moved, path)
        path = moved
        yield path
        if far < settled * step.stride:
            return


def farthest(path: KnotPath, other: KnotPath) -> float:
    """Return by how much the paths' vertices differ at most along an axis, at any knot [m]."""
    return float(np.max(np.abs(path.polygons - other.polygons)))


def solve_program(program: MorphProgram, effort: Effort | None = None) -> KnotPath | None:
    """Return the path that IPOPT finds, or None where it does not converge.

    The solver's status proves no more than that: distances are measured on the path.

    Parameters
    ----------
    program: what is solved.
    effort: what may be spent on it, and is taken off; None for whatever it needs.
    """
    numbers = program.program.numbers
    rows = len(numbers["lbg"])
    effort = effort or Effort(math.inf)
    iterations = effort.iterations(rows, program.iterations)
    if iterations == 0:
        return None
    key = (iterations, program.multipliers, program.program.structure)
    solver = _SOLVERS.pop(key, None) if math.isinf(time_left()) else None
    solver = solver or _new_solver(program.program, iterations, program.multipliers)
    with answered_later():
        solution = solver(**numbers)
    check_time()  # what has been cut short is no solution
    stats = solver.stats()
    effort.spend(rows, stats["iter_count"])
    x = np.asarray(solution["x"], dtype=np.float64).reshape(-1)
    if not stats["success"] or not np.all(np.isfinite(x)):
        return None
    if rows <= SMALL and math.isinf(time_left()):
        _SOLVERS[key] = solver
        if len(_SOLVERS) > STORED:
            _SOLVERS.popitem(last=False)
    table = program.path.table.copy()
    inner = table[1:-1]
    inner[:] = x[: inner.size].reshape(inner.shape)
    return program.path.with_table(table)


def _new_solver(program: Program, iterations: int, multipliers: bool) -> ca.Function:
    """Return IPOPT with a program's expressions, for as long as there is time."""
    left = time_left()
    options: dict[str, int | float | str] = {
        "print_level": 0,
        "sb": "yes",
        "max_iter": iterations,
        "tol": TOLERANCE,
        "mu_strategy": "adaptive",
        **LINEAR_SOLVER,
        **({} if multipliers else {"constr_mult_init_max": 0.0}),
        **({"max_wall_time": max(left, LEAST_TIME)} if math.isfinite(left) else {}),
    }
    return ca.nlpsol(
        "path",
        "ipopt",
        {**program.expressions()},
        {
            "print_time": False,
            "no_nlp_grad": True,
            "calc_lam_p": False,
            "ipopt": options,
            **program.derivatives(),
        },
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
