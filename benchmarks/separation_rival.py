"""A rival of the separation planner: plain ``casadi.Opti`` and IPOPT, ellipsoids at knots.

Every drone is a B-spline of degree 5 in s = t/T that starts and ends at rest; free final time;
speed, acceleration, jerk and all pairs of ellipsoids are kept at equally spaced knots. Started from
straight lines that bulge to the right, so that the symmetry of a circle is broken for it; expanded
to SX, exact Hessians.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from hitchopt.mission.swarm_problem import SwarmProblem
from hitchopt.trajectory import PiecewisePolynomial, bernstein

Array = NDArray[np.float64]

DEGREE, FIXED = 5, 3

CONTROL_POINTS = 14
"""Of each spline."""

KNOTS = 24
"""At which limits are kept."""

BULGE = 1.2
"""How far ways bulge to the right half way, as a share of the radius of a ring that has room."""


class RivalError(Exception):
    """IPOPT gave up, or ran out of time."""


@dataclass(frozen=True, eq=False)
class RivalFlight:
    """What the rival found.

    Attributes
    ----------
    curves: of shape (N, 3) [m].
    iterations: of IPOPT.
    """

    curves: PiecewisePolynomial
    iterations: int


def fly_opti(problem: SwarmProblem, duration: float, seconds: float) -> RivalFlight:
    """Return IPOPT's solution, found in at most that many processor seconds of IPOPT.

    Parameters
    ----------
    problem: without prisms and arena.
    duration: to start from [s].
    seconds: of IPOPT.

    Raises
    ------
    RivalError: IPOPT gives up, or runs out of time.
    """
    n = problem.team.drones
    spans = CONTROL_POINTS - DEGREE
    knots = np.concatenate([np.zeros(DEGREE), np.linspace(0.0, 1.0, spans + 1), np.ones(DEGREE)])
    basis = BSpline(knots, np.eye(CONTROL_POINTS), DEGREE)
    first, last = problem.start.ravel(), problem.goal.ravel()
    opti = ca.Opti()
    inner, T = opti.variable(CONTROL_POINTS - 2 * FIXED, 3 * n), opti.variable()
    ends = [ca.DM(np.tile(end, (FIXED, 1))) for end in (first, last)]
    control = ca.vertcat(ends[0], inner, ends[1])
    s = np.linspace(0.0, 1.0, KNOTS)
    limits = problem.limits
    for order, cap in ((1, limits.speed), (2, limits.acceleration), (3, limits.jerk)):
        rate = ca.reshape(ca.mtimes(ca.DM(basis(s, order)), control).T, 3, n * KNOTS)
        opti.subject_to(ca.vec(ca.sum1(rate**2)) <= (cap * T**order) ** 2)
    points = ca.mtimes(ca.DM(basis(s)), control)
    i, j = np.triu_indices(n, 1)
    apart = ca.MX(0.0)
    for axis, scale in enumerate(problem.separation.scale):
        offset = points[:, (3 * i + axis).tolist()] - points[:, (3 * j + axis).tolist()]
        apart = apart + (float(scale) * offset) ** 2
    opti.subject_to(ca.vec(apart) >= 1.0)
    opti.subject_to(T >= 0.1)
    opti.minimize(T)
    opti.set_initial(T, duration)
    opti.set_initial(inner, _bulging(problem))
    opti.solver(
        "ipopt",
        {"expand": True, "print_time": False},
        {"print_level": 0, "sb": "yes", "max_iter": 3000, "max_cpu_time": seconds},
    )
    try:
        found = opti.solve()
    except RuntimeError as error:
        raise RivalError(str(opti.return_status())) from error
    values = np.asarray(found.value(control), dtype=np.float64)
    breaks = np.linspace(0.0, 1.0, spans + 1)
    nodes = bernstein.nodes(DEGREE)
    samples = BSpline(knots, values, DEGREE)(breaks[:-1, None] + nodes / spans)
    pieces = bernstein.interpolate(np.swapaxes(samples, 1, 2)).reshape(spans, n, 3, DEGREE + 1)
    curves = PiecewisePolynomial(float(found.value(T)) * breaks, pieces)
    return RivalFlight(curves, int(opti.stats()["iter_count"]))


def _bulging(problem: SwarmProblem) -> Array:
    """(inner control points, 3 N) [m]: straight lines that bulge to the right."""
    share = np.linspace(0.0, 1.0, CONTROL_POINTS - 2 * FIXED + 2)[1:-1, None, None]
    way = problem.goal - problem.start
    right = np.column_stack([way[:, 1], -way[:, 0], np.zeros(len(way))])
    right /= np.maximum(np.linalg.norm(right, axis=1, keepdims=True), 1e-9)
    ring = problem.separation.radius * len(way) / np.pi
    points = problem.start + share * way + BULGE * ring * np.sin(np.pi * share) * right
    return points.reshape(len(share), -1)
