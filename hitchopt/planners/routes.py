"""The routes that a morph or an action tries: its own one, a faster one, and an optimised one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from hitchopt.checks.swing import has_inertia
from hitchopt.errors import AT_END
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch
from hitchopt.hitch.casadi_model import CostFunction
from hitchopt.motion.motion import Phase
from hitchopt.planners.along import past_obstacles, plan_along, straight_plan
from hitchopt.planners.candidates import Candidate, first_certified, if_feasible
from hitchopt.planners.ends import SlackSplit, end_of_morph
from hitchopt.planners.morph.morph import moves, straight_path
from hitchopt.planners.optimised_route import OptimisedRoute
from hitchopt.planners.rests import check_at_rest
from hitchopt.planners.task import StepPlan, StepTask, require_certified
from hitchopt.planners.timing.stretch import needed_stretch
from hitchopt.planners.timing.swing import check_swing

if TYPE_CHECKING:
    from hitchopt.planners.path import Path

OWN_ROUTE = "the step's own route"
OPTIMISED_ROUTE = "optimised route"
FASTER_ROUTE = "faster route"


SEARCH_THRESHOLDS = ((1.3, 0.0), (1.1, math.radians(15.0)))
"""Durations of a step's own route over its lower bound, and mean turns of its edges [rad], above
both of which a faster route is searched without a request. Straight routes between nearly regular
polygons that hardly turn take up to 1.29 times their bound, and other routes are no faster. If
edges turn, straight lines shorten them midway: of 29 morphs between irregular polygons, 11 were 6
to 17 % faster on another route."""

MAX_SEARCHED = 24  # Number of robots up to which a faster route is searched that was not requested


def is_slow(plan: StepPlan, start: Hitch, end: Hitch) -> bool:
    """Return whether a morph takes so much longer than its bound that others may be faster."""
    from hitchopt.planners.optimise.guesses import turns
    from hitchopt.planners.optimise.search import min_duration

    if start.team.robots > MAX_SEARCHED or not start.team.layout.closed:
        return False
    bound = min_duration(start, end, plan.motion.requirements.limits)
    turn = abs(turns(start.polygon, end.polygon)[0])
    duration = plan.motion.duration
    if plan.motion.requirements.limits.swing is not None and has_inertia(plan.motion):
        duration *= needed_stretch(plan.motion)  # other routes swing as far
    return any(
        duration > ratio * bound and turn >= least_turn for ratio, least_turn in SEARCH_THRESHOLDS
    )


def plan_to_hitch(task: StepTask, end: Hitch, phase: Phase) -> StepPlan:
    """Return the plan of a morph to a hitch at any altitude, on a straight route or a faster one.

    ``phase`` has the name and the index of the step. Raises InfeasibleError if no route was found.
    """
    straight = partial(straight_plan, task, end, phase)
    search = RouteSearch(task, end, phase, straight, replaces_slow=True)
    routes = [Candidate(OWN_ROUTE, search.own_or_faster_plan)]
    if task.optimiser:
        routes.append(Candidate(OPTIMISED_ROUTE, search.optimised_plan))
    return first_certified(routes, task.effort, task.progress)


@dataclass(frozen=True, eq=False)
class RouteSearch:
    """The search of a route to the end of a step: its own one, or an optimised one."""

    task: StepTask  # The task of the step
    end: Hitch  # The hitch after it
    phase: Phase  # With the step's name and index, and the range of tensions that it states, if any
    own: Callable[[], StepPlan]  # Returns the plan along the step's own route
    duration: float | None = None  # Prescribed duration [s]; None for the fastest one
    # True to replace an own route that takes much longer than its bound
    replaces_slow: bool = False
    refines: bool = False  # True to refine route and clock together
    cost: CostFunction | None = None  # Custom cost; None for the time alone

    def plan(self) -> StepPlan:
        """Return the plan along the first certified route."""
        return first_certified(self.candidates(), self.task.effort, self.task.progress)

    def candidates(self) -> Iterator[Candidate[StepPlan]]:
        """Yield the routes to the end: the optimised one first if the step requests it.

        Raises InfeasibleError if the step's own route is infeasible, and the hitch at an end of it
        breaks a limit at rest.
        """
        task = self.task
        for_time = self.refines or self.phase.tension is not None
        is_requested = (
            task.optimiser
            and (self.cost is not None or (for_time and self.duration is None))
            and moves(task.hitch, self.end)
        )
        if is_requested:
            yield Candidate(OPTIMISED_ROUTE, self._requested_plan)
        yield Candidate(OWN_ROUTE, self._own_plan if is_requested else self.own_or_faster_plan)
        for hitch in (task.hitch, self.end):
            check_at_rest(hitch, task.requirements, AT_END, self.phase.place)
        if task.optimiser and not is_requested:
            yield Candidate(OPTIMISED_ROUTE, self.optimised_plan)

    def _requested_plan(self) -> StepPlan:
        """Return the optimised plan that the step requests, which may be along straight lines."""
        straight = partial(straight_path, self.task.hitch, self.end, self.task.requirements)
        return self.optimised_plan(if_feasible("straight lines", straight, None))

    def _own_plan(self) -> StepPlan:
        """Return the certified plan along the step's own route, if need be around obstacles."""
        own = self.own()
        phase = own.motion.phases[0]
        along = partial(plan_along, self.task, end=self.end, phase=phase, duration=self.duration)
        return past_obstacles(self.task, own, own.path, along)

    def own_or_faster_plan(self) -> StepPlan:
        """Return the plan along the step's own route, or a faster one if it looks for one."""
        own = self._own_plan()
        searches = self.replaces_slow and self.task.optimiser
        if not searches or self.duration is not None or own.path is None:
            return own
        if not is_slow(own, self.task.hitch, self.end):
            return own
        return if_feasible(FASTER_ROUTE, partial(self.optimised_plan, own.path, own), own)

    def optimised_plan(self, straight: Path | None = None, own: StepPlan | None = None) -> StepPlan:
        """Return the optimised plan.

        ``straight`` is the path along straight lines and ``own`` the plan along it, if known.
        """
        requirements = self.task.requirements
        free = requirements if self.duration is None else requirements.in_haste
        plan = OptimisedRoute(
            self.task.within(free, self.task.before),
            self.end,
            self.phase,
            duration=self.duration,
            straight=straight,
            own=own,
            refines=self.refines,
            cost=self.cost,
        ).plan()
        if free is requirements:
            return plan
        # The fastest motion may swing, but not the one in the prescribed duration
        motion = plan.motion.replaced(requirements=requirements)
        check_swing(motion)
        return require_certified(replace(plan, motion=motion))


def leg_candidates(
    task: StepTask,
    phase: Phase,
    legs: Any,
    plan_with: Callable[[Any], StepPlan],
) -> Iterator[Candidate[StepPlan]]:
    """Yield the plan to legs at the end, and the one to spread legs where it is infeasible.

    Raises InfeasibleError if the first one is infeasible and the start breaks a limit at rest.

    Parameters
    ----------
    phase: with the step's name and index.
    legs: that the step states; None for the nearest ones.
    plan_with: returns the certified plan to legs.
    """
    yield Candidate("nearest legs", partial(plan_with, legs))
    check_at_rest(task.hitch, task.requirements, AT_END, phase.place)
    if legs is None:
        yield Candidate("spread legs", partial(plan_with, "spread"))


def morph_plan(task: StepTask, polygon: Outline, legs: SlackSplit | None = None) -> StepPlan:
    """Return the plan of the step ``morph`` with its defaults; ``legs`` are those at its end."""
    phase = Phase("morph", task.index, 0.0, 0.0)

    def plan_with(legs: SlackSplit | None) -> StepPlan:
        """Return the plan to legs."""
        end = end_of_morph(task.hitch, polygon, legs, task.requirements).hitch
        straight = partial(straight_plan, task, end, phase)
        return RouteSearch(task, end, phase, straight, replaces_slow=True).plan()

    candidates = leg_candidates(task, phase, legs, plan_with)
    return first_certified(candidates, task.effort, task.progress)
