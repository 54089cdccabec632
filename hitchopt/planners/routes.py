"""Certified plans of morphs and actions along routes: straight, on detours, or optimised."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from hitchopt.checks.violations import infeasible_error, named_checks
from hitchopt.errors import HitchoptError, InfeasibleError
from hitchopt.geometry import Outline
from hitchopt.geometry.vectors import length
from hitchopt.hitch import Hitch
from hitchopt.hitch.casadi_model import CostFunction
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import Motion, Phase
from hitchopt.planners.candidates import Candidate, Effort, first_certified, first_feasible
from hitchopt.planners.compensation import compensated, with_friction_feedforward
from hitchopt.planners.ends import SlackSplit, end_of_morph, end_of_transport
from hitchopt.planners.rests import IDLE, check_at_rest, rest_motion
from hitchopt.planners.task import StepPlan, StepTask, require_certified

if TYPE_CHECKING:
    from hitchopt.planners.morph.actions import Action, FlownAction
    from hitchopt.planners.morph.detours import Translatable
    from hitchopt.planners.optimise.cost import FlightCost
    from hitchopt.planners.optimise.knots import KnotPath
    from hitchopt.planners.path import Path
    from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

P = TypeVar("P", bound="Translatable")

DIRECT_INFEASIBLE = "the step's own route is infeasible"
OWN_ROUTE = "the step's own route"
OPTIMISED_ROUTE = "optimised route"
FASTER_ROUTE = "faster route"
BEST_ROUTE = "the best route tried"
FASTER = "faster than the step's own route"


def end_of_step(phase: Phase) -> str:
    """Return the words for the end of a phase's step in errors."""
    return f"at the end of step {phase.step} ({phase.name})"


class SearchThreshold(NamedTuple):
    """Conditions under which a route faster than the step's own is searched without a request."""

    ratio: float
    """Duration of the step's own route over its lower bound."""

    turn: float
    """[rad] Mean turn of the edges."""


SEARCH_THRESHOLDS = (
    SearchThreshold(ratio=1.3, turn=0.0),
    SearchThreshold(ratio=1.1, turn=math.radians(15.0)),
)
"""Straight routes between nearly regular polygons that hardly turn take up to 1.29 times their
bound, and other routes are no faster. If edges turn, straight lines shorten them midway: of 29
morphs between irregular polygons, 11 were 6 to 17 % faster on another route."""

MAX_SEARCHED = 24
"""Number of robots up to which a faster route is searched that was not requested."""


def is_slow(plan: StepPlan, start: Hitch, end: Hitch) -> bool:
    """Return whether a morph takes so much longer than its bound that others may be faster."""
    from hitchopt.planners.optimise.guesses import turns
    from hitchopt.planners.optimise.search import min_duration

    if start.team.robots > MAX_SEARCHED or not start.team.layout.closed:
        return False
    bound = min_duration(start, end, plan.motion.requirements.limits)
    turn = abs(turns(start.polygon, end.polygon)[0])
    return any(
        plan.motion.duration > threshold.ratio * bound and turn >= threshold.turn
        for threshold in SEARCH_THRESHOLDS
    )


def plan_along(
    task: StepTask, path: Path, end: Hitch, phase: Phase, duration: float | None = None
) -> StepPlan:
    """Time a path, and return the plan of its motion; reading its certificate certifies it.

    Parameters
    ----------
    path: route to the hitch ``end``.
    phase: with the step's name, index, remark and range of tensions.
    duration: prescribed duration [s]; None for the fastest one.
    """
    from hitchopt.planners.timing.timed_motion import motion_along

    motion = motion_along(path, task.requirements, duration)
    return _plan_of(task, path, motion, end, phase)


def _plan_of(
    task: StepTask, path: Path | None, motion: Motion, end: Hitch, phase: Phase
) -> StepPlan:
    """Return the plan of a motion along a path, as one phase."""
    phases = (phase.retimed(0.0, motion.duration),)
    return replace(task.plan_ending(motion.replaced(phases=phases), end), path=path)


OBSTACLE_CHECKS = frozenset({"keep_out", "object_clearance"})
"""Checks of obstacles, over or around which hitches and objects fly."""

MAX_DETOURS = 6
"""Maximum number of detours of one path that are tried."""


def past_obstacles(
    task: StepTask, direct: StepPlan, path: P | None, along: Callable[[P], StepPlan]
) -> StepPlan:
    """Return a plan once it is certified, or one on a detour if only obstacles are in its way.

    Raises InfeasibleError with what the plan breaks, or the best one of its detours.

    Parameters
    ----------
    direct: plan along ``path``, which is None if its motion has none.
    along: returns the plan along another path.
    """
    from hitchopt.planners.morph.detours import detours

    def on_detour(route: P, shift: PiecewisePolynomial) -> StepPlan:
        """Return the certified plan along a translated path."""
        plan = require_certified(along(route.translated(shift)))
        farthest = float(np.max(length(shift.at(np.linspace(0.0, 1.0, 201)))))
        return plan.with_remark(f"on a detour of up to {farthest:.2g} m around obstacles")

    def candidates() -> Iterator[Candidate[StepPlan]]:
        """Yield the plan itself, and those on detours."""
        yield Candidate("route", partial(require_certified, direct))
        violated = {check.name for check in direct.certificate.violated}
        if path is not None and violated <= OBSTACLE_CHECKS:
            for shift in detours(path, task.requirements)[:MAX_DETOURS]:
                yield Candidate("detour", partial(on_detour, path, shift))

    return first_certified(candidates(), task.effort)


def straight_plan(
    task: StepTask, end: Hitch, phase: Phase, duration: float | None = None
) -> StepPlan:
    """Return the plan along the straight path to a hitch; of one at rest without a path."""
    from hitchopt.planners.morph.morph import moves, straight_path

    if not moves(task.hitch, end):
        rest = rest_motion(end, task.requirements, duration or IDLE, phase)
        return task.plan_ending(rest, end)
    path = straight_path(task.hitch, end, task.requirements)
    return plan_along(task, path, end, phase, duration)


def rigid_plan(
    task: StepTask, to: Array, yaw: float, phase: Phase, duration: float | None = None
) -> StepPlan:
    """Return the plan of a hitch that moves and turns without a change of its shape.

    Where prisms or objects may be in its way, it is certified. Raises InfeasibleError if the hitch
    breaks a limit at rest in the goal.

    Parameters
    ----------
    to: goal (3,) of its centroid [m].
    yaw: angle [rad] by which it turns about it.
    phase: with the step's name and index.
    duration: prescribed duration [s]; None for the fastest one.
    """
    from hitchopt.planners.morph.morph import check_loads
    from hitchopt.planners.path import RigidPath
    from hitchopt.planners.timing.timed_motion import motion_along

    requirements = task.requirements
    end = end_of_transport(task.hitch, to, yaw)
    check_at_rest(end, requirements, end_of_step(phase))
    path = RigidPath(task.hitch, to, yaw)
    if path.is_constant:
        return task.plan_ending(rest_motion(end, requirements, duration or IDLE, phase), end)
    check_loads(path, requirements.limits)

    def along(path: RigidPath) -> StepPlan:
        """Return the plan along a path."""
        motion = motion_along(path, requirements, duration)
        timed = motion.replaced(phases=(phase.retimed(0.0, motion.duration),))
        return task.plan_ending(timed, end)

    direct = along(path)
    if not requirements.keep_out and not requirements.objects:
        return direct
    return past_obstacles(task, direct, path, along)


def plan_like(
    task: StepTask, earlier: Motion, end: Hitch, phase: Phase, duration: float | None = None
) -> StepPlan:
    """Return the certified plan like an earlier one between nearly the same hitches.

    It is on the same route, moved to its own ends: of straight lines by the same clock as well,
    stretched or shortened to the limits. Parameters are those of ``plan_along``.
    """
    from hitchopt.planners.morph.morph import check_loads, clear_straight_path
    from hitchopt.planners.morph.retargeting import (
        EarlierRoute,
        motion_by_earlier_clock,
        straight_progress,
    )

    progress = straight_progress(earlier)
    if progress is None:
        phase = replace(phase, remark="on the route of an earlier plan")
        path = EarlierRoute.of(earlier).path(task.hitch, end)
        return require_certified(plan_along(task, path, end, phase, duration))
    path = clear_straight_path(task.hitch, end, task.requirements)
    motion = motion_by_earlier_clock(path, progress, task.requirements)
    if motion is None or duration is not None:
        check_loads(path, task.requirements.limits)
        return require_certified(plan_along(task, path, end, phase, duration))
    phase = replace(phase, remark="by the clock of an earlier plan")
    return require_certified(_plan_of(task, path, motion, end, phase))


MAX_ROLLING = 4
"""Maximum number of paths with legs that roll that are certified for one flight."""


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

    task: StepTask
    """The task of the step."""

    end: Hitch
    """The hitch after it."""

    phase: Phase
    """With the step's name and index, and the range of tensions that it states, if any."""

    own: Callable[[], StepPlan]
    """Returns the plan along the step's own route."""

    duration: float | None = None
    """Prescribed duration [s]; None for the fastest one."""

    replaces_slow: bool = False
    """True to replace an own route that takes much longer than its bound."""

    allow_slides: bool = False
    """True if legs lead and lag, so that cables slide through their clasps."""

    cost: CostFunction | None = None
    """Custom cost; None for the time alone."""

    def plan(self) -> StepPlan:
        """Return the plan along the first certified route."""
        return first_certified(self.candidates(), self.task.effort, self.task.progress)

    def candidates(self) -> Iterator[Candidate[StepPlan]]:
        """Yield the routes to the end: the optimised one first if the step requests it.

        Raises InfeasibleError if the step's own route is infeasible, and the hitch at an end of it
        breaks a limit at rest.
        """
        task = self.task
        is_requested = self._requests_optimiser()
        if is_requested:
            yield Candidate(OPTIMISED_ROUTE, self._requested_plan)
        yield Candidate(OWN_ROUTE, self._own_plan if is_requested else self.own_or_faster_plan)
        for hitch in (task.hitch, self.end):
            check_at_rest(hitch, task.requirements, end_of_step(self.phase))
        if task.optimiser and not is_requested:
            yield Candidate(OPTIMISED_ROUTE, self.optimised_plan)

    def _requests_optimiser(self) -> bool:
        """Return whether the step requests an optimised route."""
        from hitchopt.planners.morph.morph import moves

        for_time = self.allow_slides or self.phase.tension is not None
        is_requested = self.cost is not None or (for_time and self.duration is None)
        return self.task.optimiser and is_requested and moves(self.task.hitch, self.end)

    def _requested_plan(self) -> StepPlan:
        """Return the optimised plan that the step requests, which may be along straight lines."""
        from hitchopt.planners.morph.morph import straight_path

        ends = self.task.hitch, self.end
        straight = Candidate(
            "straight lines", partial(straight_path, *ends, self.task.requirements)
        )
        return self.optimised_plan(first_feasible([straight], None))

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
        faster = Candidate(FASTER_ROUTE, partial(self.optimised_plan, own.path, own))
        return first_feasible([faster], own)

    def optimised_plan(self, straight: Path | None = None, own: StepPlan | None = None) -> StepPlan:
        """Return the optimised plan.

        ``straight`` is the path along straight lines and ``own`` the plan along it, if known.
        """
        return OptimisedRoute(
            self.task,
            self.end,
            self.phase,
            self.duration,
            straight,
            own,
            self.allow_slides,
            self.cost,
        ).plan()


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
    check_at_rest(task.hitch, task.requirements, end_of_step(phase))
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
    plan = first_certified(candidates, task.effort, task.progress)
    return with_friction_feedforward(plan, timed=False)


def transport_plan(task: StepTask, to: Array) -> StepPlan:
    """Return the plan of the step ``transport`` to a goal (3,) [m], with its defaults."""
    plan = rigid_plan(task, to, 0.0, Phase("transport", task.index, 0.0, 0.0))
    return with_friction_feedforward(plan, timed=False)


def action_plan(
    task: StepTask,
    action: Action,
    end: Hitch,
    phase: Phase,
    duration: float | None,
    reason: str,
) -> StepPlan:
    """Return the plan of an action of the paper, whose remark names the further drones that move.

    Parameters
    ----------
    end: hitch after the action; its legs may differ from those of the action's law.
    phase: with the step's name and index.
    duration: prescribed duration [s]; None for the fastest one.
    reason: why its legs differ; empty if they do not.
    """
    from hitchopt.planners.morph.actions import ActionMorph

    flown = ActionMorph(action, end, task.requirements, duration).solve()
    if flown is None:
        rest = rest_motion(end, task.requirements, duration or IDLE, phase)
        return task.plan_ending(rest, end)
    phase = replace(phase, remark="; ".join(_remarks_on_drones(flown, action, reason)))
    return _plan_of(task, flown.path, flown.motion, end, phase)


def rolling_action_plan(
    task: StepTask, action: Action, end: Hitch, phase: Phase, duration: float | None
) -> StepPlan:
    """Return the certified plan of an action whose legs roll between its ends.

    Parameters are those of ``action_plan``. Raises InfeasibleError if legs come too close with any
    roll.
    """
    from hitchopt.planners.morph.actions import ActionMorph
    from hitchopt.planners.morph.legs import largest_roll

    morph = ActionMorph(action, end, task.requirements, duration)

    def along(path: Path) -> StepPlan:
        """Return the certified plan along one of the paths."""
        flown = morph.flown(path)
        remark = f"legs roll by up to {math.degrees(largest_roll(path)):.0f}° on the way"
        if flown.worst is not None:
            remark += f": limits bind at {flown.worst:.0%} of the path"
        return require_certified(
            _plan_of(task, path, flown.motion, end, replace(phase, remark=remark))
        )

    paths = morph.rolling[:MAX_ROLLING] or [morph.path_by_law]
    rolling = [Candidate("rolling path", partial(along, path)) for path in paths]
    return first_certified(rolling, task.effort, task.progress)


def _remarks_on_drones(flown: FlownAction, action: Action, reason: str) -> list[str]:
    """Describe the drones that move in addition to those of an action, and why."""
    team = action.start.team
    remarks = list[str]()
    if flown.worst is not None:
        reason = ", and ".join(
            filter(None, [reason, f"limits bind at {flown.worst:.0%} of the path"])
        )
    if flown.turning:
        cause = "tensions differ, so legs turn with both edges at their vertex"
        if np.any(action.start.roll):
            cause = "legs are rolled, so they turn with both edges at their vertex"
        elif team.loaded and np.ptp(team.tension) == 0.0:
            cause = "clasps carry weight, so legs rise as it changes"
        remarks.append(_further_drones(flown.turning, "turn", cause))
    if flown.sliding:
        remarks.append(_further_drones(flown.sliding, "slide", reason))
    return remarks


def _further_drones(names: Sequence[str], verb: str, reason: str) -> str:
    """Describe drones that move in addition to those of an action."""
    ending = "s" if len(names) == 1 else ""
    return f"{', '.join(names)} {verb}{ending} as well: {reason}"


@dataclass(frozen=True, eq=False)
class OptimisedRoute:
    """A route that the optimiser finds to a hitch, at the same altitude or not."""

    task: StepTask
    """The task of the step."""

    end: Hitch
    """The hitch after it."""

    phase: Phase
    """With the step's name, index and range of tensions."""

    duration: float | None = None
    """Prescribed duration [s]; None for the fastest one."""

    straight: Path | None = None
    """The step's own path, which is a candidate if it is feasible; None if it is not."""

    own: StepPlan | None = None
    """Certified plan along this path, if there is one."""

    allow_slides: bool = False
    """Whether legs that lead and lag are also tried."""

    cost: CostFunction | None = None
    """Minimised together with the duration."""

    _certified: dict[Motion, StepPlan] = field(default_factory=dict, init=False)
    """Certified plans by their motions."""

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
            self._certified_motion,
            self.phase.tension,
            self.straight,
            cost,
            task.effort,
        ).solve()
        if routes.rejected is not None:
            return self._plan_along_best(routes.rejected)
        if not routes.accepted:
            raise HitchoptError("no route was found")
        fastest = routes.accepted[0]
        plan = self._in_duration(self._certified[fastest.motion])
        remark = ""
        if plan.path is not self.straight:
            is_feasible = any(not route.name for route in routes.accepted)
            remark = self._remark(fastest.name, is_feasible=is_feasible)
        if (self.allow_slides or cost is not None) and self.duration is None:
            plan, gain = refined_plan(task, plan, self.phase, cost)
            remark = "; ".join(filter(None, [remark, gain]))
        return plan.with_remark(remark) if remark else plan

    def _certified_motion(self, path: Path) -> Motion | None:
        """Return a certified motion along a path, if possible with legs that lead and lag."""
        from hitchopt.planners.morph.legs import legs_clear, with_slides

        requirements = self.task.requirements
        climbing = self._climbing(path)
        candidates = list[Candidate[Motion]]()
        if self.allow_slides:
            candidates += [
                Candidate("route with slides", partial(self._certified_along, variant))
                for variant in with_slides(climbing, requirements.limits)
                if legs_clear(variant, requirements)
            ]
        candidates.append(Candidate("route", partial(self._certified_along, climbing)))
        return first_feasible(candidates, None)

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

    def _in_duration(self, plan: StepPlan) -> StepPlan:
        """Return the certified plan in the prescribed duration, if there is one."""
        from hitchopt.planners.timing.timed_motion import check_duration, in_duration

        if self.duration is None:
            return plan
        check_duration(self.duration, plan.motion.duration)
        slower = in_duration(plan.motion, self.duration)
        phases = (self.phase.retimed(0.0, self.duration),)
        return require_certified(replace(plan, motion=slower.replaced(phases=phases)))

    def _remark(self, guess: str, *, is_feasible: bool) -> str:
        """Describe a route from a guess; ``is_feasible`` says whether straight lines are."""
        route = f"on an optimised route, first guess {guess}" if guess else "legs lead and lag"
        if self.cost is not None:
            return route
        return f"{route}; {FASTER if is_feasible else DIRECT_INFEASIBLE}"

    def _plan_along_best(self, best: KnotPath) -> StepPlan:
        """Return the plan along the best route that was tried.

        Raises InfeasibleError with the limits that it breaks, and where along the route.
        """
        from hitchopt.planners.morph.morph import load_violation, shape_violation

        path = self._climbing(best.path)
        route = f"along {BEST_ROUTE} ({best.name})"
        violation = shape_violation(path) or load_violation(path, self.task.requirements.limits)
        if violation is not None:
            when = violation.when.replace("of the path", route)
            raise InfeasibleError([replace(violation, when=when)])
        plan = plan_along(self.task, path, self.end, self.phase)
        if plan.certificate.certified:
            return plan
        motion = plan.motion
        step = f"in step {self.phase.step} ({self.phase.name})"
        unplaced = infeasible_error(plan.certificate, motion).violations
        named = named_checks(plan.certificate, Flight.of(motion))
        placed = [
            replace(violation, when=f"at {check.time / motion.duration:.0%} {route}, {step}")
            for violation, check in zip(unplaced, named, strict=True)
        ]
        raise InfeasibleError(placed)


def refined_plan(
    task: StepTask, plan: StepPlan, phase: Phase, cost: FlightCost | None = None
) -> tuple[StepPlan, str]:
    """Return the plan with its route and clock refined together, and what it gained.

    It is the plan itself if none is shorter, with a cost none better.
    With friction at the clasps, plans are compared with legs that lean against it.
    """
    from hitchopt.planners.optimise.refinement import MAX_EFFORT, flight_cost, refined

    path = plan.path
    if path is None:
        return plan, ""
    has_friction = cost is None and task.hitch.team.friction > 0.0
    leaning = compensated(plan, timed=False) if has_friction else None

    def certified(route: Path, motion: Motion) -> StepPlan | None:
        """Return the certified plan of a shorter motion along another path."""
        phases = (phase.retimed(0.0, motion.duration),)
        shorter = replace(plan, motion=motion.replaced(phases=phases), path=route)
        if not shorter.certificate.certified:
            return None
        if leaning is not None:
            also_leaning = compensated(shorter, timed=False)
            is_longer = also_leaning.plan.motion.duration >= leaning.plan.motion.duration
            if is_longer or also_leaning.share < leaning.share:
                return None
        return shorter

    effort = Effort(MAX_EFFORT, whole=task.effort)
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
