"""Planning of a problem of single drones."""

from __future__ import annotations

import math

import numpy as np

from hitchopt.checks import certify
from hitchopt.errors import InfeasibleError, Violation
from hitchopt.hitch import GRAVITY
from hitchopt.mission.memory import Progress, remembered
from hitchopt.mission.swarm_problem import SwarmProblem
from hitchopt.motion.motion import Motion, Phase
from hitchopt.steps.certified_motions import Certified, infeasible
from hitchopt.values import Array

SHARE = 1.0 - 1e-6
"""Share of what thrust and tilt allow that is used, so that rounding breaks no limit."""


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
    task = SeparationTask(
        problem.start,
        problem.goal,
        problem.requirements.planned,
        duration=problem.duration,
        acceleration=flyable_accelerations(problem),
        names=problem.team.drone_names,
    )
    separated = separate(task, progress)
    phase = Phase("fly", 0, 0.0, separated.drones.duration, separated.remark)
    motion = Motion.single(problem.team, problem.requirements, separated.drones, (phase,))
    certificate = certify(motion, progress and (lambda name: progress(f"certifying {name}")))
    if not certificate.certified:
        raise infeasible(certificate, motion)
    return Certified(motion, certificate)


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
