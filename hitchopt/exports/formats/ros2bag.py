"""Format ros2bag: a bag (MCAP or sqlite3) of every drone's trajectory, path and setpoints.

Per drone NAME, in frame ``map`` (east-north-up) or ``map_nwu``, all at the plan's times from 0 on:

``/NAME/trajectory``      trajectory_msgs/MultiDOFJointTrajectory, one message: a point per sample
``/NAME/path``            nav_msgs/Path, one message, for looking at
``/NAME/cmd_full_state``  crazyflie_interfaces/FullState, one message per sample, to be streamed

Feed-forward: accelerations of the trajectory are the drone's own, ``a``. Those of the full states
are ``a_ff = a - F / m`` with the cable's force F on the drone, since the controllers that take them
(Mellinger's among them) add gravity and know no cable: the thrust is ``m (a_ff + g ẑ)``. Attitudes
are those of the thrust. Angular velocities of the trajectory are about the frame's axes, those of
the full states about the body's.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.exports.export_options import ROS_DISTROS, STORAGES
from hitchopt.exports.formats.attitude_in_frame import angular_velocities, attitudes_of
from hitchopt.exports.formats.file_reading import needed
from hitchopt.exports.formats.format import Candidate, Format, Task
from hitchopt.exports.formats.ros2_messages import FRAMES, Messages, bag_recording
from hitchopt.exports.recording import Recording
from hitchopt.motion.states import iterate_states, sample_times
from hitchopt.storage.atomic import Writer

STEM = "setpoints"

METADATA = "metadata.yaml"

BLOCK = 20_000
"""Setpoints that are held at once."""

FRAME_IDS = {frame: name for name, frame in FRAMES.items() if frame != "ned"}
"""Names of fixed frames: REP 105 has ``map``, which is east-north-up by REP 103."""


class Ros2Bag(Format):
    """A bag to play."""

    name = "ros2bag"
    frames = tuple(FRAME_IDS)
    rate = 100.0
    accuracy = 1e-3
    feed_forward = (
        "cmd_full_state: acc = a - F/m, the cable's force F and the drone's mass m, with attitude "
        "and body rates to match; trajectory: the drone's own acceleration"
    )
    carries_pull = True
    receiver_integral = False

    def candidates(self, task: Task) -> Iterator[Candidate]:
        """Give the one bag there is."""
        writers: dict[str, Writer] = {
            f"{STEM}{STORAGES[task.options.storage]}": lambda path: write_bag(path, task),
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
    """Write the bag's data at ``path`` and its metadata next to it.

    Raises
    ------
    UnsupportedError: rosbags is not installed.
    OSError: a file cannot be written.
    """
    bags = needed("rosbags.rosbag2")
    storage = bags.StoragePlugin[task.options.storage.upper()]
    stage = path.parent / STEM  # the library makes a directory, and calls the data by its name
    version = ROS_DISTROS[task.options.ros_distro]
    with bags.Writer(stage, version=version, storage_plugin=storage) as bag:
        _write_messages(bag, Messages(FRAME_IDS[task.frame.name]), task)
    for name in (path.name, METADATA):
        shutil.move(stage / name, path.parent / name)
    stage.rmdir()


def _write_messages(bag: Any, messages: Messages, task: Task) -> None:
    times = sample_times(task.motion.duration, task.rate)
    topics = [
        messages.connection(bag, f"/{name}/cmd_full_state", messages.FULL_STATE)
        for name in task.names
    ]
    blocks = []
    for states in iterate_states(task.motion, times, max(1, BLOCK // len(task.names))):
        attitudes = attitudes_of(task, states)
        positions, velocities, forward = task.setpoints(states)
        own = task.frame.vectors(states.accelerations)
        turning = angular_velocities(attitudes)
        row = (positions, velocities, own, turning, attitudes.quaternions)
        blocks.append(np.concatenate(row, axis=-1))
        flown = (positions, attitudes.quaternions, velocities, attitudes.body_rates, forward)
        for s, t in enumerate(states.t.tolist()):
            for d, topic in enumerate(topics):
                messages.write(bag, topic, t, messages.full_state(t, *(v[s, d] for v in flown)))
    table = np.concatenate(blocks)  # a trajectory is one message of all samples
    for d, name in enumerate(task.names):
        topic = messages.connection(bag, f"/{name}/trajectory", messages.TRAJECTORY)
        trajectory = messages.trajectory(name, times, table[:, d])
        messages.write(bag, topic, 0.0, trajectory)
        topic = messages.connection(bag, f"/{name}/path", messages.PATH)
        messages.write(bag, topic, 0.0, messages.path(times, table[:, d, :3], task.frame.heading))
