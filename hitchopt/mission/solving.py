"""A problem to a plan, step by step, certified as a whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hitchopt.certificate import Certificate, merged
from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.assignment import Assignment
from hitchopt.mission.diagnosis import infeasible
from hitchopt.mission.ends import shared_hitch
from hitchopt.mission.form_records import Form, Land, Release
from hitchopt.mission.free_flight import check_above_ground, check_start, plan_hover, plan_land
from hitchopt.mission.motions import Certified, Kept, certified, check_at_rest
from hitchopt.mission.planning import plan_blended, plan_step
from hitchopt.mission.problem import DronesStart, Problem
from hitchopt.mission.situation import Situation, Tied
from hitchopt.mission.step_records import FollowVertex, Hold, ShapeStep, Step
from hitchopt.mission.tying import plan_form, plan_release
from hitchopt.model.motion import Motion, joined_motions
from hitchopt.planners.forming.assigning import assigned

__all__ = ["Certified", "Kept", "Progress", "solve_from_drones", "solve_problem", "solve_steps"]

Array = NDArray[np.float64]

Progress = Callable[[str], None]

RATES = ("speed", "acceleration", "jerk", "vertex_speed", "thrust", "tilt")
"""Checks that hold more easily where everything goes slower."""


def solve_problem(
    problem: Problem, progress: Progress | None = None, *, optimiser: bool = True
) -> Certified:
    """Return the plan of all steps with its certificate.

    Parameters
    ----------
    problem: what is to be flown.
    progress: called with what is being done now.
    optimiser: try optimised ways too; without them steps go their own way or not at all.

    Raises
    ------
    InfeasibleError: what binds, where and when; no plan that breaks a limit is returned.
    HitchoptError: a planner failed to find what may exist, and says so.
    """
    kept = Kept(problem.limits, problem.separation, problem.arena, optimiser)
    start = problem.start
    if isinstance(start, DronesStart):
        return solve_from_drones(problem.team, start.drones, problem.mission, kept, progress)
    _tell(progress, "sharing the start's legs")
    hitch = shared_hitch(problem.team, start.polygon, start.altitude, start.legs, kept)
    return solve_steps(hitch, problem.mission, kept, progress)


def solve_from_drones(
    team: Team,
    drones: Array,
    steps: tuple[Step, ...],
    kept: Kept,
    progress: Progress | None = None,
) -> Certified:
    """Return the plan of ``steps`` from drones on free cables; errors as solve_problem.

    The first hitch that is formed assigns robots to roles, for all of the plan.

    Parameters
    ----------
    drones: (2n, 3) [m], q0, r0, q1, … of the robots as they are given.
    """
    first = next((step for step in steps if isinstance(step, Form)), None)
    assignment = Assignment.fixed(team.robots)
    if first is not None and first.assign == "auto":
        _tell(progress, "assigning robots to edges")
        assignment = assigned(team, drones, first.polygon, kept.limits.leg)
    before = Situation(assignment.team(team), assignment.drones(drones))
    check_start(before, kept)
    found = _solved(before, steps, kept, progress)
    check_above_ground(found.motion)
    return replace(found, motion=replace(found.motion, assignment=assignment))


def solve_steps(
    start: Hitch,
    steps: tuple[Step, ...],
    kept: Kept,
    progress: Progress | None = None,
) -> Certified:
    """Return the plan of ``steps`` from a formed hitch; errors as solve_problem."""
    check_at_rest(start, kept, "at the start (t = 0)")
    return _solved(Situation.holding(start), steps, kept, progress)


def _solved(
    start: Situation, steps: tuple[Step, ...], kept: Kept, progress: Progress | None
) -> Certified:
    situation = start
    motions: list[Motion] = []
    certificates: list[Certificate] = []
    for first, group in _groups(steps):
        _tell(progress, f"planning step {first} ({group[0].name})")
        try:
            planned = _planned(situation, group, first, kept)
        except InfeasibleError as error:
            raise _in_step(error, first, group) from None
        motions.append(planned.motion)
        situation = planned.after
        if planned.certificate is None:
            _tell(progress, f"certifying step {first} ({group[0].name})")
        certificates.append(planned.certificate or certified(planned.motion).certificate)
    motion = joined_motions(motions)
    certificate = merged(motion, certificates)
    if not certificate.certified:
        broken = infeasible(certificate, kept.separation, motion.phases)
        raise _advised(broken, certificate, motion, steps)
    return Certified(motion, certificate)


def _groups(steps: Sequence[Step]) -> Iterator[tuple[int, list[Step]]]:
    """Yield the steps that follow one another without a stop, with the first one's index."""
    group: list[Step] = []
    for i, step in enumerate(steps):
        group.append(step)
        if not getattr(step, "blend", False):
            yield i + 1 - len(group), group
            group = []
    if group:
        raise InputError("blend", True, "false in the last step", "leave it out: nothing follows")


def _planned(before: Situation, group: list[Step], first: int, kept: Kept) -> Tied:
    """Return the plan of steps that follow one another without a stop; mostly there is one."""
    step = group[0]
    if isinstance(step, Form):
        return plan_form(before, step, first, kept)
    if isinstance(step, Release):
        return plan_release(before, step, first, kept)
    if isinstance(step, Land):
        return plan_land(before, step, first, kept)
    if before.hitch is None:
        if isinstance(step, Hold):
            return plan_hover(before, step.seconds, first, kept)
        raise InputError(f"mission[{first}].{step.name}", None, "given a hitch", "form one before")
    if len(group) == 1:
        planned = plan_step(before.hitch, step, first, kept)
    else:
        shapes = [step for step in group if isinstance(step, ShapeStep)]
        planned = plan_blended(before.hitch, shapes, first, kept)
    after = replace(before, hitch=planned.end, drones=planned.end.drones)
    return Tied(planned.motion, after, planned.certificate)


def _in_step(error: InfeasibleError, first: int, group: list[Step]) -> InfeasibleError:
    """Return the error with the step named wherever its words do not name it yet."""
    names = " and ".join(f"{i} ({step.name})" for i, step in enumerate(group, first))
    suffix = f"of step {names}"
    return InfeasibleError(
        [
            _with_remedy(
                v
                if f"step {first}" in v.when or "end of step" in v.when
                else replace(v, when=f"{v.when} {suffix}".strip()),
                "leave out blend" if len(group) > 1 else "",
            )
            for v in error.violations
        ],
        error.note,
    )


def _advised(
    error: InfeasibleError, certificate: Certificate, motion: Motion, steps: Sequence[Step]
) -> InfeasibleError:
    """Return the error with what can be changed in the steps in which limits are broken."""
    advised = []
    for violation, check in zip(error.violations, certificate.violated, strict=True):
        found = {
            _advice(steps, phase.step, check.name)
            for phase in motion.phases
            if phase.start <= check.time <= phase.end
        }
        advised.append(_with_remedy(violation, max(found, default="")))
    return InfeasibleError(advised, error.note)


def _advice(steps: Sequence[Step], i: int, check: str) -> str:
    if check == "duration":
        return ""
    if isinstance(steps[i], FollowVertex) and check in RATES:
        return "give the points more time"
    blends = any(getattr(step, "blend", False) for step in steps[max(0, i - 1) : i + 1])
    return "leave out blend" if blends else ""


def _with_remedy(violation: Violation, advice: str) -> Violation:
    return replace(violation, remedy=f"{violation.remedy}, or {advice}") if advice else violation


def _tell(progress: Progress | None, message: str) -> None:
    if progress is not None:
        progress(message)
