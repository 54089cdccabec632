"""The messages of a bag, made and read with rosbags, without ROS."""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError
from hitchopt.exports.formats.file_reading import needed, reading
from hitchopt.exports.recording import Recording, Samples, recording_of_samples
from hitchopt.values import Array

FULL_STATE_TEXT = """std_msgs/Header header
geometry_msgs/Pose pose
geometry_msgs/Twist twist
geometry_msgs/Vector3 acc
"""
"""Definition of crazyflie_interfaces' message, which no ROS distribution brings along."""

FRAMES = {"map": "enu", "map_nwu": "nwu", "map_ned": "ned"}
"""Frames by the names in messages' headers."""


class Messages:
    """Makes messages.

    Parameters
    ----------
    frame_id: name of the frame in their headers.
    """

    FULL_STATE = "crazyflie_interfaces/msg/FullState"
    TRAJECTORY = "trajectory_msgs/msg/MultiDOFJointTrajectory"
    PATH = "nav_msgs/msg/Path"

    def __init__(self, frame_id: str = "") -> None:
        self.frame_id = frame_id

    @cached_property
    def store(self) -> Any:
        """Types of ROS 2, and FullState."""
        typesys = needed("rosbags.typesys")
        store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        store.register(typesys.get_types_from_msg(FULL_STATE_TEXT, self.FULL_STATE))
        return store

    def connection(self, bag: Any, topic: str, kind: str) -> Any:
        """Return the bag's connection for a topic."""
        return bag.add_connection(topic, kind, typestore=self.store)

    def write(self, bag: Any, connection: Any, t: float, message: Any) -> None:
        """Write a message at time t [s] into the bag."""
        data = self.store.serialize_cdr(message, message.__msgtype__)
        bag.write(connection, round(1e9 * t), bytes(data))

    def full_state(
        self, t: float, place: Array, turned: Array, velocity: Array, rates: Array, acc: Array
    ) -> Any:
        """Return a full-state setpoint; ``turned`` is a quaternion w, x, y, z."""
        twist = self._of("geometry_msgs/msg/Twist", self._vector(velocity), self._vector(rates))
        pose = self._pose(place, turned)
        return self._of(self.FULL_STATE, self._header(t), pose, twist, self._vector(acc))

    def trajectory(self, name: str, t: Array, table: Array) -> Any:
        """Return the trajectory of one drone.

        Parameters
        ----------
        table: (S, 16), positions, velocities, accelerations, angular velocities in the frame's
            axes, and quaternions w, x, y, z.
        """
        still = self._vector(np.zeros(3))
        points = []
        for at, row in zip(t.tolist(), table, strict=True):
            place, velocity, acceleration, turning = map(self._vector, np.split(row[:12], 4))
            twists = ((velocity, turning), (acceleration, still))
            points.append(
                self._of(
                    "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint",
                    [self._of("geometry_msgs/msg/Transform", place, self._quaternion(row[12:]))],
                    *([self._of("geometry_msgs/msg/Twist", *twist)] for twist in twists),
                    self._stamp("builtin_interfaces/msg/Duration", at),
                )
            )
        return self._of(self.TRAJECTORY, self._header(0.0), [name], points)

    def path(self, t: Array, places: Array, heading: float) -> Any:
        """Return the path of one drone (S, 3)."""
        turned = _upright(heading)
        poses = [
            self._of("geometry_msgs/msg/PoseStamped", self._header(at), self._pose(place, turned))
            for at, place in zip(t.tolist(), places, strict=True)
        ]
        return self._of(self.PATH, self._header(0.0), poses)

    def _of(self, kind: str, *values: Any) -> Any:
        return self.store.types[kind](*values)

    def _vector(self, v: Array) -> Any:
        return self._of("geometry_msgs/msg/Vector3", *v.tolist())

    def _pose(self, place: Array, turned: Array) -> Any:
        point = self._of("geometry_msgs/msg/Point", *place.tolist())
        return self._of("geometry_msgs/msg/Pose", point, self._quaternion(turned))

    def _quaternion(self, turned: Array) -> Any:
        w, x, y, z = turned.tolist()
        return self._of("geometry_msgs/msg/Quaternion", x, y, z, w)

    def _header(self, t: float) -> Any:
        stamp = self._stamp("builtin_interfaces/msg/Time", t)
        return self._of("std_msgs/msg/Header", stamp, self.frame_id)

    def _stamp(self, kind: str, t: float) -> Any:
        return self._of(kind, *divmod(round(1e9 * t), 1_000_000_000))


def _upright(heading: float) -> Array:
    return np.array([math.cos(0.5 * heading), 0.0, 0.0, math.sin(0.5 * heading)])


def bag_recording(path: Path) -> Recording:
    """Return the curves of all MultiDOFJointTrajectory messages of a bag, a folder or a file.

    Raises
    ------
    UnsupportedError: rosbags is not installed.
    FileError: no bag, a damaged one, or one without such messages.
    """
    highlevel = needed("rosbags.highlevel")
    found: dict[str, Array] = {}
    frame = ""
    store = Messages().store
    # The library raises many exceptions of its own, without a common root.
    with (
        reading(path, "bag", Exception),
        highlevel.AnyReader([path], default_typestore=store) as bag,
    ):
        kinds = sorted({connection.msgtype for connection in bag.connections})
        wanted = [c for c in bag.connections if c.msgtype == Messages.TRAJECTORY]
        if not wanted:  # of no connection the library gives all messages
            raise FileError(f"holds no {Messages.TRAJECTORY}, but {', '.join(kinds) or 'nothing'}")
        for connection, _, data in bag.messages(wanted):
            message = bag.deserialize(data, connection.msgtype)
            frame = FRAMES.get(message.header.frame_id, "")
            for i, name in enumerate(message.joint_names):
                if name in found:
                    raise FileError(f"holds two trajectories of {name!r}")
                found[name] = _table(message, i)
    if not found:
        raise FileError(f"{path}: its trajectories name no joint")
    names, tables = tuple(found), list(found.values())
    if any(not np.array_equal(table[:, 0], tables[0][:, 0]) for table in tables):
        raise FileError(f"{path}: its trajectories have different times")
    values = np.stack(tables, axis=1)
    samples = Samples.of_rows(values[:, 0, 0], values[..., 1:])
    smooth = 2 if np.all(np.isfinite(values)) else 0
    return recording_of_samples(names, lambda: [samples], frame, smooth)


def _table(message: Any, joint: int) -> Array:
    """Return t, position, velocity, acceleration of one joint, (S, 10); nan where not given."""
    rows = []
    for point in message.points:
        at = point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec
        place = point.transforms[joint].translation
        row = [at, place.x, place.y, place.z]
        for given in (point.velocities, point.accelerations):
            linear = given[joint].linear if len(given) > joint else None
            row += [math.nan] * 3 if linear is None else [linear.x, linear.y, linear.z]
        rows.append(row)
    if len(rows) < 2:
        raise FileError("a trajectory has fewer than two points")
    return np.array(rows, dtype=np.float64)
