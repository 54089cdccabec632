"""The model over many robots and times at once, as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import Team
from hitchopt.hitch.layout import Layout
from hitchopt.model.attitude import attitude_function
from hitchopt.model.robot import JET, robot_function
from hitchopt.model.slipping import slipping_clasp_function

Array = NDArray[np.float64]

BATCH = 512
"""Number of columns that one call evaluates: a larger map takes longer to make than it saves."""


@dataclass(frozen=True, eq=False)
class FlatJets:
    """Flat outputs at J values of a parameter, with derivatives by it up to the third.

    Attributes
    ----------
    vertices: (J, points, 3, 4) [m]; n points of a closed hitch, n + 1 of a chain.
    q_legs: (J, n, 4) [m]
    tensions: (J, n, 4) [N]
    """

    vertices: Array
    q_legs: Array
    tensions: Array


@dataclass(frozen=True, eq=False)
class DroneJets:
    """Drones, forces and legs of flat outputs at the same J values of the parameter.

    Attributes
    ----------
    positions: (J, 2n, 3, 4) [m] and derivatives by the parameter, in the order q0, r0, q1, ….
    cable_forces: (J, 2n, 3) [N], of the cable on the drone.
    thrusts: (J, 2n, 3) [N], with the parameter taken as time.
    r_legs: (J, n, 4) [m], ``e_k`` and derivatives.
    """

    positions: Array
    cable_forces: Array
    thrusts: Array
    r_legs: Array


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
    quaternions, body_rates = _mapped(attitude_function(), [jets, yaws])
    shape = thrusts.shape[:-1]
    return Attitudes(quaternions.reshape(*shape, 4), body_rates.reshape(*shape, 3))


def drone_jets(team: Team, flat: FlatJets) -> DroneJets:
    """Return drones, forces and thrusts for flat outputs; linear in J·n.

    The paper's class is used where all tensions are equal, the general clasp elsewhere.
    """
    count, n = flat.q_legs.shape[:2]
    stencil = flat.vertices[:, team.layout.stencil]
    tensions = flat.tensions[:, team.layout.neighbours]
    equal = bool(np.all(flat.tensions[..., 0] == flat.tensions[0, 0, 0])) and not np.any(
        flat.tensions[..., 1:]
    )
    columns = count * n
    per_robot = (team.cable_length, team.mass[::2], team.cable_weight[::2])
    q, r, q_force, r_force, q_thrust, r_thrust, r_leg = _mapped(
        robot_function(equal),
        [
            stencil.reshape(columns, 12, JET),
            flat.q_legs.reshape(columns, 1, JET),
            tensions.reshape(columns, 3, JET),
            *(np.tile(value, count).reshape(columns, 1, 1) for value in per_robot),
        ],
    )

    def paired(a: Array, b: Array) -> Array:
        """Return (J, 2n, 3, width) of two (columns, 3, width), q and r alternating."""
        return np.stack([a, b], axis=1).reshape(count, 2 * n, 3, a.shape[-1])

    return DroneJets(
        paired(q, r),
        paired(q_force, r_force)[..., 0],
        paired(q_thrust, r_thrust)[..., 0],
        r_leg.reshape(count, n, JET),
    )


def slipping_drones(
    layout: Layout, vertices: Array, legs: Array, tensions: Array, pulls: Array
) -> Array:
    """Return the jets of drones on legs whose pulls differ from their edges' tensions.

    Parameters
    ----------
    layout: the hitch's.
    vertices: (J, points, 3, 4) [m], of a level hitch.
    legs: (J, n, 2, 4) [m], ``d_k`` and ``e_k``.
    tensions: (J, n, 4) [N], of the edges.
    pulls: (J, n, 2, 4) [N], of the legs.

    Returns
    -------
    (J, clasps, 2, 3, 4) [m]: ``r_{k-1}`` and ``q_k`` at every clasp; nan where no leaning of the
    legs lets it balance.
    """
    count, behind, ahead = len(vertices), layout.behind, layout.ahead
    around = [layout.starts[behind], layout.clasps, layout.ends[ahead]]
    columns = count * len(layout.clasps)
    at_clasp = [
        vertices[:, np.column_stack(around)].reshape(columns, 9, JET),
        np.stack([legs[:, behind, 1], legs[:, ahead, 0]], axis=2).reshape(columns, 2, JET),
        tensions[:, np.column_stack([behind, ahead])].reshape(columns, 2, JET),
        np.stack([pulls[:, behind, 1], pulls[:, ahead, 0]], axis=2).reshape(columns, 2, JET),
    ]
    both = np.stack(_mapped(slipping_clasp_function(), at_clasp), axis=1)
    return both.reshape(count, len(layout.clasps), 2, 3, JET)


def _mapped(function: ca.Function, inputs: list[Array]) -> list[Array]:
    """Return the outputs (columns, rows, width) of ``function`` for inputs of that layout.

    Casadi's buffers read and write numpy's memory: converting large arrays to its own matrices
    takes four times as long as the evaluation. Casadi takes longer to make a map than to run it,
    so columns come in batches of few sizes, whose maps are reused.
    """
    columns = len(inputs[0])
    size = min(BATCH, 1 << (columns - 1).bit_length())
    padded = -(-columns // size) * size
    given = []
    for array in inputs:
        column_major = np.empty((padded, array.shape[2], array.shape[1]))
        column_major[:columns] = array.transpose(0, 2, 1)
        column_major[columns:] = column_major[0]
        given.append(column_major)
    results = [
        np.zeros((padded, function.size2_out(i), function.size1_out(i)))
        for i in range(function.n_out())
    ]
    buffer, evaluate = _map(function, size).buffer()
    for first in range(0, padded, size):
        for i, array in enumerate(given):
            # casadi's stubs ask for a size, which its wrapper takes from the memory itself.
            buffer.set_arg(i, array[first : first + size].reshape(-1).data)  # type: ignore[call-arg]
        for i, array in enumerate(results):
            buffer.set_res(i, array[first : first + size].reshape(-1).data)  # type: ignore[call-arg]
        evaluate()
    return [array[:columns].transpose(0, 2, 1) for array in results]


@lru_cache(maxsize=64)
def _map(function: ca.Function, size: int) -> ca.Function:
    return function.map(size)
