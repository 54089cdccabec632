"""Ctrl-C ends a plan wherever it comes, also within solvers that would keep it to themselves."""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import osqp
import pytest
import scipy.sparse as sp

import hitchopt as ho
from hitchopt.hitch.leg_program import QuadraticProgram
from hitchopt.planners.separation.program import solve_program


class Nuisance(ca.Callback):
    """Sends a signal at every iteration of IPOPT."""

    def __init__(self, variables: int, rows: int) -> None:
        super().__init__()
        self.sizes = {"x": variables, "f": 1, "g": rows, "lam_x": variables, "lam_g": rows}
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
        os.kill(os.getpid(), signal.SIGINT)
        return [0]


def test_the_optimiser_ends_on_ctrl_c_at_the_first_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Nuisance] = []
    build = ca.nlpsol

    def disturbed(name: str, plugin: str, program: dict[str, Any], options: Any) -> ca.Function:
        made.append(Nuisance(program["x"].numel(), program["g"].numel()))
        return build(name, plugin, program, {**options, "iteration_callback": made[-1]})

    monkeypatch.setattr(ca, "nlpsol", disturbed)
    triangle = ho.regular_polygon(3, 1.0)
    start, before = ho.Hitch.spread(ho.Team(3, 2.4), triangle), signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        ho.morph(start, triangle.rotated(0.5), optimize=True)
    assert len(made) == 1
    assert made[0].sent > 0
    assert signal.getsignal(signal.SIGINT) is before


def test_osqp_that_was_interrupted_ends_the_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    """It says so after Ctrl-C, which it keeps to itself."""
    one, eye = np.ones(2), sp.csc_array(sp.eye(2))
    program = QuadraticProgram(eye, 0.3 * one, eye, -one, one)
    np.testing.assert_allclose(solve_program(program), -0.3 * one, atol=1e-3)
    found = SimpleNamespace(info=SimpleNamespace(status_val=int(osqp.SolverStatus.OSQP_SIGINT)))
    monkeypatch.setattr(osqp.OSQP, "solve", lambda *_, **__: found)
    with pytest.raises(KeyboardInterrupt):
        solve_program(program)
