"""The casadi model of a clasp through which cables slide against friction.

Friction lets the tension step where a cable goes around a clasp: a leg that grows, cable sliding
into it, pulls harder than its edge, one that grows shorter less, by up to ``e^{μ θ}`` for the angle
θ that the cable wraps (the polygon's interior angle where tensions are equal). The clasp still
balances where it is planned if its two legs lean accordingly: ``P_q q̂_k + P_r r̂_{k-1} = V``, a
triangle with the sides ``P_q``, ``P_r`` and the known ``V = T_{k-1} u_{k-1} - T_k u_k - w_k``, in
the plane that V and the planned leg span. With the tensions for pulls it is the clasp without
friction.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca

from hitchopt.model.loaded_clasp import closed_triangle
from hitchopt.model.robot import JET
from hitchopt.model.series import Series, unit


@lru_cache
def slipping_clasp_function() -> ca.Function:
    """Return both drones of clasp k as a function of jets, for any pull of its legs.

    The triangle must exist.

    Returns
    -------
    Function with inputs
        ``vertices`` (9, 4): jets of ``p_{k-1}, p_k, p_{k+1}`` [m], three rows each,
        ``legs`` (2, 4): jets of ``e_{k-1}, d_k`` [m], distances of the drones from ``p_k``,
        ``tensions`` (2, 4): jets of ``T_{k-1}, T_k`` [N], of the edges,
        ``pulls`` (2, 4): jets of what the legs ``e_{k-1}, d_k`` pull with at the clasp [N],
        ``planned`` (3, 4): jets of a vector on the side of V where q_k is [m],
        ``load`` (3, 4): jets of the outside force on the clasp [N],
        ``halves`` (2, 4): jets of half of the weights of both legs' cables [N],
    and outputs
        ``r``, ``q`` (3, 4): jets of the positions of ``r_{k-1}`` and ``q_k`` [m].
    """
    vertices, legs = ca.SX.sym("p", 9, JET), ca.SX.sym("l", 2, JET)
    tensions, pulls = ca.SX.sym("T", 2, JET), ca.SX.sym("P", 2, JET)
    planned, load, halves = ca.SX.sym("x", 3, JET), ca.SX.sym("w", 3, JET), ca.SX.sym("h", 2, JET)
    before, here, there = (Series.of_jet(point) for point in ca.vertsplit(vertices, 3))
    T, P, sizes, half = (
        [Series.of_jet(values[i, :]) for i in range(2)]
        for values in (tensions, pulls, legs, halves)
    )
    r_direction, q_direction = closed_triangle(
        T[0] * unit(here - before) - T[1] * unit(there - here) - Series.of_jet(load),
        Series.of_jet(planned),
        None,
        (P[0], P[1]),
        (half[0], half[1]),
    )
    return ca.Function(
        "slipping_clasp",
        [vertices, legs, tensions, pulls, planned, load, halves],
        [(here + sizes[0] * r_direction).jet, (here + sizes[1] * q_direction).jet],
        ["vertices", "legs", "tensions", "pulls", "planned", "load", "halves"],
        ["r", "q"],
        {"cse": True},
    )
