"""The optimiser's model: a robot's drones at rest, seen from above, in casadi.

Functions are built when they are first asked for, which takes 0.1 s at most.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca

from hitchopt.hitch.series import Series
from hitchopt.model.clasps import Clasp, Edge

NAMES = ("vertices", "q_legs", "tensions", "cable_length", "roll", "loads", "weight")


@lru_cache
def planar(loaded: bool, choice: bool) -> ca.Function:
    """Return robot k at rest in a level closed hitch, seen from above, and the turn at ``p_k``.

    Parameters
    ----------
    loaded: whether clasps carry weight or legs are rolled.
    choice: of loaded clasps whether cables have weight, so that they sag and rest on the clasps; of
        others whether all tensions are equal, so that legs go on along the neighbouring edges.

    Returns
    -------
    Function with inputs ``vertices`` (8, 1): ``p_{k-1}, p_k, p_{k+1}, p_{k+2}`` [m]; ``q_legs``
    [m]: ``d_k``, where loaded (3, 1) of cables k-1, k and k+1; ``tensions`` (3, 1) [N]; and
    ``cable_length`` [m] of cable k, where loaded (2, 1) of cables k-1 and k. Where loaded besides
    ``roll`` (2, 1) [rad] and ``loads`` (6, 1) [N] at ``p_k`` and ``p_{k+1}``, and ``weight`` of
    cables per length [N/m]. Outputs are ``place`` (5, 1): ``q_k``, ``r_k`` from above, ``e_k`` [m],
    and ``turn``: the sine of the exterior angle at ``p_k``.
    """
    names = NAMES if loaded else NAMES[:4]
    sizes = (8, 3, 3, 2, 2, 6, 1) if loaded else (8, 1, 3, 1)
    given = [ca.SX.sym(name, size) for name, size in zip(names, sizes, strict=True)]
    vertices, q_legs, tensions, lengths = given[:4]
    corners = ca.vertsplit(vertices, 2)
    if loaded:
        roll, loads, weight = given[4:]
        corners = [ca.vertcat(point, 0.0) for point in corners]
        rho = weight if choice else None
    else:  # the legs of cables k-1 and k+1 do not matter
        q_legs, lengths, rho = ca.vertcat(0.0, q_legs, 0.0), ca.vertcat(0.0, lengths), None
    points = [Series([point]) for point in corners]
    edges = [Edge.of(points[i + 1] - points[i], Series([tensions[i]]), rho) for i in range(3)]
    d = [Series([q_legs[i]]) for i in range(3)]
    here, there = (
        Clasp.of(
            (edges[i], edges[i + 1]),
            (d[i], d[i + 1]),
            lengths[i],
            loads[3 * i : 3 * i + 3] if loaded else None,
            rho,
            Series([roll[i]]) if loaded else None,
            alike=choice,
        )
        for i in range(2)
    )
    q = points[1] + here.legs[1] * here.directions[1]
    r = points[2] + there.legs[0] * there.directions[0]
    place = ca.vertcat(q.value[:2], r.value[:2], there.r_cable.value)
    u = [edge.along.value for edge in edges]
    turn = u[0][1] * u[1][0] - u[0][0] * u[1][1]
    return ca.Function("planar", given, [place, turn], [*names], ["place", "turn"], {"cse": True})
