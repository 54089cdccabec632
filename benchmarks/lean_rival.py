"""The lean rival: the least that one would write in plain casadi and IPOPT, with free final time.

Vertices are uniform B-splines of degree 5 in s = t/T with 10 coefficients each; q-legs go evenly
along a smooth step. Speeds, accelerations, thrust, tilt, legs, convexity and the distances of all
pairs of drones are kept at 24 samples; there are no limits of jerk, no cables' clearances, no
certificate. Written in SX throughout, so that casadi differentiates one flat graph.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from benchmarks.rival import RivalError, Solution, flat_ends, flat_sampler, straight_time
from benchmarks.tasks import Task
from hitchopt.hitch import GRAVITY
from hitchopt.model.robot import JET

Array = NDArray[np.float64]

COEFFICIENTS, SAMPLES, DEGREE = 10, 24, 5
FIXED = 3
"""Coefficients at either end that rest fixes."""

LEG_STEP = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])
"""Bernstein coefficients of the q-legs' share of their change."""


def solve_lean(task: Task, seconds: float) -> Solution:
    """Return IPOPT's solution, found in at most that many seconds of IPOPT.

    Raises
    ------
    RivalError: IPOPT gives up, or runs out of time.
    """
    n, (first, last) = task.robots, flat_ends(task)
    inner = COEFFICIENTS - DEGREE
    knots = np.concatenate([np.zeros(DEGREE), np.linspace(0.0, 1.0, inner + 1), np.ones(DEGREE)])
    basis = BSpline(knots, np.eye(COEFFICIENTS), DEGREE)
    step = BSpline(np.repeat([0.0, 1.0], len(LEG_STEP)), LEG_STEP, len(LEG_STEP) - 1)
    places = (first[: 2 * n], last[: 2 * n])
    free = ca.SX.sym("c", COEFFICIENTS - 2 * FIXED, 2 * n)
    T = ca.SX.sym("T")
    ends = [ca.DM(np.tile(place, (FIXED, 1))) for place in places]
    control = ca.vertcat(ends[0], free, ends[1])
    s = np.linspace(0.0, 1.0, SAMPLES)
    change = last[2 * n :] - first[2 * n :]
    vertices = [ca.mtimes(ca.DM(basis(s, order)), control) / T**order for order in range(3)]
    legs = [np.outer(step(s, order), change) for order in range(3)]
    legs[0] += first[2 * n :]
    g = _rows(task, vertices, [ca.DM(jet) / T**order for order, jet in enumerate(legs)])
    share = np.linspace(0.0, 1.0, COEFFICIENTS - 2 * FIXED + 2)[1:-1, None]
    start = places[0] + share * (places[1] - places[0])
    x0 = np.append(start.T.ravel(), straight_time(task))
    low = np.append(np.full(start.size, -np.inf), 0.1)
    solver = ca.nlpsol(
        "lean",
        "ipopt",
        {"x": ca.vertcat(ca.vec(free), T), "f": T, "g": g},
        {
            "print_time": False,
            "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 1000, "max_cpu_time": seconds},
        },
    )
    found = solver(x0=x0, lbx=low, ubx=np.inf, lbg=-np.inf, ubg=0.0)
    if not solver.stats()["success"]:
        raise RivalError(str(solver.stats()["return_status"]))
    x = np.asarray(found["x"], dtype=np.float64).ravel()
    duration = float(x[-1])
    middle = x[:-1].reshape(2 * n, -1).T
    whole = [np.tile(places[0], (FIXED, 1)), middle, np.tile(places[1], (FIXED, 1))]
    curve = BSpline(knots, np.concatenate(whole), DEGREE)

    def flat(t: Array) -> Array:
        x = np.clip(t / duration, 0.0, 1.0)
        orders = []
        for order in range(JET):
            legs = np.outer(step(x, order), change) + (order == 0) * first[2 * n :]
            orders.append(np.concatenate([curve(x, order), legs], axis=1) / duration**order)
        return np.stack(orders, axis=-1)

    return Solution(duration, flat_sampler(task, flat))


def _rows(task: Task, vertices: list[ca.SX], q_legs: list[ca.SX]) -> ca.SX:
    """Return what is not to be positive, of jets (samples, 2n) and (samples, n) by time."""
    n = task.robots
    flat = []
    for shift in (-1, 0, 1, 2):
        at = (np.arange(n) + shift) % n
        for axis in range(2):
            flat += [ca.vec(jet[:, (2 * at + axis).tolist()]).T for jet in vertices]
    flat += [ca.vec(jet).T for jet in q_legs]
    rows, places = _robot(task).map(n * SAMPLES)(ca.vertcat(*flat))
    x, y = (
        ca.horzcat(*(ca.reshape(places[axis + drone, :], SAMPLES, n) for drone in (0, 2)))
        for axis in range(2)
    )
    i, j = (index.tolist() for index in np.triu_indices(2 * n, 1))
    squared = ca.vec((x[:, i] - x[:, j]) ** 2 + (y[:, i] - y[:, j]) ** 2)
    return ca.vertcat(ca.vec(rows), (2.0 * task.separation.radius) ** 2 - squared)


def _robot(task: Task) -> ca.Function:
    """Return one robot's rows and its drones' places (4,), of its four vertices and its q-leg.

    The input's rows are value, velocity and acceleration of every coordinate, then of the q-leg.
    """
    team, limits = task.start.team, task.limits
    jets = ca.SX.sym("jets", 27)
    value, rate, second = jets[::3], jets[1::3], jets[2::3]
    before, here, there, after, d = ca.vertsplit(value, [0, 2, 4, 6, 8, 9])
    e = float(team.cable_length[0]) - ca.norm_2(there - here) - d
    pulled = [
        (here - before) / ca.norm_2(here - before),
        (there - after) / ca.norm_2(there - after),
    ]
    places = ca.vertcat(here + d * pulled[0], there + e * pulled[1])
    speeds = ca.jtimes(places, value, rate)
    known, following = ca.vertcat(value, rate), ca.vertcat(rate, second)
    accelerations = ca.jtimes(speeds, known, following)
    back, edge = here - before, there - here
    mass, tension = float(team.mass[0]), float(team.tension[0])
    hover, slope = mass * GRAVITY, float(np.tan(limits.tilt))
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
            level - (slope * hover) ** 2,
        ]
    return ca.Function("robot", [jets], [ca.vertcat(*rows), places], {"cse": True})
