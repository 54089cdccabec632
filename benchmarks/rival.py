"""A rival of optimised morphs: a minimal formulation in plain casadi and IPOPT.

Vertices are uniform B-splines of degree 5 in s = t/T with 10 coefficients each and free final time;
q-legs go evenly along a smooth step. Speeds, accelerations, thrust, tilt, legs, convexity and the
distances of all pairs of drones are kept at 24 samples. There are no limits of jerk, no clearances
of cables, no certificate. Written in SX throughout, so that casadi differentiates one flat graph.
"""

from __future__ import annotations

from dataclasses import dataclass

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
class Rival:
    """Solution of the rival."""

    duration: float  # duration of the flight [s]
    # largest relative excess over the limits of speed and acceleration between samples
    excess: float


class RivalError(Exception):
    """IPOPT failed or ran out of time."""


def solve(
    start: ho.Hitch, end: ho.Hitch, limits: ho.Limits, separation: ho.Separation, seconds: float
) -> Rival:
    """Return IPOPT's solution within a limit of processor time [s].

    Raises
    ------
    RivalError: IPOPT fails or runs out of time.
    """
    n = start.team.robots
    (first, q_first), (last, q_last) = (
        (hitch.vertices[:, :2].ravel(), hitch.q_legs) for hitch in (start, end)
    )
    inner = COEFFICIENTS - DEGREE
    knots = np.concatenate([np.zeros(DEGREE), np.linspace(0.0, 1.0, inner + 1), np.ones(DEGREE)])
    basis = BSpline(knots, np.eye(COEFFICIENTS), DEGREE)
    robot = _robot(start, limits)
    free, T = ca.SX.sym("c", COEFFICIENTS - 2 * FIXED, 2 * n), ca.SX.sym("T")
    fixed = [ca.DM(np.tile(place, (FIXED, 1))) for place in (first, last)]
    control = ca.vertcat(fixed[0], free, fixed[1])

    def jets(s: Array, control: ca.SX | ca.DM, T: ca.SX | ca.DM) -> ca.SX | ca.DM:
        legs = [np.outer(LEG_STEP(s, order), q_last - q_first) for order in range(3)]
        legs[0] += q_first
        vertices = [ca.mtimes(ca.DM(basis(s, order)), control) / T**order for order in range(3)]
        flat = []
        for shift in (-1, 0, 1, 2):
            at = (np.arange(n) + shift) % n
            for axis in range(2):
                flat += [ca.vec(jet[:, (2 * at + axis).tolist()]).T for jet in vertices]
        flat += [ca.vec(ca.DM(leg) / T**order).T for order, leg in enumerate(legs)]
        return ca.vertcat(*flat)

    rows, places = robot.map(n * SAMPLES)(jets(np.linspace(0.0, 1.0, SAMPLES), control, T))
    x, y = (
        ca.horzcat(*(ca.reshape(places[axis + drone, :], SAMPLES, n) for drone in (0, 2)))
        for axis in range(2)
    )
    i, j = (index.tolist() for index in np.triu_indices(2 * n, 1))
    squared = ca.vec((x[:, i] - x[:, j]) ** 2 + (y[:, i] - y[:, j]) ** 2)
    g = ca.vertcat(ca.vec(rows), (2.0 * separation.radius) ** 2 - squared)
    share = np.linspace(0.0, 1.0, COEFFICIENTS - 2 * FIXED + 2)[1:-1, None]
    guess = first + share * (last - first)
    longest = float(np.max(np.linalg.norm(end.drones - start.drones, axis=-1)))
    solver = ca.nlpsol(
        "rival",
        "ipopt",
        {"x": ca.vertcat(ca.vec(free), T), "f": T, "g": g},
        {
            "print_time": False,
            "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 1000, "max_cpu_time": seconds},
        },
    )
    solution = solver(
        x0=np.append(guess.T.ravel(), 2.0 + 4.0 * longest),
        lbx=np.append(np.full(guess.size, -np.inf), 0.1),
        ubx=np.inf,
        lbg=-np.inf,
        ubg=0.0,
    )
    if not solver.stats()["success"]:
        raise RivalError(str(solver.stats()["return_status"]))
    values = np.asarray(solution["x"], dtype=np.float64).ravel()
    duration, middle = float(values[-1]), values[:-1].reshape(2 * n, -1).T
    whole = np.concatenate([np.tile(first, (FIXED, 1)), middle, np.tile(last, (FIXED, 1))])
    fine = np.linspace(0.0, 1.0, 2001)
    checked = robot.map(n * len(fine))(jets(fine, ca.DM(whole), ca.DM(duration)))[0]
    speeds, accelerations = (np.asarray(checked)[rows] for rows in ([4, 8], [5, 9]))
    excess = max(
        float(np.sqrt(1.0 + np.max(speeds) / limits.speed**2)) - 1.0,
        float(np.sqrt(1.0 + np.max(accelerations) / limits.acceleration**2)) - 1.0,
    )
    return Rival(duration, excess)


def _robot(start: ho.Hitch, limits: ho.Limits) -> ca.Function:
    """Return the function of one robot's constraint rows (≤ 0) and its drones' places (4,).

    The input has value, velocity and acceleration of the coordinates of four vertices, then of the
    q-leg.
    """
    team = start.team
    jets = ca.SX.sym("jets", 27)
    value, rate, second = jets[::3], jets[1::3], jets[2::3]
    before, start_vertex, end_vertex, after, d = ca.vertsplit(value, [0, 2, 4, 6, 8, 9])
    e = float(team.cable_length[0]) - ca.norm_2(end_vertex - start_vertex) - d
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
    return ca.Function("robot", [jets], [ca.vertcat(*rows), places], {"cse": True})
