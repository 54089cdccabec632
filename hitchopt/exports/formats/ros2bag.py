"""Format ros2bag: a bag (MCAP or sqlite3) of every drone's trajectory, path and setpoints.

Per drone NAME, in frame ``map`` (east-north-up) or ``map_nwu``, all at the plan's times from 0 on:

``/NAME/trajectory``      trajectory_msgs/MultiDOFJointTrajectory, one message: a point per sample
``/NAME/path``            nav_msgs/Path, one message, for looking at
``/NAME/cmd_full_state``  crazyflie_interfaces/FullState, one message per sample, to be streamed

Feed-forward: accelerations of the trajectory are the drone's own, ``a``. Those of the full states
are ``a_ff = a - F / m`` with the cable's force F on the drone, since the controllers that take them
(Mellinger's among them) add gravity and know no cable; attitude and body rates are those of the
thrust ``m (a_ff + g ẑ)``.

Attitudes follow from differential flatness: the body's z axis is along the thrust ``a_ff + g ẑ``
(over the mass), its x axis in the vertical plane of the heading. With the thrust's derivative
``j_ff`` of constant heading, the rates about the body's axes follow [rad/s]. The frame's z axis
must point up.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from hitchopt.exports.export_options import ROS_DISTROS, STORAGES
from hitchopt.exports.formats.file_reading import needed
from hitchopt.exports.formats.format import Candidate, Format, Task
from hitchopt.exports.formats.ros2_messages import FRAMES, Messages, bag_recording
from hitchopt.exports.recording import Recording
from hitchopt.hitch import GRAVITY
from hitchopt.motion.states import States, iterate_states, sample_times, states_at
from hitchopt.storage.atomic import Writer
from hitchopt.values import Array

STEP = 1e-4
"""Step of the pull's central difference [s]: its second derivative errs by 1e-8 of itself."""


STEM = "setpoints"

METADATA = "metadata.yaml"

BLOCK = 20_000
"""Setpoints that are held at once."""

FRAME_IDS = {frame: name for name, frame in FRAMES.items() if frame != "ned"}
"""Names of fixed frames: REP 105 has ``map``, which is east-north-up by REP 103."""


@dataclass(frozen=True, eq=False)
class Attitudes:
    """Attitudes at S times of D drones.

    Attributes
    ----------
    quaternions: (S, D, 4), x, y, z, w: from the body's axes to the frame's.
    rates: (S, D, 3) [rad/s], about the body's axes.
    """

    quaternions: Array
    rates: Array


def attitudes_of(task: Task, states: States) -> Attitudes:
    """Return the drones' attitudes and rates in the file's frame."""
    frame, t = task.frame, states.t
    upward = np.array([0.0, 0.0, GRAVITY])
    specific = frame.vectors(states.accelerations) - task.pulls(states) + upward
    before = np.maximum(t - STEP, 0.0)
    after = np.minimum(t + STEP, task.motion.duration)
    pulls = [task.pulls(states_at(task.motion, at)) for at in (before, after)]
    change = (pulls[1] - pulls[0]) / (after - before)[:, None, None]
    jerk = frame.vectors(states.jerks) - change
    size = np.linalg.norm(specific, axis=-1, keepdims=True)
    z = specific / size
    left = np.array([-np.sin(frame.heading), np.cos(frame.heading), 0.0])
    x = np.cross(left, z)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    y = np.cross(z, x)
    turning = (jerk - np.sum(jerk * z, axis=-1, keepdims=True) * z) / size  # the rate of z
    roll, pitch = -np.sum(turning * y, axis=-1), np.sum(turning * x, axis=-1)
    # Constant heading: x stays normal to `left`, so ω_z (y·left) = ω_y (z·left).
    yaw = pitch * (z @ left) / (y @ left)
    axes = np.stack([x, y, z], axis=-1)
    flat = Rotation.from_matrix(axes.reshape(-1, 3, 3)).as_quat(canonical=True)
    quaternions = np.asarray(flat, dtype=np.float64).reshape(*axes.shape[:-2], 4)
    return Attitudes(quaternions, np.stack([roll, pitch, yaw], axis=-1))


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
        blocks.append(np.stack([positions, velocities, own]))
        flown = (positions, attitudes.quaternions, velocities, attitudes.rates, forward)
        for s, t in enumerate(states.t.tolist()):
            for d, topic in enumerate(topics):
                messages.write(bag, topic, t, messages.full_state(t, *(v[s, d] for v in flown)))
    table = np.concatenate(blocks, axis=1)  # a trajectory is one message of all samples
    for d, name in enumerate(task.names):
        topic = messages.connection(bag, f"/{name}/trajectory", messages.TRAJECTORY)
        trajectory = messages.trajectory(name, times, table[:, :, d], task.frame.heading)
        messages.write(bag, topic, 0.0, trajectory)
        topic = messages.connection(bag, f"/{name}/path", messages.PATH)
        messages.write(bag, topic, 0.0, messages.path(times, table[0, :, d], task.frame.heading))
