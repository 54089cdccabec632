"""The best certified way of a step: its own where that will do, else an optimised one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from hitchopt.certificate import Certificate, certify
from hitchopt.errors import HitchoptError, InfeasibleError
from hitchopt.hitch import Hitch
from hitchopt.mission.diagnosis import infeasible
from hitchopt.mission.motions import Kept, flying
from hitchopt.model.motion import Motion, Phase
from hitchopt.planners.flight import Flight
from hitchopt.planners.flown import fly_unhurried
from hitchopt.planners.optimise.search import Candidate, Judge, candidates
from hitchopt.planners.path import ShapePath


@dataclass(frozen=True, eq=False)
class WayTask:
    """One hitch to another, in one step of a mission.

    Attributes
    ----------
    start, end: at one altitude, both within all limits at rest.
    kept: what every step has to keep.
    phase: the step's name and index.
    duration: exactly that long [s], or None.
    optimize: look for a faster way even where the step's own one will do.
    tension: smallest and largest [N] where tensions may change on the way.
    """

    start: Hitch
    end: Hitch
    kept: Kept
    phase: Phase
    duration: float | None = None
    optimize: bool = False
    tension: tuple[float, float] | None = None


def best_way(own: Callable[[], Motion], task: WayTask) -> Motion:
    """Return the motion of a step: its own one, or an optimised one where that is better.

    Parameters
    ----------
    own: gives the step's own motion, straight and by its own law of the legs.
    task: what is to be flown.

    Raises
    ------
    InfeasibleError: what the step's own way breaks, no other way having been found either.
    HitchoptError: that one could not be timed, and no other way was found.
    """
    motion: Motion | None = None
    refusal: HitchoptError
    try:
        motion = own()
        certificate = _certificate(motion)
        if certificate.certified and not task.optimize and task.tension is None:
            return motion
        refusal = infeasible(certificate, task.kept.separation, motion.phases)
        if not certificate.certified:
            motion = None
    except HitchoptError as error:
        refusal = error
    if not task.kept.optimiser:
        if motion is None:
            raise refusal
        return motion
    for candidate in candidates(
        task.start, task.end, task.kept.distances, _judge(task), task.tension
    ):
        found = _as_asked(candidate, task, shut=motion is None)
        if found is None or (motion is not None and found.duration >= motion.duration):
            break  # the others are slower still
        return found
    if motion is not None:
        return motion
    if isinstance(refusal, InfeasibleError):
        raise InfeasibleError(refusal.violations, _found_nothing(refusal))
    raise refusal


def _judge(task: WayTask) -> Judge:
    """Return what flies a path and believes the certificate alone."""

    def judged(path: ShapePath) -> Flight | None:
        flight = fly_unhurried(path, task.kept.limits)
        motion = flying(flight, task.start.team, task.kept, [task.phase])
        return flight if _certificate(motion).certified else None

    return judged


def _as_asked(candidate: Candidate, task: WayTask, *, shut: bool) -> Motion | None:
    """Return a candidate's motion in the step's duration; None where it cannot be so fast."""
    flight = candidate.flight
    if task.duration is not None:
        if task.duration < flight.duration:
            return None
        flight = flight.lasting(task.duration)
    phase = replace(task.phase, end=flight.duration, remark=_remark(shut, candidate.name))
    return flying(flight, task.start.team, task.kept, [phase])


def _certificate(motion: Motion) -> Certificate:
    """Return the certificate of one step, the whole plan's duration left open."""
    return certify(replace(motion, limits=replace(motion.limits, duration=None)))


def _remark(shut: bool, name: str) -> str:
    why = "the step's own way is shut" if shut else "faster than the step's own way"
    return f"on an optimised way, first guess {name}: {why}"


def _found_nothing(refusal: InfeasibleError) -> str:
    if any(violation.constraint == "duration" for violation in refusal.violations):
        return "the optimiser found no way that is fast enough either"
    return "the optimiser found no other way"
