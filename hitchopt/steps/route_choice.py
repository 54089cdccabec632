"""The hitch that a step ends with, its routes there, and legs that lean against friction."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import HitchoptError, InfeasibleError, Violation
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.hitch import cable_slack
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Phase
from hitchopt.planners.morph.actions import Action
from hitchopt.planners.morph.legs import SLIDES
from hitchopt.planners.morph.path import ShapePath
from hitchopt.planners.timing.flight import Flight, check_duration, fly, needed_stretch
from hitchopt.steps.certified_motions import at_rest, checked, flying, infeasible, resting
from hitchopt.steps.step import IDLE, StepPlan, StepTask
from hitchopt.steps.step_keys import RolledLegs, SlackSplit


def split_hitch(
    team: Team,
    polygon: Outline | ArrayLike,
    altitude: float,
    legs: SlackSplit,
    requirements: Requirements,
) -> Hitch:
    """Return the hitch whose slack is split as ``legs`` says."""
    if isinstance(legs, RolledLegs):
        sharing, roll, auto = legs.sharing, legs.roll, legs.roll is None
    else:
        sharing, roll, auto = legs, None, False
    if isinstance(sharing, str) and sharing == "spread":
        limits, separation = requirements.limits, requirements.separation
        return Hitch.spread(
            team, polygon, altitude, limits=limits, separation=separation, roll=roll
        )
    given = 0.0 if roll is None else roll
    if isinstance(sharing, str):
        hitch = Hitch.balanced(team, polygon, altitude, given)
    else:
        hitch = Hitch(team, polygon, altitude, sharing, given)
    return hitch.least_rolled(requirements) if auto else hitch


@dataclass(frozen=True, eq=False)
class End:
    """The hitch after a step, at rest, and what the action's own legs would break, in words."""

    hitch: Hitch
    reason: str = ""


def end_of_morph(
    start: Hitch, polygon: Outline, legs: SlackSplit | None, requirements: Requirements
) -> End:
    """Return the hitch on ``polygon``; without ``legs`` with fractions nearest to those before."""
    if legs is not None:
        return End(split_hitch(start.team, polygon, start.altitude, legs, requirements))
    return End(_nearest(start, polygon, start.fractions, requirements))


def end_of_action(action: Action, legs: SlackSplit | None, requirements: Requirements) -> End:
    """Return the hitch after an action; without ``legs`` with those nearest to its law's."""
    start, polygon = action.start, action.polygon
    if legs is not None:
        return end_of_morph(start, polygon, legs, requirements)
    wanted = action.kept_legs
    try:
        hitch = Hitch(start.team, polygon, start.altitude, wanted, start.roll)
    except InfeasibleError as error:
        reason = _words(replace(error.violations[0], limit=requirements.limits.leg))
    else:
        broken = at_rest(hitch, requirements).certificate.violated
        if not broken:
            return End(hitch)
        reason = _words(broken[0].violation("", ""))
    nearest = _nearest(start, polygon, wanted / cable_slack(start.team, polygon), requirements)
    # A cable that need not slide keeps its legs to the last bit, so that its drones stay.
    q_legs = np.where(np.abs(nearest.q_legs - wanted) < SLIDES, wanted, nearest.q_legs)
    end = Hitch(start.team, polygon, start.altitude, q_legs, nearest.roll)
    return End(end, f"{reason} at the end")


def _words(broken: Violation) -> str:
    """Return such as "legs 0.11 m at q0 would be below 0.15 m"."""
    unit = "" if broken.unit in {"1", "ratio"} else f" {broken.unit}"
    relation = "below" if broken.sense == "min" else "above"
    place = f" at {', '.join(broken.where)}" if broken.where else ""
    value = f"{broken.constraint} {broken.value:.3g}{unit}{place}"
    return f"{value} would be {relation} {broken.limit:.3g}{unit}"


def _nearest(
    start: Hitch, polygon: Outline, fractions: ArrayLike, requirements: Requirements
) -> Hitch:
    """Return the hitch within all limits whose fractions are nearest to those given."""
    return Hitch.nearest(
        start.team,
        polygon,
        start.altitude,
        fractions,
        limits=requirements.limits,
        separation=requirements.separation,
        arena=requirements.arena,
        roll=start.roll,
    )


FASTER = "faster than the step's own route"
SHUT = "the step's own route is infeasible"
SLOWER = "the step's own route takes longer"


def optimised(task: StepTask, end: Hitch, phase: Phase, duration: float | None = None) -> StepPlan:
    """Return the fastest plan that the optimiser finds from the task's hitch to another.

    Parameters
    ----------
    task: what is asked.
    end: at the same altitude; both hitches are within all limits at rest.
    phase: the step's name and index, and within what tensions may change meanwhile.
    duration: exactly that long [s], or None.

    Raises
    ------
    InfeasibleError: it takes longer than ``duration``, or breaks a limit then.
    HitchoptError: no route was found.
    """
    from hitchopt.planners.optimise.search import OptimisedMorph

    start, requirements = task.hitch, task.requirements
    accepted: dict[Flight, StepPlan] = {}

    def planned(flight: Flight) -> StepPlan:
        flown = replace(phase, end=flight.duration)
        return task.ended(flying(flight, start.team, requirements, [flown]), end)

    def judged(path: ShapePath) -> Flight | None:
        """Return the flight along a path, if it is certified."""
        flight = fly(path, requirements.limits)
        found = planned(flight)
        if not found.certificate.certified:
            return None
        accepted[flight] = found
        return flight

    found = OptimisedMorph(start, end, requirements, judged, phase.tension).solve()
    if not found:
        raise HitchoptError("no route was found")
    best, words = found[0].flight, f"on an optimised route, first guess {found[0].name}"
    if duration is None:
        return accepted[best].remarked(words)
    check_duration(duration, best.duration)
    return checked(planned(best.lasting(duration)).remarked(words))


def refused_both(own: HitchoptError, other: HitchoptError, note: str) -> HitchoptError:
    """Return what tells why neither a step's own route nor the optimised one is flown.

    What binds on the own one; a route that only takes too long is told before others.
    """
    told = [each for each in (own, other) if isinstance(each, InfeasibleError)]
    if not told:
        return own
    first = min(told, key=_shortest)  # the own one where none has a time
    if first is not own and isinstance(own, InfeasibleError):
        note = SHUT if _shortest(own) == math.inf else SLOWER
    return InfeasibleError(first.violations, first.note or note)


def _shortest(refusal: InfeasibleError) -> float:
    """Return the time that a route takes at least [s], if that alone is why it is refused."""
    timed = all((v.constraint, v.sense) == ("duration", "min") for v in refusal.violations)
    return max((v.limit for v in refusal.violations if timed), default=math.inf)


SHARES = (1.0, 0.8, 0.65, 0.5, 0.4, 0.3, 0.25)
"""Shares of the friction to lean against, tried in turn until every limit is satisfied."""

WHOLE = 0.99
"""Share of the friction from which on all of it counts as used."""

NO_ROOM = "legs do not lean against friction: limits leave no room for it"

LONGER = 1.5
"""Most times as long as without friction that a step may last for legs to lean so far."""


def against_friction(planned: StepPlan, *, timed: bool) -> StepPlan:
    """Return the plan with legs that lean against friction as far as limits allow.

    It is the given one where the team's cables have no friction or none of them slides, and where
    limits leave no room for leaning, which its remarks then say. The motion may take up to LONGER
    times as long, unless its time is given (``timed``) or the whole plan's is limited.
    """
    motion, limits = planned.motion, planned.motion.requirements.limits
    if motion.team.cable_friction == 0.0:
        return planned
    from hitchopt.planners.morph.friction import leaning, worth_leaning

    if not worth_leaning(motion):
        return planned
    slower = not timed and limits.duration is None
    for share in SHARES:
        found = leaning(motion, limits, share, slower=slower)
        if found is None or found.motion.duration > LONGER * motion.duration:
            continue
        words = f"legs lean against friction, by up to {math.degrees(found.turned):.2g}°"
        if share < 1.0:
            words += f" ({share:.0%} of what would do: limits leave room for no more)"
        leant = replace(planned, motion=found.motion).remarked(words)
        if leant.certificate.certified:
            return leant
    return planned.remarked(NO_ROOM)


def worked(task: StepTask, seconds: float | None, phase: Phase, *, needed: bool = True) -> StepPlan:
    """Return the plan in which drones swing until the clasps' friction has lost its memory.

    They swing as far as limits allow; the remark says how far.

    Parameters
    ----------
    task: with a hitch of cables with friction, at rest before and after.
    seconds: how long [s]; None for SWINGS of SWING, up to LONGER times as long where limits of
        motion need that.
    phase: its name, step and remark; the times are set.
    needed: it may not be left out where limits leave no room for it.

    Raises
    ------
    InfeasibleError: limits leave no room for a quarter of what would do.
    """
    from hitchopt.planners.morph.friction import SWING, SWINGS, settling

    lasts = SWING * (SWINGS + 0.5) if seconds is None else seconds
    hitch, requirements, tried = task.hitch, task.requirements, None
    rest = resting(hitch, requirements, lasts, phase)
    for share in SHARES:
        found = settling(rest, share)
        if found is None:
            break
        leaning, used = found
        motion = leaning.motion
        words = f"drones swing by up to {math.degrees(leaning.turned):.2g}°"
        curves = motion.drones, motion.vertices, motion.pulls
        factor = needed_stretch(motion.team, requirements.limits, *curves)
        if factor > 1.0 and seconds is None and factor <= LONGER:
            motion = motion.slowed(factor)
        if used < WHOLE:
            words += f" (at least {used:.0%} of what would do: legs have room for no more)"
        tried = task.ended(motion, hitch).remarked(words)
        if tried.certificate.certified:
            return tried
    if tried is None:
        return task.ended(rest, hitch).remarked("no leg can lean against friction")
    if needed:
        raise infeasible(tried.certificate, tried.motion)
    left = task.ended(resting(hitch, requirements, IDLE, phase), hitch)
    return left.remarked("clasps keep their friction: limits leave no room to work them")
