"""Format ros2bag: a bag (MCAP or sqlite3) of every drone's trajectory, path and setpoints.

Per drone NAME, in frame ``map`` (east-north-up) or ``map_nwu``, at the plan's times from 0:

``/NAME/trajectory``      trajectory_msgs/MultiDOFJointTrajectory, one message: a point per sample
``/NAME/path``            nav_msgs/Path, one message, for display
``/NAME/cmd_full_state``  crazyflie_interfaces/FullState, one message per sample, for streaming

Feed-forward: accelerations of the trajectory are those of the drone, ``a``. Those of full states
are ``a_ff = a - F / m`` with the cable force F on the drone, because their controllers (such as
Mellinger's) add gravity and have no cable model: the thrust is ``m (a_ff + g ẑ)``, which defines
the attitude. Angular velocities of the trajectory are in the fixed frame, those of full states in
the body frame. Bags are written and read with rosbags, without ROS. crazyflies.yaml configures the
filter and the controller of Crazyflies for streaming.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError
from hitchopt.exports.contents import FileContents, required_module
from hitchopt.exports.firmware import SETTINGS, team_parameters
from hitchopt.exports.format import ExportTask, Format, FormatOutput
from hitchopt.exports.formats.crazyflie import parameter_notes, settings_text
from hitchopt.exports.options import ROS_DISTROS, STORAGES, ExportOptions
from hitchopt.hitch import Team
from hitchopt.storage.archive import reading
from hitchopt.values import Array

STEM = "setpoints"  # File name of the data, without suffix
METADATA = "metadata.yaml"  # File name of the metadata
BLOCK = 20_000  # Number of setpoints that are computed at once
FULL_STATE = "crazyflie_interfaces/msg/FullState"
TRAJECTORY = "trajectory_msgs/msg/MultiDOFJointTrajectory"
POINT = "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint"
PATH = "nav_msgs/msg/Path"

FULL_STATE_TEXT = """std_msgs/Header header
geometry_msgs/Pose pose
geometry_msgs/Twist twist
geometry_msgs/Vector3 acc
"""
"""Definition of crazyflie_interfaces' message, which is not part of ROS distributions."""

FRAMES = {"map": "enu", "map_nwu": "nwu", "map_ned": "ned"}  # By names in headers (REP 105, 103)


class Ros2Bag(Format):
    """A bag to play: trajectories, paths and full-state setpoints."""

    name = "ros2bag"
    file = f"{STEM}{{ending}}"
    endings = tuple(STORAGES.values())
    frames = ("enu", "nwu")
    rate = 100.0
    accuracy = 1e-3
    feed_forward = (
        "cmd_full_state: acc = a - G F/m with the cable's force F, the mass m and the pull gain G "
        "(1 without a named controller); trajectory: the drone's acceleration a"
    )
    flown_by = "stream"
    needs_stiffness = False
    has_gains = True
    streamed = 30.0

    def parameters(self, team: Team, options: ExportOptions) -> Mapping[str, Any]:
        """Return the Crazyflies' parameters; empty if a drone has another autopilot."""
        if any(kind.controller == "px4" for kind in team.quadrotor):
            return {}
        return {"parameters": team_parameters(team, options.stiffness, options.damping)}

    def write(self, folder: Path, task: ExportTask) -> FormatOutput:
        """Write the bag, and settings of Crazyflies; raises UnsupportedError without rosbags."""
        (data,) = self.files(task)
        options = task.options
        bags = required_module("rosbags.rosbag2")
        stage = folder / STEM  # rosbags creates a directory, and data with the same name
        version = ROS_DISTROS[options.ros_distro]
        plugin = options.storage.upper()
        kind = bags.StoragePlugin[plugin]
        with bags.Writer(stage, version=version, storage_plugin=kind) as bag:
            _write_messages(bag, task)
        for name in (data, METADATA):
            shutil.move(stage / name, folder / name)
        stage.rmdir()
        notes = (
            f"ros2 bag play FOLDER sends /{task.names[0]}/cmd_full_state and the like",
            f"{task.rate:g} Hz to every drone: one radio streams to about four Crazyflies",
        )
        if not task.settings:
            return FormatOutput((data, METADATA), notes)
        text = settings_text(task)
        (folder / SETTINGS).write_text(text, encoding="utf-8", newline="\n")
        return FormatOutput((data, METADATA, SETTINGS), (*notes, *parameter_notes(task)))

    def load(self, files: Sequence[Path]) -> FileContents:
        """Return the curves of all MultiDOFJointTrajectory messages of a bag.

        The file is the bag's data or metadata. Raises UnsupportedError without rosbags.
        """
        path = files[0].parent if files[0].name == METADATA else files[0]
        highlevel = required_module("rosbags.highlevel")
        store = message_types()
        tables_by_name: dict[str, Array] = {}
        frame = ""
        with (  # rosbags' exceptions have no common base class
            reading(path, "bag", Exception),
            highlevel.AnyReader([path], default_typestore=store) as bag,
        ):
            kinds = sorted({connection.msgtype for connection in bag.connections})
            connections = [c for c in bag.connections if c.msgtype == TRAJECTORY]
            if not connections:  # with an empty list, messages() yields all messages
                raise FileError(f"contains no {TRAJECTORY}, but {', '.join(kinds) or 'nothing'}")
            for connection, _, data in bag.messages(connections):
                message = bag.deserialize(data, connection.msgtype)
                frame = FRAMES.get(message.header.frame_id, "")
                for i, name in enumerate(message.joint_names):
                    if name in tables_by_name:
                        raise FileError(f"contains two trajectories of {name!r}")
                    tables_by_name[name] = np.array([_row(point, i) for point in message.points])
            if not tables_by_name:
                raise FileError("its trajectories name no joint")
            tables = list(tables_by_name.values())
            if any(not np.array_equal(table[:, 0], tables[0][:, 0]) for table in tables):
                raise FileError("its trajectories have different times")
            values = np.stack(tables, axis=1)
            samples = values[..., 1:] if np.all(np.isfinite(values)) else values[..., 1:4]
            smooth = 0 if samples.shape[-1] == 3 else 2
            return FileContents.of_samples(
                tuple(tables_by_name), values[:, 0, 0], samples, frame, smooth
            )

    def sent(self, files: Sequence[Path], manifest: Mapping[str, Any]) -> FileContents:
        """Return the full states that are streamed, whose accelerations include cable forces."""
        highlevel = required_module("rosbags.highlevel")
        store = message_types()
        names = tuple(map(str, manifest["drones"].values()))
        frame = ""
        rows: dict[str, list[list[float]]] = {name: [] for name in names}
        with (
            reading(files[0], "bag", Exception),
            highlevel.AnyReader([files[0]], default_typestore=store) as bag,
        ):
            connections = [c for c in bag.connections if c.msgtype == FULL_STATE]
            if len(connections) != len(names):
                raise FileError(f"has {len(connections)} streams of {FULL_STATE}, not {len(names)}")
            for connection, _, data in bag.messages(connections):
                message = bag.deserialize(data, connection.msgtype)
                stamp = message.header.stamp
                frame = FRAMES.get(message.header.frame_id, "")
                vectors = message.pose.position, message.twist.linear, message.acc
                values = [x for vector in vectors for x in (vector.x, vector.y, vector.z)]
                name = connection.topic.strip("/").partition("/")[0]
                rows[name].append([stamp.sec + 1e-9 * stamp.nanosec, *values])
            table = np.array([rows[name] for name in names])
        return FileContents.of_samples(
            names, table[0, :, 0], np.moveaxis(table[..., 1:], 0, 1), frame, 2
        )

    def read(self, folder: Path, task: ExportTask) -> FileContents:  # noqa: ARG002
        """Return the curves of the trajectories."""
        return self.load([folder / METADATA])


def _write_messages(bag: Any, task: ExportTask) -> None:
    store = message_types()
    names = {frame: name for name, frame in FRAMES.items()}
    frame = names[task.frame.name]

    def topic(name: str, kind: str) -> Any:
        return bag.add_connection(f"/{name}", kind, typestore=store)

    def send(connection: Any, t: float, message: Any) -> None:
        data = store.serialize_cdr(message, message.__msgtype__)
        bag.write(connection, round(1e9 * t), bytes(data))

    def message(kind: str, *values: Any) -> Any:
        return store.types[kind if "/msg/" in kind else f"geometry_msgs/msg/{kind}"](*values)

    def stamp(kind: str, t: float) -> Any:
        return message(f"builtin_interfaces/msg/{kind}", *divmod(round(1e9 * t), 1_000_000_000))

    def header(t: float) -> Any:
        return message("std_msgs/msg/Header", stamp("Time", t), frame)

    def vector(v: Array, kind: str = "Vector3") -> Any:
        return message(kind, *v.tolist())

    def twist(v: Array, rates: Array) -> Any:
        return message("Twist", vector(v), vector(rates))

    def quaternion(q: Array) -> Any:
        return vector(np.roll(q, -1), "Quaternion")

    def pose(position: Array, q: Array) -> Any:
        return message("Pose", vector(position, "Point"), quaternion(q))

    streams = [topic(f"{name}/cmd_full_state", FULL_STATE) for name in task.names]
    times, blocks = [], []
    for block_times, samples in task.blocks(BLOCK):
        times += block_times.tolist()
        blocks.append(samples)
        for s, t in enumerate(block_times.tolist()):
            for d, stream in enumerate(streams):
                state = {name: values[s, d] for name, values in samples.items()}
                at = pose(state["positions"], state["quaternions"])
                rates = twist(state["velocities"], state["body_rates"])
                acceleration = vector(state["feed_forward"])
                send(stream, t, message(FULL_STATE, header(t), at, rates, acceleration))
    zero = np.zeros(3)
    angle = 0.5 * task.frame.heading
    level = np.array([math.cos(angle), 0.0, 0.0, math.sin(angle)])
    for d, name in enumerate(task.names):  # a trajectory is one message of all samples
        states = {key: np.concatenate([block[key][:, d] for block in blocks]) for key in blocks[0]}
        q, body_rates = states["quaternions"], states["body_rates"]
        cross = np.cross(q[:, 1:], body_rates) + q[:, :1] * body_rates
        angular_velocities = body_rates + 2.0 * np.cross(q[:, 1:], cross)
        points, poses = [], []
        for s, t in enumerate(times):
            transform = message("Transform", vector(states["positions"][s]), quaternion(q[s]))
            velocity = twist(states["velocities"][s], angular_velocities[s])
            acceleration = twist(states["accelerations"][s], zero)
            since_start = stamp("Duration", t)
            points.append(message(POINT, [transform], [velocity], [acceleration], since_start))
            poses.append(message("PoseStamped", header(t), pose(states["positions"][s], level)))
        trajectory = message(TRAJECTORY, header(0.0), [name], points)
        send(topic(f"{name}/trajectory", TRAJECTORY), 0.0, trajectory)
        send(topic(f"{name}/path", PATH), 0.0, message(PATH, header(0.0), poses))


@lru_cache
def message_types() -> Any:
    """Return the types of ROS 2, and FullState; raises UnsupportedError without rosbags."""
    typesys = required_module("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    store.register(typesys.get_types_from_msg(FULL_STATE_TEXT, FULL_STATE))
    return store


def _row(point: Any, joint: int) -> list[float]:
    """Return time, position, velocity, acceleration of a joint (10,); nan if missing."""
    position = point.transforms[joint].translation
    row = [point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec]
    row += [position.x, position.y, position.z]
    for derivatives in (point.velocities, point.accelerations):
        linear = derivatives[joint].linear if len(derivatives) > joint else None
        row += [math.nan] * 3 if linear is None else [linear.x, linear.y, linear.z]
    return row
