"""Motions of single steps with their certificates: at rest, along routes, on free cables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.checks import Certificate, Check, certify
from hitchopt.checks.custom import Rule
from hitchopt.checks.registry import RULE_OF, TEAM_REPORTS
from hitchopt.checks.rule import REPORT_IT, CheckRule, ReportRule
from hitchopt.checks.tracking import TRACKING_RADIUS
from hitchopt.errors import (
    HitchoptError,
    InfeasibleError,
    RequestError,
    Violation,
)
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.casadi_model import CostFunction
from hitchopt.hitch.hitch import ALTITUDE_TOLERANCE, cable_slack
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import SETTLE, CableState, Motion, Phase, concatenated
from hitchopt.planners.candidates import Candidate, Effort, first_certified, first_feasible
from hitchopt.steps.step import IDLE, RestState, RolledLegs, SlackSplit, StepPlan, StepTask
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Points

if TYPE_CHECKING:
    from hitchopt.planners.morph.actions import Action
    from hitchopt.planners.morph.path import Path

LEVEL_TOLERANCE = 1e-3
"""Difference of heights up to which drones count as being at one height [m]: it changes a distance
of 0.24 m by less than 1e-5 m."""


@dataclass(frozen=True, eq=False)
class CertifiedMotion:
    """Motion of one team's whole plan with its certificate."""

    motion: Motion
    """The motion."""

    certificate: Certificate
    """Its certificate."""

    paths: tuple[Path | None, ...] = ()
    """Paths of the groups of steps; None for one that has none, or several."""


@dataclass(frozen=True, eq=False)
class CertifiedFlight:
    """Flight of a whole plan with its certificate."""

    flight: Flight
    """The flight."""

    certificate: Certificate
    """Its certificate."""


def require_certified(plan: StepPlan, when: str = "") -> StepPlan:
    """Return a certified plan, or raise InfeasibleError; ``when`` describes the time."""
    if not plan.certificate.certified:
        raise infeasible_error(plan.certificate, plan.motion, when)
    return plan


def require_tracking(motion: Motion, stated: Requirements | None) -> None:
    """Raise InfeasibleError if the tracking errors that a problem states, if any, break a distance.

    Planners' distances include them, but hanging cables are displaced farther; see
    ``tracking_radius``.
    """
    if stated is None or not stated.limits.tube.level:
        return
    flown = motion.replaced(requirements=stated.untimed)
    certificate = certify(flown, reports=())
    radius = certificate[TRACKING_RADIUS.name]
    if not radius.holds:
        raise infeasible_error(replace(certificate, limited=(radius,)), flown)


def rest_motion(hitch: Hitch, requirements: Requirements, duration: float, phase: Phase) -> Motion:
    """Return the motion of a hitch at rest for a duration [s]; the phase is retimed to it."""
    breaks = [0.0, duration]
    return Motion(
        hitch.team,
        requirements,
        drones=PiecewisePolynomial.constant(breaks, hitch.drones),
        vertices=PiecewisePolynomial.constant(breaks, hitch.vertices),
        legs=PiecewisePolynomial.constant(breaks, hitch.legs),
        tensions=PiecewisePolynomial.constant(breaks, hitch.team.tension),
        phases=(phase.retimed(0.0, duration),),
    )


def rest_plan(hitch: Hitch, requirements: Requirements) -> StepPlan:
    """Return the plan of a hitch at rest for one second."""
    motion = rest_motion(hitch, requirements, 1.0, Phase("hold", 0, 0.0, 1.0))
    return StepPlan(motion, RestState(hitch.team, hitch.drones, hitch))


def check_at_rest(hitch: Hitch, requirements: Requirements, when: str) -> None:
    """Raise InfeasibleError if the hitch breaks a limit at rest."""
    require_certified(rest_plan(hitch, requirements), when)


def infeasible_error(
    certificate: Certificate,
    flown: Motion | Flight,
    when: str = "",
    rules: Sequence[Rule[Any]] = (),
) -> InfeasibleError:
    """Return the error of a certificate's violations; ``when`` describes the time and step.

    ``rules`` are the custom rules in the certificate.
    """
    flight = Flight.of(flown)
    violations = list[Violation]()
    for check in named_checks(certificate, flight, rules):
        phases = _phases_at(check, flight)
        time_and_step = when
        if not when and check.name != "duration":
            step = f", in step {phases[0].step} ({phases[0].name})" if phases else ""
            time_and_step = f"at t = {check.time:.4g} s{step}"
        own_remedy = _remedy(check, flight, rules, at_start=bool(when))
        remedy = _separation_shortfall(check, flight) + own_remedy
        violations.append(check.violation(time_and_step, remedy))
    return InfeasibleError(violations)


def named_checks(
    certificate: Certificate, flight: Flight, rules: Sequence[Rule[Any]] = ()
) -> list[Check]:
    """Return the violated checks that a refusal names: those that a user can change, if any.

    What only a fault can break otherwise, such as the balance of an object that slips, follows from
    them.
    """
    violated = certificate.violated
    named = [check for check in violated if _remedy(check, flight, rules) != REPORT_IT]
    return named or list(violated)


def _phases_at(check: Check, flight: Flight) -> list[Phase]:
    """Return the phases in which a check is worst."""
    return [phase for phase in flight.phases if phase.start <= check.time <= phase.end]


def _remedy(
    check: Check, flight: Flight, rules: Sequence[Rule[Any]], *, at_start: bool = False
) -> str:
    """Return the suggested change for a violated check, and for the check that determines it.

    Drones without a hitch ``at_start`` are where the user placed them.
    """
    rule_of: dict[str, CheckRule | ReportRule] = {
        **RULE_OF,
        **{report.name: report for report in TEAM_REPORTS},
        **{rule.name: rule.check_rule for rule in rules},
    }
    rule = rule_of[check.name]
    if check.binding in rule_of:
        binding = replace(check, name=check.binding, binding="")
        return f"{_remedy(binding, flight, rules, at_start=at_start)}, or {rule.remedy}"
    phases = _phases_at(check, flight)
    is_free = bool(phases) and not any(phase.formed for phase in phases)
    remedy = rule.free_remedy if is_free else ""
    if at_start and is_free and isinstance(rule, CheckRule):
        remedy = rule.start_remedy or remedy
    if not remedy and isinstance(rule, CheckRule) and len(flight.teams) == 1:
        remedy = rule.remedy_at(flight.teams[0].motion, check)
    return remedy or rule.remedy


def _separation_shortfall(check: Check, flight: Flight) -> str:
    """Describe the distance of two drones at one height and its shortfall, or return nothing."""
    if check.name != "separation":
        return ""
    heights = list[float]()
    for flown in flight.all_teams:
        drones = flown.motion.drones
        first, last = drones.breaks[[0, -1]]
        places = drones.at(float(np.clip(check.time, first, last)))
        names = map(flown.label, flown.motion.team.drone_names)
        for name, place in zip(names, places, strict=True):
            if name in check.where:
                heights.append(place[2])
    if np.ptp(heights) > LEVEL_TOLERANCE:
        return ""
    diameter = 2.0 * flight.requirements.separation.radius
    required = diameter * check.number
    distance = diameter * check.worst
    return f"{distance:.3g} m apart, {required - distance:.3g} m too close: "


# The hitch at the end of a step, and routes to it.


def split_hitch(
    team: Team,
    polygon: Outline | Points,
    altitude: float,
    legs: SlackSplit,
    requirements: Requirements,
) -> Hitch:
    """Return the hitch with the slack split ``legs``."""
    sharing = legs.sharing if isinstance(legs, RolledLegs) else legs
    roll = legs.roll if isinstance(legs, RolledLegs) else None
    if isinstance(sharing, str) and sharing == "spread":
        return Hitch.spread(
            team,
            polygon,
            altitude,
            roll=roll,
            limits=requirements.limits,
            separation=requirements.separation,
        )
    initial_roll = 0.0 if roll is None else roll
    if isinstance(sharing, str):
        hitch = Hitch.balanced(team, polygon, altitude, initial_roll)
    else:
        hitch = Hitch(team, polygon, altitude, sharing, initial_roll)
    auto_roll = isinstance(legs, RolledLegs) and roll is None
    return hitch.least_rolled(requirements) if auto_roll else hitch


class End(NamedTuple):
    """The end of a step."""

    hitch: Hitch
    """Hitch after the step."""

    reason: str = ""
    """Description of the limit that the legs of the paper's action would break, if they do."""


def end_of_morph(
    start: Hitch, polygon: Outline, legs: SlackSplit | None, requirements: Requirements
) -> End:
    """Return the hitch on ``polygon``; by default its fractions are nearest to the initial ones."""
    if legs is not None:
        return End(split_hitch(start.team, polygon, start.altitude, legs, requirements))
    return End(_nearest(start, polygon, start.fractions, requirements))


def end_of_action(action: Action, legs: SlackSplit | None, requirements: Requirements) -> End:
    """Return the hitch after an action; by default its legs are nearest to the action's own."""
    from hitchopt.planners.morph.legs import SLIDING_TOLERANCE

    start = action.start
    polygon = action.polygon
    if legs is not None:
        return end_of_morph(start, polygon, legs, requirements)
    legs_by_law = action.legs_by_law

    def by_law() -> End:
        """Return the hitch with the legs of the action's law."""
        hitch = Hitch(start.team, polygon, start.altitude, legs_by_law, start.roll)
        check_at_rest(hitch, requirements, "at the end")
        return End(hitch)

    def nearest_to_law(violation: Violation) -> End:
        """Return the feasible hitch with the nearest legs; they avoid the violation of the law."""
        fractions = legs_by_law / cable_slack(start.team, polygon)
        nearest = _nearest(start, polygon, fractions, requirements)
        # A cable that does not slide keeps its legs to the last bit, so that its drones stay
        slides = np.abs(nearest.q_legs - legs_by_law) >= SLIDING_TOLERANCE
        q_legs = np.where(slides, nearest.q_legs, legs_by_law)
        end = Hitch(start.team, polygon, start.altitude, q_legs, nearest.roll)
        reason = replace(violation, when="at the end", remedy="with the action's own legs")
        return End(end, str(reason))

    def amended(error: InfeasibleError) -> Candidate[End]:
        """Return the nearest legs as a candidate."""
        return Candidate("nearest legs", partial(nearest_to_law, error.violations[0]))

    return first_certified([Candidate("the action's own legs", by_law, amended)], Effort())


def _nearest(
    start: Hitch, polygon: Outline, fractions: ArrayLike, requirements: Requirements
) -> Hitch:
    """Return the feasible hitch with the nearest fractions."""
    return Hitch.nearest(
        start.team,
        polygon,
        start.altitude,
        fractions,
        roll=start.roll,
        limits=requirements.limits,
        separation=requirements.separation,
        arena=requirements.arena,
    )


DIRECT_INFEASIBLE = "the step's own route is infeasible"
OWN_ROUTE = "the step's own route"
OPTIMISED_ROUTE = "optimised route"
FASTER_ROUTE = "faster route"
BEST_ROUTE = "the best route tried"
FASTER = "faster than the step's own route"


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
    phases = (phase.retimed(0.0, motion.duration),)
    return replace(task.plan_ending(motion.replaced(phases=phases), end), path=path)


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


def plan_to_hitch(task: StepTask, end: Hitch, phase: Phase) -> StepPlan:
    """Return the plan of a morph to a hitch at any altitude, on a straight route or a faster one.

    ``phase`` has the name and the index of the step. Raises InfeasibleError if no route was found.
    """

    def straight_or_faster() -> StepPlan:
        """Return the plan along the straight route, or a faster one if that is slow."""
        own = require_certified(straight_plan(task, end, phase))
        if not task.optimiser or own.path is None or not is_slow(own, task.hitch, end):
            return own
        faster = partial(optimised_plan, task, end, phase, straight=own.path)
        return first_feasible(Candidate(FASTER_ROUTE, faster), own)

    routes = [Candidate(OWN_ROUTE, straight_or_faster)]
    if task.optimiser:
        routes.append(Candidate(OPTIMISED_ROUTE, partial(optimised_plan, task, end, phase)))
    return first_certified(routes, task.effort, task.progress)


def optimised_plan(
    task: StepTask,
    end: Hitch,
    phase: Phase,
    duration: float | None = None,
    *,
    straight: Path | None = None,
    allow_slides: bool = False,
    cost: CostFunction | None = None,
) -> StepPlan:
    """Return the fastest plan that the optimiser finds to a hitch, at the same altitude or not.

    Raises InfeasibleError if the plan takes longer than ``duration`` [s].

    Parameters
    ----------
    phase: with the step's name, index and range of tensions.
    duration: prescribed duration [s], or None.
    straight: the step's own path, which is a candidate if it is feasible; None if it is not.
    allow_slides: also try legs that lead and lag.
    cost: minimised together with the duration.
    """
    from hitchopt.planners.morph.legs import legs_clear, with_slides
    from hitchopt.planners.optimise.cost import ShapeCost
    from hitchopt.planners.optimise.search import NoRouteError, OptimisedMorph
    from hitchopt.planners.timing.timed_motion import check_duration, in_duration

    requirements = task.requirements
    climb = end.altitude - task.hitch.altitude
    certified: dict[Motion, StepPlan] = {}

    def climbing(path: Path) -> Path:
        """Return a path of the search, which is horizontal, with the climb to the end."""
        return path if path is straight or climb == 0.0 else path.climbing(climb)

    def certified_motion(path: Path) -> Motion | None:
        """Return a certified motion along a path, if possible with legs that lead and lag."""
        climbed = climbing(path)
        variants: list[Path] = []
        if allow_slides:
            sliding = with_slides(climbed, requirements.limits)
            variants += [variant for variant in sliding if legs_clear(variant, requirements)]
        for variant in (*variants, climbed):
            try:
                plan = plan_along(task, variant, end, phase)
            except HitchoptError:
                if variant is climbed:
                    raise
                continue
            if plan.certificate.certified:
                certified[plan.motion] = plan
                return plan.motion
        return None

    shape_cost = None if cost is None else ShapeCost(task.hitch.team, cost)
    morph = OptimisedMorph(
        task.hitch,
        end,
        requirements,
        certified_motion,
        phase.tension,
        straight,
        shape_cost,
        task.effort,
    )
    try:
        candidates = morph.solve()
    except NoRouteError as error:
        path = climbing(error.best.path)
        return _plan_along_best(task, path, error.best.name, end, phase)
    if not candidates:
        raise HitchoptError("no route was found")
    fastest = candidates[0]
    plan = certified[fastest.motion]
    if duration is not None:
        check_duration(duration, plan.motion.duration)
        slower = in_duration(plan.motion, duration)
        slower = slower.replaced(phases=(phase.retimed(0.0, duration),))
        plan = require_certified(replace(plan, motion=slower))
    if plan.path is straight:
        return plan
    route = "legs lead and lag"
    if fastest.name:
        route = f"on an optimised route, first guess {fastest.name}"
    if cost is not None:
        return plan.with_remark(f"{route}; its cost is {fastest.cost:.4g} s")
    is_feasible = any(not candidate.name for candidate in candidates)
    return plan.with_remark(f"{route}; {FASTER if is_feasible else DIRECT_INFEASIBLE}")


def _plan_along_best(task: StepTask, path: Path, name: str, end: Hitch, phase: Phase) -> StepPlan:
    """Return the plan along the best route that was tried; ``name`` is that of its guess.

    Raises InfeasibleError with the limits that it breaks, and where along the route.
    """
    from hitchopt.planners.morph.morph import check_loads, check_shapes

    route = f"along {BEST_ROUTE} ({name})"
    try:
        check_shapes(path)
        check_loads(path, task.requirements.limits)
    except InfeasibleError as error:
        violations = [
            replace(violation, when=violation.when.replace("of the path", route))
            for violation in error.violations
        ]
        raise InfeasibleError(violations, error.note) from error
    plan = plan_along(task, path, end, phase)
    if plan.certificate.certified:
        return plan
    motion = plan.motion
    step = f"in step {phase.step} ({phase.name})"
    unplaced = infeasible_error(plan.certificate, motion).violations
    named = named_checks(plan.certificate, Flight.of(motion))
    placed = [
        replace(violation, when=f"at {check.time / motion.duration:.0%} {route}, {step}")
        for violation, check in zip(unplaced, named, strict=True)
    ]
    raise InfeasibleError(placed)


FRICTION_SHARES = (1.0, 0.8, 0.65, 0.5, 0.4, 0.3, 0.25)
"""Fractions of the friction that feed-forward compensates; the first certified one is used."""

FULL_SHARE = 0.99
"""Fraction of the friction that counts as all of it."""

MAX_SLOWDOWN = 1.5
"""Maximum ratio of a step's duration with friction feed-forward to that without."""

MIN_SLIDE = 1e-3
"""[m] Change of leg lengths below which a step ends without settling."""

NOT_COMPENSATED = "clasp friction is not compensated: limits bind"


def with_friction_feedforward(plan: StepPlan, *, timed: bool) -> StepPlan:
    """Return the plan in which legs lean against friction, as far as limits allow.

    Unless its duration is prescribed (``timed``) or limited, MAX_SLOWDOWN bounds the slowdown.
    """
    motion = plan.motion
    if motion.team.cable_friction == 0.0:
        return plan
    from hitchopt.planners.morph.friction import feedforward_matters, friction_feedforward

    if not feedforward_matters(motion):
        return plan
    slower = not timed and motion.requirements.limits.duration is None
    for share in FRICTION_SHARES:
        feedforward = friction_feedforward(motion, share, slower=slower)
        if feedforward is None or feedforward.motion.duration > MAX_SLOWDOWN * motion.duration:
            continue
        remark = f"legs lean against friction, by up to {math.degrees(feedforward.lean):.2g}°"
        if share < 1.0:
            remark += f" ({share:.0%} of the friction: limits bind)"
        compensated = replace(plan, motion=feedforward.motion).with_remark(remark)
        if compensated.certificate.certified:
            return compensated
    return plan.with_remark(NOT_COMPENSATED)


def plan_blended(steps: Sequence[Any], task: StepTask) -> StepPlan:
    """Return the plan of shape steps without a stop in between; ``task`` is the first step's.

    One path leads through the end hitches of all steps and is timed as a whole; each phase ends as
    the path passes its step's hitch. Raises InputError for a step without motion.
    """
    from hitchopt.planners.morph.morph import BlendedMorph, moves

    requirements = task.requirements
    hitches = [task.hitch]
    for i, step in enumerate(steps, task.index):
        start = hitches[-1]
        step_task = StepTask(RestState(start.team, start.drones, start), i, requirements)
        end = step.end(step_task).hitch
        step.check_end(end, step_task)
        if not moves(start, end):
            bound = "a step with motion if steps are blended"
            remedy = "omit it, or omit blend"
            raise RequestError(f"mission[{i}].{step.name}", "no motion", bound, remedy)
        hitches.append(end)
    motion, joints = BlendedMorph(hitches, requirements).solve()
    times = [0.0, *joints.tolist(), motion.duration]
    remarks = ["continues without a stop"] * (len(steps) - 1) + [""]
    phases = tuple(
        Phase(step.name, task.index + j, times[j], times[j + 1], remarks[j])
        for j, step in enumerate(steps)
    )
    plan = task.plan_ending(motion.replaced(phases=phases), hitches[-1])
    return with_friction_feedforward(plan, timed=False)


def with_settling(plan: StepPlan, task: StepTask, settle: float | str | bool) -> StepPlan:
    """Return the plan with swings at its end that remove the hysteresis of cables that slid.

    ``settle`` is ``Step.settling`` of its last step. If limits bind, automatic swings are omitted,
    and swings of a prescribed duration [s] raise InfeasibleError.
    """
    hitch = plan.after.hitch
    if settle is False or hitch is None or hitch.team.cable_friction == 0.0:
        return plan
    was_tied = task.before.hitch is None
    largest_slide = np.max(np.ptp(plan.motion.legs.coefficients, axis=(0, -1)))
    if not was_tied and largest_slide < MIN_SLIDE:
        return plan
    seconds = settle if isinstance(settle, float) else None
    settling = settling_plan(
        task.within(task.requirements, plan.after),
        seconds,
        Phase(SETTLE, plan.motion.phases[-1].step, 0.0, 0.0),
        required=seconds is not None,
    )
    return replace(plan, motion=concatenated([plan.motion, settling.motion]))


def settling_plan(
    task: StepTask, duration: float | None, phase: Phase, *, required: bool = True
) -> StepPlan:
    """Return the plan in which drones swing to remove friction hysteresis at the clasps.

    They swing as far as limits allow for a duration [s], by default SWINGS of SWING, or longer if
    limits need that. Raises InfeasibleError if limits bind and the swing is ``required``.
    """
    from hitchopt.planners.morph.friction import SWING, SWINGS, settling_swings
    from hitchopt.planners.timing.timed_motion import needed_stretch

    hitch = task.hitch
    requirements = task.requirements
    plan: StepPlan | None = None
    rest_duration = SWINGS * SWING if duration is None else duration
    rest = rest_motion(hitch, requirements, rest_duration, phase)
    for share in FRICTION_SHARES:
        settling = settling_swings(rest, share)
        if settling is None:
            break
        swings, swing_share = settling
        motion = swings.motion
        remark = f"drones swing by up to {math.degrees(swings.lean):.2g}°"
        factor = needed_stretch(motion)
        if factor > 1.0 and duration is None and factor <= MAX_SLOWDOWN:
            motion = motion.slowed(factor)
        if swing_share < FULL_SHARE:
            remark += f" (at least {swing_share:.0%} of the swing that suffices: legs bind)"
        plan = task.plan_ending(motion, hitch).with_remark(remark)
        if plan.certificate.certified:
            return plan
    if plan is None:
        return task.plan_ending(rest, hitch).with_remark("no leg can lean against friction")
    if required:
        raise infeasible_error(plan.certificate, plan.motion)
    unsettled = task.plan_ending(rest_motion(hitch, requirements, IDLE, phase), hitch)
    return unsettled.with_remark("friction hysteresis is not removed: limits bind")


# Motions on free cables.


def hover_motion(task: StepTask, duration: float) -> Motion:
    """Return the motion of parked or hovering drones at rest on free cables."""
    from hitchopt.planners.forming.stages import stage

    team = task.before.team
    rest = PiecewisePolynomial.constant([0.0, duration], task.before.drones)
    motion = stage("parked", rest, team, task.requirements, task.index, CableState.GROUND)
    (phase,) = motion.phases
    if phase.state is not CableState.FREE:
        return motion
    return replace(motion, phases=(replace(phase, name="hold"),))


def check_start(task: StepTask) -> None:
    """Raise InfeasibleError if drones on free cables break a limit at the start."""
    try:
        require_certified(StepPlan(hover_motion(task, 1.0), task.before), "at the start (t = 0)")
    except InfeasibleError as error:
        spans = list[Violation]()
        consequences = list[Violation]()
        for violation in error.violations:
            if violation.constraint == "span":
                spans.append(_overstretched(violation, task.before))
            else:
                consequences.append(violation)
        raise InfeasibleError([*spans, *consequences], error.note) from error


def _overstretched(violation: Violation, state: RestState) -> Violation:
    """Return the violation of a span at the start, with the names and the distance of drones."""
    k = int(violation.where[0].removeprefix("cable "))
    q, r = state.drones[2 * k : 2 * k + 2]
    distance = float(np.linalg.norm(r - q))
    remedy = (
        f"{distance:.6g} m apart on a cable of {state.team.cable_length[k]:.6g} m: move q{k} and "
        f"r{k} of start.drones closer together, or use a longer cable"
    )
    return replace(violation, where=(f"robot {k}", f"q{k}", f"r{k}"), remedy=remedy)


def check_above_ground(motion: Motion) -> None:
    """Raise InfeasibleError if drones of a plan without an arena go below the ground, z = 0."""
    heights = motion.drones.coefficients[:, :, 2]
    if motion.requirements.arena is not None or np.min(heights) >= -ALTITUDE_TOLERANCE:
        return
    piece, drone, _ = np.unravel_index(int(np.argmin(heights)), heights.shape)
    lowest = float(np.min(heights))
    where = (motion.team.drone_names[drone],)
    when = f"above the ground at about t = {motion.drones.breaks[piece]:.4g} s"
    remedy = "keep altitudes above 0, or add an arena with a lower floor"
    raise InfeasibleError([Violation("arena", lowest, 0.0, "min", "m", where, when, remedy)])
