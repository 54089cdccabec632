"""The model over many robots and times at once, as arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.statics import cable_forces
from hitchopt.model.array_machine import CHUNK, mapped
from hitchopt.model.attitude import attitude_function
from hitchopt.model.loaded_clasp import loaded_clasp_function
from hitchopt.model.robot import JET, robot_function
from hitchopt.model.slipping import slipping_clasp_function
from hitchopt.model.straight_legs import straight_legs
from hitchopt.values import Array

UPWARD = np.array([0.0, 0.0, GRAVITY])
"""[m/s²] What thrusts hold against besides accelerations."""


@dataclass(frozen=True, eq=False)
class FlatJets:
    """Flat outputs at J values of a parameter, with derivatives by it up to the third.

    Attributes
    ----------
    vertices: (J, points, 3, 4) [m]; n points of a closed hitch, n + 1 of a chain.
    q_legs: (J, n, 4) [m], lengths of cable.
    tensions: (J, n, 4) [N]
    roll: (J, clasps, 4) [rad], or None where legs are not rolled.
    """

    vertices: Array
    q_legs: Array
    tensions: Array
    roll: Array | None = None

    def taken(self, span: slice) -> FlatJets:
        """Return those at some values of the parameter."""
        roll = None if self.roll is None else self.roll[span]
        return FlatJets(self.vertices[span], self.q_legs[span], self.tensions[span], roll)


@dataclass(frozen=True, eq=False)
class DroneJets:
    """Drones, forces and legs of flat outputs at the same J values of the parameter.

    Attributes
    ----------
    positions: (J, 2n, 3, 4) [m] and derivatives by the parameter, in the order q0, r0, q1, ….
    cable_forces: (J, 2n, 3) [N], of the cable on the drone.
    thrusts: (J, 2n, 3) [N], with the parameter taken as time.
    legs: (J, n, 2, 4) [m], distances of q_k and r_k from their vertices, and derivatives.
    """

    positions: Array
    cable_forces: Array
    thrusts: Array
    legs: Array


@dataclass(frozen=True, eq=False)
class Attitudes:
    """Attitudes and their rates.

    Attributes
    ----------
    quaternions: (…, 4), w, x, y, z, from the body's axes to the world's; with yaw 0 and a thrust
        that points upward w is positive.
    body_rates: (…, 3) [rad/s], angular velocity about the body's axes.
    """

    quaternions: Array
    body_rates: Array


def attitudes(thrusts: Array, thrust_rates: Array, yaw: float = 0.0) -> Attitudes:
    """Return the attitudes that point thrusts (…, 3) [N] where they must, at a constant yaw.

    Parameters
    ----------
    thrusts: (…, 3) [N] or any other unit.
    thrust_rates: (…, 3), their derivatives by time.
    yaw: [rad], as in ``model.attitude``.
    """
    columns = thrusts.size // 3
    jets = np.stack([thrusts.reshape(columns, 3), thrust_rates.reshape(columns, 3)], axis=-1)
    yaws = np.tile([[[yaw, 0.0]]], (columns, 1, 1))
    quaternions, body_rates = mapped(attitude_function(), [jets, yaws])
    shape = thrusts.shape[:-1]
    return Attitudes(quaternions.reshape(*shape, 4), body_rates.reshape(*shape, 3))


def drone_jets(team: Team, flat: FlatJets) -> DroneJets:
    """Return drones, forces and thrusts for flat outputs; linear in J·n.

    The paper's class is used where all tensions are equal, the general clasp elsewhere; where
    clasps carry weight or legs are rolled, the clasp with loads. Values are nan where tensions
    cannot carry them. Large teams are evaluated at a few values of the parameter at a time, so that
    what is gathered for it stays in the processor's cache.
    """
    count, n = flat.q_legs.shape[:2]
    loaded = team.loaded or flat.roll is not None
    equal = bool(np.all(flat.tensions[..., 0] == flat.tensions[0, 0, 0])) and not np.any(
        flat.tensions[..., 1:]
    )
    size = max(1, CHUNK // n)
    whole: list[Array] = []
    for first in range(0, max(count, 1), size):
        span = slice(first, first + size)
        some = flat if count <= size else flat.taken(span)
        if loaded:
            part = _loaded_jets(team, some)
        else:
            part = _straight_jets(team, some) if equal else _plain_jets(team, some)
        if some is flat:
            return part
        own = [getattr(part, field.name) for field in fields(part)]
        whole = whole or [np.empty((count, *each.shape[1:])) for each in own]
        for into, each in zip(whole, own, strict=True):
            into[span] = each
    return DroneJets(*whole)


def _straight_jets(team: Team, flat: FlatJets) -> DroneJets:
    """Return ``drone_jets`` of clasps without loads where all tensions are equal."""
    drones, along, r_legs = straight_legs(team, flat.vertices, flat.q_legs)
    positions = drones.reshape(len(drones), team.drones, 3, JET)
    forces = flat.tensions[0, 0, 0] * along.reshape(positions.shape[:-1])
    thrusts = team.mass[:, None] * (positions[..., 2] + UPWARD) - forces
    return DroneJets(positions, forces, thrusts, np.stack([flat.q_legs, r_legs], axis=2))


def _plain_jets(team: Team, flat: FlatJets) -> DroneJets:
    """Return ``drone_jets`` of clasps without loads, robot by robot, whatever the tensions."""
    count, n = flat.q_legs.shape[:2]
    columns, layout = count * n, team.layout
    q, r, q_force, r_force, q_thrust, r_thrust, r_leg = mapped(
        robot_function(False),
        [
            flat.vertices[:, layout.stencil].reshape(columns, 12, JET),
            flat.q_legs.reshape(columns, 1, JET),
            flat.tensions[:, layout.neighbours].reshape(columns, 3, JET),
            *(_constants(value, count) for value in (team.cable_length, team.mass[::2])),
        ],
    )

    def paired(a: Array, b: Array) -> Array:
        """Return (J, 2n, 3, width) of two (columns, 3, width), q and r alternating."""
        return np.stack([a, b], axis=1).reshape(count, 2 * n, 3, a.shape[-1])

    return DroneJets(
        paired(q, r),
        paired(q_force, r_force)[..., 0],
        paired(q_thrust, r_thrust)[..., 0],
        np.stack([flat.q_legs, r_leg.reshape(count, n, JET)], axis=2),
    )


def _constants(values: Array, count: int) -> Array:
    """Return constants (items, …) for every one of ``count`` points, as columns (·, rows, 1)."""
    return np.tile(values.reshape(len(values), -1), (count, 1))[..., None]


def _loaded_jets(team: Team, flat: FlatJets) -> DroneJets:
    """Return ``drone_jets`` of clasps with loads, clasp by clasp."""
    layout, count, clasps = team.layout, len(flat.q_legs), len(team.layout.clasps)
    around, both = layout.around_clasps, np.column_stack([layout.behind, layout.ahead])
    columns = count * clasps
    weight = GRAVITY * team.cable_density
    roll = np.zeros((count, clasps, JET)) if flat.roll is None else flat.roll
    found = mapped(
        loaded_clasp_function(weight > 0.0, flat.roll is not None),
        [
            flat.vertices[:, around].reshape(columns, 9, JET),
            flat.q_legs[:, both].reshape(columns, 2, JET),
            flat.tensions[:, both].reshape(columns, 2, JET),
            roll.reshape(columns, 1, JET),
            _constants(team.cable_length[layout.behind], count),
            _constants(np.outer(-GRAVITY * team.load, [0.0, 0.0, 1.0]), count),
            _constants(np.full(clasps, weight), count),
        ],
    )
    r, q, r_force, q_force, legs = (x.reshape(count, clasps, *x.shape[1:]) for x in found)
    positions = flat.vertices[:, layout.anchors]  # where a chain's end has no leg
    forces = np.zeros((count, team.drones, 3))
    distances = np.zeros((count, team.drones, JET))
    for drones, place, force, leg in (
        (2 * layout.behind + 1, r, r_force, legs[:, :, 0]),
        (2 * layout.ahead, q, q_force, legs[:, :, 1]),
    ):
        positions[:, drones], forces[:, drones] = place, force[..., 0]
        distances[:, drones] = leg
    alone = np.flatnonzero(~layout.has_leg.ravel())
    if alone.size:
        taut, pulls = np.ones(team.robots), np.repeat(flat.tensions[..., 0], 2, axis=1)
        ends = cable_forces(team, positions[..., 0], flat.vertices[..., 0], pulls, taut)
        forces[:, alone] = ends[:, alone]
    thrusts = team.mass[:, None] * (positions[..., 2] + UPWARD) - forces
    return DroneJets(positions, forces, thrusts, distances.reshape(count, -1, 2, JET))


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
    team: whose cables.
    vertices: (J, points, 3, 4) [m]
    legs: (J, n, 2, 4) [m], ``d_k`` and ``e_k``, distances of drones from their vertices.
    tensions: (J, n, 4) [N], of the edges.
    pulls: (J, n, 2, 4) [N], of the legs at their clasps.
    planned: (J, 2n, 3, 4) [m], drones in balance without friction, in whose planes legs lean; None
        of legs that are not rolled.
    cables: (J, n, 2, 4) [m], lengths of cable in the legs; None where they do not sag.

    Returns
    -------
    (J, clasps, 2, 3, 4) [m]: ``r_{k-1}`` and ``q_k`` at every clasp; nan where no leaning of the
    legs lets it balance.
    """
    layout = team.layout
    count, behind, ahead = len(vertices), layout.behind, layout.ahead
    around = layout.around_clasps
    columns = count * len(layout.clasps)
    if planned is None:
        sides = vertices[:, around[:, 2]] - vertices[:, around[:, 0]]
    else:
        sides = planned[:, 2 * ahead] - vertices[:, layout.clasps]
    half = 0.5 * GRAVITY * team.cable_density
    halves = half * (legs if cables is None else cables)
    loads = np.zeros(sides.shape)
    loads[:, :, 2] = halves[:, ahead, 1] + halves[:, behind, 0]
    whole = half * (team.cable_length[ahead] + team.cable_length[behind])
    loads[:, :, 2, 0] -= whole + GRAVITY * team.load

    def of_legs(values: Array) -> Array:
        """Return the values (J, n, 2, 4) of the legs at every clasp, (J·clasps, 2, 4)."""
        pairs = np.stack([values[:, behind, 1], values[:, ahead, 0]], axis=2)
        return pairs.reshape(columns, 2, JET)

    at_clasp = [
        vertices[:, around].reshape(columns, 9, JET),
        of_legs(legs),
        tensions[:, np.column_stack([behind, ahead])].reshape(columns, 2, JET),
        of_legs(pulls),
        sides.reshape(columns, 3, JET),
        loads.reshape(columns, 3, JET),
        of_legs(halves),
    ]
    both = np.stack(mapped(slipping_clasp_function(), at_clasp), axis=1)
    return both.reshape(count, len(layout.clasps), 2, 3, JET)
