"""A problem to a certified plan: one loop over its steps; finished ones are remembered."""

from __future__ import annotations

import hashlib
import math
import pickle
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace

import numpy as np

from hitchopt.checks import certify, merged
from hitchopt.checks.registry import RULE_OF
from hitchopt.errors import HitchoptError, InfeasibleError, Progress, TimeLimitError, Violation
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.flight_controller import CONTROLLERS, FlightController
from hitchopt.hitch.requirements import Prism, Requirements
from hitchopt.hitch.team import Assignment
from hitchopt.mission.problem import DronesStart, HitchStart, Problem, SwarmProblem
from hitchopt.motion.motion import Motion, Phase, joined_motions
from hitchopt.objects import Slab, SolidObject
from hitchopt.objects.placing import in_world
from hitchopt.steps import FollowVertex, Form, Step
from hitchopt.steps.carrying import PAST, TransportObject
from hitchopt.steps.certified_motions import (
    Certified,
    check_above_ground,
    check_at_rest,
    check_start,
    infeasible,
    plan_blended,
    split_hitch,
)
from hitchopt.steps.step import RestState, StepPlan, StepTask
from hitchopt.values import Array

AT_START, UNPLANNED = "at the start (t = 0)", "not looked at yet: steps "


WIDENED = frozenset(
    {"separation", "cable_clearance", "crossing", "legs", "arena", "keep_out", "object_clearance"}
)
"""Checks of distances that planners keep wider by ``limits.tracking``."""


@contextmanager
def _naming_tracking(requirements: Requirements) -> Iterator[None]:
    """Let errors say that drones which may be off need the distances that bind."""
    try:
        yield
    except TimeLimitError:
        raise
    except InfeasibleError as error:
        if not (off := requirements.limits.tracking):
            raise
        advice = f"let drones be off by less: limits.tracking of {off:.3g} m widens this distance"
        violations = [
            replace(each, remedy=_remedy(each, advice)) if each.constraint in WIDENED else each
            for each in error.violations
        ]
        raise InfeasibleError(violations, error.note) from None


def check_controllers(team: Team) -> None:
    """Raise InfeasibleError unless named flight controllers can hold the cables' tension.

    Without feed-forward drones give way, and an integral drives them back whatever the tension.
    """
    unfed = [kind.loop for kind in team.quadrotor if kind.loop.name and not kind.loop.feed_forward]
    if not unfed:
        return
    names = [name for name, fed in zip(team.drone_names, team.feed_forward, strict=True) if not fed]
    loops = [FlightController.of(name, float(team.mass[0])) for name in CONTROLLERS]
    fit = ", ".join(loop.name for loop in loops if loop.feed_forward)
    most = float(np.min(team.mass * GRAVITY * np.tan(team.max_tilt)))
    remedy = (
        f"{unfed[0].name} ignores the accelerations that hold the tension, and holds pulls of "
        f"{most:.2g} N at most by its tilt; set team.quadrotor.controller to one of {fit}"
    )
    share = float(np.mean(team.feed_forward))
    places = (*names[:4], *(["…"] if len(names) > 4 else []))
    broken = Violation("feed_forward", share, 1.0, "min", "", places, "in all of the plan", remedy)
    raise InfeasibleError([broken])


def solve_problem(
    problem: Problem, progress: Progress | None = None, *, optimiser: bool = True
) -> Certified:
    """Return the certified plan of all steps, without an ``optimiser`` on their own routes alone.

    ``progress`` is called with what is being done now. Raises InfeasibleError: what binds, where
    and when; HitchoptError: a planner failed to find what may exist.
    """
    check_controllers(problem.team)
    with _naming_tracking(problem.requirements):
        return _solved(problem, progress, optimiser=optimiser)


def _solved(problem: Problem, progress: Progress | None, *, optimiser: bool) -> Certified:
    """Return the certified plan of all steps."""
    steps, requirements, tell = problem.mission, problem.requirements, progress or (lambda _: None)
    planned = requirements.with_reserve  # stops on the common clock may use the rest
    state, assignment = _start_state(problem, planned, tell)
    start, parts, motions = state.hitch, list[StepPlan](), list[Motion]()
    for first, group in _groups(steps):
        tell(f"planning step {first} ({group[0].name}), {first} of {len(steps)} done")
        if isinstance(group[0], Form):
            state = state.regrouped(problem.rings[first])
        task = StepTask(state, first, state.at_objects(planned), optimiser)
        try:
            part = _step(group, task, tell)
        except TimeLimitError:
            raise
        except HitchoptError as error:
            if first == 0 and start is not None:
                check_at_rest(start, planned, AT_START)
            if not isinstance(error, InfeasibleError):
                raise
            broken = _in_step(error, first, group)
            rest = range(first + len(group), len(steps))
            later = (
                f"{UNPLANNED}{', '.join(f'{i} ({steps[i].name})' for i in rest)}" if rest else ""
            )
            raise InfeasibleError(broken.violations, f"{broken.note}\n{later}".strip()) from None
        parts.append(part)
        motions.append(state.with_waiting(part.motion, planned))
        state = part.after
    motion = joined_motions(motions)
    motion = replace(motion, requirements=requirements, assignment=assignment)
    certificate = merged(motion, [part.certificate for part in parts])
    if not certificate.certified:
        if start is not None:
            check_at_rest(start, planned, AT_START)
        raise _advised(Certified(motion, certificate), steps)
    if isinstance(problem.start, DronesStart):
        check_above_ground(motion)
    return Certified(motion, certificate)


CACHE_SIZE = 32
"""Capacity of the cache in steps; one of 1000 robots takes 76 MB."""

_FINISHED: dict[bytes, StepPlan] = {}
"""Plans of steps by the digests of all that they depend on, the least recently used first."""


def forget() -> None:
    """Clear the cache of steps planned in this process."""
    _FINISHED.clear()


def contents(value: object) -> object:
    """Return the contents of a request in built-in types; two print alike only if equal."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.strides, value.tobytes()
    if is_dataclass(value):
        return type(value), [contents(getattr(value, each.name)) for each in fields(value)]
    if isinstance(value, Mapping):
        return [(key, contents(each)) for key, each in value.items()]
    if isinstance(value, (tuple, list)):
        return type(value), [contents(each) for each in value]
    return value if isinstance(value, (str, int, float, type(None))) else pickle.dumps(value)


def _start_state(
    problem: Problem, requirements: Requirements, tell: Progress
) -> tuple[RestState, Assignment | None]:
    """Return where a mission starts; from free cables, with the robots' roles for all of it."""
    team, start = problem.team, problem.start
    whole = team if problem.changes else None
    if isinstance(start, Hitch):
        return replace(RestState.formed(start), whole=whole), None
    if isinstance(start, HitchStart):
        tell("splitting the slack at the start")
        hitch = split_hitch(team, start.polygon, start.altitude, start.legs, requirements)
        return replace(RestState.formed(hitch), whole=whole), None
    named = RestState(team, start.drones, whole=whole)  # drones have the file's names
    check_start(StepTask(named, 0, requirements))
    assignment = Assignment.fixed(team.robots)
    form = next((step for step in problem.mission if isinstance(step, Form)), None)
    if whole is not None:
        return named, None
    if form is not None and form.assign == "auto":
        tell("assigning robots to edges")
        from hitchopt.planners.forming.approach import assign_robots

        assignment = assign_robots(team, start.drones, form.polygon, requirements.limits.leg)
    return RestState(assignment.team(team), assignment.drones(start.drones)), assignment


def _step(group: tuple[Step, ...], task: StepTask, tell: Progress) -> StepPlan:
    """Return the certified plan of steps without a stop, from the cache if nothing differs."""
    key = hashlib.sha256(repr(contents((group, task))).encode()).digest()
    planned = _FINISHED.pop(key, None)
    if planned is None:
        planned = group[0].plan(task) if len(group) == 1 else plan_blended(group, task)
        tell(f"certifying step {task.index} ({group[0].name})")
        _ = planned.certificate  # is kept with the plan
    else:
        tell("reused from cache")
    _FINISHED[key] = planned  # as the one used last
    if len(_FINISHED) > CACHE_SIZE:
        del _FINISHED[next(iter(_FINISHED))]
    return planned


def _groups(steps: Sequence[Step]) -> Iterator[tuple[int, tuple[Step, ...]]]:
    """Yield the steps that follow one another without a stop, with the first one's index."""
    first = 0
    for i, step in enumerate(steps):
        if not step.blends:
            yield first, tuple(steps[first : i + 1])
            first = i + 1


def _in_step(error: InfeasibleError, first: int, group: Sequence[Step]) -> InfeasibleError:
    """Return the error with the step named as the file has it, wherever it happens."""
    names = " and ".join(f"{i} ({step.name})" for i, step in enumerate(group, first))
    violations = []
    for violation in error.violations:
        when = violation.when
        if len(group) == 1:  # parts of a step have names of their own
            when = re.sub(rf"step {first} \(\w+\)", f"step {names}", when)
        if f"step {first}" not in when and "end of step" not in when:
            when = f"{when} of step {names}".strip()
        remedy = _remedy(violation, "leave out blend" * (len(group) > 1))
        violations.append(replace(violation, when=when, remedy=remedy))
    return InfeasibleError(violations, error.note)


def _advised(certified: Certified, steps: Sequence[Step]) -> InfeasibleError:
    """Return the error of a failed certificate; of blended steps it suggests a stop."""
    error = infeasible(certified.certificate, certified.motion)
    violations = []
    for violation, check in zip(error.violations, certified.certificate.violated, strict=True):
        during = [p for p in certified.motion.phases if p.start <= check.time <= p.end]
        around = [steps[i] for p in during for i in (p.step - 1, p.step) if i >= 0]
        carried = [p.step for p in during if isinstance(steps[p.step], TransportObject)]
        blends = check.name != "duration" and any(step.blends for step in around)
        timed = any(isinstance(steps[phase.step], FollowVertex) for phase in during)
        rule = RULE_OF.get(check.name)
        longer = "give the points more time" * bool(timed and rule and rule.derivative > 0)
        advice = longer or "leave out blend" * blends
        if carried and check.name in PAST:
            key = f"mission[{carried[0]}].{TransportObject.name}"
            advice = f"raise {key}.lift, or lead it around by {key}.via"
        violations.append(replace(violation, remedy=_remedy(violation, advice)))
    return InfeasibleError(violations, error.note)


def _remedy(violation: Violation, advice: str) -> str:
    return f"{violation.remedy}, or {advice}" if advice else violation.remedy


SHARE = 1.0 - 1e-6
"""Share of the limits of thrust and tilt in use, so that rounding breaks no limit."""

CORNERS, THIN = 24, 1e-3
"""Corners of the polygon around a circle, and height of the prism around a rim [m]."""


def solve_swarm(problem: SwarmProblem, progress: Progress | None = None) -> Certified:
    """Return the plan with its certificate; ``progress`` is called with what is being done now.

    Raises InfeasibleError: what binds, where and when; no plan that breaks a limit is returned.
    """
    with _naming_tracking(problem.requirements):
        return _separated(problem, progress)


def _separated(problem: SwarmProblem, progress: Progress | None) -> Certified:
    """Return the certified plan of single drones."""
    from hitchopt.planners.separation import SeparatedFlight, SeparationTask

    longest = problem.limits.duration
    if longest is not None and problem.duration is not None and problem.duration > longest:
        remedy, asked = "lower duration, or raise limits.duration", problem.duration
        violation = Violation("duration", asked, longest, "max", "s", (), "as asked for", remedy)
        raise InfeasibleError([violation])
    planned = problem.requirements.with_reserve
    prisms = [(f"prism {k}", prism) for k, prism in enumerate(planned.keep_out)]
    for name, body in problem.objects.items():
        prisms += [(name, _prism_around(body, slab)) for slab in body.slabs]
    names, keep_out = zip(*prisms, strict=True) if prisms else ((), ())
    task = SeparationTask(
        problem.start,
        problem.goal,
        replace(planned, keep_out=keep_out, objects={}),
        duration=problem.duration,
        acceleration=flyable_accelerations(problem),
        names=problem.team.drone_names,
        prisms=names,
    )
    separated = SeparatedFlight(task).solve(progress)
    phase = Phase("fly", 0, 0.0, separated.drones.duration, separated.remark)
    motion = Motion.single(problem.team, problem.requirements, separated.drones, (phase,))
    certificate = certify(motion, progress and (lambda name: progress(f"certifying {name}")))
    if not certificate.certified:
        raise infeasible(certificate, motion)
    return Certified(motion, certificate)


def _prism_around(body: SolidObject, slab: Slab) -> Prism:
    """Return a prism that holds a slab of an object, where it stands."""
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

    Raises InfeasibleError for one that cannot even hover.
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
    limits = problem.requirements.limits
    level = GRAVITY * math.sin(limits.tilt)  # what leans the thrust by the tilt at most
    return np.minimum(SHARE * np.minimum(spare, level), limits.with_reserve.acceleration)
