"""A rival of optimised morphs: a minimal formulation in plain casadi and IPOPT.

Vertices are uniform B-splines of degree 5 in s = t/T with 10 coefficients each and free final time;
q-legs and roll change evenly along a smooth step; the roll also has coefficients of this kind.
Speeds, accelerations, thrust, tilt, legs, convexity and the distances of all pairs of drones are
kept at 24 samples. There are no limits of jerk, no clearances of cables, no certificate. Written in
SX throughout, so that casadi differentiates one flat graph of ``hitchopt.model``. It is built once
for a team: start, end and cable lengths are parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from scipy.interpolate import BSpline

import hitchopt as ho
from benchmarks.measuring import Array

COEFFICIENTS, SAMPLES, DEGREE = 10, 24, 5
FIXED = 3
"""Number of coefficients at either end that are fixed by rest."""

MIN_ANGLE = 1e-3  # [rad] Smallest exterior angle

Symbols = Any  # SX, MX or DM of casadi, whose types have no common arithmetic

LEG_STEP = BSpline(np.repeat([0.0, 1.0], 8), np.repeat([0.0, 1.0], 4), 7)
"""The q-legs' share of their change."""


@dataclass(frozen=True, eq=False)
class RivalFlight:
    """Solution of the rival."""

    duration: float  # duration of the flight [s]
    # largest relative excess over the limits of speed and acceleration between samples
    excess: float


class RivalError(Exception):
    """IPOPT failed or ran out of time."""


@dataclass(frozen=True, eq=False)
class Rival:
    """The rival for teams of one size and kind."""

    team: ho.Team  # with masses, tensions and thrusts; cable lengths may differ
    limits: ho.Limits  # of motion
    separation: ho.Separation  # of drones
    seconds: float  # limit of IPOPT's processor time [s]

    def flight(
        self, s: Array, control: Symbols, T: Symbols, q: Symbols, cables: Symbols
    ) -> tuple[Mapping[str, Symbols], Symbols]:
        """Return outputs of ``hitchopt.model`` at s (J,), and squared vertex speeds (n, J).

        Parameters
        ----------
        control: (COEFFICIENTS, 3n) [m, rad], of the vertices and the roll.
        T: duration [s].
        q: (n, 2) [m], the q-legs at start and end.
        cables: (n, 1) [m], cable lengths.
        """
        n = self.team.robots
        basis = BSpline(_knots(), np.eye(COEFFICIENTS), DEGREE)
        level = ca.DM(np.kron(np.eye(n), np.eye(3, 2)))  # coordinates x, y, 0 from x, y
        vertices, rolls, q_legs = [], [], []
        for order in range(3):
            splines = ca.mtimes(ca.DM(basis(s, order)), control) / T**order
            vertices.append(ca.mtimes(level, splines[:, : 2 * n].T))
            rolls.append(splines[:, 2 * n :].T)
            share = ca.DM(LEG_STEP(s, order)[None])
            q_legs.append(ca.mtimes(q[:, 1] - q[:, 0], share) / T**order)
        q_legs[0] += ca.repmat(q[:, 0], 1, len(s))
        hitch = ho.model(self.team, self.separation, roll=True, cables=True).map(len(s))
        outputs = hitch(
            vertices=vertices[0],
            vertex_velocities=vertices[1],
            vertex_accelerations=vertices[2],
            roll=rolls[0],
            roll_velocities=rolls[1],
            roll_accelerations=rolls[2],
            q_legs=q_legs[0],
            q_leg_velocities=q_legs[1],
            q_leg_accelerations=q_legs[2],
            cable_lengths=ca.repmat(cables, 1, len(s)),
        )
        return outputs, squares(vertices[1])

    def rows(self, outputs: Mapping[str, Symbols], vertex_speeds: Symbols) -> Symbols:
        """Return the constraints' rows (≤ 0) of outputs of the model and squared vertex speeds."""
        limits = self.limits
        thrusts: Symbols = ca.reshape(outputs["thrusts"], 3, -1)
        level = thrusts[0, :] ** 2 + thrusts[1, :] ** 2
        steepest = float(np.tan(limits.tilt))
        rows = [
            limits.leg - outputs["legs"],
            MIN_ANGLE - outputs["exterior_angles"],
            vertex_speeds - limits.vertex_speed**2,
            squares(outputs["velocities"]) - limits.speed**2,
            squares(outputs["accelerations"]) - limits.acceleration**2,
            level + thrusts[2, :] ** 2 - float(self.team.max_thrust[0]) ** 2,
            level - (steepest * thrusts[2, :]) ** 2,
            1.0 - outputs["separations"] ** 2,
        ]
        return ca.vertcat(*(ca.vec(row) for row in rows))

    @cached_property
    def solver(self) -> ca.Function:
        """IPOPT for all starts and ends of teams of this size."""
        n = self.team.robots
        free, T = ca.SX.sym("c", COEFFICIENTS - 2 * FIXED, 3 * n), ca.SX.sym("T")
        ends, q, cables = ca.SX.sym("ends", 3 * n, 2), ca.SX.sym("q", n, 2), ca.SX.sym("L", n)
        first, last = (ca.repmat(ends[:, i].T, FIXED, 1) for i in range(2))
        samples = np.linspace(0.0, 1.0, SAMPLES)
        g = self.rows(*self.flight(samples, ca.vertcat(first, free, last), T, q, cables))
        parameters = ca.vertcat(ca.vec(ends), ca.vec(q), cables)
        limits = {"max_iter": 1000, "max_cpu_time": self.seconds}
        return ca.nlpsol(
            "rival",
            "ipopt",
            {"x": ca.vertcat(ca.vec(free), T), "p": parameters, "f": T, "g": g},
            {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", **limits}},
        )

    def solve(self, start: ho.Hitch, end: ho.Hitch, seed: ho.Plan | None = None) -> RivalFlight:
        """Return IPOPT's solution from a guess of its own, or from a plan of the same morph.

        Raises
        ------
        RivalError: IPOPT fails or runs out of time.
        """
        n, cables = start.team.robots, start.team.cable_length
        first, last = (np.append(hitch.vertices[:, :2], hitch.roll) for hitch in (start, end))
        q = np.column_stack([start.q_legs, end.q_legs])
        share = np.linspace(0.0, 1.0, COEFFICIENTS - 2 * FIXED + 2)[1:-1, None]
        guess = first + share * (last - first)
        longest = float(np.max(np.linalg.norm(end.drones - start.drones, axis=-1)))
        guessed_duration = 2.0 + 4.0 * longest
        if seed is not None:
            guess, guessed_duration = self._fitted(seed, first, last), seed.duration
        solution = self.solver(
            x0=np.append(guess.T.ravel(), guessed_duration),
            p=np.concatenate([first, last, q.T.ravel(), cables]),
            lbx=np.append(np.full(guess.size, -np.inf), 0.1),
            ubx=np.inf,
            lbg=-np.inf,
            ubg=0.0,
        )
        if not self.solver.stats()["success"]:
            raise RivalError(str(self.solver.stats()["return_status"]))
        values = np.asarray(solution["x"], dtype=np.float64).ravel()
        duration, middle = float(values[-1]), values[:-1].reshape(3 * n, -1).T
        whole = np.concatenate([np.tile(first, (FIXED, 1)), middle, np.tile(last, (FIXED, 1))])
        fine = np.linspace(0.0, 1.0, 2001)
        given = (ca.DM(whole), ca.DM(duration), ca.DM(q), ca.DM(cables))
        outputs, _ = self.flight(fine, *given)
        return RivalFlight(duration, self.excess(outputs))

    def _fitted(self, plan: ho.Plan, first: Array, last: Array) -> Array:
        """Return the free coefficients of splines next to a plan's vertices, without roll."""
        s = np.linspace(0.0, 1.0, 4 * SAMPLES)
        vertices = plan.motion.vertices.at(plan.motion.vertices.breaks[0] + s * plan.duration)
        level = vertices[..., :2].reshape(len(s), -1)
        values = np.column_stack([level, np.zeros((len(s), self.team.robots))])
        basis = BSpline(_knots(), np.eye(COEFFICIENTS), DEGREE)(s)
        ends = np.outer(basis[:, :FIXED].sum(1), first) + np.outer(basis[:, -FIXED:].sum(1), last)
        middle = basis[:, FIXED:-FIXED]
        return np.asarray(np.linalg.lstsq(middle, values - ends, rcond=None)[0])

    def excess(self, outputs: Mapping[str, Symbols]) -> float:
        """Return the largest relative excess over the limits of speed and acceleration."""
        speed, acceleration = (
            float(np.sqrt(np.max(np.asarray(squares(outputs[name])))))
            for name in ("velocities", "accelerations")
        )
        return max(speed / self.limits.speed, acceleration / self.limits.acceleration) - 1.0


def _knots() -> Array:
    """Return the knots of clamped splines with COEFFICIENTS coefficients on [0, 1]."""
    ends = np.zeros(DEGREE)
    inner = np.linspace(0.0, 1.0, COEFFICIENTS - DEGREE + 1)
    return np.concatenate([ends, inner, ends + 1.0])


def squares(columns: Symbols) -> Symbols:
    """Return the squared lengths (m, J) of vectors in columns (3 m, J)."""
    count = columns.size2()
    vectors: Symbols = ca.reshape(columns, 3, -1)
    return ca.reshape(ca.sum1(vectors**2), -1, count)
