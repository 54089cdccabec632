"""IPOPT on the program of a way."""

from __future__ import annotations

import math
from collections import deque

import casadi as ca
import numpy as np

from hitchopt.planners.optimise.knot_path import Way
from hitchopt.planners.optimise.morph_program import WayProgram
from hitchopt.planners.optimise.signals import answered_later
from hitchopt.time_limit import check_time, time_left

TOLERANCE = 1e-3
"""Of the scaled conditions: a way is settled and measured anyway, and never believed."""


LEAST_TIME = 1e-3
"""[s] IPOPT's limit must be positive."""

_LAST: deque[ca.Function] = deque(maxlen=1)
"""casadi keeps a function's derivatives as long as somebody uses them: the solver before does, for
the next one, which is built a third faster."""


def solve_program(program: WayProgram) -> Way | None:
    """Return the way that IPOPT finds, or None where it does not converge.

    Its word is not taken for more than that: what the way keeps is measured on its path.
    """
    left = time_left()
    solver = ca.nlpsol(
        "way",
        "ipopt",
        {"x": program.x, "f": program.f, "g": program.g},
        {
            "print_time": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "max_iter": program.iterations,
                "tol": TOLERANCE,
                "mu_strategy": "adaptive",
                **({"max_wall_time": max(left, LEAST_TIME)} if math.isfinite(left) else {}),
            },
        },
    )
    _LAST.append(solver)
    with answered_later():
        solution = solver(
            x0=program.start,
            lbx=program.lower,
            ubx=program.upper,
            lbg=program.least,
            ubg=program.most,
        )
    check_time()  # what has been cut short is no solution
    x = np.asarray(solution["x"], dtype=np.float64).reshape(-1)
    if not solver.stats()["success"] or not np.all(np.isfinite(x)):
        return None
    table = program.layout.table(program.way)
    inner = table[1:-1]
    solved = x[: inner.size].reshape(inner.shape)
    return program.layout.way(np.concatenate([table[:1], solved, table[-1:]]), program.way)
