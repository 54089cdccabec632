"""The optimiser's model: a robot's drones at rest, seen from above, in casadi.

Functions are built when they are first asked for, which takes 0.1 s at most.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca

from hitchopt.model.clasps import Clasp, Edge, planar_legs
from hitchopt.model.series import Series


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
    vertices, tensions = ca.SX.sym("p", 8), ca.SX.sym("T", 3)
    q_legs, lengths = ca.SX.sym("d", 3 if loaded else 1), ca.SX.sym("L", 2 if loaded else 1)
    given, names = [vertices, q_legs, tensions, lengths], [*NAMES[:4]]
    if loaded:
        roll, loads, weight = ca.SX.sym("psi", 2), ca.SX.sym("w", 6), ca.SX.sym("g")
        given, names = [*given, roll, loads, weight], [*NAMES]
        place, u = _loaded(given, choice)
    else:
        place, u = _plain(given, choice)
    turn = u[0][1] * u[1][0] - u[0][0] * u[1][1]
    return ca.Function("planar", given, [place, turn], names, ["place", "turn"], {"cse": True})


NAMES = ("vertices", "q_legs", "tensions", "cable_length", "roll", "loads", "weight")


def _plain(given: list[ca.SX], alike: bool) -> tuple[ca.SX, list[ca.SX]]:
    """Return place and edges' directions of robot k between clasps that carry nothing."""
    vertices, q_leg, tensions, length = given
    points = [Series([point]) for point in ca.vertsplit(vertices, 2)]
    edges = [Edge.of(points[i + 1] - points[i], Series([tensions[i]]), None) for i in range(3)]
    d = Series([q_leg])
    e = d.constant(length) - edges[1].cable - d
    ends = []
    for behind, ahead in ((edges[0], edges[1]), (edges[1], edges[2])):
        V = None if alike else behind.pull * behind.along - ahead.pull * ahead.along
        ends.append(planar_legs(behind.along, ahead.along, V))
    q, r = points[1] + d * ends[0][1], points[2] + e * ends[1][0]
    return ca.vertcat(q.value, r.value, e.value), [edge.along.value for edge in edges]


def _loaded(given: list[ca.SX], weighty: bool) -> tuple[ca.SX, list[ca.SX]]:
    """Return place and edges' directions of robot k between loaded clasps."""
    vertices, q_legs, tensions, lengths, roll, loads, weight = given
    points = [Series([ca.vertcat(point, 0.0)]) for point in ca.vertsplit(vertices, 2)]
    rho = weight if weighty else None
    edges = [Edge.of(points[i + 1] - points[i], Series([tensions[i]]), rho) for i in range(3)]
    d = [Series([q_legs[i]]) for i in range(3)]
    here, there = (
        Clasp.of(
            (edges[i], edges[i + 1]),
            (d[i], d[i + 1]),
            lengths[i],
            loads[3 * i : 3 * i + 3],
            rho,
            Series([roll[i]]),
        )
        for i in range(2)
    )
    q = points[1] + here.legs[1] * here.directions[1]
    r = points[2] + there.legs[0] * there.directions[0]
    place = ca.vertcat(q.value[:2], r.value[:2], there.r_cable.value)
    return place, [edge.along.value for edge in edges]
