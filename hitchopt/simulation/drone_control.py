"""The controller: thrust and moment from setpoints and a drone's measured state.

It is the geometric controller of T. Lee, M. Leok and N. H. McClamroch, "Geometric tracking control
of a quadrotor UAV on SE(3)", CDC 2010, adapted to a hitch in two respects: the cable's pull is fed
forward, and the position loop is soft, since a stiff one turns every centimetre of error into
tension.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import GRAVITY
from hitchopt.simulation.flight_task import Setpoints

Array = NDArray[np.float64]

POSITION_GAIN, VELOCITY_GAIN = 36.0, 10.0
"""Gains of the position loop [1/s²], [1/s]: 4.75 N/m at 132 g."""

ATTITUDE_GAIN, RATE_GAIN = 900.0, 54.0
"""Gains of the attitude loop [1/s²], [1/s], whose delay is some 60 ms."""

LEAST_FORCE = 1e-9
"""Thrust below which it has no direction [N]."""


def desired_thrusts(
    setpoints: Setpoints, masses: Array, positions: Array, velocities: Array
) -> Array:
    """Return the thrust (2n, 3) [N] that leads drones back to their setpoints.

    Parameters
    ----------
    setpoints: commands (2n, …).
    masses: (2n,) [kg]
    positions, velocities: measured (2n, 3) [m], [m/s].
    """
    error = setpoints.positions - positions
    rate = setpoints.velocities - velocities
    acceleration = setpoints.accelerations + POSITION_GAIN * error + VELOCITY_GAIN * rate
    acceleration[:, 2] += GRAVITY
    forces: Array = masses[:, None] * acceleration - setpoints.cable_forces
    return forces


def attitude_command(
    setpoints: Setpoints,
    desired: Array,
    attitudes: Array,
    rates: Array,
    masses: Array,
    inertia: Array,
) -> tuple[Array, Array]:
    """Return the thrust along each drone's axis and the moment that turns it to the desired one.

    Parameters
    ----------
    setpoints: their jerks and yaws are used.
    desired: thrust (2n, 3) [N].
    attitudes: (2n, 3, 3), columns are the body's axes in the world.
    rates: (2n, 3) [rad/s], about the body's axes.
    masses, inertia: (2n,) [kg], (2n, 3) [kg m²]

    Returns
    -------
    thrusts (2n,) [N], moments (2n, 3) [N m] about the body's axes; before any limit.
    """
    goals = desired_attitudes(desired, setpoints.yaw)
    goal_rates = _desired_rates(goals, desired, masses[:, None] * setpoints.jerks)
    across = np.einsum("iba,ibc->iac", goals, attitudes)  # R_d^T R
    skew = 0.5 * (across - across.transpose(0, 2, 1))
    error = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=-1)
    carried = np.einsum("iba,ib->ia", across, goal_rates)  # R^T R_d omega_d
    turning = -ATTITUDE_GAIN * error - RATE_GAIN * (rates - carried)
    moments = inertia * turning + _cross(rates, inertia * rates)
    thrusts = np.einsum("ia,ia->i", desired, attitudes[:, :, 2])
    return thrusts, moments


def desired_attitudes(desired: Array, yaw: Array) -> Array:
    """Return (2n, 3, 3): the third axis along the desired thrust, the first toward the yaw."""
    third = desired / np.maximum(np.linalg.norm(desired, axis=-1, keepdims=True), LEAST_FORCE)
    heading = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=-1)
    second = _cross(third, heading)
    second /= np.maximum(np.linalg.norm(second, axis=-1, keepdims=True), LEAST_FORCE)
    attitudes: Array = np.stack([_cross(second, third), second, third], axis=-1)
    return attitudes


def _desired_rates(goals: Array, desired: Array, change: Array) -> Array:
    """Return (2n, 3) [rad/s]: the rates of the desired attitudes as the thrust changes, [N/s]."""
    size = np.maximum(np.linalg.norm(desired, axis=-1, keepdims=True), LEAST_FORCE)
    turning = np.einsum("iba,ib->ia", goals, change / size)
    return np.stack([-turning[:, 1], turning[:, 0], np.zeros(len(turning))], axis=-1)


def _cross(a: Array, b: Array) -> Array:
    """Return cross products (k, 3); numpy's takes longer than all other parts of a command."""
    (x, y, z), (u, v, w) = a.T, b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)
