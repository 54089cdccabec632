"""Drones as bodies: what of a command becomes force and moment, and when.

A ``rigid`` drone has an attitude loop (some 60 ms late) and motors (first order, 20 ms) between the
wanted force and the real one; a ``point`` drone has one lag of 80 ms, which is as late in all.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hitchopt.simulation.drone_control import ARM, Reference, attitude_command
from hitchopt.simulation.mujoco_world import World
from hitchopt.simulation.mujoco_xml import BODY

Array = NDArray[np.float64]


class Drones(Protocol):
    """Turns wanted forces into real ones; keeps the motors' state.

    Attributes
    ----------
    saturated: (2n,), whether the last command had to be cut.
    thrusts: (2n,) [N], what the motors give now.
    """

    saturated: NDArray[np.bool_]
    thrusts: Array

    def apply(self, world: World, wanted: Array, reference: Reference, seconds: float, /) -> None:
        """Put forces on the world's drones for the next ``seconds``.

        Parameters
        ----------
        world: where they are.
        wanted: (2n, 3) [N], the thrust.
        reference: what they are told, for how their attitude is to turn.
        seconds: until the next command.
        """
        ...


def make_drones(world: World, max_thrust: Array, lag: float) -> Drones:
    """Return the drones of a world, hovering.

    Parameters
    ----------
    world: where they are.
    max_thrust: (2n,) [N]
    lag: of their thrust [s].
    """
    if world.rigid:
        return RigidDrones(world, max_thrust, lag)
    return PointDrones(max_thrust, lag)


class PointDrones:
    """Point masses: the force itself lags."""

    def __init__(self, max_thrust: Array, lag: float) -> None:
        self._max_thrust = max_thrust
        self._lag = lag
        self._force: Array | None = None
        self.saturated = np.zeros(len(max_thrust), dtype=np.bool_)
        self.thrusts = np.zeros(len(max_thrust))

    def apply(self, world: World, wanted: Array, _reference: Reference, seconds: float) -> None:
        """Put forces on the drones; there is nothing to turn."""
        size = np.linalg.norm(wanted, axis=-1)
        self.saturated = size > self._max_thrust
        allowed = wanted * np.minimum(1.0, self._max_thrust / np.maximum(size, 1e-9))[:, None]
        self._force = (
            allowed
            if self._force is None
            else allowed + (self._force - allowed) * _remains(seconds, self._lag)
        )
        self.thrusts = np.linalg.norm(self._force, axis=-1)
        world.data.xfrc_applied[world.drone_bodies, :3] = self._force


class RigidDrones:
    """Rigid bodies under Lee's controller; collective thrust and moments lag as the motors do."""

    def __init__(self, world: World, max_thrust: Array, lag: float) -> None:
        self._max_thrust = max_thrust
        self._max_moment = ARM * BODY.radius * max_thrust[:, None] * np.array([1.0, 1.0, 0.2])
        self._lag = lag
        self._state: Array | None = None
        self._rate_dofs = world.drone_dofs + 3
        self.saturated = np.zeros(len(max_thrust), dtype=np.bool_)
        self.thrusts = np.zeros(len(max_thrust))

    def apply(self, world: World, wanted: Array, reference: Reference, seconds: float) -> None:
        """Put thrust along every drone's axis, and the moments that turn it."""
        attitudes = world.data.xmat[world.drone_bodies].reshape(-1, 3, 3)
        rates = world.data.qvel[self._rate_dofs]
        thrusts, moments = attitude_command(
            reference, wanted, attitudes, rates, world.masses, world.inertia
        )
        self.saturated = thrusts > self._max_thrust
        command = np.column_stack(
            [
                np.clip(thrusts, 0.0, self._max_thrust),
                np.clip(moments, -self._max_moment, self._max_moment),
            ]
        )
        self._state = (
            command
            if self._state is None
            else command + (self._state - command) * _remains(seconds, self._lag)
        )
        self.thrusts = self._state[:, 0]
        applied = world.data.xfrc_applied
        applied[world.drone_bodies, :3] = self.thrusts[:, None] * attitudes[:, :, 2]
        applied[world.drone_bodies, 3:] = np.einsum("iab,ib->ia", attitudes, self._state[:, 1:])


def _remains(seconds: float, lag: float) -> float:
    return float(np.exp(-seconds / lag)) if lag > 0.0 else 0.0
