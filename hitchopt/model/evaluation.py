"""The model over many robots and times at once, as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.forces import cable_forces, chord_pull, closed_triangle
from hitchopt.hitch.series import JET, Series
from hitchopt.model.clasps import Clasp, Edge
from hitchopt.values import Array

UPWARD = np.array([0.0, 0.0, GRAVITY])
"""[m/s²] What thrusts hold against besides accelerations."""


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
    layout = team.layout
    weight = GRAVITY * team.cable_density if team.cable_density > 0.0 else None
    load = np.outer([0.0, 0.0, -GRAVITY], team.load)[:, None] if np.any(team.load) else None
    steady = not np.any(flat.tensions[..., 1:])
    equal = steady and bool(np.all(flat.tensions[..., 0] == flat.tensions[0, 0, 0]))
    d = _scalars(flat.q_legs)
    with np.errstate(all="ignore"):  # edges of no length have no direction
        vertices = Series.of_jet(flat.vertices)
        vectors = vertices.taken(layout.ends) - vertices.taken(layout.starts)
        tension = _scalars(flat.tensions)
        edge = Edge.of(vectors, tension.constant(tension.value) if equal else tension, weight)
        clasp = Clasp.of(
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
            positions[:, drones] += (clasp.legs[end] * clasp.directions[end]).jet
            distances[:, drones] = clasp.legs[end].jet[..., 0, :]
        pulls, taut = np.repeat(flat.tensions[..., 0], 2, axis=1), np.ones(team.robots)
        forces = cable_forces(team, positions[..., 0], flat.vertices[..., 0], pulls, taut)
    thrusts = team.mass[:, None] * (positions[..., 2] + UPWARD) - forces
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
        pull = chord_pull(T, _scalars(along)) if half > 0.0 else T
        edges = pull * u
        directions = closed_triangle(
            edges.taken(behind) - edges.taken(ahead) - Series.of_jet(loads),
            Series.of_jet(sides),
            None,
            (_scalars(pulls[:, behind, 1]), _scalars(pulls[:, ahead, 0])),
            (_scalars(halves[:, behind, 1]), _scalars(halves[:, ahead, 0])) if half > 0.0 else None,
        )
        clasps = points.taken(layout.clasps)
        sizes = _scalars(legs[:, behind, 1]), _scalars(legs[:, ahead, 0])
        found = [
            (clasps + size * direction).jet
            for size, direction in zip(sizes, directions, strict=True)
        ]
    return np.stack(found, axis=2)
