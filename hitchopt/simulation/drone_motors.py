"""The drones' motors: which forces and moments follow from a command, and when.

A ``rigid`` drone has an attitude loop (some 60 ms of delay) and motors (first order, 20 ms) between
the desired force and the actual one; a ``point`` drone has one lag of 80 ms, the same delay in all.
"""

from __future__ import annotations

import numpy as np

from hitchopt.simulation.drone_control import LEAST_FORCE, attitude_command
from hitchopt.simulation.flight_task import Setpoints
from hitchopt.simulation.mujoco_world import World
from hitchopt.simulation.mujoco_xml import BODY_RADIUS
from hitchopt.values import Array

ARM = 0.5
"""Lever arm of the thrust in a drone's largest roll and pitch moments, over the drone's radius."""

MOMENT_SHARES = np.array([1.0, 1.0, 0.2])
"""Largest roll, pitch and yaw moment over the largest roll moment: propellers' drag is small."""


class Motors:
    """Motors with limits and a lag, which apply their forces to the drones of a world.

    Parameters
    ----------
    world: simulated world.
    max_thrust: (2n,) [N]
    lag: time constant [s].

    Attributes
    ----------
    saturated: whether the last command exceeded the thrust (2n,).
    thrusts: present thrusts (2n,) [N].
    """

    def __init__(self, world: World, max_thrust: Array, lag: float) -> None:
        self._world, self._max_thrust, self._lag = world, np.array(max_thrust), lag
        self._state: Array | None = None
        self.saturated = np.zeros(len(max_thrust), dtype=np.bool_)
        self.thrusts = np.zeros(len(max_thrust))

    def stop(self, drone: int) -> None:
        """Stop the motors of a drone, whose thrust fades with their lag."""
        self._max_thrust[drone] = 0.0

    def apply(self, desired: Array, setpoints: Setpoints, seconds: float) -> None:
        """Apply forces to the world's drones for the next ``seconds``.

        Parameters
        ----------
        desired: thrust (2n, 3) [N].
        setpoints: define the yaw, and how the attitude is to turn.
        seconds: time until the next command.
        """
        world = self._world
        attitudes = world.data.xmat[world.drone_bodies].reshape(-1, 3, 3)
        if world.rigid:
            command = self._rigid(desired, setpoints, attitudes)
        else:
            command = self._point(desired)
        remains = np.exp(-seconds / self._lag) if self._lag > 0.0 else 0.0
        before = command if self._state is None else self._state
        state = self._state = command + (before - command) * remains
        applied = world.data.xfrc_applied
        if world.rigid:
            self.thrusts = state[:, 0]
            applied[world.drone_bodies, :3] = self.thrusts[:, None] * attitudes[:, :, 2]
            applied[world.drone_bodies, 3:] = np.einsum("iab,ib->ia", attitudes, state[:, 1:])
        else:
            self.thrusts = np.linalg.norm(state, axis=-1)
            applied[world.drone_bodies, :3] = state

    def _point(self, desired: Array) -> Array:
        """Return the force (2n, 3) [N] of point masses: the desired one, within its limit."""
        size = np.linalg.norm(desired, axis=-1)
        self.saturated = (size > self._max_thrust) & (self._max_thrust > 0.0)
        share = np.minimum(1.0, self._max_thrust / np.maximum(size, LEAST_FORCE))
        allowed: Array = desired * share[:, None]
        return allowed

    def _rigid(self, desired: Array, setpoints: Setpoints, attitudes: Array) -> Array:
        """Return thrusts and moments (2n, 4) [N], [N m] of rigid bodies, within their limits."""
        world = self._world
        rates = world.data.qvel[world.drone_dofs + 3]
        thrusts, moments = attitude_command(
            setpoints, desired, attitudes, rates, world.masses, world.inertia
        )
        self.saturated = (thrusts > self._max_thrust) & (self._max_thrust > 0.0)
        limit = ARM * BODY_RADIUS * self._max_thrust[:, None] * MOMENT_SHARES
        return np.column_stack(
            [np.clip(thrusts, 0.0, self._max_thrust), np.clip(moments, -limit, limit)]
        )
