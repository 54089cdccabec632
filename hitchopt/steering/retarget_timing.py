"""Durations of a retarget: a brake that keeps all limits, then the shortest shift that does."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hitchopt.hitch import GRAVITY
from hitchopt.requirements import Limits
from hitchopt.steering.retarget_path import RetargetPath
from hitchopt.steering.smooth_change import PEAK_ACCELERATION, PEAK_JERK, PEAK_SPEED
from hitchopt.values import Array

WAITS = (0.0, 0.05, 0.1, 0.2, 0.4)
"""[s] How long the old plan is flown on where a retarget cannot begin at once."""

BRAKES = (0.3, 0.45, 0.7, 1.0, 1.5, 2.2, 3.2)
"""[s] Durations of the brake that are tried."""

BRAKE_SHARES, SHARE = (0.85, 0.95), 0.99
"""Shares of the limits that are used at samples, by the brake alone (the larger one where no brake
keeps the smaller) and by the whole; the rest is for what is between samples."""

BRAKE_SAMPLES, SAMPLES = 8, 16
"""Number of times at which the limits are looked at, besides those at which the jerk jumps."""

AFTER = 1e-6
"""Share of a duration before its end at which one-sided derivatives are taken."""

PLACES = np.linspace(0.0, 1.0, SAMPLES, endpoint=False)
BRAKE_PLACES = np.append(np.linspace(0.0, 1.0, BRAKE_SAMPLES, endpoint=False), 1.0 - AFTER)
"""Those times over the duration, of the whole and of a brake."""

SHORTEST = 0.3
"""[s] Shortest shift."""

ROUNDS = 8
"""Maximum number of times that a shift is prolonged."""

GROWTH = 1.04
"""Least factor by which it is."""

ROUNDING = 1e-6
"""Relative difference of durations that rounding may make of equal states."""


def turning_slowly(limits: Limits) -> Limits:
    """Return limits whose jerk is at most what turns a hovering drone at ``body_rate``."""
    if limits.body_rate is None:
        return limits
    return replace(limits, jerk=min(limits.jerk, GRAVITY * limits.body_rate))


def excess(path: RetargetPath, limits: Limits, t: Array, brake: float, shift: float) -> float:
    """Return how many times slower a motion would have to be at its samples, at most.

    Exact for speed, acceleration and jerk; thrust and tilt, which do not scale, count by the square
    root of their share of the limit. At t = 0 the state is given: there only the jerk counts.

    Parameters
    ----------
    t: (J,) times [s], the first one 0.
    brake, shift: durations [s].
    """
    found = path.jets(t, brake, shift)
    x, thrust = found.drones, found.thrusts
    squared = np.einsum("jdxk,jdxk->kjd", x, x)
    jerk = math.sqrt(float(np.max(squared[3]))) / limits.jerk
    speed = math.sqrt(float(np.max(squared[1, 1:]))) / limits.speed
    acceleration = math.sqrt(float(np.max(squared[2, 1:]))) / limits.acceleration
    vertices = found.vertices[1:, ..., 1]
    vertex = float(np.max(np.einsum("jdx,jdx->jd", vertices, vertices)))
    vertex = math.sqrt(vertex) / limits.vertex_speed
    level2 = thrust[1:, :, 0] ** 2 + thrust[1:, :, 1] ** 2
    up = thrust[1:, :, 2]
    force = float(np.max(np.sqrt(level2 + up * up) / path.team.max_thrust))
    lean = float(np.max(np.arctan2(np.sqrt(level2), up))) / limits.tilt
    most = max(speed, vertex, math.sqrt(max(acceleration, force, lean)), float(np.cbrt(jerk)))
    return most if math.isfinite(most) else math.inf


def brakes(still: RetargetPath, limits: Limits, most: int) -> list[float]:
    """Return the durations [s] of BRAKES in which the state comes to rest within the limits.

    Parameters
    ----------
    still: a path from the state that does not turn; where it leads makes no difference.
    most: number of durations that will do.
    """
    if not still.state.moves:
        return [BRAKES[0]]
    first: list[float] = []
    left: list[float] = []
    for brake in BRAKES:
        if len(first) == most:
            break
        found = excess(still, limits, brake * BRAKE_PLACES, brake, math.inf)
        if found <= BRAKE_SHARES[0]:
            first.append(brake)
        elif found <= BRAKE_SHARES[1]:
            left.append(brake)
    return (first + left)[:most]


def shortest_shift(path: RetargetPath, limits: Limits, brake: float) -> float | None:
    """Return the duration [s] of a shift that keeps all limits at samples, or None."""
    far = path.farthest(brake)
    if not math.isfinite(far):
        return None
    shift = max(
        PEAK_SPEED * far / limits.speed,
        math.sqrt(PEAK_ACCELERATION * far / limits.acceleration),
        float(np.cbrt(PEAK_JERK * far / limits.jerk)),
        SHORTEST,
    )
    for _ in range(ROUNDS):
        last = (brake * (1.0 - AFTER), shift * (1.0 - AFTER))
        times = np.concatenate([max(shift, brake) * PLACES, last])
        found = excess(path, limits, times, brake, shift)
        if found <= SHARE * (1.0 + ROUNDING):  # a prolonged shift often just keeps it
            return shift
        if not math.isfinite(found):
            return None
        shift *= max(found / SHARE, GROWTH)
    return None
