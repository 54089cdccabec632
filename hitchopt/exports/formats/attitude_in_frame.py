"""Attitudes and body rates of drones in a file's frame.

The body's z axis is along the thrust ``m (a_ff + g ẑ)``, its yaw is the frame's heading. In a frame
whose z axis points down the body's axes are forward, right, down, as its readers expect; in others
forward, left, up.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hitchopt.exports.formats.format import Task
from hitchopt.model.evaluation import Attitudes, attitudes
from hitchopt.motion.states import States
from hitchopt.values import Array

FLIPPED = np.array([1.0, -1.0, -1.0])
"""Signs of axes that are turned by 180° about x."""


def attitudes_of(task: Task, states: States) -> Attitudes:
    """Return the drones' attitudes and rates in the file's frame.

    Where set points hold the tension, they belong to what is fed forward, as everywhere: no cable
    force; the position loop tilts drones by what pulls.
    """
    frame, team = task.frame, task.motion.team
    if task.options.hold_tension:
        nothing = np.zeros_like(states.cable_forces)
        states = replace(states, cable_forces=nothing, cable_force_rates=nothing)
    thrusts = frame.vectors(states.thrusts(team))
    rates = frame.vectors(states.thrust_rates(team))
    if frame.vectors(np.array([0.0, 0.0, 1.0]))[2] > 0.0:
        return attitudes(thrusts, rates, frame.heading)
    found = attitudes(thrusts * FLIPPED, rates * FLIPPED, -frame.heading)
    return Attitudes(found.quaternions * [1.0, *FLIPPED], found.body_rates * FLIPPED)


def angular_velocities(found: Attitudes) -> Array:
    """Return the body rates (…, 3) [rad/s] about the file's axes instead of the body's."""
    w, v = found.quaternions[..., :1], found.quaternions[..., 1:]
    once = np.cross(v, found.body_rates)
    turned: Array = found.body_rates + 2.0 * (w * once + np.cross(v, once))
    return turned
