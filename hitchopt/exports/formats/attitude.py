"""How a drone must stand and turn for its thrust to point where it must: differential flatness.

The body's z axis is along the thrust ``a_ff + g ẑ`` (over the mass), its x axis in the vertical
plane of the heading. With the thrust's derivative ``j_ff`` of constant heading, the rates about the
body's axes follow [rad/s]. Frames with z up only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.exports.formats.format import Task, pull_of
from hitchopt.hitch import GRAVITY
from hitchopt.motion.states import States, states_at

Array = NDArray[np.float64]

STEP = 1e-4
"""[s] Over which the pull is differentiated: its second derivative errs by 1e-8 of itself."""


@dataclass(frozen=True, eq=False)
class Attitudes:
    """At S times of D drones.

    Attributes
    ----------
    quaternions: (S, D, 4), x, y, z, w: from the body's axes to the frame's.
    rates: (S, D, 3) [rad/s], about the body's axes.
    """

    quaternions: Array
    rates: Array


def attitudes_of(task: Task, states: States) -> Attitudes:
    """Return how the drones stand and turn, in the file's frame."""
    room, t = task.room, states.t
    specific = room.vectors(states.accelerations) - pull_of(task, states)
    specific = specific + np.array([0.0, 0.0, GRAVITY])
    before = np.maximum(t - STEP, 0.0)
    after = np.minimum(t + STEP, task.motion.duration)
    pulls = [pull_of(task, states_at(task.motion, at)) for at in (before, after)]
    change = (pulls[1] - pulls[0]) / (after - before)[:, None, None]
    jerk = room.vectors(states.jerks) - change
    size = np.linalg.norm(specific, axis=-1, keepdims=True)
    z = specific / size
    left = np.array([-np.sin(room.heading), np.cos(room.heading), 0.0])
    x = np.cross(left, z)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    y = np.cross(z, x)
    turning = (jerk - np.sum(jerk * z, axis=-1, keepdims=True) * z) / size  # the rate of z
    roll, pitch = -np.sum(turning * y, axis=-1), np.sum(turning * x, axis=-1)
    # Constant heading: x stays normal to `left`, so ω_z (y·left) = ω_y (z·left).
    yaw = pitch * (z @ left) / (y @ left)
    axes = np.stack([x, y, z], axis=-1)
    return Attitudes(_quaternions(axes), np.stack([roll, pitch, yaw], axis=-1))


def _quaternions(axes: Array) -> Array:
    from scipy.spatial.transform import Rotation

    flat = Rotation.from_matrix(axes.reshape(-1, 3, 3)).as_quat(canonical=True)
    return np.asarray(flat, dtype=np.float64).reshape(*axes.shape[:-2], 4)
