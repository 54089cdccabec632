"""Sparse quadratic programs by OSQP, whose word is not taken for anything.

OSQP keeps silent on some mistakes: data of wrong length and crossed bounds in an update leave the
old program in place. Sizes and bounds are checked before every call, residuals computed after it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from hitchopt.time_limit import check_time, time_left

Array = NDArray[np.float64]

ACCURACY = 1e-4
"""Absolute and relative, of residuals that are scaled to about one; planes keep a wider margin."""

MOST_ITERATIONS = 500
"""A program that takes more is used as it is then: whoever asks checks what becomes of it."""


LEAST_TIME = 1e-3
"""[s] OSQP takes a limit of zero for none."""


class ProgramError(Exception):
    """A program that OSQP did not solve in any sense."""


@dataclass(frozen=True, eq=False)
class QuadraticProgram:
    """Minimise x·Px/2 + q·x where lower <= Ax <= upper.

    Attributes
    ----------
    P: upper triangle, columns compressed.
    A: columns compressed; entries that happen to be zero are stored.
    """

    P: sp.csc_array[np.float64]
    q: Array
    A: sp.csc_array[np.float64]
    lower: Array
    upper: Array

    def __post_init__(self) -> None:
        rows, columns = self.A.shape
        if self.P.shape != (columns, columns) or self.q.shape != (columns,):
            raise ValueError(f"objective of {self.P.shape}, {self.q.shape} for {columns} unknowns")
        if self.lower.shape != (rows,) or self.upper.shape != (rows,):
            raise ValueError(f"bounds of {self.lower.shape}, {self.upper.shape} for {rows} rows")
        if not (np.all(np.isfinite(self.q)) and np.all(np.isfinite(self.A.data))):
            raise ValueError("a program with nan or inf")
        if not np.all(self.lower <= self.upper):
            row = int(np.argmax(~(self.lower <= self.upper)))
            raise ValueError(f"row {row}: {self.lower[row]} <= {self.upper[row]} is crossed")

    def residual(self, x: Array) -> float:
        """Return by how much ``x`` breaks the worst row."""
        values = self.A @ x
        return float(max(0.0, np.max(self.lower - values), np.max(values - self.upper)))


@dataclass(frozen=True, eq=False)
class Solution:
    """What OSQP found.

    Attributes
    ----------
    x: the unknowns.
    residual: by how much they break the worst row, computed from the program.
    iterations: that it took.
    """

    x: Array
    residual: float
    iterations: int


class Solver:
    """OSQP, set up once for programs of one pattern and updated while that stays the same."""

    def __init__(self) -> None:
        self._osqp: Any = None
        self._program: QuadraticProgram | None = None
        self._multipliers: Array | None = None

    def solve(self, program: QuadraticProgram, first: Array, common_rows: int) -> Solution:
        """Return a solution, searched from ``first``.

        Parameters
        ----------
        program: what is to be solved.
        first: (unknowns,) where to start.
        common_rows: how many of the first rows mean what they did in the last program.

        Raises
        ------
        ProgramError: not solved, not even roughly.
        """
        import osqp

        if first.shape != program.q.shape:
            raise ValueError(f"a start of {first.shape} for {program.q.shape}")
        multipliers = np.zeros(len(program.lower))
        if self._multipliers is not None:
            same = self._same_pattern(program)
            kept = len(multipliers) if same else min(common_rows, len(self._multipliers))
            multipliers[:kept] = self._multipliers[:kept]
        if self._same_pattern(program):
            self._osqp.update(
                q=program.q, l=program.lower, u=program.upper, Px=program.P.data, Ax=program.A.data
            )
        else:
            self._set_up(program)
        self._program = program
        self._osqp.warm_start(x=first, y=multipliers)
        if math.isfinite(left := time_left()):
            self._osqp.update_settings(time_limit=max(left, LEAST_TIME))
        result = self._osqp.solve(raise_error=False)
        if result.info.status_val == osqp.SolverStatus.OSQP_SIGINT:
            raise KeyboardInterrupt  # which OSQP has kept to itself
        check_time()  # what has been cut short is no solution
        x = np.asarray(result.x, dtype=np.float64)
        if x.shape != program.q.shape or not np.all(np.isfinite(x)):
            self._osqp = None
            self._multipliers = None
            raise ProgramError(str(result.info.status))
        y = np.asarray(result.y, dtype=np.float64)
        self._multipliers = y if np.all(np.isfinite(y)) else None
        return Solution(x, program.residual(x), int(result.info.iter))

    def _same_pattern(self, program: QuadraticProgram) -> bool:
        last = self._program
        return (
            self._osqp is not None
            and last is not None
            and all(
                old.shape == new.shape
                and np.array_equal(old.indptr, new.indptr)
                and np.array_equal(old.indices, new.indices)
                for old, new in ((last.A, program.A), (last.P, program.P))
            )
        )

    def _set_up(self, program: QuadraticProgram) -> None:
        import osqp

        self._osqp = osqp.OSQP(algebra="builtin")
        self._osqp.setup(
            sp.csc_matrix(program.P),
            program.q,
            sp.csc_matrix(program.A),
            program.lower,
            program.upper,
            eps_abs=ACCURACY,
            eps_rel=ACCURACY,
            max_iter=MOST_ITERATIONS,
            warm_starting=True,
            polishing=False,
            verbose=False,
        )
