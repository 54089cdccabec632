"""Certified plans along routes of the optimiser, refined with their clocks."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

from hitchopt.checks.violations import infeasible_error, named_checks
from hitchopt.errors import HitchoptError, InfeasibleError, Reason
from hitchopt.hitch import Hitch
from hitchopt.hitch.casadi_model import CostFunction
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import Motion, Phase
from hitchopt.planners.along import past_obstacles, plan_along
from hitchopt.planners.candidates import Effort, if_feasible
from hitchopt.planners.morph.morph import load_violation, shape_violation
from hitchopt.planners.path import Path
from hitchopt.planners.task import StepPlan, StepTask, require_certified
from hitchopt.planners.timing.timed_motion import check_duration, in_duration

if TYPE_CHECKING:
    from hitchopt.planners.optimise.cost import FlightCost
    from hitchopt.planners.optimise.knots import KnotPath

DIRECT_INFEASIBLE = "the step's own route is infeasible"
FASTER = "faster than the step's own route"


@dataclass(frozen=True, eq=False)
class OptimisedRoute:
    """A route that the optimiser finds to a hitch, at the same altitude or not."""

    task: StepTask  # The task of the step
    end: Hitch  # The hitch after it
    phase: Phase  # With the step's name, index and range of tensions
    duration: float | None = None  # Prescribed duration [s]; None for the fastest one
    # The step's own path, which is a candidate if it is feasible; None if it is not
    straight: Path | None = None
    own: StepPlan | None = None  # Certified plan along this path, if there is one
    refines: bool = False  # Whether route and clock are then refined together
    cost: CostFunction | None = None  # Minimised together with the duration
    # Certified plans by their motions
    _certified: dict[Motion, StepPlan] = field(default_factory=dict, init=False)

    def plan(self) -> StepPlan:
        """Return the fastest plan.

        Raises InfeasibleError if the plan takes longer than the prescribed duration.
        """
        from hitchopt.planners.optimise.cost import FlightCost
        from hitchopt.planners.optimise.search import OptimisedMorph

        task = self.task
        cost = None if self.cost is None else FlightCost(task.hitch.team, self.cost)
        routes = OptimisedMorph(
            task.hitch,
            self.end,
            task.requirements,
            judge=self._certified_motion,
            tension=self.phase.tension,
            straight=self.straight,
            cost=cost,
            effort=task.effort,
        ).solve()
        if routes.rejected is not None:
            return self._plan_along_best(routes.rejected)
        if not routes.accepted:
            raise HitchoptError("no route was found")
        fastest = routes.accepted[0]
        plan = self._certified[fastest.motion]
        if self.duration is not None:
            check_duration(self.duration, plan.motion.duration)
            slower = in_duration(plan.motion, self.duration)
            phases = (self.phase.retimed(0.0, self.duration),)
            plan = require_certified(replace(plan, motion=slower.replaced(phases=phases)))
        remark = ""
        if fastest.name:
            remark = f"on an optimised route, first guess {fastest.name}"
            if self.cost is None:
                is_straight_feasible = any(not route.name for route in routes.accepted)
                remark += f"; {FASTER if is_straight_feasible else DIRECT_INFEASIBLE}"
        if (self.refines or cost is not None) and self.duration is None:
            plan, gain = refined_plan(task, plan, self.phase, cost)
            remark = "; ".join(filter(None, [remark, gain]))
        return plan.with_remark(remark) if remark else plan

    def _certified_motion(self, path: Path) -> Motion | None:
        """Return a certified motion along a path, or None."""
        certified = partial(self._certified_along, self._climbing(path))
        return if_feasible("route", certified, None)

    def _climbing(self, path: Path) -> Path:
        """Return a path of the search, which is horizontal, with the climb to the end."""
        climb = self.end.altitude - self.task.hitch.altitude
        return path if path is self.straight or climb == 0.0 else path.climbing(climb)

    def _certified_along(self, path: Path) -> Motion:
        """Return the certified motion along a path."""
        along = partial(plan_along, self.task, end=self.end, phase=self.phase)
        if self.own is not None and path is self.own.path:
            plan = self.own
        else:
            plan = past_obstacles(self.task, along(path), path, along)
        self._certified[plan.motion] = plan
        return plan.motion

    def _plan_along_best(self, best: KnotPath) -> StepPlan:
        """Return the plan along the best route that was tried.

        Raises InfeasibleError with the limits that it breaks, and where along the route.
        """
        path = self._climbing(best.path)
        route = f"along the best route tried ({best.name})"
        limits = self.task.requirements.limits
        violation = shape_violation(path, route) or load_violation(path, limits, route)
        if violation is not None:
            raise InfeasibleError([replace(violation, reason=Reason.NO_ROUTE)])
        plan = plan_along(self.task, path, self.end, self.phase)
        if plan.certificate.certified:
            return plan
        motion = plan.motion
        unplaced = infeasible_error(plan.certificate, motion).violations
        named = named_checks(plan.certificate, Flight.of(motion))
        placed = [
            replace(
                violation,
                when=f"at {check.time / motion.duration:.0%} {route}",
                steps=(self.phase.place,),
                reason=Reason.NO_ROUTE,
            )
            for violation, check in zip(unplaced, named, strict=True)
        ]
        raise InfeasibleError(placed)


def refined_plan(
    task: StepTask, plan: StepPlan, phase: Phase, cost: FlightCost | None = None
) -> tuple[StepPlan, str]:
    """Return the plan with its route and clock refined together, and what it gained.

    It is the plan itself if none is shorter, with a cost none better.
    """
    from hitchopt.planners.optimise.refinement import TUNING, flight_cost, refined

    path = plan.path
    if path is None:
        return plan, ""

    def certified(route: Path, motion: Motion) -> StepPlan | None:
        """Return the certified plan of a shorter motion along another path."""
        phases = (phase.retimed(0.0, motion.duration),)
        shorter = replace(plan, motion=motion.replaced(phases=phases), path=route)
        return shorter if shorter.certificate.certified else None

    effort = Effort(TUNING.max_effort, whole=task.effort)
    better = refined(path, plan.motion, phase.tension, certified, effort, cost=cost)
    if better is None:
        if cost is None:
            return plan, ""
        return plan, f"its cost is {flight_cost(path, plan.motion, cost):.4g} s"
    before = plan.motion.duration
    after = better.certified.motion.duration
    gain = f"refined with its clock: {before:.2f} s → {after:.2f} s"
    if cost is not None:
        gain += f"; its cost is {better.cost:.4g} s"
    return better.certified, gain
