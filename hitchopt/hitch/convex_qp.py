"""A sparse convex QP, solved to high accuracy and believed only after its residuals."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

Array = NDArray[np.float64]

RESIDUAL = 1e-6
"""Largest violation of a row or a bound, in its own unit, of a solution that is used."""


@dataclass(frozen=True, eq=False)
class QuadraticProgram:
    """``min ½ x'Hx + g'x`` over ``rows x ≥ least`` and ``lower ≤ x ≤ upper``.

    Attributes
    ----------
    hessian: (m, m), positive semidefinite.
    gradient: (m,)
    rows: (r, m)
    least: (r,)
    lower, upper: (m,)
    """

    hessian: sparse.csc_matrix
    gradient: Array
    rows: sparse.csc_matrix
    least: Array
    lower: Array
    upper: Array

    def residual(self, x: Array) -> float:
        """Return by how much x breaks the worst row or bound."""
        gaps = [self.least - self.rows @ x, self.lower - x, x - self.upper]
        return float(max(np.max(gap, initial=0.0) for gap in gaps))


def solve_qp(problem: QuadraticProgram) -> Array | None:
    """Return the minimiser, or None where the solver finds none that keeps its constraints.

    By PIQP, which ships with casadi: an interior-point method, since the sharings are asked for to
    1e-6 and better, where OSQP is slow.
    """
    H, A = ca.DM(problem.hessian), ca.DM(problem.rows)
    solver = ca.conic(
        "sharing", "piqp", {"h": H.sparsity(), "a": A.sparsity()}, {"error_on_fail": False}
    )
    solution = solver(
        h=H,
        g=problem.gradient,
        a=A,
        lba=problem.least,
        uba=np.inf,
        lbx=problem.lower,
        ubx=problem.upper,
    )
    x = np.asarray(solution["x"], dtype=np.float64).reshape(-1)
    if not np.all(np.isfinite(x)) or problem.residual(x) > RESIDUAL:
        return None
    return np.clip(x, problem.lower, problem.upper)
