"""Attitudes and body rates that point a drone's thrust where it must: differential flatness.

The body's z axis is along the thrust ``a_ff + g ẑ`` (over the mass), its x axis in the vertical
plane of the heading. With the thrust's derivative ``j_ff`` of constant heading, the rates about the
body's axes follow [rad/s]. The frame's z axis must point up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from hitchopt.exports.formats.format import Task
from hitchopt.hitch import GRAVITY
from hitchopt.motion.states import States, states_at
from hitchopt.values import Array

STEP = 1e-4
"""Step of the pull's central difference [s]: its second derivative errs by 1e-8 of itself."""


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
