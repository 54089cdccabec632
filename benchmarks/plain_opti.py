"""A rival: what one would write in plain ``casadi.Opti`` and IPOPT, with free final time.

Vertices and q-legs are uniform B-splines of degree 5 in s = t/T; every limit is kept at equally
spaced samples, distances over all pairs of drones. Started from the straight line, exact Hessians,
expanded to SX. It is let off ``cable_clearance`` and ``crossing``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from benchmarks.rival import RivalError, Solution, flat_ends, flat_sampler, straight_time
from benchmarks.tasks import Task
from hitchopt.model.robot import JET, robot_function

Array = NDArray[np.float64]

DEGREE = 5
FIXED = 3
"""Control points at either end that rest fixes: neither velocity nor acceleration."""


@dataclass(frozen=True)
class Fineness:
    """How fine a rival looks.

    Attributes
    ----------
    control_points: of each spline; more of them fly faster and take longer to find.
    samples: at which limits are kept; fewer let it break them by more, see its excess.
    """

    control_points: int
    samples: int


COARSE, FINE = Fineness(10, 24), Fineness(14, 36)


class Constrained(Protocol):
    """What takes constraints: ``casadi.Opti``, or a rockit ``Ocp``."""

    def subject_to(self, constraint: ca.MX) -> object:
        """Keep a constraint."""


def solve_opti(task: Task, fineness: Fineness, seconds: float) -> Solution:
    """Return IPOPT's solution, found in at most that many seconds of IPOPT.

    Raises
    ------
    RivalError: IPOPT gives up, or runs out of time.
    """
    points, (first, last) = fineness.control_points, flat_ends(task)
    knots = np.concatenate(
        [
            np.zeros(DEGREE),
            np.linspace(0.0, 1.0, points - DEGREE + 1),
            np.ones(DEGREE),
        ]
    )
    basis = BSpline(knots, np.eye(points), DEGREE)
    opti = ca.Opti()
    inner, T = opti.variable(points - 2 * FIXED, len(first)), opti.variable()
    ends = [ca.DM(np.tile(end, (FIXED, 1))) for end in (first, last)]
    control = ca.vertcat(ends[0], inner, ends[1])
    s = np.linspace(0.0, 1.0, fineness.samples)
    jets = [ca.mtimes(ca.DM(basis(s, order)), control) / T**order for order in range(JET)]
    keep_limits(opti, task, jets)
    opti.subject_to(T >= 0.1)
    opti.minimize(T)
    opti.set_initial(T, straight_time(task))
    share = np.linspace(0.0, 1.0, points - 2 * FIXED + 2)[1:-1, None]
    opti.set_initial(inner, first + share * (last - first))
    opti.solver(
        "ipopt",
        {"expand": True, "print_time": False},
        {"print_level": 0, "sb": "yes", "max_iter": 1000, "max_cpu_time": seconds},
    )
    try:
        found = opti.solve()
    except RuntimeError as error:
        if "bad_alloc" in str(error):  # while casadi builds what IPOPT is to call
            raise MemoryError from error
        raise RivalError(str(opti.return_status())) from error
    duration = float(found.value(T))
    curve = BSpline(knots, np.asarray(found.value(control), dtype=np.float64), DEGREE)

    def flat(t: Array) -> Array:
        x = np.clip(t / duration, 0.0, 1.0)
        return np.stack([curve(x, order) / duration**order for order in range(JET)], axis=-1)

    return Solution(duration, flat_sampler(task, flat))


def keep_limits(opti: Constrained, task: Task, jets: list[ca.MX]) -> None:
    """Keep all limits at J samples of flat outputs; ``jets`` are their derivatives (J, 3n)."""
    team, limits, n = task.start.team, task.limits, task.robots
    count = jets[0].shape[0]
    values = ca.vertcat(*(ca.vec(jet.T) for jet in jets), task.start.altitude, 0.0)
    level = 3 * n * count * JET  # where the altitude stands, and after it a zero
    j, k, order = np.ogrid[:count, :n, :JET]
    base = 3 * n * (count * order + j)
    near = (k[..., None] + np.arange(-1, 3)) % n
    places = np.empty((count, n, JET, 4, 3), dtype=np.int_)
    places[..., 0] = base[..., None] + 2 * near
    places[..., 1] = places[..., 0] + 1
    places[..., 2] = np.where(order == 0, level, level + 1)[..., None]
    vertices = ca.reshape(values[places.ravel().tolist()], 12, JET * n * count)
    legs = np.broadcast_to(base + 2 * n + k, (count, n, JET))
    q_leg = ca.reshape(values[legs.ravel().tolist()], 1, JET * n * count)
    tension = ca.DM(np.tile([team.tension[0], 0.0, 0.0, 0.0], (3, n * count)))
    constants = [
        ca.DM(np.full((1, n * count), value)) for value in (team.cable_length[0], team.mass[0])
    ]
    q, r, _, _, q_thrust, r_thrust, r_leg = robot_function(True).map(n * count)(
        vertices, q_leg, tension, *constants
    )
    opti.subject_to(ca.vec(q_leg[0, ::JET]) >= limits.leg)
    opti.subject_to(ca.vec(r_leg[0, ::JET]) >= limits.leg)
    for drone, thrust in ((q, q_thrust), (r, r_thrust)):
        for order_of, limit in ((1, limits.speed), (2, limits.acceleration), (3, limits.jerk)):
            opti.subject_to(ca.vec(ca.sum1(drone[:2, order_of::JET] ** 2)) <= limit**2)
        opti.subject_to(ca.vec(ca.sum1(thrust**2)) <= float(team.max_thrust[0]) ** 2)
        slope = float(np.tan(limits.tilt))
        opti.subject_to(ca.vec(ca.sum1(thrust[:2, :] ** 2)) <= ca.vec((slope * thrust[2, :]) ** 2))
    opti.subject_to(ca.vec(ca.sum1(vertices[3:5, 1::JET] ** 2)) <= limits.vertex_speed**2)
    back = vertices[3:5, ::JET] - vertices[0:2, ::JET]
    edge = vertices[6:8, ::JET] - vertices[3:5, ::JET]
    opti.subject_to(ca.vec(back[1, :] * edge[0, :] - back[0, :] * edge[1, :]) >= 1e-3)
    drones = ca.horzcat(q[:2, ::JET], r[:2, ::JET])
    columns = np.arange(2 * n * count).reshape(2, count, n)
    each = columns.transpose(1, 0, 2).reshape(count, 2 * n)
    i, m = np.triu_indices(2 * n, 1)
    apart = drones[:, each[:, i].ravel().tolist()] - drones[:, each[:, m].ravel().tolist()]
    opti.subject_to(ca.vec(ca.sum1(apart**2)) >= (2.0 * task.separation.radius) ** 2)
