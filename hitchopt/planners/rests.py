"""Motions at rest: of a hitch, and of drones on free cables; and what breaks a limit there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hitchopt.checks.violations import infeasible_error
from hitchopt.errors import InfeasibleError, StepPlace, Violation
from hitchopt.hitch import Hitch
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.motion import Motion, Phase
from hitchopt.planners.stages import stage
from hitchopt.planners.task import RestState, StepPlan, StepTask, require_certified
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

IDLE = 0.01  # [s] Default duration of a step without motion


def rest_motion(hitch: Hitch, requirements: Requirements, duration: float, phase: Phase) -> Motion:
    """Return the motion of a hitch at rest for a duration [s]; the phase is retimed to it."""
    breaks = [0.0, duration]
    return Motion(
        hitch.team,
        requirements,
        drones=PiecewisePolynomial.constant(breaks, hitch.drones),
        vertices=PiecewisePolynomial.constant(breaks, hitch.vertices),
        legs=PiecewisePolynomial.constant(breaks, hitch.legs),
        tensions=PiecewisePolynomial.constant(breaks, hitch.team.tension),
        phases=(phase.retimed(0.0, duration),),
    )


def rest_plan(hitch: Hitch, requirements: Requirements) -> StepPlan:
    """Return the plan of a hitch at rest for one second."""
    motion = rest_motion(hitch, requirements, 1.0, Phase("hold", 0, 0.0, 1.0))
    return StepPlan(motion, RestState(hitch.team, hitch.drones, hitch))


def check_at_rest(
    hitch: Hitch, requirements: Requirements, when: str, step: StepPlace | None = None
) -> None:
    """Raise InfeasibleError if the hitch breaks a limit at rest, at a time in words of a step."""
    require_certified(rest_plan(hitch, requirements), when, step)


def check_hover(task: StepTask, drones: Array, when: str) -> None:
    """Raise InfeasibleError if drones (2n, 3) [m] at rest on free cables break a limit."""
    state = replace(task.before, drones=drones)
    motion = hover_motion(task.within(task.requirements, state), 1.0)
    require_certified(StepPlan(motion, state), when)


def hover_motion(task: StepTask, duration: float) -> Motion:
    """Return the motion of parked or hovering drones at rest on free cables."""
    team = task.before.team
    rest = PiecewisePolynomial.constant([0.0, duration], task.before.drones)
    motion = stage("parked", rest, team, task.requirements, task.index, CableState.GROUND)
    (phase,) = motion.phases
    if not phase.state.hangs:
        return motion
    return replace(motion, phases=(replace(phase, name="hold"),))


def check_start(task: StepTask) -> None:
    """Raise InfeasibleError if drones on free cables break a limit at the start."""
    plan = StepPlan(hover_motion(task, 1.0), task.before)
    if plan.certificate.certified:
        return
    spans = list[Violation]()
    consequences = list[Violation]()
    error = infeasible_error(plan.certificate, plan.motion, "at the start (t = 0)")
    for violation in error.violations:
        if violation.constraint == "span":
            k = int(violation.where[0].removeprefix("cable "))
            q, r = task.before.drones[2 * k : 2 * k + 2]
            distance = float(np.linalg.norm(r - q))
            remedy = (
                f"{distance:.6g} m apart on a cable of {task.before.team.cable_length[k]:.6g} m: "
                f"move q{k} and r{k} of start.drones closer together, or use a longer cable"
            )
            named = (f"robot {k}", f"q{k}", f"r{k}")
            spans.append(replace(violation, where=named, remedy=remedy))
        else:
            consequences.append(violation)
    raise InfeasibleError([*spans, *consequences])
