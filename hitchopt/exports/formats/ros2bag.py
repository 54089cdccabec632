"""Format ros2bag: a bag (MCAP or sqlite3) of every drone's trajectory, path and setpoints.

Per drone NAME, in frame ``map`` (east-north-up) or ``map_nwu``, all at the plan's times from 0 on:

``/NAME/trajectory``      trajectory_msgs/MultiDOFJointTrajectory, one message: a point per sample
``/NAME/path``            nav_msgs/Path, one message, for looking at
``/NAME/cmd_full_state``  crazyflie_interfaces/FullState, one message per sample, to be streamed

Feed-forward: accelerations of the trajectory are the drone's own, ``a``. Those of the full states
are ``a_ff = a - F / m`` with the cable's force F on the drone, since the controllers that take them
(Mellinger's among them) add gravity and know no cable; attitude and body rates are those of the
thrust ``m (a_ff + g ẑ)``.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.exports.formats.attitude import attitudes_of
from hitchopt.exports.formats.extras import needed
from hitchopt.exports.formats.format import ROS_DISTROS, Candidate, Task, Whole, pull_of
from hitchopt.exports.formats.ros2_messages import Messages, bag_recording
from hitchopt.exports.recording import Recording
from hitchopt.motion.states import iterate_states, sample_times
from hitchopt.storage.atomic import Writer

Array = NDArray[np.float64]

STEM = "setpoints"

METADATA = "metadata.yaml"

SUFFIXES = {"mcap": ".mcap", "sqlite3": ".db3"}

BLOCK = 20_000
"""Setpoints that are held at once."""

FRAME_IDS = {"enu": "map", "nwu": "map_nwu"}
"""As REP 105 calls a fixed frame; REP 103 says east-north-up where nothing else is said."""


class Ros2Bag(Whole):
    """A bag to play."""

    name = "ros2bag"
    summary = "a ROS 2 bag of trajectories, paths and full-state setpoints"
    frames = tuple(FRAME_IDS)
    rate = 100.0
    accuracy = 1e-3
    feed_forward = (
        "cmd_full_state: acc = a - F/m, the cable's force F and the drone's mass m, with attitude "
        "and body rates to match; trajectory: the drone's own acceleration"
    )

    def candidates(self, task: Task) -> Iterator[Candidate]:
        """Give the one bag there is."""
        needed("rosbags")
        data = f"{STEM}{SUFFIXES[task.storage]}"
        writers: dict[str, Writer] = {
            data: lambda path: write_bag(path, task),
            METADATA: lambda path: None,  # noqa: ARG005  written with the data
        }
        notes = (
            f"ros2 bag play FOLDER sends /{task.names[0]}/cmd_full_state and the like",
            f"{task.rate:g} Hz to every drone: one radio streams to about four Crazyflies",
        )
        yield Candidate(writers, notes)

    def read(self, folder: Path, task: Task) -> Recording:  # noqa: ARG002
        """Return the curves of the trajectories."""
        return bag_recording(folder)


def write_bag(path: Path, task: Task) -> None:
    """Write the bag's data at ``path`` and its metadata beside it.

    Raises
    ------
    UnsupportedError: rosbags is not installed.
    OSError: a file cannot be written.
    """
    bags = needed("rosbags.rosbag2")
    kind = bags.StoragePlugin.MCAP if task.storage == "mcap" else bags.StoragePlugin.SQLITE3
    stage = path.parent / STEM  # the library makes a directory, and calls the data by its name
    version = ROS_DISTROS[task.ros_distro]
    with bags.Writer(stage, version=version, storage_plugin=kind) as bag:
        _write_messages(bag, Messages(FRAME_IDS[task.room.frame]), task)
    shutil.move(stage / path.name, path)
    shutil.move(stage / METADATA, path.parent / METADATA)
    stage.rmdir()


def _write_messages(bag: Any, messages: Messages, task: Task) -> None:
    times = sample_times(task.motion.duration, task.rate)
    states_topics = [
        messages.connection(bag, f"/{name}/cmd_full_state", messages.FULL_STATE)
        for name in task.names
    ]
    blocks = []
    for states in iterate_states(task.motion, times, max(1, BLOCK // len(task.names))):
        room = task.room
        attitudes = attitudes_of(task, states)
        positions = room.points(states.positions)
        velocities, own = room.vectors(states.velocities), room.vectors(states.accelerations)
        forward = own - pull_of(task, states)
        blocks.append(np.stack([positions, velocities, own]))
        for s, t in enumerate(states.t.tolist()):
            for d, topic in enumerate(states_topics):
                message = messages.full_state(
                    t,
                    positions[s, d],
                    attitudes.quaternions[s, d],
                    velocities[s, d],
                    attitudes.rates[s, d],
                    forward[s, d],
                )
                bag.write(topic, round(1e9 * t), messages.bytes_of(message))
    table = np.concatenate(blocks, axis=1)  # a trajectory is one message of all samples
    for d, name in enumerate(task.names):
        topic = messages.connection(bag, f"/{name}/trajectory", messages.TRAJECTORY)
        message = messages.trajectory(name, times, table[:, :, d], task.room.heading)
        bag.write(topic, 0, messages.bytes_of(message))
        topic = messages.connection(bag, f"/{name}/path", messages.PATH)
        path = messages.path(times, table[0, :, d], task.room.heading)
        bag.write(topic, 0, messages.bytes_of(path))
