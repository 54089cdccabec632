"""The casadi model of a clasp through which cables slide against friction.

Friction lets the tension step where a cable goes around a clasp: a leg that grows, cable sliding
into it, pulls harder than its edge, one that grows shorter less, by up to ``e^{μ θ}`` for the angle
θ that the cable wraps (the polygon's interior angle where tensions are equal). The clasp still
balances where it is planned if its two legs lean accordingly: ``P_q q̂_k + P_r r̂_{k-1} = V``, a
triangle with the sides ``P_q``, ``P_r`` and the known ``V = T_{k-1} u_{k-1} - T_k u_k``. With
``P_q = T_k`` and ``P_r = T_{k-1}`` it is the clasp without friction.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca

from hitchopt.model.robot import JET, jet_of, unit


@lru_cache
def slipping_clasp_function() -> ca.Function:
    """Return both drones of clasp k as a function of jets, for any pull of its legs.

    Level hitches only, clockwise seen from above; the triangle must exist.

    Returns
    -------
    Function with inputs
        ``vertices`` (9, 4): jets of ``p_{k-1}, p_k, p_{k+1}`` [m], three rows each,
        ``legs`` (2, 4): jets of ``e_{k-1}, d_k`` [m],
        ``tensions`` (2, 4): jets of ``T_{k-1}, T_k`` [N], of the edges,
        ``pulls`` (2, 4): jets of what the legs ``e_{k-1}, d_k`` pull with [N],
    and outputs
        ``r``, ``q`` (3, 4): jets of the positions of ``r_{k-1}`` and ``q_k`` [m].
    """
    vertices, legs = ca.SX.sym("p", 9, JET), ca.SX.sym("l", 2, JET)
    tensions, pulls = ca.SX.sym("T", 2, JET), ca.SX.sym("P", 2, JET)
    flat = ca.vertcat(vertices, legs, tensions, pulls)
    before, here, there = ca.vertsplit(vertices[:, 0], 3)
    V = tensions[0, 0] * unit(here - before) - tensions[1, 0] * unit(there - here)
    size, outward = ca.norm_2(V), unit(V)
    onward = ca.vertcat(outward[1], -outward[0], 0.0)  # where edge k goes, to the right of V
    behind, ahead = pulls[0, 0], pulls[1, 0]
    along = (size**2 + ahead**2 - behind**2) / (2.0 * size)
    across = ca.sqrt(ahead**2 - along**2)
    q = here + legs[1, 0] * (along * outward + across * onward) / ahead
    r = here + legs[0, 0] * ((size - along) * outward - across * onward) / behind
    return ca.Function(
        "slipping_clasp",
        [vertices, legs, tensions, pulls],
        [jet_of(r, flat), jet_of(q, flat)],
        ["vertices", "legs", "tensions", "pulls"],
        ["r", "q"],
        {"cse": True},
    )
