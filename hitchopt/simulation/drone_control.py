"""The controller: thrust and moment from setpoints and a drone's measured state.

It is the geometric controller of T. Lee, M. Leok and N. H. McClamroch, "Geometric tracking control
of a quadrotor UAV on SE(3)", CDC 2010, adapted to a hitch in two respects: the cable's force that
the setpoints hold is fed forward, and nothing else; and the position loop is soft, since a stiff
one turns every centimetre of error into tension.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError
from hitchopt.hitch import GRAVITY, Team
from hitchopt.simulation.flight_task import Setpoints
from hitchopt.simulation.simulation_settings import Settings
from hitchopt.values import Array

POSITION_GAIN, VELOCITY_GAIN = 36.0, 10.0
"""Gains of the position loop where the team states no stiffness [1/s²], [1/s]: 4.75 N/m at 132 g.
Another stiffness has the same damping ratio."""

INTEGRAL_TIME = 2.0
"""Time after which the integral of a constant error answers as much as the error itself [s]."""

ATTITUDE_GAIN, RATE_GAIN = 900.0, 54.0
"""Gains of the attitude loop [1/s²], [1/s], whose delay is some 60 ms."""

LEAST_FORCE = 1e-9
"""Thrust below which it has no direction [N]."""


@dataclass(frozen=True, eq=False)
class PositionGains:
    """Gains of the drones' position loops.

    Attributes
    ----------
    stiffness, damping, integral: (2n,) [N/m], [N s/m], [N/(m s)]
    feed_forward: (2n,), whether the cable force of the setpoints is added.
    """

    stiffness: Array
    damping: Array
    integral: Array
    feed_forward: NDArray[np.bool_]

    @classmethod
    def of(cls, team: Team, settings: Settings) -> PositionGains:
        """Return the gains of a team's drones, the settings replacing what they state.

        Raises
        ------
        InputError: a stiffness with which a drone oscillates more and more.
        """
        own = POSITION_GAIN * team.mass
        stated = np.where(np.isfinite(team.stiffness), team.stiffness, own)
        given = settings.stiffness
        stiffness = stated if given is None else np.full(team.drones, given)
        ratio = VELOCITY_GAIN / (2.0 * np.sqrt(POSITION_GAIN))
        damping = 2.0 * ratio * np.sqrt(stiffness * team.mass)
        winds = team.integral if settings.integral is None else settings.integral
        feeds = team.feed_forward if settings.feed_forward is None else settings.feed_forward
        gains = cls(
            stiffness,
            damping,
            np.where(winds, stiffness / INTEGRAL_TIME, 0.0),
            np.broadcast_to(feeds, stiffness.shape),
        )
        gains._check_stable(team.mass, settings)
        return gains

    def _check_stable(self, masses: Array, settings: Settings) -> None:
        """Check that errors decay: the loop's characteristic polynomial has no growing root.

        Raises
        ------
        InputError: a drone whose errors grow.
        """
        delay = _delay_polynomial(settings)
        for mass, *gains in np.unique(
            np.column_stack([masses, self.damping, self.stiffness, self.integral]), axis=0
        ):
            order = 3 if gains[2] > 0.0 else 2
            inertia = np.polymul(delay, mass * np.eye(order + 1)[0])
            growth = np.max(np.roots(np.polyadd(inertia, gains[:order])).real)
            if growth >= 0.0:
                raise InputError(
                    "stiffness",
                    float(gains[1]),
                    f"low enough for a drone of {mass:g} kg whose thrust lags behind its command; "
                    "at this one it oscillates more and more",
                    "lower it, or take --drones point with a shorter --lag",
                )


def _delay_polynomial(settings: Settings) -> Array:
    """Return the denominator of a level force's delay, highest power first, 1 at s = 0."""
    lag = settings.lag
    if settings.body == "rigid":
        return np.array([lag, 1.0, RATE_GAIN, ATTITUDE_GAIN]) / ATTITUDE_GAIN
    return np.array([lag, 1.0])


def desired_thrusts(
    setpoints: Setpoints,
    masses: Array,
    gains: PositionGains,
    positions: Array,
    velocities: Array,
    wound: Array | float = 0.0,
) -> Array:
    """Return the thrust (2n, 3) [N] that leads drones back to their setpoints.

    Parameters
    ----------
    setpoints: commands (2n, …).
    masses: (2n,) [kg]
    gains: of the position loops.
    positions, velocities: measured (2n, 3) [m], [m/s].
    wound: force of the integral action so far (2n, 3) [N].
    """
    error = setpoints.positions - positions
    rate = setpoints.velocities - velocities
    forces: Array = masses[:, None] * (setpoints.accelerations + [0.0, 0.0, GRAVITY])
    forces += gains.stiffness[:, None] * error + gains.damping[:, None] * rate + wound
    forces -= gains.feed_forward[:, None] * setpoints.cable_forces
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
