"""Planning of a problem in one loop over its steps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from hitchopt.checks import Certificate, merged
from hitchopt.checks.certifying import with_rules
from hitchopt.checks.violations import infeasible_error
from hitchopt.drones.controllers import FlightController, of_same_firmware
from hitchopt.errors import (
    HitchoptError,
    InfeasibleError,
    Progress,
    TimeLimitError,
    Violation,
    planners_faults,
)
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import Assignment
from hitchopt.mission.advice import placed_in_step, refusal, with_tilt_advice, with_tracking_advice
from hitchopt.mission.cache import Cache, digest
from hitchopt.mission.problem import Problem, TeamMission
from hitchopt.mission.starts import HitchStart
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import Motion, concatenated
from hitchopt.planners.candidates import Effort, explained_once
from hitchopt.planners.ends import split_hitch
from hitchopt.planners.path import Path
from hitchopt.planners.rests import check_at_rest, check_start
from hitchopt.planners.task import RestState, StepPlan, StepTask
from hitchopt.planners.timing.swing import after_swing
from hitchopt.slices import hooks, provided
from hitchopt.steps.blended import plan_blended
from hitchopt.steps.hitch_step import NonstopStep
from hitchopt.steps.step import Step

AT_START = "at the start (t = 0)"  # When a limit is violated before the first step


@dataclass(frozen=True, eq=False)
class CertifiedFlight:
    """Flight of a whole plan with its certificate."""

    flight: Flight  # The flight
    certificate: Certificate  # Its certificate


@dataclass(frozen=True, eq=False)
class CertifiedMotion:
    """Motion of one team's whole plan with its certificate."""

    motion: Motion  # The motion
    certificate: Certificate  # Its certificate
    # Paths of the groups of steps; None for one that has none, or several
    paths: tuple[Path | None, ...] = ()


def check_controllers(team: Team) -> None:
    """Raise InfeasibleError unless the flight controllers have the feed-forward to hold tension.

    Without feed-forward drones yield to the pull, and an integral term returns them at any tension.
    """
    kinds = team.quadrotor
    unsuited = [kind.loop for kind in kinds if kind.loop.name and not kind.loop.feed_forward]
    if not unsuited:
        return
    pairs = zip(team.drone_names, team.feed_forward, strict=True)
    names = [name for name, feed_forward in pairs if not feed_forward]
    available = of_same_firmware(unsuited[0].name)
    loops = [FlightController.of(name, float(team.mass[0])) for name in available]
    suitable = ", ".join(loop.name for loop in loops if loop.feed_forward)
    max_tension = float(np.min(team.mass * GRAVITY * np.tan(team.max_tilt)))
    remedy = (
        f"{unsuited[0].name} ignores the accelerations that hold the tension; its tilt holds "
        f"pulls of at most {max_tension:.2g} N. Set team.quadrotor.controller to one of {suitable}"
    )
    share = float(np.mean(team.feed_forward))
    where = (*names[:4], *(["…"] if len(names) > 4 else []))
    values = share, 1.0, "min", "", where, "throughout the plan", remedy
    raise InfeasibleError([Violation("feed_forward", *values)])


def solve_problem(
    problem: Problem,
    progress: Progress | None = None,
    *,
    optimiser: bool = True,
    cache: Cache | None = None,
) -> CertifiedFlight:
    """Return the certified plan of all teams; without ``optimiser`` on direct routes only.

    ``progress`` is a status callback; ``cache`` has the steps of earlier plans. With other plans in
    the air a team may wait before each step.

    Raises InfeasibleError with the violated limits, locations and times: a team cannot fly alone,
    no start time separates it from the others, or the plan violates a custom rule. Raises
    HitchoptError if a planner failed on a problem that may be feasible.
    """
    report = progress or (lambda _: None)
    certified = _plan_teams(problem, report, cache, optimiser=optimiser)
    if not problem.rules:
        return certified
    certificate = with_rules(certified.certificate, certified.flight, problem.rules, report)
    if not certificate.certified:
        raise infeasible_error(certificate, certified.flight, rules=problem.rules)
    return replace(certified, certificate=certificate)


def _plan_teams(
    problem: Problem, report: Progress, cache: Cache | None, *, optimiser: bool
) -> CertifiedFlight:
    """Return the plan of all teams, certified for the limits of hitchopt."""
    alone = {
        name: _plan_alone(mission, report, cache, optimiser=optimiser)
        for name, mission in problem.teams.items()
    }
    if problem.others or len(alone) > 1:
        motions = {name: each.motion for name, each in alone.items()}
        scheduled: CertifiedFlight = provided("schedule")(problem, motions, report)
        return scheduled
    (only,) = alone.values()
    return CertifiedFlight(Flight.of(only.motion), only.certificate)


def route_of(problem: Problem) -> Path | None:
    """Return the path of the only step of one team's problem; None if nothing moves."""
    (mission,) = problem.teams.values()
    return _plan_alone(mission, lambda _: None, None, optimiser=True).paths[0]


def _plan_alone(
    mission: TeamMission, report: Progress, cache: Cache | None, *, optimiser: bool
) -> CertifiedMotion:
    """Return the certified plan of one team alone."""

    def report_team(status: str) -> None:
        report(f"{mission.name}: {status}" if mission.name else status)

    if mission.team.has_cables:
        check_controllers(mission.team)
    try:
        return _plan_steps(mission, report_team, cache, optimiser=optimiser)
    except TimeLimitError:
        raise
    except InfeasibleError as error:
        advised = with_tracking_advice(error, mission.requirements, mission.team)
        advised = with_tilt_advice(advised, mission.requirements, mission.team)
        raise advised.of_team(mission.name) from error


def _plan_steps(
    mission: TeamMission, report: Progress, cache: Cache | None, *, optimiser: bool
) -> CertifiedMotion:
    """Return the certified plan of all steps."""
    steps, requirements = mission.steps, mission.requirements
    with_reserve = requirements.with_reserve  # the reserve is for stops on the common clock
    state = _start_state(mission, with_reserve, report)
    start = state.hitch
    plans = list[StepPlan]()
    motions = list[Motion]()
    for first, group in _groups(steps):
        report(f"planning step {first} ({group[0].name}), {first} of {len(steps)} done")
        needed, stated = map(state.with_objects, (with_reserve, requirements))
        if motions:
            needed = after_swing(needed, concatenated(motions))
        task = StepTask(state, first, needed, optimiser, stated)
        try:
            plan = _plan_group(group, task, report, cache)
        except TimeLimitError:
            raise
        except HitchoptError as error:
            if first == 0 and start is not None:
                check_at_rest(start, with_reserve, AT_START)
            if not (isinstance(error, InfeasibleError) and mission.team.has_cables):
                raise
            named = placed_in_step(error, first, group)
            rest = [f"{i} ({step.name})" for i, step in enumerate(steps)][first + len(group) :]
            raise InfeasibleError(named.violations, named.note, rest) from error
        plans.append(plan)
        motions.append(plan.motion)
        state = plan.after
    motion = concatenated(motions)
    if motion.requirements is not requirements:
        motion = motion.replaced(requirements=requirements)
    certificate = merged(motion, [plan.certificate for plan in plans])
    if not certificate.certified:
        if start is not None:
            check_at_rest(start, with_reserve, AT_START)
        raise refusal(motion, certificate, steps)
    return CertifiedMotion(motion, certificate, tuple(plan.path for plan in plans))


def _start_state(mission: TeamMission, requirements: Requirements, report: Progress) -> RestState:
    """Return the state at the start; if cables are free, robots are assigned to edges."""
    team, start = mission.team, mission.start
    if isinstance(start, HitchStart):
        report("splitting the slack at the start")
        hitch = split_hitch(team, start.outline, start.altitude, start.split, requirements)
        return RestState(team, hitch.drones, hitch)
    if isinstance(start, Hitch):
        return RestState(team, start.drones, start)
    if not team.has_cables:
        return RestState(team, start)
    state = RestState(team, start.drones)  # with the file's order of robots
    check_start(StepTask(state, 0, requirements))
    assignment = Assignment.fixed(team.robots)
    form = mission.form
    if form is not None and not form.assigns_in_order:
        report("assigning robots to edges")
        with planners_faults():
            assignment = form.assignment(team, start.drones, requirements)
    return RestState(assignment.team(team), start.drones[assignment.drones])


def _plan_group(
    group: tuple[Step, ...], task: StepTask, report: Progress, cache: Cache | None
) -> StepPlan:
    """Return the certified plan of steps without a stop, from the cache if possible."""
    if cache is None or any(getattr(step, "cost", None) is not None for step in group):
        return _new_plan(group, task, report)
    request = digest((group, task))
    plan = cache.take(request)
    if plan is None:
        plan = _new_plan(group, task, report)
    else:
        report("reused from cache")
    cache.store(request, plan)
    return plan


def _new_plan(group: tuple[Step, ...], task: StepTask, report: Progress) -> StepPlan:
    """Return the certified plan of steps without a stop."""
    per_robot = max(step.effort_per_robot for step in group)
    effort = Effort(per_robot * task.before.team.robots)
    task = replace(task, progress=report, effort=effort)
    with planners_faults(), explained_once():
        if len(group) == 1:
            plan = group[0].plan(task)
        else:
            nonstop_steps = cast("tuple[NonstopStep, ...]", group)  # no others blend
            plan = plan_blended(nonstop_steps, task)
        # Cables slid in the last step that has the key, if a transport follows
        settling = [step.settling for step in group if "settle" in vars(step)]
        for append in hooks("after_step"):
            plan = append(plan, task, settling[-1] if settling else False)
    report(f"certifying step {task.index} ({group[0].name})")
    _ = plan.certificate  # stored with the plan
    return plan


def _groups(steps: Sequence[Step]) -> Iterator[tuple[int, tuple[Step, ...]]]:
    """Yield groups of steps without a stop in between, with the index of the first."""
    first = 0
    for i, step in enumerate(steps):
        if not step.blends:
            yield first, tuple(steps[first : i + 1])
            first = i + 1
