"""The casadi model of one catenary robot in a hitch, and of one clasp.

Flat outputs are the vertices ``p_k``, the q-legs ``d_k`` and the tensions ``T_k``, each with its
derivatives up to the third by a common parameter (time, or a path's): a *jet*. Robot k depends on
``p_{k-1} … p_{k+2}``, ``d_k`` and ``T_{k-1} … T_{k+1}`` only, so a hitch of n robots at J times is
one function mapped over n·J columns, and its derivatives stay as local.

At the ends of an open chain, where there is no leg, the edge's other end stands in for the point
beyond: u_{k-1} = -u_k turns the cable back onto its edge, so that with ``d_k = 0`` the drone stands
at p_k and its cable pulls it along the edge.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca

from hitchopt.hitch import GRAVITY
from hitchopt.model.cache import kept

ORDER = 3
"""Jets go up to the jerk."""

JET = ORDER + 1


@kept
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
        ``cable_length`` [m], ``mass`` [kg], ``cable_weight`` [N] that each drone carries,
    and outputs
        ``q``, ``r`` (3, 4): jets of the drones' positions [m],
        ``q_force``, ``r_force`` (3, 1): the cable's force on them [N],
        ``q_thrust``, ``r_thrust`` (3, 1): ``m (a + g ẑ) - cable force`` [N], with the parameter
        taken as time,
        ``r_leg`` (1, 4): jet of ``e_k`` [m],
        ``cable_residual``: ``|q - p_k| + |p_{k+1} - p_k| + |r - p_{k+1}| - L`` [m].
    """
    vertices, q_leg, tensions = (
        ca.SX.sym("p", 12, JET),
        ca.SX.sym("d", 1, JET),
        ca.SX.sym("T", 3, JET),
    )
    length, mass, weight = ca.SX.sym("L"), ca.SX.sym("m"), ca.SX.sym("w")
    flat = ca.vertcat(vertices, q_leg, tensions)
    before, here, there, after = ca.vertsplit(vertices[:, 0], 3)
    u_before, u, u_after = unit(here - before), unit(there - here), unit(after - there)
    T_before, T, T_after = ca.vertsplit(tensions[:, 0])
    if equal_tensions:
        q_direction, r_direction = u_before, -u_after
    else:
        q_direction = _reflected(u, T_before * u_before - T * u)
        r_direction = -_reflected(u, T * u - T_after * u_after)
    edge = ca.norm_2(there - here)
    r_leg = length - edge - q_leg[0]
    q = jet_of(here + q_leg[0] * q_direction, flat)
    r = jet_of(there + r_leg * r_direction, flat)
    lift = ca.DM([0.0, 0.0, GRAVITY])
    down = ca.vertcat(0.0, 0.0, -weight)
    q_force, r_force = down - T * q_direction, down - T * r_direction
    residual = ca.norm_2(q[:, 0] - here) + edge + ca.norm_2(r[:, 0] - there) - length
    outputs = {
        "q": q,
        "r": r,
        "q_force": q_force,
        "r_force": r_force,
        "q_thrust": mass * (q[:, 2] + lift) - q_force,
        "r_thrust": mass * (r[:, 2] + lift) - r_force,
        "r_leg": jet_of(r_leg, flat),
        "cable_residual": residual,
    }
    return ca.Function(
        "robot",
        [vertices, q_leg, tensions, length, mass, weight],
        list(outputs.values()),
        ["vertices", "q_leg", "tensions", "cable_length", "mass", "cable_weight"],
        list(outputs),
        {"cse": True},
    )


@lru_cache
def clasp_function() -> ca.Function:
    """Return the unbalanced force at clasp k, eq. (2) of the paper, for any positions.

    Returns
    -------
    Function with inputs ``vertices`` (9, 1): ``p_{k-1}, p_k, p_{k+1}`` [m], ``q`` (3, 1): ``q_k``,
    ``r`` (3, 1): ``r_{k-1}`` [m], ``tensions`` (2, 1): ``T_{k-1}, T_k`` [N], ``load`` (3, 1):
    ``w_k`` [N], and output ``residual`` (3, 1) [N].
    """
    vertices, q, r = ca.SX.sym("p", 9), ca.SX.sym("q", 3), ca.SX.sym("r", 3)
    tensions, load = ca.SX.sym("T", 2), ca.SX.sym("w", 3)
    before, here, there = ca.vertsplit(vertices, 3)
    ahead = tensions[1] * (unit(q - here) + unit(there - here))
    behind = tensions[0] * (unit(r - here) - unit(here - before))
    return ca.Function(
        "clasp",
        [vertices, q, r, tensions, load],
        [ahead + behind + load],
        ["vertices", "q", "r", "tensions", "load"],
        ["residual"],
    )


def unit(vector: ca.SX) -> ca.SX:
    """Return the direction of a vector."""
    return vector / ca.norm_2(vector)


def _reflected(u: ca.SX, V: ca.SX) -> ca.SX:
    """Return u mirrored in the plane normal to V: ``u - 2 (u·v̂) v̂``."""
    return u - 2.0 * ca.dot(u, V) / ca.dot(V, V) * V


def jet_of(value: ca.SX, flat: ca.SX) -> ca.SX:
    """Return the value and its derivatives by the parameter, given the flat outputs' jets."""
    columns = [value]
    known = ca.vec(flat[:, :ORDER])
    following = ca.vec(flat[:, 1:])
    for _ in range(ORDER):
        columns.append(ca.jtimes(columns[-1], known, following))
    return ca.horzcat(*columns)
