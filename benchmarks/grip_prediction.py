"""The grip in which a plan holds an object, predicted from its history at the clasps."""

from __future__ import annotations

import numpy as np

from benchmarks.grip_history import GripHistory, LoadedGrip
from hitchopt.hitch import GRAVITY
from hitchopt.plan import Plan
from hitchopt.simulation.flight_task import Task
from hitchopt.values import Array

PARTS = 16
"""Parts in which the weight passes to the clasps of a prediction."""


def held_grip(
    plan: Plan, task: Task, tied: float, clasp_friction: float, thickness: float
) -> LoadedGrip:
    """Return the state of a grip while it holds, by its history at the clasps.

    Parameters
    ----------
    plan: whose steps are grasp, lift and hold, in this order, with one tension.
    task: the plan as it is simulated.
    tied: radius [m] of the hitch that comes around the object.
    clasp_friction: coefficient of cables on each other.
    thickness: of cables [m].
    """
    grasp, lift, hold = (
        next(each for each in plan.motion.phases if each.name == name)
        for name in ("grasp", "lift", "hold")
    )
    held = task.index(lift.start)
    places = task.vertices[held]
    level = places[:, 2].mean() - task.cargo.poses[held, 0, 2]
    away = np.max(np.linalg.norm(task.vertices - places, axis=-1), axis=-1)
    there = (task.t >= grasp.start) & (away < 1e-3)
    lifting = np.flatnonzero((task.t >= lift.start) & (task.t <= hold.start))
    borne = task.cargo.borne[lifting, 0]
    parts = [lifting[np.argmax(borne >= i / PARTS)] for i in range(1, PARTS)]
    body = task.cargo.objects["held"]
    tension = float(plan.at(hold.start).tensions[0])
    history = GripHistory(body.section, tension, clasp_friction, 0.01, thickness)
    near = (1.0 + thickness / tied) * (places - task.cargo.poses[held, 0, :3])[:, :2]
    closed = history.closed(_drones(task, int(np.argmax(there)), level), near)
    drones = [_drones(task, int(i), level) for i in (*parts, task.index(hold.start + 0.1))]
    return history.lifted(closed, drones, GRAVITY * body.mass)


def _drones(task: Task, index: int, level: float) -> Array:
    """Return drones (n, 2, 3) [m] about the object, above the plane where cables meet it."""
    base = task.cargo.poses[index, 0, :3] + [0.0, 0.0, level]
    drones: Array = task.setpoints.positions[index].reshape(-1, 2, 3) - base
    return drones
