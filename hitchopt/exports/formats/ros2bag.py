"""Format ros2bag: a bag (MCAP or sqlite3) of every drone's trajectory, path and setpoints.

Per drone NAME, in frame ``map`` (east-north-up) or ``map_nwu``, all at the plan's times from 0 on:

``/NAME/trajectory``      trajectory_msgs/MultiDOFJointTrajectory, one message: a point per sample
``/NAME/path``            nav_msgs/Path, one message, for looking at
``/NAME/cmd_full_state``  crazyflie_interfaces/FullState, one message per sample, to be streamed

Feed-forward: accelerations of the trajectory are the drone's own, ``a``. Those of the full states
are ``a_ff = a - F / m`` with the cable's force F on the drone, since the controllers that take them
(Mellinger's among them) add gravity and know no cable: the thrust is ``m (a_ff + g ẑ)``. Attitudes
are those of the thrust. Angular velocities of the trajectory are about the frame's axes, those of
the full states about the body's. Bags are made and read with rosbags, without ROS. The filter and
the controller of Crazyflies that are streamed to are set by crazyflies.yaml.
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
from hitchopt.exports.firmware import SETTINGS, team_parameters
from hitchopt.exports.format import Format, Task, Written
from hitchopt.exports.formats.crazyflie import parameter_notes, settings_text
from hitchopt.exports.options import ROS_DISTROS, STORAGES, ExportOptions
from hitchopt.exports.recording import Recording, needed
from hitchopt.hitch import Team
from hitchopt.storage.archive import reading
from hitchopt.values import Array

STEM, METADATA = "setpoints", "metadata.yaml"  # Names of the data, without ending, and of the rest
BLOCK = 20_000  # Setpoints that are held at once
FULL_STATE = "crazyflie_interfaces/msg/FullState"
TRAJECTORY = "trajectory_msgs/msg/MultiDOFJointTrajectory"
POINT = "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint"
PATH = "nav_msgs/msg/Path"

FULL_STATE_TEXT = """std_msgs/Header header
geometry_msgs/Pose pose
geometry_msgs/Twist twist
geometry_msgs/Vector3 acc
"""
"""Definition of crazyflie_interfaces' message, which no ROS distribution brings along."""

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
        "cmd_full_state: acc = a - G F/m, the cable's force F, the drone's mass m and G, the pull "
        "gain of a named controller, else 1, with attitude and body rates to match; trajectory: "
        "the drone's own acceleration"
    )
    flown_by = "stream"
    streamed = 30.0

    def parameters(self, team: Team, options: ExportOptions) -> Mapping[str, Any]:
        """Return the Crazyflies' parameters, if none of the drones has another autopilot."""
        if any(kind.controller == "px4" for kind in team.quadrotor):
            return {}
        return {"parameters": team_parameters(team, options.stiffness, options.damping)}

    def write(self, folder: Path, task: Task) -> Written:
        """Write the bag, and settings of Crazyflies; raise UnsupportedError without rosbags."""
        (data,), options, bags = self.files(task), task.options, needed("rosbags.rosbag2")
        stage = folder / STEM  # the library makes a directory, and calls the data by its name
        version, plugin = ROS_DISTROS[options.ros_distro], options.storage.upper()
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
            return Written((data, METADATA), notes)
        text = settings_text(task, task.frame.points(task.motion.drones.at(0.0)))
        (folder / SETTINGS).write_text(text, encoding="utf-8", newline="\n")
        return Written((data, METADATA, SETTINGS), (*notes, *parameter_notes(task)))

    def load(self, files: Sequence[Path]) -> Recording:
        """Return the curves of all MultiDOFJointTrajectory messages of a bag.

        It is given by its data or its metadata; UnsupportedError says that rosbags is missing.
        """
        path = files[0].parent if files[0].name == METADATA else files[0]
        highlevel, store = needed("rosbags.highlevel"), message_types()
        tables_by_name: dict[str, Array] = {}
        frame = ""
        with (  # many exceptions, without a common root
            reading(path, "bag", Exception),
            highlevel.AnyReader([path], default_typestore=store) as bag,
        ):
            kinds = sorted({connection.msgtype for connection in bag.connections})
            wanted = [c for c in bag.connections if c.msgtype == TRAJECTORY]
            if not wanted:  # of no connection the library gives all messages
                raise FileError(f"holds no {TRAJECTORY}, but {', '.join(kinds) or 'nothing'}")
            for connection, _, data in bag.messages(wanted):
                message = bag.deserialize(data, connection.msgtype)
                frame = FRAMES.get(message.header.frame_id, "")
                for i, name in enumerate(message.joint_names):
                    if name in tables_by_name:
                        raise FileError(f"holds two trajectories of {name!r}")
                    tables_by_name[name] = np.array([_row(point, i) for point in message.points])
            if not tables_by_name:
                raise FileError("its trajectories name no joint")
            tables = list(tables_by_name.values())
            if any(not np.array_equal(table[:, 0], tables[0][:, 0]) for table in tables):
                raise FileError("its trajectories have different times")
            values = np.stack(tables, axis=1)
            samples = values[..., 1:] if np.all(np.isfinite(values)) else values[..., 1:4]
            smooth = 0 if samples.shape[-1] == 3 else 2
            return Recording.of_samples(
                tuple(tables_by_name), values[:, 0, 0], samples, frame, smooth
            )

    def read(self, folder: Path, task: Task) -> Recording:  # noqa: ARG002
        """Return the curves of the trajectories, found by the metadata."""
        return self.load([folder / METADATA])


def _write_messages(bag: Any, task: Task) -> None:
    store, names = message_types(), {frame: name for name, frame in FRAMES.items()}
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

    def turned(q: Array) -> Any:
        return vector(np.roll(q, -1), "Quaternion")

    def pose(place: Array, q: Array) -> Any:
        return message("Pose", vector(place, "Point"), turned(q))

    streams = [topic(f"{name}/cmd_full_state", FULL_STATE) for name in task.names]
    times, blocks = [], []
    for here, samples in task.blocks(BLOCK):
        times += here.tolist()
        blocks.append(samples)
        for s, t in enumerate(here.tolist()):
            for d, stream in enumerate(streams):
                now = {name: values[s, d] for name, values in samples.items()}
                moved = twist(now["velocities"], now["body_rates"])
                there, bent = (
                    pose(now["positions"], now["quaternions"]),
                    vector(now["feed_forward"]),
                )
                send(stream, t, message(FULL_STATE, header(t), there, moved, bent))
    still, turn = np.zeros(3), 0.5 * task.frame.heading
    level = np.array([math.cos(turn), 0.0, 0.0, math.sin(turn)])
    for d, name in enumerate(task.names):  # a trajectory is one message of all samples
        own = {key: np.concatenate([block[key][:, d] for block in blocks]) for key in blocks[0]}
        quaternions = own["quaternions"]
        axes, rates = quaternions[:, 1:], own["body_rates"]  # turned about the frame's axes below
        across = np.cross(axes, rates) + quaternions[:, :1] * rates
        rates = rates + 2.0 * np.cross(axes, across)
        points, poses = [], []
        for s, t in enumerate(times):
            there = message("Transform", vector(own["positions"][s]), turned(quaternions[s]))
            moved = twist(own["velocities"][s], rates[s])
            bent = twist(own["accelerations"][s], still)
            points.append(message(POINT, [there], [moved], [bent], stamp("Duration", t)))
            poses.append(message("PoseStamped", header(t), pose(own["positions"][s], level)))
        trajectory = message(TRAJECTORY, header(0.0), [name], points)
        send(topic(f"{name}/trajectory", TRAJECTORY), 0.0, trajectory)
        send(topic(f"{name}/path", PATH), 0.0, message(PATH, header(0.0), poses))


@lru_cache
def message_types() -> Any:
    """Return the types of ROS 2, and FullState; raise UnsupportedError without rosbags."""
    typesys = needed("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    store.register(typesys.get_types_from_msg(FULL_STATE_TEXT, FULL_STATE))
    return store


def _row(point: Any, joint: int) -> list[float]:
    """Return time, position, velocity, acceleration of a joint (10,); nan where not given."""
    place = point.transforms[joint].translation
    row = [point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec]
    row += [place.x, place.y, place.z]
    for given in (point.velocities, point.accelerations):
        linear = given[joint].linear if len(given) > joint else None
        row += [math.nan] * 3 if linear is None else [linear.x, linear.y, linear.z]
    return row
