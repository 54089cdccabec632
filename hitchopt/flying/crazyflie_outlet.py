"""Setpoints as full states over crazyflie_py, the Python client of Crazyswarm2.

Accelerations are ``a - F / m`` with the cable's force F, since the controllers on board add gravity
and know no cable; angular velocities are those of the thrust vector. Measurements are the poses
that ``/NAME/pose`` carries, where the fleet's file logs them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

from hitchopt.errors import InputError, UnsupportedError
from hitchopt.exports.formats.crazyswarm2_start import LANDED
from hitchopt.exports.reference_frame import ReferenceFrame
from hitchopt.flying.course import Flown
from hitchopt.model.evaluation import attitudes
from hitchopt.values import Array

VALID = 500
"""[ms] How long the last setpoint remains valid when the stream ends."""

DOWN = 1.0
"""[s] Time in which the firmware puts down drones that have landed."""


class CrazyflieOutlet:
    """A fleet of Crazyflies.

    Parameters
    ----------
    names: of the drones in the plan.
    robots: their names in the fleet.
    frame: axes of the fleet's world, east-north-up.
    swarm: a ``Crazyswarm``; its ``allcfs`` is a node of ROS.
    spin: lets ROS handle what has arrived.
    pose: class of the messages of poses.

    Raises
    ------
    InputError: the fleet has no robot of a name.
    """

    def __init__(
        self,
        names: Sequence[str],
        robots: Sequence[str],
        frame: ReferenceFrame,
        swarm: Any,
        spin: Callable[[], None],
        pose: type,
    ) -> None:
        known = swarm.allcfs.crazyfliesByName
        for robot in robots:
            if robot not in known:
                raise InputError("fleet", robot, f"one of {', '.join(known)}", "name it in --fleet")
        self._robots = [known[robot] for robot in robots]
        self._frame, self._spin = frame, spin
        self._found: dict[str, Array] = {}
        for name, robot in zip(names, robots, strict=True):
            heard = partial(self._heard, name)
            swarm.allcfs.create_subscription(pose, f"/{robot}/pose", heard, 10)

    def _heard(self, name: str, message: Any) -> None:
        place = message.pose.position
        point = np.array([place.x, place.y, place.z])
        if np.all(np.isfinite(point)):
            self._found[name] = self._frame.planned(point)

    def send(self, flown: Flown, now: float) -> None:  # noqa: ARG002
        """Send every drone its full state."""
        frame, at = self._frame, flown.setpoints
        turned = attitudes(
            frame.vectors(flown.thrusts), frame.vectors(flown.thrust_rates), frame.heading
        )
        rows = zip(
            self._robots,
            frame.points(at.positions).tolist(),
            frame.vectors(at.velocities).tolist(),
            frame.vectors(flown.feed_forward).tolist(),
            turned.body_rates.tolist(),
            strict=True,
        )
        for robot, position, velocity, forward, rates in rows:
            robot.cmdFullState(position, velocity, forward, frame.heading, rates)

    def measured(self) -> dict[str, Array]:
        """Return the poses' positions."""
        self._spin()
        found, self._found = self._found, {}
        return found

    def close(self, *, landed: bool) -> None:
        """Give the drones back to their high-level commander, which puts down landed ones."""
        for robot in self._robots:
            robot.notifySetpointsStop(VALID)
        if landed:
            for robot in self._robots:
                robot.land(LANDED, DOWN)
        self._spin()


def crazyflie_outlet(
    names: Sequence[str], robots: Sequence[str], frame: ReferenceFrame
) -> CrazyflieOutlet:
    """Return the fleet that the running Crazyswarm2 server has.

    Raises
    ------
    UnsupportedError: there is no ROS with crazyflie_py here.
    InputError: the fleet has no robot of a name.
    """
    try:
        rclpy, client = import_module("rclpy"), import_module("crazyflie_py")
        pose = import_module("geometry_msgs.msg").PoseStamped
    except ImportError as error:
        words = "source the setup of a ROS 2 workspace with Crazyswarm2 first"
        raise UnsupportedError(f"Crazyflies need crazyflie_py ({error}); {words}") from None
    swarm = client.Crazyswarm()

    def spin() -> None:
        for _ in range(4 * len(names)):
            rclpy.spin_once(swarm.allcfs, timeout_sec=0.0)

    return CrazyflieOutlet(names, robots, frame, swarm, spin, pose)
