"""The hitch that a step ends with, its routes there, and legs that lean against friction."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.checks import Certificate
from hitchopt.errors import HitchoptError, InfeasibleError, TimeLimitError, Violation
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.hitch import cable_slack
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion, Phase
from hitchopt.planners import Planner
from hitchopt.planners.morph.actions import Action
from hitchopt.planners.morph.legs import SLIDES, legs_clear
from hitchopt.planners.morph.morph import StraightMorph
from hitchopt.planners.morph.path import ShapePath, shapes_along
from hitchopt.planners.timing.flight import Flight, check_duration, fly, needed_stretch
from hitchopt.planners.timing.profile import flight_estimate
from hitchopt.steps.certified_motions import (
    Certified,
    certificate_at_rest,
    certified,
    checked,
    flying,
    infeasible,
    resting,
)
from hitchopt.steps.step import StepPlan
from hitchopt.steps.step_keys import RolledLegs, SlackSplit

if TYPE_CHECKING:
    from hitchopt.planners.optimise.search import OptimisedMorph


@dataclass(frozen=True, eq=False)
class End:
    """The hitch after a step.

    Attributes
    ----------
    hitch: at rest.
    reason: what the action's own legs would break, in words; nothing if they break nothing.
    """

    hitch: Hitch
    reason: str = ""


def split_hitch(
    team: Team,
    polygon: Outline | ArrayLike,
    altitude: float,
    legs: SlackSplit,
    requirements: Requirements,
) -> Hitch:
    """Return the hitch whose slack is split as ``legs`` says."""
    roll, auto = None, False
    if isinstance(legs, RolledLegs):
        sharing, roll, auto = legs.sharing, legs.roll, legs.roll is None
    else:
        sharing = legs
    if isinstance(sharing, str) and sharing == "spread":
        return Hitch.spread(
            team,
            polygon,
            altitude,
            limits=requirements.limits,
            separation=requirements.separation,
            roll=roll,
        )
    given = 0.0 if roll is None else roll
    if isinstance(sharing, str):
        hitch = Hitch.balanced(team, polygon, altitude, given)
    else:
        hitch = Hitch(team, polygon, altitude, sharing, given)
    return hitch.least_rolled(requirements) if auto else hitch


def end_of_morph(
    start: Hitch, polygon: Outline, legs: SlackSplit | None, requirements: Requirements
) -> End:
    """Return the hitch on ``polygon``; without ``legs`` with fractions nearest to those before."""
    if legs is not None:
        return End(split_hitch(start.team, polygon, start.altitude, legs, requirements))
    return End(_nearest(start, polygon, start.fractions, requirements))


def end_of_action(action: Action, legs: SlackSplit | None, requirements: Requirements) -> End:
    """Return the hitch after an action; without ``legs`` with those nearest to its law's.

    Those themselves where they keep every limit.
    """
    start, polygon = action.start, action.polygon
    if legs is not None:
        return End(split_hitch(start.team, polygon, start.altitude, legs, requirements))
    wanted = action.kept_legs
    try:
        hitch = Hitch(start.team, polygon, start.altitude, wanted, start.roll)
    except InfeasibleError as error:
        reason = _words(replace(error.violations[0], limit=requirements.limits.leg))
    else:
        reason = broken_at_rest(hitch, requirements)
        if not reason:
            return End(hitch)
    nearest = _nearest(start, polygon, wanted / cable_slack(start.team, polygon), requirements)
    # A cable that need not slide keeps its legs to the last bit, so that its drones stay.
    same = np.abs(nearest.q_legs - wanted) < SLIDES
    q_legs = np.where(same, wanted, nearest.q_legs)
    end = Hitch(start.team, polygon, start.altitude, q_legs, nearest.roll)
    return End(end, f"{reason} at the end")


def broken_on_the_way(
    path: ShapePath, s: float, altitude: float, requirements: Requirements
) -> str:
    """Return what the path's hitch at s breaks, or comes closest to breaking, in words."""
    shape = shapes_along(path, np.array([s]))
    given, roll = shape.legs[0], 0.0 if shape.roll is None else shape.roll[0]
    legs = np.where(path.team.layout.has_leg, given, np.inf)
    place = f"at {s:.0%} of the path"
    if np.min(legs) <= 0.0:
        k, end = np.unravel_index(int(np.argmin(legs)), legs.shape)
        name = f"{'qr'[end]}{k}"
        limit, value = requirements.limits.leg, float(legs[k, end])
        short = Violation("legs", value, limit, "min", "m", (name,), place, "")
        return f"{_words(short)} {place}"
    points = path.vertices.at(s)[:, :2]
    broken = broken_at_rest(Hitch(path.team, points, altitude, given[:, 0], roll), requirements)
    return f"{broken} {place}" if broken else f"distances would all but reach their limits {place}"


def broken_at_rest(hitch: Hitch, requirements: Requirements) -> str:
    """Return the first limit that the hitch breaks, in words; nothing if it keeps them all."""
    broken = certificate_at_rest(hitch, requirements).violated
    return _words(broken[0].violation("", "")) if broken else ""


def _words(broken: Violation) -> str:
    """Return such as "legs 0.11 m at q0 would be below 0.15 m"."""
    unit = "" if broken.unit in {"1", "ratio"} else f" {broken.unit}"
    relation = "below" if broken.sense == "min" else "above"
    place = f" at {', '.join(broken.where)}" if broken.where else ""
    what = f"{broken.constraint} {broken.value:.3g}{unit}{place}"
    return f"{what} would be {relation} {broken.limit:.3g}{unit}"


def _nearest(
    start: Hitch, polygon: Outline, fractions: ArrayLike, requirements: Requirements
) -> Hitch:
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


Solution = TypeVar("Solution")

FASTER = "faster than the step's own route"
SHUT = "the step's own route is infeasible"
SLOWER = "the step's own route takes longer"


@dataclass(frozen=True, eq=False)
class Route(Generic[Solution]):
    """A planner whose solution becomes the motion of a step.

    Attributes
    ----------
    planner: what is asked.
    motion_of: gives the motion of its solution.
    """

    planner: Planner[object, Solution]
    motion_of: Callable[[Solution], Motion]

    @property
    def problem(self) -> object:
        """The planner's problem."""
        return self.planner.problem

    def motion(self) -> Motion:
        """Return the motion, whatever it breaks."""
        return self.motion_of(self.planner.solve())

    def solve(self) -> Certified:
        """Return the motion with its certificate; raises InfeasibleError for what it breaks."""
        return checked(self.motion())

    def within(self, duration: float) -> Certified | None:
        """Return the same if it takes no longer [s]; straight ones are estimated first.

        Raises InfeasibleError for what it breaks.
        """
        if isinstance(self.planner, StraightMorph):
            least = flight_estimate(self.planner.path, self.planner.requirements.limits)
            if duration < least < math.inf:
                return None
        motion = self.motion()
        return checked(motion) if motion.duration <= duration else None


@dataclass(frozen=True, eq=False)
class OptimisedRoute:
    """The fastest route that the optimiser finds from one hitch to another.

    Attributes
    ----------
    start, end: at one altitude, both within all limits at rest.
    requirements: what the motion must satisfy.
    phase: the step's name and index, and within what tensions may change meanwhile.
    duration: exactly that long [s], or None.
    lead: also try legs that lead and lag.
    """

    start: Hitch
    end: Hitch
    requirements: Requirements
    phase: Phase
    duration: float | None = None
    lead: bool = False

    @property
    def problem(self) -> object:
        """The paths that the search starts from."""
        return self._planner([]).problem

    def solve(self) -> Certified:
        """Return the fastest motion that was found, flown in the step's duration."""
        accepted: list[tuple[Flight, Certificate]] = []
        found = self._planner(accepted).solve()
        if not found:
            raise HitchoptError("no route was found")
        flight, remark = found[0].flight, f"on an optimised route, first guess {found[0].name}"
        if self.duration is not None:
            check_duration(self.duration, flight.duration)
            return checked(self._motion(flight.lasting(self.duration), remark))
        certificate = next(each for one, each in accepted if one is flight)
        return Certified(self._motion(flight, remark), certificate)

    def _planner(self, accepted: list[tuple[Flight, Certificate]]) -> OptimisedMorph:
        """Return the search for paths; ``accepted`` takes flights that are certified."""
        from hitchopt.planners.optimise.search import OptimisedMorph

        ends = self.start, self.end
        judge = partial(self._judged, accepted)
        return OptimisedMorph(*ends, self.requirements, judge, self.phase.tension)

    def _motion(self, flight: Flight, remark: str = "") -> Motion:
        phase = replace(self.phase, end=flight.duration, remark=remark)
        return flying(flight, self.start.team, self.requirements, [phase])

    def _judged(self, accepted: list[tuple[Flight, Certificate]], path: ShapePath) -> Flight | None:
        """Return the flight along a path, or one on which legs lead and lag, if it is certified."""
        from hitchopt.planners.morph.legs import leading

        limits = self.requirements.limits
        led = (p for p in leading(path, limits) if legs_clear(p, self.requirements))
        for tried in (*(led if self.lead else ()), path):
            try:
                flight = fly(tried, limits)
            except HitchoptError:
                if tried is path:
                    raise
                continue
            certificate = certified(self._motion(flight)).certificate
            if certificate.certified:
                accepted.append((flight, certificate))
                return flight
        return None


def routed(
    routes: Sequence[Route[Any] | OptimisedRoute], note: str, *, fastest: bool = False
) -> tuple[Certified, str]:
    """Return a motion that satisfies all limits, and why it is not that of the first route.

    Parameters
    ----------
    routes: in the order in which they are tried, the step's own first.
    note: added to the refusal where more than one was tried.
    fastest: try the last one first, and then those that may be faster.

    Raises
    ------
    InfeasibleError: none does; says what binds on the first of them.
    HitchoptError: as the first of them, where none tells what binds.
    """
    found: Certified | None = None
    taken = 0
    refusals: dict[int, HitchoptError] = {}
    numbered = list(enumerate(routes))
    for i, route in reversed(numbered) if fastest else numbered:
        try:
            if found is None:
                found, taken = route.solve(), i
            elif fastest and isinstance(route, Route):
                faster = route.within(found.motion.duration)
                found, taken = (faster, i) if faster else (found, taken)
        except TimeLimitError:
            raise
        except HitchoptError as error:
            refusals[i] = error
    if found is None:
        raise _refusal([refusals[i] for i, _ in numbered], note)
    return found, "" if taken == 0 else SHUT if 0 in refusals else FASTER


def _refusal(refusals: Sequence[HitchoptError], note: str) -> HitchoptError:
    """Return what is said where no route satisfies all limits.

    A route that only takes too long is told before others, that which takes the least time first.
    """
    own = refusals[0]
    told = [refusal for refusal in refusals if isinstance(refusal, InfeasibleError)]
    if not told:
        return own
    first = min(told, key=_shortest)  # the first one where none has a time
    if first is not own and isinstance(own, InfeasibleError):
        note = SHUT if _shortest(own) == math.inf else SLOWER
    return InfeasibleError(first.violations, first.note or (note if len(refusals) > 1 else ""))


def _shortest(refusal: InfeasibleError) -> float:
    """Return the time that a route takes at least [s], if that alone is why it is refused."""
    timed = all((v.constraint, v.sense) == ("duration", "min") for v in refusal.violations)
    return max((v.limit for v in refusal.violations if timed), default=math.inf)


SHARES = (1.0, 0.8, 0.65, 0.5, 0.4, 0.3, 0.25)
"""Shares of the friction to lean against, tried in turn until every limit is satisfied."""

REFUSED = 0.5
"""Factor of a share that breaks a limit to the next one tried: certificates take time."""

WHOLE = 0.99
"""Share of the friction from which on all of it counts as used."""

NO_ROOM = "legs do not lean against friction: limits leave no room for it"

LONGER = 1.5
"""Most times as long as without friction that a step may last for legs to lean so far."""


def against_friction(planned: StepPlan, *, timed: bool) -> StepPlan:
    """Return the plan with legs that lean against friction as far as limits allow.

    It is the given one where the team's cables have no friction or none of them slides, and where
    limits leave no room for leaning, which its remarks then say. The motion may take up to LONGER
    times as long for it, unless its time is given or the whole plan's is limited.

    Parameters
    ----------
    planned: from rest to rest, of a hitch.
    timed: whether the step's own time is given.
    """
    motion, limits = planned.motion, planned.motion.requirements.limits
    if motion.team.cable_friction == 0.0:
        return planned
    from hitchopt.planners.morph.friction import leaning, worth_leaning

    if not worth_leaning(motion):
        return planned
    slower = not timed and limits.duration is None
    most = 1.0
    for share in SHARES:
        if share > most:
            continue
        found = leaning(motion, limits, share, slower=slower)
        if found is None or found.motion.duration > LONGER * motion.duration:
            continue
        words = f"legs lean against friction, by up to {math.degrees(found.turned):.2g}°"
        if share < 1.0:
            words += f" ({share:.0%} of what would do: limits leave room for no more)"
        judged = certified(remarked(found.motion, words))
        if judged.certificate.certified:
            return replace(planned, motion=judged.motion, certificate=judged.certificate)
        most = REFUSED * share
    return replace(planned, motion=remarked(motion, NO_ROOM))


def worked(
    hitch: Hitch, requirements: Requirements, seconds: float | None, phase: Phase
) -> Certified:
    """Return the motion in which drones swing until the clasps' friction has lost its memory.

    They swing as far as limits allow, ``remark`` says how far.

    Parameters
    ----------
    hitch: of cables with friction, at rest before and after.
    requirements: what the motion must satisfy.
    seconds: how long [s]; None for SWINGS of SWING, up to LONGER times as long where limits of
        motion need that.
    phase: its name, step and remark; the times are set.

    Raises
    ------
    InfeasibleError: limits leave no room for a quarter of what would do.
    """
    from hitchopt.planners.morph.friction import SWING, SWINGS, settling

    lasts = SWING * (SWINGS + 0.5) if seconds is None else seconds
    limits, judged = requirements.limits, None
    rest = resting(hitch, requirements, lasts, phase)
    for share in SHARES:
        found = settling(rest, share)
        if found is None:
            break
        leaning, used = found
        motion = leaning.motion
        words = f"drones swing by up to {math.degrees(leaning.turned):.2g}°"
        curves = motion.drones, motion.vertices, motion.pulls
        factor = needed_stretch(motion.team, limits, *curves)
        if factor > 1.0 and seconds is None and factor <= LONGER:
            motion = motion.slowed(factor)
        if used < WHOLE:
            words += f" (at least {used:.0%} of what would do: legs have room for no more)"
        judged = certified(remarked(motion, words))
        if judged.certificate.certified:
            return judged
    if judged is None:
        return certified(remarked(rest, "no leg can lean against friction"))
    raise infeasible(judged.certificate, judged.motion)


def remarked(motion: Motion, words: str) -> Motion:
    """Return the same motion, the remarks of its phases with these words at their end."""
    phases = tuple(
        replace(phase, remark=f"{phase.remark}; {words}" if phase.remark else words)
        for phase in motion.phases
    )
    return replace(motion, phases=phases)
