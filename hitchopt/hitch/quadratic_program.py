"""Convex quadratic programs with sparse rows, and their solution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hitchopt.values import Array, Indices

if TYPE_CHECKING:
    import casadi as ca
    import scipy.sparse as sp

RESIDUAL_TOLERANCE = 1e-6
"""Largest violation of a row or a bound, in its own unit, of an accepted solution."""


@dataclass(frozen=True, eq=False)
class QuadraticProgram:
    """``min ½ x'Px + q'x`` over ``lower ≤ A x ≤ upper`` and ``x_min ≤ x ≤ x_max``.

    P (m, m) is symmetric and positive semidefinite. A (r, m) also stores entries of value zero.
    x_min and x_max are (m,) or one bound for all variables.
    """

    P: sp.csc_array[np.float64]
    q: Array
    A: sp.csc_array[np.float64]
    lower: Array
    upper: Array
    x_min: Array | float = -np.inf
    x_max: Array | float = np.inf


class Rows:
    """Rows ``lower ≤ A x ≤ upper`` over a number of variables, assembled block by block."""

    def __init__(self, variables: int) -> None:
        self.count = 0
        self.variables = variables
        self._entries: list[tuple[Indices, Indices, Array]] = []
        self._bounds: list[tuple[Array, Array]] = []

    def add(
        self,
        rows: Indices,
        columns: Indices,
        values: Array,
        lower: Array,
        upper: Array | float = np.inf,
    ) -> int:
        """Add rows with entries at local indices ``rows``; return the index of the first row."""
        first = self.count
        self._entries.append((first + rows, columns, values))
        self._bounds.append((lower, np.broadcast_to(upper, len(lower))))
        self.count += len(lower)
        return first

    def extend(self, rows: Indices, columns: Indices, value: float) -> None:
        """Add one entry of the same value to each of some existing rows."""
        self._entries.append((rows, columns, np.full(len(rows), value)))

    def add_bounds(self, columns: Indices, lower: Array | float, upper: Array | float) -> None:
        """Bound single variables."""
        count = len(columns)
        self.add(np.arange(count), columns, np.ones(count), np.broadcast_to(lower, count), upper)

    def compressed(self) -> tuple[sp.csc_array[np.float64], Array, Array]:
        """Return A, lower and upper; A also stores entries of value zero."""
        import scipy.sparse as sp

        rows, columns, values = (np.concatenate(part) for part in zip(*self._entries, strict=True))
        lower, upper = (np.concatenate(part) for part in zip(*self._bounds, strict=True))
        shape = (self.count, self.variables)
        return sp.csc_array((values, (rows, columns)), shape=shape), lower, upper


def solve_qp(program: QuadraticProgram) -> Array | None:
    """Return the minimiser, or None if its residuals exceed RESIDUAL_TOLERANCE.

    The solver is PIQP, an interior-point method that ships with casadi; OSQP is slow to reach the
    accuracy of 1e-6 that leg lengths need. Its status is not trusted; residuals are recomputed.
    """
    import casadi as ca

    def converted(matrix: sp.csc_array[np.float64]) -> ca.DM:  # casadi's own takes a millisecond
        matrix.sum_duplicates()  # sorts the indices, too
        sparsity = ca.Sparsity(*matrix.shape, matrix.indptr.tolist(), matrix.indices.tolist())
        return ca.DM(sparsity, matrix.data)

    hessian = converted(program.P)
    rows = converted(program.A)
    shapes = {"h": hessian.sparsity(), "a": rows.sparsity()}
    solver = ca.conic("program", "piqp", shapes, {"error_on_fail": False})
    solution = solver(
        h=hessian,
        g=program.q,
        a=rows,
        lba=program.lower,
        uba=program.upper,
        lbx=program.x_min,
        ubx=program.x_max,
    )
    minimizer = np.asarray(solution["x"], dtype=np.float64).reshape(-1)
    values = program.A @ minimizer
    residuals = [
        program.lower - values,
        values - program.upper,
        program.x_min - minimizer,
        minimizer - program.x_max,
    ]
    if not np.max(np.concatenate(residuals)) <= RESIDUAL_TOLERANCE:  # nan is not
        return None
    return np.clip(minimizer, program.x_min, program.x_max)
