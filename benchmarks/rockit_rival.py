"""A rival that others wrote: morphs by multiple shooting with rockit of KU Leuven.

rockit (Gillis et al., "Effortless modeling of optimal control problems with rockit", 2020;
https://gitlab.kuleuven.be/meco-software/rockit) transcribes the problem and IPOPT solves it. States
are vertices, roll and q-legs with their first two derivatives, controls are their third ones. The
model is ``hitchopt.model``; constraints are those of ``benchmarks.rival``, between intervals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import rockit

import hitchopt as ho
from benchmarks.measuring import Array
from benchmarks.rival import Rival, RivalError, RivalFlight, Symbols, squares

INTERVALS = 24

SAMPLES_BETWEEN = 80
"""Number of times in each interval at which limits are compared afterwards."""

STATES = ("x", "v", "a", "jerk")

INPUTS = (
    ("vertices", "roll", "q_legs"),
    ("vertex_velocities", "roll_velocities", "q_leg_velocities"),
    ("vertex_accelerations", "roll_accelerations", "q_leg_accelerations"),
)
"""Inputs of the model by order of derivative."""

FIRST_DURATION = 5.0
"""Initial guess of the duration [s]."""

JERK_WEIGHT = 1e-6
"""Weight of the integral of the squared control in the cost, which makes the solution unique."""


@dataclass(frozen=True, eq=False)
class RockitRival:
    """The rival for teams of one size and kind."""

    rival: Rival
    """Team, limits, constraints and limit of time."""

    @cached_property
    def problem(self) -> tuple[Any, dict[str, Any]]:
        """Return rockit's problem, and its parameters and states by name."""
        team = self.rival.team
        n = team.robots
        ocp = rockit.Ocp(T=rockit.FreeTime(FIRST_DURATION))
        x, v, a = ocp.state(4 * n), ocp.state(4 * n), ocp.state(4 * n)
        jerk = ocp.control(4 * n)
        first, last, cables = ocp.parameter(4 * n), ocp.parameter(4 * n), ocp.parameter(n)
        for state, rate in ((x, v), (v, a), (a, jerk)):
            ocp.set_der(state, rate)
        for state, start, end in ((x, first, last), (v, 0, 0), (a, 0, 0)):
            ocp.subject_to(ocp.at_t0(state) == start)
            ocp.subject_to(ocp.at_tf(state) == end)
        outputs, vertex_speeds = self.flight((x, v, a), cables)
        rows = self.rival.rows(outputs, vertex_speeds)
        ocp.subject_to(rows <= 0, include_first=False, include_last=False)
        ocp.add_objective(ocp.T)
        ocp.add_objective(JERK_WEIGHT * ocp.integral(ca.sumsqr(jerk)))
        limits = {"max_iter": 1000, "max_cpu_time": self.rival.seconds}
        ocp.solver(
            "ipopt",
            {"expand": True, "print_time": False, "error_on_fail": True}
            | {f"ipopt.{key}": value for key, value in limits.items()}
            | {"ipopt.print_level": 0, "ipopt.sb": "yes"},
        )
        ocp.method(rockit.MultipleShooting(N=INTERVALS, intg="rk"))
        states = {"x": x, "v": v, "a": a, "jerk": jerk}
        return ocp, {**states, "first": first, "last": last, "cables": cables}

    def flight(
        self, states: tuple[Symbols, Symbols, Symbols], cables: Symbols
    ) -> tuple[Mapping[str, Symbols], Symbols]:
        """Return outputs of ``hitchopt.model``, and squared vertex speeds.

        Parameters
        ----------
        states: values, first and second derivatives (4n, J) of vertices, roll and q-legs.
        cables: (n, 1) [m], cable lengths.
        """
        n, count = self.rival.team.robots, states[0].size2()
        level = ca.DM(np.kron(np.eye(n), np.eye(3, 2)))  # coordinates x, y, 0 from x, y
        inputs: dict[str, Symbols] = {"cable_lengths": ca.repmat(cables, 1, count)}
        for names, values in zip(INPUTS, states, strict=True):
            plan_view, roll, legs = ca.vertsplit(values, [0, 2 * n, 3 * n, 4 * n])
            parts = (ca.mtimes(level, plan_view), roll, legs)
            inputs |= zip(names, parts, strict=True)
        hitch = ho.model(self.rival.team, self.rival.separation, roll=True, cables=True)
        return hitch.map(count)(**inputs), squares(inputs["vertex_velocities"])

    def solve(self, start: ho.Hitch, end: ho.Hitch) -> RivalFlight:
        """Return IPOPT's solution.

        Raises
        ------
        RivalError: IPOPT fails or runs out of time.
        """
        ocp, symbols = self.problem
        first, last = (_state(hitch) for hitch in (start, end))
        ocp.set_value(symbols["first"], first)
        ocp.set_value(symbols["last"], last)
        ocp.set_value(symbols["cables"], start.team.cable_length)
        share = np.linspace(0.0, 1.0, INTERVALS + 1)
        ocp.set_initial(symbols["x"], first[:, None] + np.outer(last - first, share))
        try:
            solution = ocp.solve()
        except Exception as error:  # rockit and casadi raise plain RuntimeError and Exception
            raise RivalError(str(error).splitlines()[0]) from error
        duration = float(solution.value(ocp.T))
        x, v, a, jerk = (solution.sample(symbols[name], grid="control")[1] for name in STATES)
        between = _between(x, v, a, jerk, duration)
        outputs, _ = self.flight(between, ca.DM(start.team.cable_length))
        return RivalFlight(duration, self.rival.excess(outputs))


def _between(
    x: Array, v: Array, a: Array, jerk: Array, duration: float
) -> tuple[ca.DM, ca.DM, ca.DM]:
    """Return values and two derivatives between knots (INTERVALS + 1, 4n), jerk being constant."""
    t = duration / INTERVALS * np.linspace(0.0, 1.0, SAMPLES_BETWEEN)[:, None, None]
    x, v, a, jerk = (values[:-1] for values in (x, v, a, jerk))
    values = x + t * v + t**2 / 2.0 * a + t**3 / 6.0 * jerk
    rates = v + t * a + t**2 / 2.0 * jerk
    curvatures = a + t * jerk
    columns = [ca.DM(each.reshape(-1, x.shape[1]).T) for each in (values, rates, curvatures)]
    return columns[0], columns[1], columns[2]


def _state(hitch: ho.Hitch) -> Array:
    """Return vertices, roll and q-legs of a hitch (4n,)."""
    return np.concatenate([hitch.vertices[:, :2].ravel(), hitch.roll, hitch.q_legs])
