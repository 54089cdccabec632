"""The best certified motion of a step: its own where that satisfies all limits, else optimised."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from hitchopt.checks import Certificate
from hitchopt.errors import HitchoptError, InfeasibleError
from hitchopt.hitch import Hitch
from hitchopt.motion.motion import Motion, Phase
from hitchopt.planners.optimise.candidates import candidates
from hitchopt.planners.path.leading_legs import leading
from hitchopt.planners.path.leg_law import legs_clear
from hitchopt.planners.path.shape_path import ShapePath
from hitchopt.planners.timing.flight_curves import Flight
from hitchopt.planners.timing.fly_path import fly
from hitchopt.requirements import Requirements
from hitchopt.steps.certified_motions import Certified, certified, flying
from hitchopt.steps.diagnosis import infeasible


@dataclass(frozen=True, eq=False)
class RouteTask:
    """What a route planner is asked: one hitch to another, in one step of a mission.

    Attributes
    ----------
    start, end: at one altitude, both within all limits at rest.
    requirements: what the motion must satisfy.
    phase: the step's name and index, and within what tensions may change meanwhile.
    duration: exactly that long [s], or None.
    optimize: look for a faster route even where the step's own one satisfies all limits.
    optimiser: whether the optimiser may be used.
    """

    start: Hitch
    end: Hitch
    requirements: Requirements
    phase: Phase
    duration: float | None = None
    optimize: bool = False
    optimiser: bool = True


def best_motion(own: Callable[[], Motion], task: RouteTask) -> Certified:
    """Return the motion of a step: its own one, or an optimised one where that is better.

    Parameters
    ----------
    own: gives the step's own motion, straight and by its own law of the legs.
    task: what is to be flown.

    Raises
    ------
    InfeasibleError: what the step's own route breaks, no other route having been found either.
    HitchoptError: that one could not be timed, and no other route was found.
    """
    motion: Motion | None = None
    refusal: HitchoptError | None = None
    try:
        motion = own()
        if not (task.optimize or task.phase.tension is not None):
            return _sound(motion, task)
    except HitchoptError as error:
        motion, refusal = None, error
    found = _optimised(task) if task.optimiser else None
    if motion is not None and (found is None or motion.duration <= found.motion.duration):
        try:  # only now, as it is not needed where another route is faster
            return _sound(motion, task)
        except InfeasibleError as error:
            motion, refusal = None, error
    if found is None:
        raise _refused(refusal, task)
    remark = found.motion.phases[0].remark + _why(shut=motion is None)
    phases = (replace(found.motion.phases[0], remark=remark),)
    return Certified(replace(found.motion, phases=phases), found.certificate)


def _sound(motion: Motion, task: RouteTask) -> Certified:
    """Return the motion with its certificate, or raise InfeasibleError for what it breaks."""
    found = certified(motion)
    if not found.certificate.certified:
        raise infeasible(found.certificate, task.requirements.separation, motion.phases)
    return found


@dataclass(frozen=True, eq=False)
class _Passed:
    """A path that a flight has been certified along."""

    path: ShapePath
    flight: Flight
    certificate: Certificate


class _Judge:
    """Flies paths and accepts those whose certificates hold, which it collects."""

    def __init__(self, task: RouteTask) -> None:
        self.task = task
        self.passed: list[_Passed] = []

    def __call__(self, path: ShapePath) -> Flight | None:
        task = self.task
        flight = fly(path, task.requirements.limits)
        phase = replace(task.phase, end=flight.duration)
        found = certified(flying(flight, task.start.team, task.requirements, [phase]))
        if not found.certificate.certified:
            return None
        self.passed.append(_Passed(path, flight, found.certificate))
        return flight


def _optimised(task: RouteTask) -> Certified | None:
    """Return the fastest optimised motion in the step's duration; None where there is none."""
    judge = _Judge(task)
    found = candidates(task.start, task.end, task.requirements, judge, task.phase.tension)
    if not found:
        return None
    passed = next(passed for passed in judge.passed if passed.flight is found[0].flight)
    if task.optimize and passed.flight.duration > (task.duration or 0.0):
        passed = _led(passed, judge)
    flight, remark = passed.flight, f"on an optimised route, first guess {found[0].name}: "
    if task.duration is None:
        phase = replace(task.phase, end=flight.duration, remark=remark)
        return Certified(
            flying(flight, task.start.team, task.requirements, [phase]), passed.certificate
        )
    if task.duration < flight.duration:
        return None
    flight = flight.lasting(task.duration)
    phase = replace(task.phase, end=flight.duration, remark=remark)
    return certified(flying(flight, task.start.team, task.requirements, [phase]))


def _led(passed: _Passed, judge: _Judge) -> _Passed:
    """Return what has passed, or a faster flight on which legs lead and lag."""
    requirements = judge.task.requirements
    for path in leading(passed.path, requirements.limits):
        try:
            flight = judge(path) if legs_clear(path, requirements) else None
        except HitchoptError:
            continue
        if flight is not None:
            return min(passed, judge.passed[-1], key=lambda p: p.flight.duration)
    return passed


def _why(*, shut: bool) -> str:
    return "the step's own route is infeasible" if shut else "faster than the step's own route"


def _refused(refusal: HitchoptError | None, task: RouteTask) -> HitchoptError:
    if isinstance(refusal, InfeasibleError) and task.optimiser:
        return InfeasibleError(refusal.violations, _found_nothing(refusal))
    return refusal or HitchoptError("no route was found")


def _found_nothing(refusal: InfeasibleError) -> str:
    if any(violation.constraint == "duration" for violation in refusal.violations):
        return "the optimiser found no route that is fast enough either"
    return "the optimiser found no other route"
