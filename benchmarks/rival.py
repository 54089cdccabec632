"""A rival of optimised morphs: a minimal formulation in plain casadi and IPOPT.

Vertices are uniform B-splines of degree 5 in s = t/T with 10 coefficients each and free final time;
q-legs go evenly along a smooth step. Speeds, accelerations, thrust, tilt, legs, convexity and the
distances of all pairs of drones are kept at 24 samples. There are no limits of jerk, no clearances
of cables, no certificate. Written in SX throughout, so that casadi differentiates one flat graph.
It is built once for a team: start, end and cable lengths are parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from scipy.interpolate import BSpline

import hitchopt as ho
from benchmarks.measuring import Array
from hitchopt.hitch import GRAVITY

COEFFICIENTS, SAMPLES, DEGREE = 10, 24, 5
FIXED = 3
"""Number of coefficients at either end that are fixed by rest."""

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
    separation: ho.Separation  # of which only the radius counts
    seconds: float  # limit of IPOPT's processor time [s]

    def jets(self, s: Array, control: ca.SX | ca.DM, T: ca.SX | ca.DM, q: ca.SX | ca.DM) -> ca.SX:
        """Return the inputs of ``_robot`` at s (J,), a column per robot and sample.

        Parameters
        ----------
        control: (COEFFICIENTS, 2n) [m], of the vertices.
        T: duration [s].
        q: (n, 2) [m], the q-legs at start and end.
        """
        n, inner = self.team.robots, COEFFICIENTS - DEGREE
        ends = np.zeros(DEGREE)
        knots = np.concatenate([ends, np.linspace(0.0, 1.0, inner + 1), ends + 1.0])
        basis = BSpline(knots, np.eye(COEFFICIENTS), DEGREE)
        change, constant = (q[:, 1] - q[:, 0]).T, ca.repmat(q[:, 0].T, len(s), 1)
        legs = [ca.DM(LEG_STEP(s, order)) @ change / T**order for order in range(3)]
        legs[0] += constant
        vertices = [ca.mtimes(ca.DM(basis(s, order)), control) / T**order for order in range(3)]
        flat = []
        for shift in (-1, 0, 1, 2):
            at = (np.arange(n) + shift) % n
            for axis in range(2):
                flat += [ca.vec(jet[:, (2 * at + axis).tolist()]).T for jet in vertices]
        flat += [ca.vec(leg).T for leg in legs]
        return ca.vertcat(*flat)

    def rows(self, s: Array, *given: ca.SX | ca.DM) -> tuple[ca.SX, ca.SX]:
        """Return rows and places of ``_robot`` at s; ``given`` are arguments of ``jets``, cables.

        Cable lengths have shape (n, 1) [m].
        """
        *curves, cables = given
        lengths = ca.vec(ca.repmat(cables.T, len(s), 1)).T
        robot = _robot(self.team, self.limits).map(self.team.robots * len(s))
        rows, places = robot(self.jets(s, *curves), lengths)
        return rows, places

    @cached_property
    def solver(self) -> ca.Function:
        """IPOPT for all starts and ends of teams of this size."""
        n = self.team.robots
        free, T = ca.SX.sym("c", COEFFICIENTS - 2 * FIXED, 2 * n), ca.SX.sym("T")
        ends, q, cables = ca.SX.sym("ends", 2 * n, 2), ca.SX.sym("q", n, 2), ca.SX.sym("L", n)
        first, last = (ca.repmat(ends[:, i].T, FIXED, 1) for i in range(2))
        samples = np.linspace(0.0, 1.0, SAMPLES)
        rows, places = self.rows(samples, ca.vertcat(first, free, last), T, q, cables)
        x, y = (
            ca.horzcat(*(ca.reshape(places[axis + drone, :], SAMPLES, n) for drone in (0, 2)))
            for axis in range(2)
        )
        i, j = (index.tolist() for index in np.triu_indices(2 * n, 1))
        squared = ca.vec((x[:, i] - x[:, j]) ** 2 + (y[:, i] - y[:, j]) ** 2)
        g = ca.vertcat(ca.vec(rows), (2.0 * self.separation.radius) ** 2 - squared)
        parameters = ca.vertcat(ca.vec(ends), ca.vec(q), cables)
        limits = {"max_iter": 1000, "max_cpu_time": self.seconds}
        return ca.nlpsol(
            "rival",
            "ipopt",
            {"x": ca.vertcat(ca.vec(free), T), "p": parameters, "f": T, "g": g},
            {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", **limits}},
        )

    def solve(self, start: ho.Hitch, end: ho.Hitch) -> RivalFlight:
        """Return IPOPT's solution.

        Raises
        ------
        RivalError: IPOPT fails or runs out of time.
        """
        n, cables = start.team.robots, start.team.cable_length
        first, last = (hitch.vertices[:, :2].ravel() for hitch in (start, end))
        q = np.column_stack([start.q_legs, end.q_legs])
        share = np.linspace(0.0, 1.0, COEFFICIENTS - 2 * FIXED + 2)[1:-1, None]
        guess = first + share * (last - first)
        longest = float(np.max(np.linalg.norm(end.drones - start.drones, axis=-1)))
        solution = self.solver(
            x0=np.append(guess.T.ravel(), 2.0 + 4.0 * longest),
            p=np.concatenate([first, last, q.T.ravel(), cables]),
            lbx=np.append(np.full(guess.size, -np.inf), 0.1),
            ubx=np.inf,
            lbg=-np.inf,
            ubg=0.0,
        )
        if not self.solver.stats()["success"]:
            raise RivalError(str(self.solver.stats()["return_status"]))
        values = np.asarray(solution["x"], dtype=np.float64).ravel()
        duration, middle = float(values[-1]), values[:-1].reshape(2 * n, -1).T
        whole = np.concatenate([np.tile(first, (FIXED, 1)), middle, np.tile(last, (FIXED, 1))])
        fine = np.linspace(0.0, 1.0, 2001)
        given = (ca.DM(whole), ca.DM(duration), ca.DM(q), ca.DM(cables))
        checked = np.asarray(self.rows(fine, *given)[0])
        speeds, accelerations = (checked[rows] for rows in ([4, 8], [5, 9]))
        excess = max(
            float(np.sqrt(1.0 + np.max(speeds) / self.limits.speed**2)) - 1.0,
            float(np.sqrt(1.0 + np.max(accelerations) / self.limits.acceleration**2)) - 1.0,
        )
        return RivalFlight(duration, excess)


def _robot(team: ho.Team, limits: ho.Limits) -> ca.Function:
    """Return the function of one robot's constraint rows (≤ 0) and its drones' places (4,).

    Inputs are value, velocity and acceleration of the coordinates of four vertices, then of the
    q-leg; and the cable length.
    """
    jets, cable = ca.SX.sym("jets", 27), ca.SX.sym("L")
    value, rate, second = jets[::3], jets[1::3], jets[2::3]
    before, start_vertex, end_vertex, after, d = ca.vertsplit(value, [0, 2, 4, 6, 8, 9])
    e = cable - ca.norm_2(end_vertex - start_vertex) - d
    pulled = [
        (start_vertex - before) / ca.norm_2(start_vertex - before),
        (end_vertex - after) / ca.norm_2(end_vertex - after),
    ]
    places = ca.vertcat(start_vertex + d * pulled[0], end_vertex + e * pulled[1])
    speeds = ca.jtimes(places, value, rate)
    arguments, following = ca.vertcat(value, rate), ca.vertcat(rate, second)
    accelerations = ca.jtimes(speeds, arguments, following)
    back, edge = start_vertex - before, end_vertex - start_vertex
    mass, tension = float(team.mass[0]), float(team.tension[0])
    hover, steepest = mass * GRAVITY, float(np.tan(limits.tilt))
    rows = [
        limits.leg - d,
        limits.leg - e,
        1e-3 - (back[1] * edge[0] - back[0] * edge[1]),
        ca.sumsqr(rate[2:4]) - limits.vertex_speed**2,
    ]
    for k, direction in enumerate(pulled):
        acceleration = accelerations[2 * k : 2 * k + 2]
        level = ca.sumsqr(mass * acceleration + tension * direction)
        rows += [
            ca.sumsqr(speeds[2 * k : 2 * k + 2]) - limits.speed**2,
            ca.sumsqr(acceleration) - limits.acceleration**2,
            level + hover**2 - float(team.max_thrust[0]) ** 2,
            level - (steepest * hover) ** 2,
        ]
    return ca.Function("robot", [jets, cable], [ca.vertcat(*rows), places], {"cse": True})
