"""The casadi model of one catenary robot whose clasps carry weight, or whose legs are rolled.

The force triangles are those of ``hitchopt.hitch.statics.leg_directions`` with loads. Legs are
lengths of cable; the distances of the drones from their vertices are less where it sags. Where a
chain's end has no leg, the cable's direction at the drone is that of its edge.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import casadi as ca

from hitchopt.hitch import GRAVITY
from hitchopt.hitch.cable_spans import shortening
from hitchopt.hitch.statics import PASSES
from hitchopt.model.cache import stored
from hitchopt.model.robot import JET, jet_of, unit


@stored
def loaded_robot_function(weighty: bool) -> ca.Function:
    """Return robot k's drones where clasps carry loads or legs are rolled, as ``robot_function``.

    Parameters
    ----------
    weighty: whether cables have weight, so that they sag, rest on the clasps, and pull harder the
        higher they are; else clasps carry loads alone.

    Returns
    -------
    Function with inputs
        ``vertices`` (12, 4): jets of ``p_{k-1}, p_k, p_{k+1}, p_{k+2}`` [m], three rows each,
        ``q_legs`` (3, 4): jets of ``d_{k-1}, d_k, d_{k+1}`` [m],
        ``tensions`` (3, 4): jets of ``T_{k-1}, T_k, T_{k+1}`` [N],
        ``roll`` (2, 4): jets of the roll at ``p_k`` and ``p_{k+1}`` [rad],
        ``cable_length`` (3, 1): those of cables k - 1, k and k + 1 [m],
        ``loads`` (6, 1): outside forces on the clasps ``p_k`` and ``p_{k+1}`` [N], three rows each,
        ``has_leg`` (2, 1): 1 where q_k and r_k have a leg, 0 where they have none,
        ``mass`` [kg], ``weight``: of a cable per length [N/m],
    and the outputs of ``robot_function``, with ``legs`` (2, 4), jets of the distances of the drones
    from their vertices [m], in the place of ``r_leg``.
    """
    vertices, q_legs, tensions, roll = (
        ca.SX.sym(name, rows, JET) for name, rows in (("p", 12), ("d", 3), ("T", 3), ("psi", 2))
    )
    lengths, loads, has_leg = ca.SX.sym("L", 3), ca.SX.sym("w", 6), ca.SX.sym("b", 2)
    mass, weight = ca.SX.sym("m"), ca.SX.sym("g")
    flat = ca.vertcat(vertices, q_legs, tensions, roll)
    legs = _Legs.of(
        ca.vertsplit(vertices[:, 0], 3),
        (q_legs[:, 0], tensions[:, 0], roll[:, 0]),
        (lengths, loads, has_leg, weight if weighty else ca.SX(0.0)),
    )
    lift = ca.vertcat(0.0, 0.0, GRAVITY)
    places, forces, thrusts = [], [], []
    for i in range(2):
        place = jet_of(legs.ends[i] + legs.chords[i] * legs.directions[i], flat)
        force = -legs.pulls[i] * legs.directions[i] - ca.vertcat(0.0, 0.0, legs.weights[i])
        places.append(place)
        forces.append(force)
        thrusts.append(mass * (place[:, 2] + lift) - force)
    return ca.Function(
        "loaded_robot",
        [vertices, q_legs, tensions, roll, lengths, loads, has_leg, mass, weight],
        [*places, *forces, *thrusts, jet_of(ca.vertcat(*legs.chords), flat)],
        [
            *("vertices", "q_legs", "tensions", "roll", "cable_length", "loads", "has_leg"),
            *("mass", "weight"),
        ],
        ["q", "r", "q_force", "r_force", "q_thrust", "r_thrust", "legs"],
        {"cse": True},
    )


@stored
def loaded_planar_function(weighty: bool) -> ca.Function:
    """Return robot k at rest in a level closed hitch, seen from above, as ``planar_function``.

    Parameters
    ----------
    weighty: see ``loaded_robot_function``.

    Returns
    -------
    Function with inputs ``vertices`` (8, 1): ``p_{k-1}, p_k, p_{k+1}, p_{k+2}`` [m]; ``q_legs``,
    ``tensions``, ``cable_length`` (3, 1); ``roll`` (2, 1), ``loads`` (6, 1) and ``weight`` as of
    ``loaded_robot_function``; and outputs ``place`` (5, 1): ``q_k``, ``r_k`` from above, ``e_k``
    [m], and ``turn``: the sine of the exterior angle at ``p_k``.
    """
    vertices, q_legs, tensions = ca.SX.sym("p", 8), ca.SX.sym("d", 3), ca.SX.sym("T", 3)
    lengths, roll, loads = ca.SX.sym("L", 3), ca.SX.sym("psi", 2), ca.SX.sym("w", 6)
    weight = ca.SX.sym("g")
    points = [ca.vertcat(point, 0.0) for point in ca.vertsplit(vertices, 2)]
    has_leg = ca.SX.ones(2)
    legs = _Legs.of(
        points,
        (q_legs, tensions, roll),
        (lengths, loads, has_leg, weight if weighty else ca.SX(0.0)),
    )
    q, r = (legs.ends[i] + legs.chords[i] * legs.directions[i] for i in range(2))
    u = [unit(b - a) for a, b in pairwise(points)]
    turn = u[0][1] * u[1][0] - u[0][0] * u[1][1]
    return ca.Function(
        "loaded_planar",
        [vertices, q_legs, tensions, lengths, roll, loads, weight],
        [ca.vertcat(q[:2], r[:2], legs.r_cable), turn],
        ["vertices", "q_legs", "tensions", "cable_length", "roll", "loads", "weight"],
        ["place", "turn"],
        {"cse": True},
    )


@dataclass(frozen=True, eq=False)
class _Legs:
    """Both legs of robot k, that of q_k first.

    Attributes
    ----------
    ends: the vertices that they hang on (3, 1) [m].
    directions: unit vectors to the drones (3, 1).
    chords: distances of the drones from their vertices [m].
    pulls: along the chords [N].
    weights: that the drones carry [N].
    r_cable: length of cable of the r-leg [m].
    """

    ends: list[ca.SX]
    directions: list[ca.SX]
    chords: list[ca.SX]
    pulls: list[ca.SX]
    weights: list[ca.SX]
    r_cable: ca.SX

    @classmethod
    def of(
        cls,
        points: list[ca.SX],
        state: tuple[ca.SX, ca.SX, ca.SX],
        constants: tuple[ca.SX, ca.SX, ca.SX, ca.SX],
    ) -> _Legs:
        """Return the legs of robot k.

        Parameters
        ----------
        points: ``p_{k-1}, p_k, p_{k+1}, p_{k+2}`` (3, 1) [m].
        state: ``q_legs``, ``tensions``, ``roll``.
        constants: ``cable_length``, ``loads``, ``has_leg``, ``weight``.
        """
        (d, T, roll), (lengths, loads, has_leg, weight) = state, constants
        chords = [b - a for a, b in pairwise(points)]
        sizes = [ca.norm_2(chord) for chord in chords]
        u = [chord / size for chord, size in zip(chords, sizes, strict=True)]
        factors = (weight / T) ** 2 / 24.0
        half = 0.5 * weight
        # What is left of each cable for its r-leg: none at a chain's end.
        e = [
            lengths[i] - sizes[i] * (1.0 + factors[i] * ca.sumsqr(chords[i][:2])) - d[i]
            for i in range(3)
        ]
        e[1] = has_leg[1] * e[1]
        ends = []
        for i in range(2):
            # Beyond a chain's end something that closes a triangle stands in for what is not there.
            side = ca.vertcat(-u[1][1], u[1][0], 0.0) * (1.0 - 2.0 * i)
            beyond = 2 * i
            other = has_leg[i] * u[beyond] + (1.0 - has_leg[i]) * side
            T_other = has_leg[i] * T[beyond] + (1.0 - has_leg[i]) * T[1]
            before, after = (other, u[1]) if i == 0 else (u[1], other)
            pulls = (T_other, T[1]) if i == 0 else (T[1], T_other)
            carried = lengths[i] - d[i] + lengths[i + 1] - e[i + 1]
            w = loads[3 * i : 3 * i + 3] - ca.vertcat(0.0, 0.0, has_leg[i] * half * carried)
            both = closed_triangle(
                pulls[0] * before - pulls[1] * after - w,
                before + after,
                roll[i],
                pulls,
                (half * e[i], half * d[i + 1]),
            )
            straight = -u[1] if i == 0 else u[1]
            ends.append(has_leg[i] * both[1 - i] + (1.0 - has_leg[i]) * straight)
        cables = (d[1], e[1])
        legs = [
            cable * shortening(factors[1] * cable * cable * ca.sumsqr(direction[:2]))
            for cable, direction in zip(cables, ends, strict=True)
        ]
        # The straight piece of cable up to the drone: its leg, or its edge.
        spans = [leg + (1.0 - has_leg[i]) * sizes[1] for i, leg in enumerate(legs)]
        return cls(
            [points[1], points[2]],
            ends,
            legs,
            [T[1] + half * span * along[2] for span, along in zip(spans, ends, strict=True)],
            [half * span for span in spans],
            e[1],
        )


def closed_triangle(
    V: ca.SX,
    onward: ca.SX,
    roll: ca.SX,
    pulls: tuple[ca.SX, ca.SX],
    halves: tuple[ca.SX, ca.SX],
) -> tuple[ca.SX, ca.SX]:
    """Return the directions of the legs r_{k-1} and q_k at a clasp, by ``statics.leg_directions``.

    Parameters
    ----------
    V: the known side of the force triangle [N].
    onward: a vector on the side of V where q_k is without roll, in the plane of both legs.
    roll: [rad]
    pulls: of both legs at the clasp [N].
    halves: half of the weights of both legs [N].
    """
    size = ca.norm_2(V)
    along = V / size
    level = unit(onward - ca.dot(onward, along) * along)
    across = ca.cos(roll) * level + ca.sin(roll) * ca.cross(level, along)
    behind, ahead = pulls
    for _ in range(PASSES):
        a = (size + (ahead - behind) * (ahead + behind) / size) / 2.0
        aside = ca.sqrt((ahead - a) * (ahead + a)) * across
        r_direction, q_direction = (
            ((size - a) * along - aside) / behind,
            (a * along + aside) / ahead,
        )
        behind = pulls[0] + halves[0] * r_direction[2]
        ahead = pulls[1] + halves[1] * q_direction[2]
    return r_direction, q_direction
