"""The model: from flat outputs (vertices, legs, tensions, roll) to drones and thrusts.

One formula over ``Series`` serves batches of times (``drone_jets``) and casadi expressions
(``casadi_model.py``). A clasp ``p_k`` depends on ``p_{k-1} … p_{k+1}`` and on cables k-1 and k
only. Legs are cable lengths; drones are nearer to their vertices if cables sag.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hitchopt.hitch.forces import cable_forces, chord_pull, closed_triangle, shortening
from hitchopt.hitch.quadrotor import GRAVITY
from hitchopt.hitch.series import JET, Series
from hitchopt.hitch.team import Team
from hitchopt.values import Array, Indices


@dataclass(frozen=True, eq=False)
class Edge:
    """An edge of a hitch."""

    along: Series  # its direction
    cable: Series  # its cable length [m]
    pull: Series  # along its chord [N]
    tension: Series  # of its cable [N]
    sag: Any  # factor of ``forces.cable_of`` for its cable [1/m²]; None without weight

    @classmethod
    def of(cls, vector: Series, tension: Series, weight: Any) -> Edge:
        """Return the edge along a vector; ``weight`` is that of cables [N/m], None for none."""
        cable, size, sag = cable_of_span(vector, tension, weight)
        pull = tension if weight is None else chord_pull(tension, cable * (0.5 * weight))
        return cls(vector / size, cable, pull, tension, sag)

    def select(self, index: Indices) -> Edge:
        """Return the edges at some indices."""
        tension = self.tension.select(index)
        pull = tension if self.pull is self.tension else self.pull.select(index)
        sag = None if self.sag is None else self.sag.select(index)
        return Edge(self.along.select(index), self.cable.select(index), pull, tension, sag)


def cable_of_span(vector: Series, tension: Series, weight: Any) -> tuple[Series, Series, Any]:
    """Return cable length and chord [m] of a span, and its factor of ``forces.cable_of``.

    ``weight`` is that of cables [N/m]; None for none, as is then the factor.
    """
    size = vector.dot(vector).root
    if weight is None:
        return size, size, None
    sag = tension.constant(weight * weight / 24.0) / (tension * tension)
    level = vector.row(0, 1)
    return size + size * sag * level.dot(level), size, sag


def clasp_legs(
    edges: tuple[Edge, Edge],
    q_legs: tuple[Series, Series],
    cable_length: Any,
    load: Any,
    weight: Any,
    roll: Series | None,
    *,
    equal: bool = False,
) -> tuple[tuple[Series, Series], tuple[Series, Series], Series]:
    """Return directions and chords [m] of the legs r_{k-1} and q_k at ``p_k``, and ``e_{k-1}`` [m].

    Pairs, given and returned, begin with cable k-1 and end with cable k. At ``p_k`` the edge and
    the r-leg of cable k-1 meet the q-leg and the edge of cable k.

    Parameters
    ----------
    edges, q_legs: of both cables; the q-leg of cable k-1 is at ``p_{k-1}``.
    cable_length: of cable k-1 [m].
    load: external force on the clasp [N]; None for none.
    weight: of cables per length [N/m]; None for none.
    roll: of the clasp [rad]; None for none.
    equal: whether all tensions are equal. Without load, weight and roll, legs then continue the
        neighbouring edges.
    """
    (behind, ahead), (q_behind, q_leg) = edges, q_legs
    length_behind = q_behind.constant(cable_length)
    r_leg = length_behind - behind.cable - q_behind
    tensions = behind.tension, ahead.tension
    if equal and load is None and weight is None and roll is None:
        return (-ahead.along, behind.along), (r_leg, q_leg), r_leg
    held = behind.pull * behind.along - ahead.pull * ahead.along  # by both legs
    if load is not None:
        held = held - held.constant(load)
    onward = behind.along + ahead.along
    if weight is None:
        return closed_triangle(held, onward, roll, tensions, None), (r_leg, q_leg), r_leg
    half = 0.5 * weight
    # Half of the lengths that meet at the clasp: edge and r-leg of cable k-1, q-leg and edge of k
    carried = (length_behind - q_behind + q_leg + ahead.cable) * half
    leg_halves = r_leg * half, q_leg * half
    directions = closed_triangle(held + carried.upward, onward, roll, tensions, leg_halves)
    levels = [direction.row(0, 1) for direction in directions]
    r_chord, q_chord = (
        leg * shortening(edge.sag * leg * leg * level.dot(level))
        for leg, edge, level in zip((r_leg, q_leg), edges, levels, strict=True)
    )
    return directions, (r_chord, q_chord), r_leg


CLASPS_PER_CHUNK = 4000
"""Clasps, summed over all values of the parameter, whose series fit into the caches."""


@dataclass(frozen=True, eq=False)
class FlatJets:
    """Flat outputs at J values of a parameter, with derivatives by it up to the third.

    Vertices (J, points, 3, 4) [m], cable lengths of q-legs (J, n, 4) [m], tensions (J, n, 4) [N]
    and roll (J, clasps, 4) [rad], None for none.
    """

    vertices: Array
    q_legs: Array
    tensions: Array
    roll: Array | None = None

    @classmethod
    def concatenated(cls, parts: Sequence[FlatJets]) -> FlatJets:
        """Return all values of several flat outputs of one team, part after part."""
        vertices, q_legs, tensions = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("vertices", "q_legs", "tensions")
        )
        if all(part.roll is None for part in parts):
            return cls(vertices, q_legs, tensions)
        shape = next(part.roll.shape for part in parts if part.roll is not None)
        rolls = [np.zeros(shape) if part.roll is None else part.roll for part in parts]
        return cls(vertices, q_legs, tensions, np.concatenate(rolls))

    def __getitem__(self, index: slice) -> FlatJets:
        roll = None if self.roll is None else self.roll[index]
        return FlatJets(self.vertices[index], self.q_legs[index], self.tensions[index], roll)


@dataclass(frozen=True, eq=False)
class DroneJets:
    """Drones, forces and legs for flat outputs, at the same J values of the parameter.

    Positions (J, 2n, 3, 4) [m], in the order q0, r0, q1, …; legs (J, n, 2, 4) [m], distances of
    drones from their vertices.
    """

    team: Team
    flat: FlatJets
    positions: Array
    legs: Array

    @property
    def cable_forces(self) -> Array:
        """(J, 2n, 3) [N]: forces of cables on drones."""
        pulls, taut = self.flat.tensions[..., 0].repeat(2, axis=1), np.ones(self.team.robots)
        points = self.flat.vertices[..., 0][:, self.team.layout.pulled_to]
        return cable_forces(self.team, self.positions[..., 0], points, pulls, taut)

    @property
    def thrusts(self) -> Array:
        """(J, 2n, 3) [N]: thrusts with the parameter as time."""
        accelerations = self.positions[..., 2] + [0.0, 0.0, GRAVITY]
        thrusts: Array = self.team.mass[:, None] * accelerations - self.cable_forces
        return thrusts


def drone_jets(team: Team, flat: FlatJets) -> DroneJets:
    """Return drones and legs for flat outputs; the cost is linear in J·n.

    If all tensions are equal, legs continue the neighbouring edges (the paper's class), unless
    clasps carry weight or legs are rolled. Values are nan where tensions cannot carry the loads.
    """
    steady = not flat.tensions[..., 1:].any()
    equal = steady and bool((flat.tensions[..., 0] == flat.tensions[0, 0, 0]).all())
    step, count = max(1, CLASPS_PER_CHUNK // team.robots), len(flat.vertices)
    if count <= step:
        return DroneJets(team, flat, *_drone_jets(team, flat, equal))
    chunks = [flat[first : first + step] for first in range(0, count, step)]
    parts = zip(*(_drone_jets(team, chunk, equal) for chunk in chunks), strict=True)
    return DroneJets(team, flat, *map(np.concatenate, parts))


def _drone_jets(team: Team, flat: FlatJets, equal: bool) -> tuple[Array, Array]:
    """Return positions and legs of ``DroneJets``; ``equal`` if all tensions are."""
    layout = team.layout
    weight = GRAVITY * team.cable_density if team.cable_density > 0.0 else None
    load = np.outer([0.0, 0.0, -GRAVITY], team.load)[:, None] if team.load.any() else None
    d = _scalars(flat.q_legs)
    with np.errstate(all="ignore"):  # edges of zero length have no direction
        vertices = Series.of_jet(flat.vertices)
        vectors = vertices.select(layout.ends) - vertices.select(layout.starts)
        tension = _scalars(flat.tensions)
        edge = Edge.of(vectors, tension.constant(tension.value) if equal else tension, weight)
        directions, legs, _ = clasp_legs(
            (edge.select(layout.behind), edge.select(layout.ahead)),
            (d.select(layout.behind), d.select(layout.ahead)),
            team.cable_length[layout.behind],
            load,
            weight,
            None if flat.roll is None else _scalars(flat.roll),
            equal=equal,
        )
        positions = flat.vertices[:, layout.anchors]  # final at a chain's ends, without legs
        distances = np.zeros((len(positions), team.drones, JET))
        for end, drones in enumerate((2 * layout.behind + 1, 2 * layout.ahead)):
            positions[:, drones] += (legs[end] * directions[end]).jet
            distances[:, drones] = legs[end].jet[..., 0, :]
    return positions, distances.reshape(len(positions), -1, 2, JET)


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
    """Return the jets of drones on legs whose tensions differ from those of their edges.

    Clasps carry the team's loads and the weight of its cables.

    Parameters
    ----------
    vertices: (J, points, 3, 4) [m]
    legs: (J, n, 2, 4) [m], ``d_k`` and ``e_k``, distances of drones from their vertices.
    tensions: (J, n, 4) [N], of the edges.
    pulls: (J, n, 2, 4) [N], tensions of the legs at their clasps.
    planned: (J, 2n, 3, 4) [m], drones in balance without friction, which define the planes of
        rolled legs; None without roll.
    cables: (J, n, 2, 4) [m], cable lengths of the legs; None if they do not sag.

    Returns
    -------
    (J, clasps, 2, 3, 4) [m]: ``r_{k-1}`` and ``q_k`` at every clasp; nan if it has no balance.
    """
    layout = team.layout
    behind, ahead = layout.behind, layout.ahead
    if planned is None:
        sides = vertices[:, layout.ends[ahead]] - vertices[:, layout.starts[behind]]
    else:
        sides = planned[:, 2 * ahead] - vertices[:, layout.clasps]
    half_weight = 0.5 * GRAVITY * team.cable_density  # of a cable, by length
    of_legs = half_weight * (legs if cables is None else cables)
    of_edges = -np.sum(of_legs, axis=2)
    of_edges[..., 0] += half_weight * team.cable_length
    loads = np.zeros(sides.shape)
    loads[:, :, 2] = of_legs[:, ahead, 1] + of_legs[:, behind, 0]
    of_cables = half_weight * (team.cable_length[ahead] + team.cable_length[behind])
    loads[:, :, 2, 0] -= of_cables + GRAVITY * team.load
    with np.errstate(all="ignore"):
        points, tension = Series.of_jet(vertices), _scalars(tensions)
        along = (points.select(layout.ends) - points.select(layout.starts)).direction
        sagging = half_weight > 0.0
        edges = (chord_pull(tension, _scalars(of_edges)) if sagging else tension) * along
        leg_weights = _scalars(of_legs[:, behind, 1]), _scalars(of_legs[:, ahead, 0])
        directions = closed_triangle(
            edges.select(behind) - edges.select(ahead) - Series.of_jet(loads),
            Series.of_jet(sides),
            None,
            (_scalars(pulls[:, behind, 1]), _scalars(pulls[:, ahead, 0])),
            leg_weights if sagging else None,
        )
        clasps = points.select(layout.clasps)
        r = clasps + _scalars(legs[:, behind, 1]) * directions[0]
        q = clasps + _scalars(legs[:, ahead, 0]) * directions[1]
        return np.stack([r.jet, q.jet], axis=2)
