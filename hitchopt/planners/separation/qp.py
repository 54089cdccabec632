"""Quadratic programs of one pattern by OSQP, each started from the last one's solution.

OSQP reports neither data of wrong length nor crossed bounds in an update; it keeps the old program
then. Programs check both when they are made. Its status is not trusted: the curves are evaluated.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.sparse as sp

from hitchopt.hitch.convex_qp import QuadraticProgram
from hitchopt.time_limit import check_time, time_left
from hitchopt.values import Array

ACCURACY = 1e-4
"""Absolute and relative tolerance of OSQP, for rows that are scaled to about one."""

MOST_ITERATIONS = 500
"""Iterations after which the current point is used as it is: the curves are evaluated anyway."""

LEAST_TIME = 1e-3
"""[s] Smallest time limit that is passed to OSQP, which takes zero for none."""


class ProgramError(Exception):
    """No finite point was returned by OSQP."""


class Solver:
    """OSQP, set up once for programs of one pattern and updated while that stays the same.

    Parameters
    ----------
    iterations: after which the current point is used as it is.
    """

    def __init__(self, iterations: int = MOST_ITERATIONS) -> None:
        self._iterations = iterations
        self._osqp: Any = None
        self._patterns: list[Any] = []
        self._multipliers: Array | None = None

    def solve(self, program: QuadraticProgram, first: Array, common_rows: int) -> Array:
        """Return OSQP's solution (unknowns,), searched from ``first``.

        Parameters
        ----------
        program: its bounds on unknowns are rows.
        first: (unknowns,) where to start.
        common_rows: number of first rows that mean the same as in the last program.

        Raises
        ------
        ProgramError: no finite point was returned.
        """
        import osqp

        if first.shape != program.q.shape:
            raise ValueError(f"a start of {first.shape} for {program.q.shape}")
        objective = sp.csc_array(sp.triu(program.P))
        patterns = [
            array for M in (program.A, objective) for array in (M.shape, M.indptr, M.indices)
        ]
        same = self._osqp is not None and all(map(np.array_equal, patterns, self._patterns))
        multipliers = np.zeros(len(program.lower))
        if self._multipliers is not None:
            common = len(multipliers) if same else min(common_rows, len(self._multipliers))
            multipliers[:common] = self._multipliers[:common]
        data = {"q": program.q, "l": program.lower, "u": program.upper}
        if same:
            self._osqp.update(**data, Px=objective.data, Ax=program.A.data)
        else:
            self._osqp = osqp.OSQP(algebra="builtin")
            self._osqp.setup(
                sp.csc_matrix(objective),
                A=sp.csc_matrix(program.A),
                **data,
                eps_abs=ACCURACY,
                eps_rel=ACCURACY,
                max_iter=self._iterations,
                warm_starting=True,
                polishing=False,
                verbose=False,
            )
        self._patterns = patterns
        self._osqp.warm_start(x=first, y=multipliers)
        if math.isfinite(left := time_left()):
            self._osqp.update_settings(time_limit=max(left, LEAST_TIME))
        result = self._osqp.solve(raise_error=False)
        if result.info.status_val == osqp.SolverStatus.OSQP_SIGINT:
            raise KeyboardInterrupt  # OSQP catches the signal
        check_time()  # what has been cut short is no solution
        x = np.asarray(result.x, dtype=np.float64)
        if x.shape != program.q.shape or not np.all(np.isfinite(x)):
            self._osqp = None
            self._multipliers = None
            raise ProgramError(str(result.info.status))
        y = np.asarray(result.y, dtype=np.float64)
        self._multipliers = y if np.all(np.isfinite(y)) else None
        return x
