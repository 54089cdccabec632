"""A rival: toppra used naively, boxes on the coordinates of drones along the straight way.

``JointVelocityConstraint`` and ``JointAccelerationConstraint`` over all x and y; a box within the
norm's ball (limit / √2), so that it keeps speed and acceleration. Vertices ride along as
coordinates with their own speed. It knows no jerk, tilt, thrust or distance.
"""

from __future__ import annotations

import logging

import numpy as np
import toppra
from numpy.typing import NDArray
from toppra import algorithm, constraint

from benchmarks.rival import RivalError, Solution
from benchmarks.samples import Samples
from benchmarks.tasks import Task
from hitchopt.planners.path.shape_path import ShapePath, drones_along

Array = NDArray[np.float64]

WAYPOINTS = 31
GRID = 201
STEP = 1e-4
"""[s] Over which accelerations are compared to tell the jerk: they jump."""

FREE = 1e3
"""[m/s²] On vertices, whose acceleration is not limited."""


def solve_toppra(task: Task) -> Solution:
    """Return toppra's solution.

    Raises
    ------
    RivalError: toppra finds none.
    """
    logging.getLogger("toppra").setLevel(logging.CRITICAL)
    n, limits = task.robots, task.limits
    s = np.linspace(0.0, 1.0, WAYPOINTS)
    path = ShapePath.straight(task.start, task.end)
    drones = drones_along(path, s).positions[..., :2, 0].reshape(WAYPOINTS, -1)
    vertices = path.flat(s).vertices[:, :, :2, 0].reshape(WAYPOINTS, -1)
    curve = toppra.SplineInterpolator(s, np.hstack([drones, vertices]))
    counts = [4 * n, 2 * n]
    speed = np.repeat([limits.speed, limits.vertex_speed], counts) / np.sqrt(2.0)
    acceleration = np.repeat([limits.acceleration / np.sqrt(2.0), FREE], counts)
    boxes = [
        constraint.JointVelocityConstraint(np.column_stack([-speed, speed])),
        constraint.JointAccelerationConstraint(np.column_stack([-acceleration, acceleration])),
    ]
    trajectory = algorithm.TOPPRA(
        boxes,
        curve,
        gridpoints=np.linspace(0.0, 1.0, GRID),
        parametrizer="ParametrizeConstAccel",
    ).compute_trajectory(0.0, 0.0)
    if trajectory is None:
        raise RivalError("toppra returns None")
    duration = float(trajectory.duration)

    def level(values: Array, altitude: float) -> Array:
        points = values.reshape(len(values), -1, 2)
        return np.concatenate([points, np.full((*points.shape[:2], 1), altitude)], axis=2)

    def sample(t: Array) -> Samples:
        orders = [trajectory(np.minimum(t, duration), order) for order in range(3)]
        later = trajectory(np.minimum(t + STEP, duration), 2)
        jerk = (later - orders[2]) / STEP
        altitude = task.start.altitude
        v, a, j = (level(values[:, : 4 * n], 0.0) for values in (orders[1], orders[2], jerk))
        x, p = (level(part, altitude) for part in np.split(orders[0], [4 * n], axis=1))
        return Samples(x, v, a, j, p, level(orders[1][:, 4 * n :], 0.0))

    return Solution(duration, sample)
