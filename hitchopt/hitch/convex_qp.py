"""Sparse convex quadratic programs, built row by row, and PIQP for those that need accuracy."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.sparse as sp

from hitchopt.values import Array, Indices

RESIDUAL = 1e-6
"""Largest violation of a row or a bound, in its own unit, of a solution that is used."""


@dataclass(frozen=True, eq=False)
class QuadraticProgram:
    """``min ½ x'Px + q'x`` over ``lower ≤ A x ≤ upper`` and ``least ≤ x ≤ most``.

    Attributes
    ----------
    P: (m, m), symmetric and positive semidefinite.
    q: (m,)
    A: (r, m); entries that happen to be zero are stored.
    lower, upper: (r,)
    least, most: (m,), or one bound for all unknowns.

    Raises
    ------
    ValueError: data of wrong length, not finite, or with crossed bounds.
    """

    P: sp.csc_array[np.float64]
    q: Array
    A: sp.csc_array[np.float64]
    lower: Array
    upper: Array
    least: Array | float = -np.inf
    most: Array | float = np.inf

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
        """Return the largest violation of a row or a bound at x."""
        values = self.A @ x
        gaps = self.lower - values, values - self.upper, self.least - x, x - self.most
        return float(max(np.max(gap, initial=0.0) for gap in gaps))


class Rows:
    """Rows ``lower ≤ A x ≤ upper`` of a program, gathered block by block.

    Parameters
    ----------
    unknowns: number of columns of A.
    """

    def __init__(self, unknowns: int) -> None:
        self.count = 0
        self._unknowns = unknowns
        self._entries: list[tuple[Indices, Indices, Array]] = []
        self._bounds: list[tuple[Array, Array]] = []

    def add(
        self, rows: Indices, columns: Indices, values: Array, lower: Array, upper: Array
    ) -> int:
        """Add rows, ``rows`` counting from the first of them; return the index of that one."""
        first = self.count
        self._entries.append((first + rows, columns, values))
        self._bounds.append((lower, upper))
        self.count += len(lower)
        return first

    def extend(self, rows: Indices, columns: Indices, value: float) -> None:
        """Add the same entry to rows that were added before."""
        self._entries.append((rows, columns, np.full(len(rows), value)))

    def add_bounds(self, columns: Indices, lower: Array | float, upper: Array | float) -> None:
        """Bound single unknowns."""
        m = len(columns)
        bounds = np.broadcast_to(lower, m), np.broadcast_to(upper, m)
        self.add(np.arange(m), columns, np.ones(m), *bounds)

    def compressed(self) -> tuple[sp.csc_array[np.float64], Array, Array]:
        """Return A, lower and upper; entries that happen to be zero are stored too."""
        rows, columns, values = (np.concatenate(part) for part in zip(*self._entries, strict=True))
        lower, upper = (np.concatenate(part) for part in zip(*self._bounds, strict=True))
        shape = (self.count, self._unknowns)
        return sp.csc_array((values, (rows, columns)), shape=shape), lower, upper


def solve_qp(program: QuadraticProgram) -> Array | None:
    """Return the minimiser, or None where no solution keeps rows and bounds within RESIDUAL.

    The solver is PIQP, an interior-point method that ships with casadi: OSQP is slow to reach the
    1e-6 and better that leg lengths need. Its status is not trusted; residuals are recomputed.
    """
    H, A = _matrix(program.P), _matrix(program.A)
    solver = ca.conic(
        "program", "piqp", {"h": H.sparsity(), "a": A.sparsity()}, {"error_on_fail": False}
    )
    solution = solver(
        h=H,
        g=program.q,
        a=A,
        lba=program.lower,
        uba=program.upper,
        lbx=program.least,
        ubx=program.most,
    )
    x = np.asarray(solution["x"], dtype=np.float64).reshape(-1)
    if not np.all(np.isfinite(x)) or program.residual(x) > RESIDUAL:
        return None
    return np.clip(x, program.least, program.most)


def _matrix(given: sp.csc_array[np.float64]) -> ca.DM:
    """Return a sparse matrix as casadi has it: its own conversion takes a millisecond."""
    given.sort_indices()
    sparsity = ca.Sparsity(*given.shape, given.indptr.tolist(), given.indices.tolist())
    return ca.DM(sparsity, given.data)
