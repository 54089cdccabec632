"""Convex programs: what reaches the solver is what was asked for."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from hitchopt.hitch.leg_program import QuadraticProgram, solve_qp


def test_rows_may_be_stored_in_any_order_and_hold_zeros() -> None:
    """The point nearest to (3, 2, 1) with ``x0 + 2 x1 <= 4`` and ``x2 >= 2`` is (2.4, 0.8, 2)."""
    data, rows = np.array([1.0, 0.0, 0.0, 2.0, 1.0]), np.array([0, 1, 1, 0, 1])
    A = sp.csc_array((data, rows, np.array([0, 2, 4, 5])), shape=(2, 3))
    assert not A.has_sorted_indices
    program = QuadraticProgram(
        sp.csc_array(np.eye(3)),
        np.array([-3.0, -2.0, -1.0]),
        A,
        np.array([-np.inf, 2.0]),
        np.array([4.0, np.inf]),
    )
    x = solve_qp(program)
    assert x is not None
    assert x == pytest.approx([2.4, 0.8, 2.0], abs=1e-6)
