"""Durations of a retarget: a brake that keeps all limits, then the shortest shift that does."""

from __future__ import annotations

import math

import numpy as np

from hitchopt.geometry.vectors import length
from hitchopt.model.evaluation import DroneJets, FlatJets
from hitchopt.requirements import Limits
from hitchopt.steering.retarget_path import RetargetPath
from hitchopt.steering.smooth_change import PEAK_ACCELERATION, PEAK_JERK, PEAK_SPEED
from hitchopt.values import Array

BRAKES = np.array([0.3, 0.45, 0.7, 1.0, 1.5, 2.2, 3.2])
"""[s] Durations of the brake that are tried; the shortest that keeps all limits is taken."""

BRAKE_SAMPLES, SAMPLES = 8, 20
"""Number of times at which the limits are looked at, of a brake and of the whole."""

SHARE = 0.9985
"""Share of the limits that is used at samples; the certificate bounds what is between them."""

SHORTEST = 0.3
"""[s] Shortest shift."""

ROUNDS = 10
"""Maximum number of times that a shift is prolonged."""

GROWTH = 1.01
"""Least factor by which it is."""


def excess(limits: Limits, flat: FlatJets, drones: DroneJets, most: Array) -> Array:
    """Return (J,) by how many times slower a motion would have to be at each of its samples.

    Exact for speed, acceleration and jerk; thrust and tilt, which do not scale, count by the square
    root of their share of the limit.

    Parameters
    ----------
    most: (2n,) largest thrusts [N].
    """
    x, thrust = drones.positions, drones.thrusts
    speed = np.max(length(x[..., 1]), axis=1) / limits.speed
    vertex = np.max(length(flat.vertices[..., 1]), axis=1) / limits.vertex_speed
    acceleration = np.max(length(x[..., 2]), axis=1) / limits.acceleration
    jerk = np.max(length(x[..., 3]), axis=1) / limits.jerk
    force = np.max(length(thrust) / most, axis=1)
    level = np.hypot(thrust[..., 0], thrust[..., 1])
    tilt = np.max(np.arctan2(level, thrust[..., 2]), axis=1) / limits.tilt
    rates = [speed, vertex, np.sqrt(np.maximum.reduce([acceleration, force, tilt])), np.cbrt(jerk)]
    found: Array = np.maximum.reduce(rates)
    return np.where(np.isfinite(found), found, np.inf)


def shortest_brake(path: RetargetPath, limits: Limits) -> float | None:
    """Return the first duration [s] of BRAKES in which the state comes to rest within the limits."""
    if not path.state.moves:
        return float(BRAKES[0])
    team = path.team
    times = (np.arange(BRAKE_SAMPLES) + 0.7) / BRAKE_SAMPLES
    for brake in BRAKES.tolist():
        found = excess(limits, *path.braked.drones(times * brake, brake, math.inf), team.max_thrust)
        if np.max(found) <= SHARE:
            return brake
    return None


def shortest_shift(path: RetargetPath, limits: Limits, brake: float) -> float | None:
    """Return the duration [s] of a shift that keeps all limits at samples; None if none is found."""
    ends = np.array([brake])
    whole = 1e-3 * brake  # a shift that is over at once: the drones at the goal
    goal = path.drones(ends, brake, whole)[1].positions[0, ..., 0]
    rest = path.braked.drones(ends, brake, math.inf)[1].positions[0, ..., 0]
    far = float(np.max(length(goal - rest)))
    turned = 0.5 * abs(path.yaw) * float(np.max(length(goal - goal.mean(axis=0))))
    far = max(far, turned)
    if not math.isfinite(far):
        return None
    shift = max(
        PEAK_SPEED * far / limits.speed,
        math.sqrt(PEAK_ACCELERATION * far / limits.acceleration),
        np.cbrt(PEAK_JERK * far / limits.jerk),
        SHORTEST,
    )
    for _ in range(ROUNDS):
        end = max(shift, brake)
        times = end * (np.arange(SAMPLES) + 0.5) / SAMPLES
        found = float(np.max(excess(limits, *path.drones(times, brake, shift), path.team.max_thrust)))
        if found <= SHARE:
            return shift
        if not math.isfinite(found):
            return None
        shift *= max(found / SHARE, GROWTH)
    return None
