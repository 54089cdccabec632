"""Routes of a step, each a planner's solution with its certificate, and which of them is taken."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from hitchopt.checks import Certificate
from hitchopt.errors import HitchoptError, InfeasibleError, TimeLimitError
from hitchopt.hitch import Hitch
from hitchopt.motion.motion import Motion, Phase
from hitchopt.planners.path.leg_law import legs_clear
from hitchopt.planners.path.shape_path import ShapePath
from hitchopt.planners.path.straight_morph import StraightMorph
from hitchopt.planners.planner import Planner
from hitchopt.planners.timing.flight_curves import Flight, check_duration
from hitchopt.planners.timing.fly_path import fly
from hitchopt.planners.timing.time_estimates import flight_estimate
from hitchopt.requirements import Requirements
from hitchopt.steps.certified_motions import Certified, certified, checked, flying

if TYPE_CHECKING:
    from hitchopt.planners.optimise.candidates import OptimisedMorph
    from hitchopt.planners.optimise.search_task import Judge

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


@dataclass(frozen=True, eq=False)
class _Accepted:
    """A path, the flight along it, and the certificate of that."""

    path: ShapePath
    flight: Flight
    certificate: Certificate


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
    def planner(self) -> OptimisedMorph:
        """The search for paths."""
        return self._planner(self._judged)

    @property
    def problem(self) -> object:
        """The paths that the search starts from."""
        return self.planner.problem

    def solve(self) -> Certified:
        """Return the fastest motion that was found, flown in the step's duration."""
        return self.search()[0]

    def search(self) -> tuple[Certified, ShapePath]:
        """Return the fastest motion that was found, and the path that it is on."""
        accepted: list[_Accepted] = []

        def judge(path: ShapePath) -> Flight | None:
            return self._judged(path, accepted)

        found = self._planner(judge).solve()
        if not found:
            raise HitchoptError("no route was found")
        flight = found[0].flight
        remark = f"on an optimised route, first guess {found[0].name}"
        taken = next(one for one in accepted if one.flight is flight)
        if self.duration is not None:
            check_duration(self.duration, flight.duration)
            return checked(self._motion(flight.lasting(self.duration), remark)), taken.path
        return Certified(self._motion(flight, remark), taken.certificate), taken.path

    def _planner(self, judge: Judge) -> OptimisedMorph:
        from hitchopt.planners.optimise.candidates import OptimisedMorph

        ends = (self.start, self.end)
        asked = self.lead or self.phase.tension is not None
        return OptimisedMorph(*ends, self.requirements, judge, self.phase.tension, asked)

    def _motion(self, flight: Flight, remark: str = "") -> Motion:
        phase = replace(self.phase, end=flight.duration, remark=remark)
        return flying(flight, self.start.team, self.requirements, [phase])

    def _judged(self, path: ShapePath, accepted: list[_Accepted] | None = None) -> Flight | None:
        """Return the flight along a path, or one on which legs lead and lag, if it is certified.

        Parameters
        ----------
        path: as the search found it.
        accepted: takes the flight with its path and certificate.
        """
        from hitchopt.planners.path.leading_legs import leading

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
                if accepted is not None:
                    accepted.append(_Accepted(tried, flight, certificate))
                return flight
        return None


def fastest_certified(own: Route[Any], other: OptimisedRoute, note: str) -> tuple[Certified, str]:
    """Return the faster one of two motions that satisfy all limits, and why the other one is not.

    The step's own route is flown only where it may be the faster one.

    Parameters
    ----------
    own: the step's own route; its planner's problem is a path.
    other: the search for a faster one.
    note: added to the refusal where neither does.

    Raises
    ------
    InfeasibleError, HitchoptError: as ``first_certified``.
    """
    try:
        found, path = other.search()
    except TimeLimitError:
        raise
    except HitchoptError as error:
        try:
            return own.solve(), ""
        except TimeLimitError:
            raise
        except HitchoptError as refusal:
            raise _refusal([refusal, error], note) from None
    try:
        if not _may_be_faster(own, other, path):
            return found, FASTER
        motion = own.motion()
        if motion.duration > found.motion.duration:  # whatever its certificate says
            return found, FASTER
        return checked(motion), ""
    except TimeLimitError:
        raise
    except HitchoptError:
        return found, SHUT


def _may_be_faster(own: Route[Any], other: OptimisedRoute, path: ShapePath) -> bool:
    """Return whether the step's own route may be faster than a path of the other, by estimates.

    Those of nearly the same paths err by nearly as much.
    """
    if not isinstance(own.planner, StraightMorph):
        return True
    limits = other.requirements.limits
    least = flight_estimate(own.planner.path, limits)
    return not math.isfinite(least) or least <= (other.duration or flight_estimate(path, limits))


def first_certified(
    routes: Sequence[Planner[object, Certified]], note: str
) -> tuple[Certified, int]:
    """Return the first route's motion that satisfies all limits, and its index in ``routes``.

    Parameters
    ----------
    routes: in the order in which they are tried.
    note: added to the refusal where more than one was tried.

    Raises
    ------
    InfeasibleError: none does; says what binds on the first of them.
    HitchoptError: as the first of them, where none tells what binds.
    """
    refusals: list[HitchoptError] = []
    for i, route in enumerate(routes):
        try:
            return route.solve(), i
        except TimeLimitError:
            raise
        except HitchoptError as error:
            refusals.append(error)
    raise _refusal(refusals, note)


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
