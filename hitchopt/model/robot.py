"""The casadi model of one catenary robot in a hitch.

Flat outputs are the vertices ``p_k``, the q-legs ``d_k`` and the tensions ``T_k``, each with its
derivatives up to the third by a common parameter (time, or a path's): a *jet*. Robot k depends on
``p_{k-1} … p_{k+2}``, ``d_k`` and ``T_{k-1} … T_{k+1}`` only, so a hitch of n robots at J times is
one function mapped over n·J columns, and its derivatives stay as local.

At the ends of an open chain, where there is no leg, the edge's other end stands in for the point
beyond: u_{k-1} = -u_k turns the cable back onto its edge, so that with ``d_k = 0`` the drone stands
at p_k and its cable pulls it along the edge.
"""

from __future__ import annotations

import casadi as ca

from hitchopt.hitch import GRAVITY
from hitchopt.model.cache import stored

ORDER = 3
"""Order of the highest derivative in jets, the jerk."""

JET = ORDER + 1
"""Number of columns of a jet."""


@stored
def robot_function(equal_tensions: bool) -> ca.Function:
    """Return robot k's drones as a function of the flat outputs' jets.

    Parameters
    ----------
    equal_tensions: the paper's class (its eq. (3)), where the legs go on along the neighbouring
        edges; else the clasp solution for any tensions. The latter is 0/0 where neighbouring
        edges are parallel and their tensions equal.

    Returns
    -------
    Function with inputs
        ``vertices`` (12, 4): jets of ``p_{k-1}, p_k, p_{k+1}, p_{k+2}`` [m], three rows each,
        ``q_leg`` (1, 4): jet of ``d_k`` [m],
        ``tensions`` (3, 4): jets of ``T_{k-1}, T_k, T_{k+1}`` [N],
        ``cable_length`` [m], ``mass`` [kg],
    and outputs
        ``q``, ``r`` (3, 4): jets of the drones' positions [m],
        ``q_force``, ``r_force`` (3, 1): the cable's force on them [N],
        ``q_thrust``, ``r_thrust`` (3, 1): ``m (a + g ẑ) - cable force`` [N], with the parameter
        taken as time,
        ``r_leg`` (1, 4): jet of ``e_k`` [m].
    """
    vertices, q_leg, tensions = (
        ca.SX.sym("p", 12, JET),
        ca.SX.sym("d", 1, JET),
        ca.SX.sym("T", 3, JET),
    )
    length, mass = ca.SX.sym("L"), ca.SX.sym("m")
    flat = ca.vertcat(vertices, q_leg, tensions)
    before, here, there, after = ca.vertsplit(vertices[:, 0], 3)
    u = unit(here - before), unit(there - here), unit(after - there)
    q_direction, r_direction = _leg_directions(u, tensions[:, 0], equal_tensions)
    T = tensions[1, 0]
    r_leg = length - ca.norm_2(there - here) - q_leg[0]
    q = jet_of(here + q_leg[0] * q_direction, flat)
    r = jet_of(there + r_leg * r_direction, flat)
    lift = ca.DM([0.0, 0.0, GRAVITY])
    q_force, r_force = -T * q_direction, -T * r_direction
    outputs = {
        "q": q,
        "r": r,
        "q_force": q_force,
        "r_force": r_force,
        "q_thrust": mass * (q[:, 2] + lift) - q_force,
        "r_thrust": mass * (r[:, 2] + lift) - r_force,
        "r_leg": jet_of(r_leg, flat),
    }
    return ca.Function(
        "robot",
        [vertices, q_leg, tensions, length, mass],
        list(outputs.values()),
        ["vertices", "q_leg", "tensions", "cable_length", "mass"],
        list(outputs),
        {"cse": True},
    )


@stored
def planar_function(equal_tensions: bool) -> ca.Function:
    """Return robot k at rest in a level hitch, seen from above, and the turn at ``p_k``.

    Parameters
    ----------
    equal_tensions: see ``robot_function``.

    Returns
    -------
    Function with inputs ``vertices`` (8, 1): ``p_{k-1}, p_k, p_{k+1}, p_{k+2}`` [m], ``q_leg``:
    ``d_k`` [m], ``tensions`` (3, 1) [N], ``cable_length`` [m], and outputs ``place`` (5, 1):
    ``q_k``, ``r_k``, ``e_k`` [m], and ``turn``: the sine of the exterior angle at ``p_k``.
    """
    vertices, q_leg = ca.SX.sym("p", 8), ca.SX.sym("d")
    tensions, length = ca.SX.sym("T", 3), ca.SX.sym("L")
    before, here, there, after = ca.vertsplit(vertices, 2)
    u = unit(here - before), unit(there - here), unit(after - there)
    q_direction, r_direction = _leg_directions(u, tensions, equal_tensions)
    r_leg = length - ca.norm_2(there - here) - q_leg
    place = ca.vertcat(here + q_leg * q_direction, there + r_leg * r_direction, r_leg)
    turn = u[0][1] * u[1][0] - u[0][0] * u[1][1]
    return ca.Function(
        "planar",
        [vertices, q_leg, tensions, length],
        [place, turn],
        ["vertices", "q_leg", "tensions", "cable_length"],
        ["place", "turn"],
        {"cse": True},
    )


def _leg_directions(
    u: tuple[ca.SX, ca.SX, ca.SX], tensions: ca.SX, equal_tensions: bool
) -> tuple[ca.SX, ca.SX]:
    """Return the directions of robot k's q-leg and r-leg, by ``statics.leg_directions``.

    Parameters
    ----------
    u: unit vectors along edges k - 1, k and k + 1.
    tensions: (3, 1) [N], those of the same edges.
    """
    if equal_tensions:
        return u[0], -u[2]
    T_before, T, T_after = ca.vertsplit(tensions)
    q_direction = _reflected(u[1], T_before * u[0] - T * u[1])
    return q_direction, -_reflected(u[1], T * u[1] - T_after * u[2])


def unit(vector: ca.SX) -> ca.SX:
    """Return the direction of a vector."""
    return vector / ca.norm_2(vector)


def _reflected(u: ca.SX, V: ca.SX) -> ca.SX:
    """Return u mirrored in the plane normal to V: ``u - 2 (u·v̂) v̂``."""
    return u - 2.0 * ca.dot(u, V) / ca.dot(V, V) * V


def jet_of(value: ca.SX, flat: ca.SX) -> ca.SX:
    """Return a value and its derivatives by the parameter, given the flat outputs' jets."""
    columns = [value]
    known = ca.vec(flat[:, :ORDER])
    following = ca.vec(flat[:, 1:])
    for _ in range(ORDER):
        columns.append(ca.jtimes(columns[-1], known, following))
    return ca.horzcat(*columns)
