"""Ctrl-C ends a plan wherever it comes, also within solvers that would keep it to themselves."""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np
import osqp
import pytest
import scipy.sparse as sp

import hitchopt as ho
from hitchopt.hitch.leg_program import QuadraticProgram
from hitchopt.planners.separation.program import solve_program

QUARTER = ho.regular_polygon(3, 1.0).rotated(0.5)


class Nuisance(ca.Callback):
    """Sends a signal at every iteration of IPOPT."""

    def __init__(self, variables: int, rows: int, number: int) -> None:
        super().__init__()
        self.sizes = {"x": variables, "f": 1, "g": rows, "lam_x": variables, "lam_g": rows}
        self.number = number
        self.sent = 0
        self.construct("nuisance", {})

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self.sizes.get(ca.nlpsol_out(i), 0), 1)

    def eval(self, arg: Sequence[ca.DM]) -> list[int]:
        assert len(arg) == ca.nlpsol_n_out()
        self.sent += 1
        os.kill(os.getpid(), self.number)
        return [0]


@pytest.fixture
def nuisances(monkeypatch: pytest.MonkeyPatch) -> list[Nuisance]:
    """Every solver of the optimiser gets one."""
    made: list[Nuisance] = []
    build = ca.nlpsol

    def disturbed(name: str, plugin: str, program: dict[str, Any], options: Any) -> ca.Function:
        made.append(Nuisance(program["x"].numel(), program["g"].numel(), signal.SIGINT))
        return build(name, plugin, program, {**options, "iteration_callback": made[-1]})

    monkeypatch.setattr(ca, "nlpsol", disturbed)
    return made


def test_the_optimiser_ends_on_ctrl_c_at_the_first_solver(nuisances: list[Nuisance]) -> None:
    start = ho.Hitch.spread(ho.Team(3, 2.4), ho.regular_polygon(3, 1.0))
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        ho.morph(start, QUARTER, optimize=True)
    assert len(nuisances) == 1
    assert nuisances[0].sent > 0
    assert signal.getsignal(signal.SIGINT) is before


class Interrupted:
    """OSQP that says what it says after Ctrl-C, which it keeps to itself."""

    def __init__(self, inner: Any) -> None:
        self.inner = inner

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)

    def solve(self, **options: Any) -> Any:
        found = self.inner.solve(**options)
        found.info.status_val = int(osqp.SolverStatus.OSQP_SIGINT)
        return found


def test_osqp_that_was_interrupted_ends_the_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    one = np.ones(2)
    program = QuadraticProgram(
        sp.csc_array(sp.eye(2)), 0.3 * one, sp.csc_array(sp.eye(2)), -one, one
    )
    np.testing.assert_allclose(solve_program(program), -0.3 * one, atol=1e-3)
    made = osqp.OSQP
    monkeypatch.setattr(osqp, "OSQP", lambda **options: Interrupted(made(**options)))
    with pytest.raises(KeyboardInterrupt):
        solve_program(program)
