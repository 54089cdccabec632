"""Ctrl-C ends a plan wherever it comes, also within solvers that would keep it to themselves."""

from __future__ import annotations

import os
import signal
from contextlib import suppress
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


def test_the_optimiser_ends_on_ctrl_c_at_the_first_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also of a solver that keeps signals to itself, as IPOPT does."""
    built: list[str] = []
    build = ca.nlpsol

    def disturbed(name: str, plugin: str, *given: Any) -> Any:
        built.append(plugin)
        solver = build(name, plugin, *given)

        def solve(**numbers: Any) -> Any:
            with suppress(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
            return solver(**numbers)

        solve.stats = solver.stats  # type: ignore[attr-defined]
        return solve

    monkeypatch.setattr(ca, "nlpsol", disturbed)
    triangle = ho.regular_polygon(3, 1.0)
    start, before = ho.Hitch.spread(ho.Team(3, 2.4), triangle), signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        ho.morph(start, triangle.rotated(0.5), optimize=True)
    assert built == ["ipopt"]
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
