"""Planning of a problem of single drones."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hitchopt.checks import certify
from hitchopt.errors import InfeasibleError, Violation
from hitchopt.hitch import GRAVITY
from hitchopt.mission.memory import Progress, remembered
from hitchopt.mission.swarm_problem import SwarmProblem
from hitchopt.motion.motion import Motion, Phase
from hitchopt.objects import Slab, SolidObject
from hitchopt.objects.placing import in_world
from hitchopt.requirements import Prism
from hitchopt.steps.certified_motions import Certified, infeasible
from hitchopt.values import Array

SHARE = 1.0 - 1e-6
"""Share of what thrust and tilt allow that is used, so that rounding breaks no limit."""

CORNERS = 24
"""Number of corners of the polygon around a circle that the planner keeps drones out of."""

THIN = 1e-3
"""[m] Height of the prism around a rim."""


@remembered
def solve_swarm(progress: Progress | None, problem: SwarmProblem) -> Certified:
    """Return the plan with its certificate; ``progress`` is called with what is being done now.

    Raises
    ------
    InfeasibleError: what binds, where and when; no plan that breaks a limit is returned.
    """
    from hitchopt.planners.separation import SeparationTask, separate

    longest = problem.limits.duration
    if longest is not None and problem.duration is not None and problem.duration > longest:
        remedy, asked = "lower duration, or raise limits.duration", problem.duration
        found = Violation("duration", asked, longest, "max", "s", (), "as asked for", remedy)
        raise InfeasibleError([found])
    planned = problem.requirements.planned
    bodies = [(name, slab) for name, body in problem.objects.items() for slab in body.slabs]
    around = tuple(prism_around(problem.objects[name], slab) for name, slab in bodies)
    prisms = [f"prism {k}" for k in range(len(planned.keep_out))]
    task = SeparationTask(
        problem.start,
        problem.goal,
        replace(planned, keep_out=planned.keep_out + around, objects={}),
        duration=problem.duration,
        acceleration=flyable_accelerations(problem),
        names=problem.team.drone_names,
        prisms=(*prisms, *(name for name, _ in bodies)),
    )
    separated = separate(task, progress)
    phase = Phase("fly", 0, 0.0, separated.drones.duration, separated.remark)
    motion = Motion.single(problem.team, problem.requirements, separated.drones, (phase,))
    certificate = certify(motion, progress and (lambda name: progress(f"certifying {name}")))
    if not certificate.certified:
        raise infeasible(certificate, motion)
    return Certified(motion, certificate)


def prism_around(body: SolidObject, slab: Slab) -> Prism:
    """Return a prism that holds a slab of an object, where it stands.

    A circle has a polygon of CORNERS corners around it.
    """
    corners = slab.section.core
    if slab.section.radius is not None:
        angles = -2.0 * np.pi / CORNERS * np.arange(CORNERS)
        reach = slab.section.radius / np.cos(np.pi / CORNERS)
        corners = reach * np.column_stack([np.cos(angles), np.sin(angles)])
    placed = in_world(body.pose, np.column_stack([corners, np.zeros(len(corners))]))
    lower, upper = body.at[2] + slab.lower, body.at[2] + slab.upper
    return Prism(placed[:, :2], min(lower, upper - THIN), upper)


def flyable_accelerations(problem: SwarmProblem) -> Array:
    """(N,) [m/s²]: what each drone can do in any direction, by its limit, its thrust and the tilt.

    Raises
    ------
    InfeasibleError: a drone that cannot even hover.
    """
    team = problem.team
    spare = team.max_thrust / team.mass - GRAVITY
    heavy = np.flatnonzero(spare <= 0.0)
    if len(heavy):
        weights, remedy = team.mass * GRAVITY, "give the drone more thrust, or less mass"
        most, names = team.max_thrust, team.drone_names
        raise InfeasibleError(
            Violation("thrust", weights[i], most[i], "max", "N", (names[i],), "at rest", remedy)
            for i in heavy
        )
    level = GRAVITY * math.sin(problem.limits.tilt)  # what leans the thrust by the tilt at most
    return np.minimum(SHARE * np.minimum(spare, level), problem.limits.planned.acceleration)
