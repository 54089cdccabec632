"""Routes of a step, each a planner's solution with its certificate, and which of them is taken."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from hitchopt.errors import HitchoptError, InfeasibleError, TimeLimitError
from hitchopt.hitch import Hitch
from hitchopt.motion.motion import Motion, Phase
from hitchopt.planners.optimise.candidates import Candidate, OptimisedMorph
from hitchopt.planners.path.leading_legs import leading
from hitchopt.planners.path.leg_law import legs_clear
from hitchopt.planners.path.shape_path import ShapePath
from hitchopt.planners.planner import Planner
from hitchopt.planners.timing.flight_curves import Flight, check_duration
from hitchopt.planners.timing.fly_path import fly
from hitchopt.requirements import Requirements
from hitchopt.steps.certified_motions import Certified, certified, checked, flying

Solution = TypeVar("Solution")


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
        ends = (self.start, self.end)
        return OptimisedMorph(*ends, self.requirements, self._judged, self.phase.tension)

    @property
    def problem(self) -> object:
        """The paths that the search starts from."""
        return self.planner.problem

    def solve(self) -> Certified:
        """Return the fastest motion that was found, flown in the step's duration."""
        found = self.planner.solve()
        if not found:
            raise HitchoptError("no route was found")
        flight = found[0].flight
        if self.lead and flight.duration > (self.duration or 0.0):
            flight = self._led(found[0])
        if self.duration is not None:
            check_duration(self.duration, flight.duration)
            flight = flight.lasting(self.duration)
        return checked(self._motion(flight, f"on an optimised route, first guess {found[0].name}"))

    def _motion(self, flight: Flight, remark: str = "") -> Motion:
        phase = replace(self.phase, end=flight.duration, remark=remark)
        return flying(flight, self.start.team, self.requirements, [phase])

    def _judged(self, path: ShapePath) -> Flight | None:
        """Return the flight along a path if its certificate holds."""
        flight = fly(path, self.requirements.limits)
        return flight if certified(self._motion(flight)).certificate.certified else None

    def _led(self, found: Candidate) -> Flight:
        """Return the flight that was found, or a faster one on which legs lead and lag."""
        for path in leading(found.path, self.requirements.limits):
            try:
                flight = self._judged(path) if legs_clear(path, self.requirements) else None
            except HitchoptError:
                continue
            if flight is not None:
                return min(found.flight, flight, key=lambda each: each.duration)
        return found.flight


def first_certified(
    routes: Sequence[Planner[object, Certified]], note: str, *, every: bool = False
) -> dict[int, Certified]:
    """Return the first route's motion that satisfies all limits, by its index in ``routes``.

    Parameters
    ----------
    routes: in the order in which they are tried.
    note: added to the refusal where more than one was tried.
    every: return all of them.

    Raises
    ------
    InfeasibleError: none does; says what binds on the first of them.
    HitchoptError: as the first of them, where none tells what binds.
    """
    found: dict[int, Certified] = {}
    refusals: list[HitchoptError] = []
    for i, route in enumerate(routes):
        try:
            found[i] = route.solve()
        except TimeLimitError:
            raise
        except HitchoptError as error:
            refusals.append(error)
        if found and not every:
            break
    if found:
        return found
    for refusal in refusals:
        if isinstance(refusal, InfeasibleError):
            added = note if len(refusals) > 1 else ""
            raise InfeasibleError(refusal.violations, refusal.note or added)
    raise refusals[0]
