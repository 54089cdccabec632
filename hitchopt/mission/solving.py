"""Planning of a problem, step by step, certified as a whole."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace

from hitchopt.checks import Certificate, merged
from hitchopt.checks.bounds.shared_values import shared_values
from hitchopt.errors import (
    HitchoptError,
    InfeasibleError,
    InputError,
    TimeLimitError,
    Violation,
)
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.assignment import Assignment
from hitchopt.mission.memory import Progress, remembered
from hitchopt.mission.problem import DronesStart, Problem, Start
from hitchopt.motion.motion import Motion, joined_motions
from hitchopt.requirements import Requirements
from hitchopt.steps import Form, Step
from hitchopt.steps.certified_motions import (
    Certified,
    certified,
    check_at_rest,
    infeasible,
    seems_to_rest,
)
from hitchopt.steps.end_hitch import split_hitch
from hitchopt.steps.free_cables import check_above_ground, check_start
from hitchopt.steps.situation import Situation, StepTask

AT_START = "at the start (t = 0)"


def solve_problem(
    problem: Problem, progress: Progress | None = None, *, optimiser: bool = True
) -> Certified:
    """Return the plan of all steps with its certificate.

    Parameters
    ----------
    problem: what is to be flown.
    progress: called with what is being done now.
    optimiser: try optimised routes too; without them steps take their own route or none.

    Raises
    ------
    InfeasibleError: what binds, where and when; no plan that breaks a limit is returned.
    HitchoptError: a planner failed to find what may exist, and says so.
    """
    # The certificates of a single step and of the plan need the same values, if no other step's.
    with shared_values() if len(problem.mission) == 1 else nullcontext():
        return _solved(
            progress, problem.team, problem.start, problem.mission, problem.requirements, optimiser
        )


@remembered
def _solved(
    progress: Progress | None,
    team: Team,
    start: Start,
    steps: tuple[Step, ...],
    requirements: Requirements,
    optimiser: bool,
) -> Certified:
    planned = requirements.planned  # stops on the common clock may use the rest
    first_form = next((step for step in steps if isinstance(step, Form)), None)
    begun = _begun(progress, team, start, first_form, planned)
    situation = begun.situation
    parts: list[Certified] = []
    groups = list(_groups(steps))
    step_of = _step if len(groups) > 1 else _only_step
    for first, group in groups:
        _tell(progress, f"planning step {first} ({group[0].name}), {first} of {len(steps)} done")
        here = situation.at_objects(planned)
        try:
            part, situation = step_of(progress, group, StepTask(situation, first, here, optimiser))
        except TimeLimitError:
            raise
        except HitchoptError as error:
            if first == 0 and situation.hitch is not None:
                check_at_rest(situation.hitch, planned, AT_START)
            if not isinstance(error, InfeasibleError):
                raise
            raise _in_step(error, first, group) from None
        parts.append(part)
    motion = joined_motions([part.motion for part in parts])
    if motion.requirements is not requirements:
        motion = replace(motion, requirements=requirements)
    certificate = merged(motion, [part.certificate for part in parts])
    if not certificate.certified:
        broken = infeasible(certificate, motion)
        raise _advised(broken, certificate, motion, steps)
    if isinstance(start, DronesStart):
        check_above_ground(motion)
    return Certified(replace(motion, assignment=begun.assignment), certificate)


@dataclass(frozen=True, eq=False)
class _Begun:
    """Where a mission starts; from free cables, with the robots' roles for all of the plan."""

    situation: Situation
    assignment: Assignment | None = None


@remembered
def _begun(
    progress: Progress | None,
    team: Team,
    start: Start,
    form: Form | None,
    requirements: Requirements,
) -> _Begun:
    """Return where a mission starts, ``form`` being the first step that forms a hitch."""
    if not isinstance(start, DronesStart):
        if isinstance(start, Hitch):
            hitch = start
        else:
            _tell(progress, "splitting the slack at the start")
            hitch = split_hitch(team, start.polygon, start.altitude, start.legs, requirements)
        if not seems_to_rest(hitch, requirements):
            check_at_rest(hitch, requirements, AT_START)
        return _Begun(Situation.formed(hitch))
    named = Situation(team, start.drones)  # drones have the file's names
    check_start(StepTask(named, 0, requirements))
    assignment = Assignment.fixed(team.robots)
    if form is not None and form.assign == "auto":
        from hitchopt.planners.forming.assigning import assigned

        _tell(progress, "assigning robots to edges")
        assignment = assigned(team, start.drones, form.polygon, requirements.limits.leg)
    return _Begun(Situation(assignment.team(team), assignment.drones(start.drones)), assignment)


def _new_step(
    progress: Progress | None, group: tuple[Step, ...], task: StepTask
) -> tuple[Certified, Situation]:
    """Return the certified motion of steps without a stop, and where it ends."""
    step = group[0]
    if len(group) == 1:
        planned = step.plan(task)
    else:
        from hitchopt.steps.blending import plan_blended

        planned = plan_blended(group, task)
    certificate = planned.certificate
    if certificate is None:
        _tell(progress, f"certifying step {task.index} ({step.name})")
        certificate = certified(planned.motion).certificate
    return Certified(planned.motion, certificate), planned.after


_step = remembered(_new_step)
_only_step = remembered(_new_step, copied=False)


def _groups(steps: Sequence[Step]) -> Iterator[tuple[int, tuple[Step, ...]]]:
    """Yield the steps that follow one another without a stop, with the first one's index."""
    group: list[Step] = []
    for i, step in enumerate(steps):
        group.append(step)
        if not step.blends:
            yield i + 1 - len(group), tuple(group)
            group = []
    if group:
        raise InputError("blend", True, "false in the last step", "leave it out: nothing follows")


def _in_step(error: InfeasibleError, first: int, group: Sequence[Step]) -> InfeasibleError:
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
    own = steps[i].advice(check)
    if own:
        return own
    blends = any(step.blends for step in steps[max(0, i - 1) : i + 1])
    return "leave out blend" if blends else ""


def _with_remedy(violation: Violation, advice: str) -> Violation:
    return replace(violation, remedy=f"{violation.remedy}, or {advice}") if advice else violation


def _tell(progress: Progress | None, message: str) -> None:
    if progress is not None:
        progress(message)
