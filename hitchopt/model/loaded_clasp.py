"""The casadi model of clasps that carry weight, or whose legs are rolled.

The force triangles are those of ``hitchopt.hitch.statics.leg_directions`` with loads. Legs are
lengths of cable; the distances of the drones from their vertices are less where it sags. A clasp
``p_k`` depends on ``p_{k-1} … p_{k+1}`` and on cables k-1 and k only.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import casadi as ca

from hitchopt.hitch.cable_spans import shortening
from hitchopt.hitch.statics import PASSES
from hitchopt.model.cache import stored
from hitchopt.model.robot import JET
from hitchopt.model.series import Series, cosine_and_sine, cross, dot, square_root, unit


@stored
def loaded_clasp_function(weighty: bool, rolled: bool) -> ca.Function:
    """Return both drones at clasp ``p_k`` as a function of the flat outputs' jets.

    Parameters
    ----------
    weighty: whether cables have weight, so that they sag, rest on the clasps, and pull harder the
        higher they are; else clasps carry loads alone.
    rolled: whether legs are rolled; else the roll does not enter.

    Returns
    -------
    Function with inputs
        ``vertices`` (9, 4): jets of ``p_{k-1}, p_k, p_{k+1}`` [m], three rows each,
        ``q_legs`` (2, 4): jets of ``d_{k-1}, d_k`` [m],
        ``tensions`` (2, 4): jets of ``T_{k-1}, T_k`` [N],
        ``roll`` (1, 4): jet of ``ψ_k`` [rad],
        ``cable_length``: ``L_{k-1}`` [m],
        ``load`` (3, 1): outside force on the clasp [N],
        ``weight``: of a cable per length [N/m],
    and outputs
        ``r``, ``q`` (3, 4): jets of the positions of ``r_{k-1}`` and ``q_k`` [m],
        ``r_force``, ``q_force`` (3, 1): the cables' force on them [N],
        ``legs`` (2, 4): jets of their distances from ``p_k`` [m].
    """
    vertices, q_legs, tensions, roll = (
        ca.SX.sym(name, rows, JET) for name, rows in (("p", 9), ("d", 2), ("T", 2), ("psi", 1))
    )
    length, load, weight = ca.SX.sym("L"), ca.SX.sym("w", 3), ca.SX.sym("g")
    points = [Series.of_jet(point) for point in ca.vertsplit(vertices, 3)]
    clasp = Clasp.of(
        points,
        [Series.of_jet(q_legs[i, :]) for i in range(2)],
        [Series.of_jet(tensions[i, :]) for i in range(2)],
        Series.of_jet(roll) if rolled else None,
        (length, load, weight if weighty else ca.SX(0.0)),
    )
    forces = []
    for i in range(2):
        half = 0.5 * weight if weighty else ca.SX(0.0)
        direction, leg = clasp.directions[i].value, clasp.legs[i].value
        pull = tensions[i, 0] + half * leg * direction[2]
        forces.append(-pull * direction - ca.vertcat(0.0, 0.0, half * leg))
    places = [points[1] + clasp.legs[i] * clasp.directions[i] for i in range(2)]
    return ca.Function(
        "loaded_clasp",
        [vertices, q_legs, tensions, roll, length, load, weight],
        [*(place.jet for place in places), *forces, ca.vertcat(*(leg.jet for leg in clasp.legs))],
        ["vertices", "q_legs", "tensions", "roll", "cable_length", "load", "weight"],
        ["r", "q", "r_force", "q_force", "legs"],
        {"cse": True},
    )


@stored
def loaded_planar_function(weighty: bool) -> ca.Function:
    """Return robot k at rest in a level closed hitch, seen from above, as ``planar_function``.

    Parameters
    ----------
    weighty: see ``loaded_clasp_function``.

    Returns
    -------
    Function with inputs ``vertices`` (8, 1): ``p_{k-1}, p_k, p_{k+1}, p_{k+2}`` [m]; ``q_legs``,
    ``tensions`` (3, 1) of cables k-1, k and k+1; ``cable_length`` (2, 1) of cables k-1 and k;
    ``roll`` (2, 1) and ``loads`` (6, 1) at ``p_k`` and ``p_{k+1}``; ``weight``; and outputs
    ``place`` (5, 1): ``q_k``, ``r_k`` from above, ``e_k`` [m], and ``turn``: the sine of the
    exterior angle at ``p_k``.
    """
    vertices, q_legs, tensions = ca.SX.sym("p", 8), ca.SX.sym("d", 3), ca.SX.sym("T", 3)
    lengths, roll, loads = ca.SX.sym("L", 2), ca.SX.sym("psi", 2), ca.SX.sym("w", 6)
    weight = ca.SX.sym("g")
    points = [Series([ca.vertcat(point, 0.0)]) for point in ca.vertsplit(vertices, 2)]
    d, T = ([Series([x]) for x in ca.vertsplit(values)] for values in (q_legs, tensions))
    rho = weight if weighty else ca.SX(0.0)
    here, there = (
        Clasp.of(
            points[i : i + 3],
            d[i : i + 2],
            T[i : i + 2],
            Series([roll[i]]),
            (lengths[i], loads[3 * i : 3 * i + 3], rho),
        )
        for i in range(2)
    )
    q = points[1] + here.legs[1] * here.directions[1]
    r = points[2] + there.legs[0] * there.directions[0]
    u = [unit(points[i + 1] - points[i]).value for i in range(2)]
    turn = u[0][1] * u[1][0] - u[0][0] * u[1][1]
    place = ca.vertcat(q.value[:2], r.value[:2], there.r_cable.value)
    return ca.Function(
        "loaded_planar",
        [vertices, q_legs, tensions, lengths, roll, loads, weight],
        [place, turn],
        ["vertices", "q_legs", "tensions", "cable_length", "roll", "loads", "weight"],
        ["place", "turn"],
        {"cse": True},
    )


@dataclass(frozen=True, eq=False)
class Clasp:
    """Both legs at clasp k, that of r_{k-1} first.

    Attributes
    ----------
    directions: unit vectors to the drones.
    legs: distances of the drones from the clasp [m].
    r_cable: length of cable of r_{k-1}'s leg [m].
    """

    directions: tuple[Series, Series]
    legs: tuple[Series, Series]
    r_cable: Series

    @classmethod
    def of(
        cls,
        points: list[Series],
        q_legs: list[Series],
        tensions: list[Series],
        roll: Series | None,
        constants: tuple[ca.SX, ca.SX, ca.SX],
    ) -> Clasp:
        """Return the legs at ``p_k``.

        Parameters
        ----------
        points: ``p_{k-1}, p_k, p_{k+1}`` [m].
        q_legs, tensions: of cables k-1 and k [m], [N].
        roll: [rad]; None for none.
        constants: the length of cable k-1 [m], the outside force [N], and the weight of cables per
            length [N/m].
        """
        length, load, weight = constants
        half = 0.5 * weight
        edges = [b - a for a, b in pairwise(points)]
        sizes = [square_root(dot(edge, edge)) for edge in edges]
        factors, cables = [], []  # of sag, and lengths of cable along the edges
        for edge, size, T in zip(edges, sizes, tensions, strict=True):
            factor = Series.constant(weight * weight / 24.0, T) / (T * T)
            level = dot(edge.row(0, 1), edge.row(0, 1))
            factors.append(factor)
            cables.append(size + size * factor * level)
        whole = Series.constant(length, sizes[0])
        e, d = whole - cables[0] - q_legs[0], q_legs[1]
        # Half of what lies about the clasp: of cable k-1 all but its q-leg.
        carried = (whole - q_legs[0] + d + cables[1]).scaled(half)
        down = Series.constant(ca.SX([0.0, 0.0, 1.0]), sizes[0])
        u = [edge / size for edge, size in zip(edges, sizes, strict=True)]
        V = (
            tensions[0] * u[0]
            - tensions[1] * u[1]
            - Series.constant(load, sizes[0])
            + carried * down
        )
        directions = closed_triangle(
            V, u[0] + u[1], roll, (tensions[0], tensions[1]), (e.scaled(half), d.scaled(half))
        )
        legs = []
        for cable, direction, factor in zip((e, d), directions, factors, strict=True):
            level = dot(direction.row(0, 1), direction.row(0, 1))
            legs.append(cable * shortening(factor * cable * cable * level))
        return cls(directions, (legs[0], legs[1]), e)


def closed_triangle(
    V: Series,
    onward: Series,
    roll: Series | None,
    pulls: tuple[Series, Series],
    halves: tuple[Series, Series],
) -> tuple[Series, Series]:
    """Return the directions of the legs r_{k-1} and q_k at a clasp, by ``statics.leg_directions``.

    Parameters
    ----------
    V: the known side of the force triangle [N].
    onward: a vector on the side of V where q_k is without roll, in the plane of both legs.
    roll: [rad]; None for none.
    pulls: of both legs at the clasp [N].
    halves: half of the weights of both legs [N].
    """
    size = square_root(dot(V, V))
    along = V / size
    across = unit(onward - dot(onward, along) * along)
    if roll is not None:
        cosine, sine = cosine_and_sine(roll)
        across = cosine * across + sine * cross(across, along)
    behind, ahead = pulls
    for left in reversed(range(PASSES)):
        a = (size + (ahead - behind) * (ahead + behind) / size).scaled(0.5)
        h = square_root((ahead - a) * (ahead + a))
        sides = ((size - a) * along - h * across, a * along + h * across)
        r_direction, q_direction = sides[0] / behind, sides[1] / ahead
        if left:
            behind = pulls[0] + halves[0] * r_direction.row(2)
            ahead = pulls[1] + halves[1] * q_direction.row(2)
    return r_direction, q_direction
