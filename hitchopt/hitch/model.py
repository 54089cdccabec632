"""The model: from flat outputs (vertices, legs, tensions, roll) to drones and thrusts.

One formula over ``Series`` serves batches of times (``drone_jets``) and casadi expressions
(``casadi_model.py``). A clasp ``p_k`` depends on ``p_{k-1} … p_{k+1}`` and on cables k-1 and k
only. Legs are cable lengths; drones are nearer to their vertices if cables sag.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hitchopt.drones.quadrotor import GRAVITY
from hitchopt.hitch.forces import LegPair, cable_forces, closed_triangle
from hitchopt.hitch.series import JET, Series
from hitchopt.hitch.taut import taut_chord, taut_part
from hitchopt.hitch.team import Team
from hitchopt.values import Array, Indices


@dataclass(frozen=True, eq=False)
class Edge:
    """An edge of a hitch."""

    along: Series  # Its direction
    cable: Series  # [m], its cable length
    first: Series  # [N], the tension at its first end, a vector toward the second one
    second: Series  # [N], the tension at its second end
    tension: Series  # [N], of its cable
    ratio: Any  # [1/m], half of the weight per length over the tension; None without weight

    @classmethod
    def of(cls, vector: Series, tension: Series, weight: Any, at_second: Any = None) -> Edge:
        """Return the edge along a vector; ``weight`` is that of cables [N/m], or None.

        The tension is that at its first end, or where ``at_second`` is 1, at its second one: as at
        the start of a chain, whose first edge may slope.
        """
        chord = vector.dot(vector).root
        along = vector / chord
        if weight is None:
            pull = tension * along
            return cls(along, chord, pull, pull, tension, None)
        at_first = tension
        if at_second is not None:
            at_first = tension - vector[2] * (weight * at_second)
        part = taut_part(vector, tension.constant(0.5 * weight) / at_first)
        first, second = at_first * part.force(), at_first * part.force(second=True)
        ratio = tension.constant(0.5 * weight) / tension
        return cls(along, part.length, first, second, tension, ratio)

    def select(self, index: Indices) -> Edge:
        """Return the edges at some indices."""
        ratio = None if self.ratio is None else self.ratio.select(index)
        along, cable = self.along.select(index), self.cable.select(index)
        first, second = self.first.select(index), self.second.select(index)
        return Edge(along, cable, first, second, self.tension.select(index), ratio)


def cable_between(vector: Series, tension: Series, weight: Any) -> Series:
    """Return the length [m] of a cable along a vector; ``weight`` [N/m] is None without one."""
    if weight is None:
        return vector.dot(vector).root
    length: Series = taut_part(vector, tension.constant(0.5 * weight) / tension).length
    return length


class ClaspLegs(NamedTuple):
    """The legs r_{k-1} and q_k at a clasp ``p_k``."""

    chords: LegPair  # [m], vectors from the clasp to their drones
    lengths: LegPair  # [m], of the chords
    r_leg: Series  # [m], ``e_{k-1}``, the cable length of the first leg


def clasp_legs(
    edges: tuple[Edge, Edge],
    q_legs: tuple[Series, Series],
    cable_length: Any,
    load: Any,
    roll: Series | None,
    *,
    equal: bool = False,
) -> ClaspLegs:
    """Return the legs at ``p_k``, where edge and r-leg of cable k-1 meet q-leg and edge of cable k.

    Pairs begin with cable k-1 and end with cable k.

    Parameters
    ----------
    edges, q_legs: of both cables; the q-leg of cable k-1 is at ``p_{k-1}``.
    cable_length: of cable k-1 [m].
    load: external force on the clasp [N]; None if there is none.
    roll: of the clasp [rad]; None if there is none.
    equal: whether all tensions are equal. Without load, weight and roll, legs then continue the
        neighbouring edges.
    """
    behind, ahead = edges
    q_leg_behind, q_leg = q_legs
    r_leg = q_leg_behind.constant(cable_length) - behind.cable - q_leg_behind
    is_weightless = behind.ratio is None
    if equal and load is None and is_weightless and roll is None:
        directions = LegPair(-ahead.along, behind.along)
    else:
        held = behind.second - ahead.first  # by both legs
        if load is not None:
            held = held - held.constant(load)
        onward = behind.along + ahead.along
        directions = closed_triangle(held, onward, roll, LegPair(behind.tension, ahead.tension))
    if is_weightless:
        chords = LegPair(r_leg * directions.behind, q_leg * directions.ahead)
        return ClaspLegs(chords, LegPair(r_leg, q_leg), r_leg)
    chords = LegPair(
        behind=taut_chord(directions.behind, r_leg, behind.ratio),
        ahead=taut_chord(directions.ahead, q_leg, ahead.ratio),
    )
    lengths = LegPair(*(chord.dot(chord).root for chord in chords))
    return ClaspLegs(chords, lengths, r_leg)


CLASPS_PER_CHUNK = 4000
"""Clasps, summed over all values of the parameter, whose series fit into the caches."""


@dataclass(frozen=True, eq=False)
class FlatJets:
    """Flat outputs at J values of a parameter, with its derivatives up to the third.

    Vertices (J, points, 3, 4) [m], cable lengths of q-legs (J, n, 4) [m], tensions (J, n, 4) [N]
    and roll (J, clasps, 4) [rad], None if there is none.
    """

    vertices: Array
    q_legs: Array
    tensions: Array
    roll: Array | None = None

    @classmethod
    def concatenated(cls, parts: Sequence[FlatJets]) -> FlatJets:
        """Return all values of several flat outputs of one team, part after part."""
        vertices = np.concatenate([part.vertices for part in parts])
        q_legs = np.concatenate([part.q_legs for part in parts])
        tensions = np.concatenate([part.tensions for part in parts])
        shapes = [part.roll.shape for part in parts if part.roll is not None]
        if not shapes:
            return cls(vertices, q_legs, tensions)
        without_roll = np.zeros(shapes[0])
        rolls = [without_roll if part.roll is None else part.roll for part in parts]
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
        points = self.flat.vertices[..., 0][:, self.team.layout.pulled_to]
        pulls = self.flat.tensions[..., 0].repeat(2, axis=1)
        taut = np.ones(self.team.robots)
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
    count = len(flat.vertices)
    chunk_size = max(1, CLASPS_PER_CHUNK // team.robots)
    if count <= chunk_size:
        positions, legs = _drone_jets(team, flat, equal)
        return DroneJets(team, flat, positions, legs)
    chunks = [flat[first : first + chunk_size] for first in range(0, count, chunk_size)]
    jets = [_drone_jets(team, chunk, equal) for chunk in chunks]
    positions = np.concatenate([chunk_positions for chunk_positions, _ in jets])
    legs = np.concatenate([chunk_legs for _, chunk_legs in jets])
    return DroneJets(team, flat, positions, legs)


def _drone_jets(team: Team, flat: FlatJets, equal: bool) -> tuple[Array, Array]:
    """Return positions and legs of ``DroneJets``; ``equal`` if all tensions are."""
    layout = team.layout
    weight = GRAVITY * team.cable_density if team.cable_density > 0.0 else None
    load = np.outer([0.0, 0.0, -GRAVITY], team.load)[:, None] if team.load.any() else None
    roll = None if flat.roll is None else _scalars(flat.roll)
    with np.errstate(all="ignore"):  # edges of zero length have no direction
        vertices = Series.of_jet(flat.vertices)
        tensions = _scalars(flat.tensions)
        if equal:
            tensions = tensions.constant(tensions.value)
        edges = Edge.of(
            vertices.select(layout.ends) - vertices.select(layout.starts),
            tensions,
            weight,
            None if layout.closed else np.arange(team.robots) == 0,
        )
        q_legs = _scalars(flat.q_legs)
        legs = clasp_legs(
            (edges.select(layout.behind), edges.select(layout.ahead)),
            (q_legs.select(layout.behind), q_legs.select(layout.ahead)),
            team.cable_length[layout.behind],
            load,
            roll,
            equal=equal,
        )
        positions = flat.vertices[:, layout.anchors]  # final at a chain's ends, without legs
        distances = np.zeros((len(positions), team.drones, JET))
        clasp_drones = (2 * layout.behind + 1, 2 * layout.ahead)
        for drones, chord, size in zip(clasp_drones, legs.chords, legs.lengths, strict=True):
            positions[:, drones] += chord.jet
            distances[:, drones] = size.jet[..., 0, :]
    return positions, distances.reshape(len(positions), -1, 2, JET)


def _scalars(jets: Array) -> Series:
    """Return the series of scalars with jets (J, items, JET)."""
    return Series.of_jet(jets[..., None, :])
