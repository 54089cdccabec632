"""The model: from flat outputs (vertices, legs, tensions, roll) to drones and thrusts.

One formula over ``Series`` serves many times at once (``drone_jets``) and the optimiser's casadi
(``planar``). A clasp ``p_k`` depends on ``p_{k-1} … p_{k+1}`` and on cables k-1 and k only. Legs
are lengths of cable; the distances of the drones from their vertices are less where it sags.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from hitchopt.hitch.forces import cable_forces, chord_pull, closed_triangle, shortening
from hitchopt.hitch.series import JET, Series
from hitchopt.hitch.team import GRAVITY, Team
from hitchopt.values import Array, Indices

if TYPE_CHECKING:
    import casadi as ca


@dataclass(frozen=True, eq=False)
class Edge:
    """An edge of a hitch.

    Attributes
    ----------
    along, cable: its direction, and the length of its cable [m].
    pull, tension: along its chord, and of its cable [N].
    sag: factor of ``forces.cable_of`` for its cable [1/m²]; None without weight.
    """

    along: Series
    cable: Series
    pull: Series
    tension: Series
    sag: Any

    @classmethod
    def of(cls, vector: Series, tension: Series, weight: Any) -> Edge:
        """Return an edge, of cables with a weight per length [N/m]; None for none."""
        size = vector.dot(vector).root
        along = vector / size
        if weight is None:
            return cls(along, size, tension, tension, None)
        sag = tension.constant(weight * weight / 24.0) / (tension * tension)
        level = vector.row(0, 1)
        cable = size + size * sag * level.dot(level)
        pull = chord_pull(tension, cable * (0.5 * weight))
        return cls(along, cable, pull, tension, sag)

    def taken(self, index: Indices) -> Edge:
        """Return some of many edges."""
        parts: dict[str, Any] = vars(self)
        return Edge(**{name: part and part.taken(index) for name, part in parts.items()})


def clasp_legs(
    edges: tuple[Edge, Edge],
    q_legs: tuple[Series, Series],
    cable_length: Any,
    load: Any,
    weight: Any,
    roll: Series | None,
    *,
    alike: bool = False,
) -> tuple[tuple[Series, Series], tuple[Series, Series], Series]:
    """Return directions and chords [m] of the legs at ``p_k``, first r_{k-1}, and its cable [m].

    Parameters
    ----------
    edges, q_legs: of cables k-1 and k.
    cable_length: of cable k-1 [m].
    load, weight, roll: outside force on the clasp [N], of cables per length [N/m], [rad]; each
        None for none.
    alike: whether all tensions are equal: legs then go on along the neighbouring edges, where
        nothing else is to be carried.
    """
    behind, ahead = edges
    whole = q_legs[0].constant(cable_length)
    e, d = whole - behind.cable - q_legs[0], q_legs[1]
    tensions = behind.tension, ahead.tension
    if alike and load is None and weight is None and roll is None:
        return (-ahead.along, behind.along), (e, d), e
    V = behind.pull * behind.along - ahead.pull * ahead.along
    if load is not None:
        V = V - V.constant(load)
    onward = behind.along + ahead.along
    if weight is None:
        return closed_triangle(V, onward, roll, tensions, None), (e, d), e
    half = 0.5 * weight
    # Half of what lies about the clasp: of cable k-1 all but its q-leg.
    carried = (whole - q_legs[0] + d + ahead.cable) * half
    directions = closed_triangle(V + carried.upward, onward, roll, tensions, (e * half, d * half))
    levels = [direction.row(0, 1) for direction in directions]
    first, second = (
        cable * shortening(edge.sag * cable * cable * level.dot(level))
        for cable, edge, level in zip((e, d), edges, levels, strict=True)
    )
    return directions, (first, second), e


CLASPS_AT_ONCE = 4000
"""Clasps, over all values of the parameter, whose series stay within the caches."""


@dataclass(frozen=True, eq=False)
class FlatJets:
    """Flat outputs at J values of a parameter, with derivatives by it up to the third.

    Vertices (J, points, 3, 4) [m], lengths of cable in q-legs (J, n, 4) [m], tensions (J, n, 4) [N]
    and roll (J, clasps, 4) [rad], None where legs are not rolled.
    """

    vertices: Array
    q_legs: Array
    tensions: Array
    roll: Array | None = None

    def chosen(self, index: slice) -> FlatJets:
        """Return the flat outputs at some of the values."""
        roll = None if self.roll is None else self.roll[index]
        return FlatJets(self.vertices[index], self.q_legs[index], self.tensions[index], roll)


@dataclass(frozen=True, eq=False)
class DroneJets:
    """Drones, forces and legs of flat outputs at the same J values of the parameter.

    Positions (J, 2n, 3, 4) [m], in the order q0, r0, q1, …; forces of cables on drones and thrusts
    (J, 2n, 3) [N], with the parameter taken as time; legs (J, n, 2, 4) [m], distances of drones
    from their vertices.
    """

    positions: Array
    cable_forces: Array
    thrusts: Array
    legs: Array


def drone_jets(team: Team, flat: FlatJets) -> DroneJets:
    """Return drones, forces and thrusts for flat outputs; linear in J·n.

    Where all tensions are equal legs go on along the neighbouring edges (the paper's class), unless
    clasps carry weight or legs are rolled. Values are nan where tensions cannot carry them.
    """
    steady = not np.any(flat.tensions[..., 1:])
    equal = steady and bool(np.all(flat.tensions[..., 0] == flat.tensions[0, 0, 0]))
    step, count = max(1, CLASPS_AT_ONCE // team.robots), len(flat.vertices)
    if count <= step:
        return _drone_jets(team, flat, equal)
    chunks = [flat.chosen(slice(first, first + step)) for first in range(0, count, step)]
    parts = [vars(_drone_jets(team, chunk, equal)) for chunk in chunks]
    return DroneJets(*(np.concatenate([part[name] for part in parts]) for name in parts[0]))


def _drone_jets(team: Team, flat: FlatJets, equal: bool) -> DroneJets:
    """Return drones, forces and thrusts of flat outputs; tensions are all ``equal`` or not."""
    layout = team.layout
    weight = GRAVITY * team.cable_density if team.cable_density > 0.0 else None
    load = np.outer([0.0, 0.0, -GRAVITY], team.load)[:, None] if np.any(team.load) else None
    d = _scalars(flat.q_legs)
    with np.errstate(all="ignore"):  # edges of no length have no direction
        vertices = Series.of_jet(flat.vertices)
        vectors = vertices.taken(layout.ends) - vertices.taken(layout.starts)
        tension = _scalars(flat.tensions)
        edge = Edge.of(vectors, tension.constant(tension.value) if equal else tension, weight)
        directions, legs, _ = clasp_legs(
            (edge.taken(layout.behind), edge.taken(layout.ahead)),
            (d.taken(layout.behind), d.taken(layout.ahead)),
            team.cable_length[layout.behind],
            load,
            weight,
            None if flat.roll is None else _scalars(flat.roll),
            alike=equal,
        )
        positions = flat.vertices[:, layout.anchors]  # where a chain's end has no leg
        distances = np.zeros((len(positions), team.drones, JET))
        for end, drones in enumerate((2 * layout.behind + 1, 2 * layout.ahead)):
            positions[:, drones] += (legs[end] * directions[end]).jet
            distances[:, drones] = legs[end].jet[..., 0, :]
        pulls, taut = np.repeat(flat.tensions[..., 0], 2, axis=1), np.ones(team.robots)
        forces = cable_forces(team, positions[..., 0], flat.vertices[..., 0], pulls, taut)
    thrusts = team.mass[:, None] * (positions[..., 2] + [0.0, 0.0, GRAVITY]) - forces
    return DroneJets(positions, forces, thrusts, distances.reshape(len(positions), -1, 2, JET))


def _scalars(jets: Array) -> Series:
    """Return the series of scalars with jets (J, items, JET)."""
    return Series.of_jet(jets[..., None, :])


def slipping_drones(
    team: Team,
    vertices: Array,
    legs: Array,
    tensions: Array,
    pulls: Array,
    planned: Array | None = None,
    cables: Array | None = None,
) -> Array:
    """Return the jets of drones on legs whose pulls differ from their edges' tensions.

    Clasps carry the team's loads and the weight of its cables.

    Parameters
    ----------
    vertices: (J, points, 3, 4) [m]
    legs: (J, n, 2, 4) [m], ``d_k`` and ``e_k``, distances of drones from their vertices.
    tensions: (J, n, 4) [N], of the edges.
    pulls: (J, n, 2, 4) [N], tensions of the legs at their clasps.
    planned: (J, 2n, 3, 4) [m], drones in balance without friction, in whose planes legs lean; None
        of legs that are not rolled.
    cables: (J, n, 2, 4) [m], lengths of cable in the legs; None where they do not sag.

    Returns
    -------
    (J, clasps, 2, 3, 4) [m]: ``r_{k-1}`` and ``q_k`` at every clasp; nan where none balances it.
    """
    layout = team.layout
    behind, ahead = layout.behind, layout.ahead
    if planned is None:
        sides = vertices[:, layout.ends[ahead]] - vertices[:, layout.starts[behind]]
    else:
        sides = planned[:, 2 * ahead] - vertices[:, layout.clasps]
    half = 0.5 * GRAVITY * team.cable_density
    halves = half * (legs if cables is None else cables)
    along = -np.sum(halves, axis=2)  # half of the weights of edges
    along[..., 0] += half * team.cable_length
    loads = np.zeros(sides.shape)
    loads[:, :, 2] = halves[:, ahead, 1] + halves[:, behind, 0]
    whole = half * (team.cable_length[ahead] + team.cable_length[behind])
    loads[:, :, 2, 0] -= whole + GRAVITY * team.load
    with np.errstate(all="ignore"):
        points, T = Series.of_jet(vertices), _scalars(tensions)
        u = (points.taken(layout.ends) - points.taken(layout.starts)).direction
        edges = (chord_pull(T, _scalars(along)) if half > 0.0 else T) * u
        directions = closed_triangle(
            edges.taken(behind) - edges.taken(ahead) - Series.of_jet(loads),
            Series.of_jet(sides),
            None,
            (_scalars(pulls[:, behind, 1]), _scalars(pulls[:, ahead, 0])),
            (_scalars(halves[:, behind, 1]), _scalars(halves[:, ahead, 0])) if half > 0.0 else None,
        )
        clasps = points.taken(layout.clasps)
        r = clasps + _scalars(legs[:, behind, 1]) * directions[0]
        q = clasps + _scalars(legs[:, ahead, 0]) * directions[1]
        return np.stack([r.jet, q.jet], axis=2)


@lru_cache
def planar(loaded: bool, choice: bool) -> ca.Function:
    """Return robot k at rest in a level closed hitch, seen from above, and the turn at ``p_k``.

    Built when it is first asked for, which takes 0.1 s at most.

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
    import casadi as ca

    names = ["vertices", "q_legs", "tensions", "cable_length", "roll", "loads", "weight"]
    names = names if loaded else names[:4]
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
        clasp_legs(
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
    q = points[1] + here[1][1] * here[0][1]
    r = points[2] + there[1][0] * there[0][0]
    place = ca.vertcat(q.value[:2], r.value[:2], there[2].value)
    u = [edge.along.value for edge in edges]
    turn = u[0][1] * u[1][0] - u[0][0] * u[1][1]
    return ca.Function("planar", given, [place, turn], names, ["place", "turn"], {"cse": True})
