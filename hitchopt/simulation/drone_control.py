"""The controller: from setpoints and what a drone believes to thrust and moment.

The geometric controller of T. Lee, M. Leok and N. H. McClamroch, "Geometric tracking control of a
quadrotor UAV on SE(3)", CDC 2010, with two things of a hitch: the cable's pull is fed forward, and
the position loop is soft, since a stiff one turns every centimetre of error into tension.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import GRAVITY

Array = NDArray[np.float64]

POSITION_GAIN = 36.0
"""[1/s²] 4.75 N/m at 132 g."""

VELOCITY_GAIN = 10.0
"""[1/s]"""

ATTITUDE_GAIN = 900.0
"""[1/s²] Of the attitude loop, which answers some 60 ms late."""

RATE_GAIN = 54.0
"""[1/s]"""

ARM = 0.5
"""Of what its motors lift, how much a drone can shift to one side over its radius."""


@dataclass(frozen=True, eq=False)
class Reference:
    """What the drones are to do now; (2n, 3) each, yaw (2n,).

    Attributes
    ----------
    positions, velocities, accelerations, jerks: [m], [m/s], [m/s²], [m/s³]
    yaw: [rad]
    cable_forces: [N], what the cables are expected to put on the drones.
    """

    positions: Array
    velocities: Array
    accelerations: Array
    jerks: Array
    yaw: Array
    cable_forces: Array


def wanted_forces(
    reference: Reference, masses: Array, positions: Array, velocities: Array
) -> Array:
    """Return (2n, 3) [N]: the thrust that drones want, believed to be at ``positions`` (2n, 3)."""
    error = reference.positions - positions
    rate = reference.velocities - velocities
    acceleration = reference.accelerations + POSITION_GAIN * error + VELOCITY_GAIN * rate
    acceleration[:, 2] += GRAVITY
    forces: Array = masses[:, None] * acceleration - reference.cable_forces
    return forces


def attitude_command(
    reference: Reference,
    wanted: Array,
    attitudes: Array,
    rates: Array,
    masses: Array,
    inertia: Array,
) -> tuple[Array, Array]:
    """Return the thrust along each drone's axis and the moment that turns it to the wanted one.

    Parameters
    ----------
    reference: its jerks and yaws count here.
    wanted: (2n, 3) [N]
    attitudes: (2n, 3, 3), columns are the body's axes in the world.
    rates: (2n, 3) [rad/s], about the body's axes.
    masses, inertia: (2n,) [kg], (2n, 3) [kg m²]

    Returns
    -------
    thrusts (2n,) [N], moments (2n, 3) [N m] about the body's axes; before any limit.
    """
    desired = desired_attitudes(wanted, reference.yaw)
    desired_rates = _desired_rates(desired, wanted, masses[:, None] * reference.jerks)
    across = np.einsum("iba,ibc->iac", desired, attitudes)  # R_d^T R
    skew = 0.5 * (across - across.transpose(0, 2, 1))
    error = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=-1)
    carried = np.einsum("iba,ib->ia", across, desired_rates)  # R^T R_d omega_d
    turning = -ATTITUDE_GAIN * error - RATE_GAIN * (rates - carried)
    moments = inertia * turning + _cross(rates, inertia * rates)
    thrusts = np.einsum("ia,ia->i", wanted, attitudes[:, :, 2])
    return thrusts, moments


def desired_attitudes(wanted: Array, yaw: Array) -> Array:
    """Return (2n, 3, 3): the third axis along the wanted thrust, the first toward the yaw."""
    third = wanted / np.maximum(np.linalg.norm(wanted, axis=-1, keepdims=True), LEAST_FORCE)
    heading = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=-1)
    second = _cross(third, heading)
    second /= np.maximum(np.linalg.norm(second, axis=-1, keepdims=True), LEAST_FORCE)
    attitudes: Array = np.stack([_cross(second, third), second, third], axis=-1)
    return attitudes


LEAST_FORCE = 1e-9
"""[N] Below it a thrust has no direction."""


def _desired_rates(desired: Array, wanted: Array, change: Array) -> Array:
    """Return (2n, 3) [rad/s]: how the desired attitude turns as the force changes, [N/s]."""
    size = np.maximum(np.linalg.norm(wanted, axis=-1, keepdims=True), LEAST_FORCE)
    turning = np.einsum("iba,ib->ia", desired, change / size)
    return np.stack([-turning[:, 1], turning[:, 0], np.zeros(len(turning))], axis=-1)


def _cross(a: Array, b: Array) -> Array:
    """Return (k, 3): numpy's own takes longer than all the rest of a command."""
    (x, y, z), (u, v, w) = a.T, b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)
