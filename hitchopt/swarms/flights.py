"""Flights of single drones next to teams with cables."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hitchopt.checks.downwash import moves
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.requirements import Limits, Prism, Requirements
from hitchopt.motion.motion import Motion, Phase
from hitchopt.objects import Slab, SolidObject
from hitchopt.objects.placing import in_world
from hitchopt.planners.task import StepPlan, StepTask
from hitchopt.swarms.separate import SeparatedCurves
from hitchopt.swarms.task import SeparationTask
from hitchopt.values import Array

LIMIT_SHARE = 1.0 - 1e-6
"""Usable fraction of the limits of thrust and tilt, as a margin for rounding."""

CIRCLE_CORNERS = 24  # Number of corners of the polygon around a circle
MIN_PRISM_HEIGHT = 1e-3  # [m] Height of the prism around a rim


def separated_flight(task: StepTask, goal: Array, duration: float | None, name: str) -> StepPlan:
    """Return the flight of single drones to goals (N, 3) [m], as one phase.

    Drones stay out of each other's downwash, and of prisms around objects. Raises InfeasibleError
    with the violated limits, locations and times.

    Parameters
    ----------
    duration: prescribed duration [s]; None for as fast as possible.
    name: of the phase.
    """
    requirements = task.requirements
    team = task.before.team
    named_prisms = list(_named_prisms(requirements, team))
    keep_out = tuple(prism for _, prism in named_prisms)
    separation_task = SeparationTask(
        task.before.drones,
        goal,
        replace(requirements, keep_out=keep_out, objects={}),
        duration=duration,
        acceleration=flyable_accelerations(team, requirements.limits),
        names=team.drone_names,
        prisms=tuple(name for name, _ in named_prisms),
    )
    separated = SeparatedCurves(separation_task).solve(task.progress)
    drones = separated.drones
    phase = Phase(name, task.index, 0.0, drones.duration, separated.remark)
    motion = Motion.single(team, requirements, drones, (phase,))
    return StepPlan(motion, replace(task.before, drones=goal))


def _named_prisms(requirements: Requirements, team: Team) -> Iterator[tuple[str, Prism]]:
    """Yield the prisms that drones of a team stay out of, also around objects, and their names.

    Above objects that their downwash moves they keep their ellipsoids' height.
    """
    for k, prism in enumerate(requirements.keep_out):
        yield f"prism {k}", prism
    separation = requirements.separation
    for name, body in requirements.objects.items():
        rise = separation.height - separation.radius if moves(body, team) else 0.0
        for slab in body.slabs:
            yield name, _prism_around(body, slab, rise)


def _prism_around(body: SolidObject, slab: Slab, rise: float) -> Prism:
    """Return a prism that contains a slab of an object, in world coordinates.

    Its ceiling is higher by ``rise`` [m]: drones that keep off it by ``radius`` keep the lower half
    of their ellipsoids off the slab if ``rise`` is ``height`` less ``radius``.
    """
    corners = slab.section.core
    if slab.section.radius is not None:
        angles = -2.0 * np.pi / CIRCLE_CORNERS * np.arange(CIRCLE_CORNERS)
        radius = slab.section.radius / np.cos(np.pi / CIRCLE_CORNERS)
        corners = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    placed = in_world(body.pose, np.column_stack([corners, np.zeros(len(corners))]))
    lower = body.at[2] + slab.lower
    upper = body.at[2] + slab.upper + max(rise, 0.0)
    return Prism(placed[:, :2], min(lower, upper - MIN_PRISM_HEIGHT), upper)


def flyable_accelerations(team: Team, limits: Limits) -> Array:
    """Return the accelerations (N,) [m/s²] that drones can reach in all directions."""
    vertical = team.max_thrust / team.mass - GRAVITY
    horizontal = GRAVITY * math.sin(limits.tilt)
    feasible = LIMIT_SHARE * np.minimum(vertical, horizontal)
    return np.minimum(feasible, limits.with_reserve.acceleration)
