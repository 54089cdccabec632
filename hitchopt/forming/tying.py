"""Tying and untying a hitch: the ways to do so, and the plans of their parts."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np

from hitchopt.checks.linking import INTERLACING
from hitchopt.checks.tracking import TRACKING_RADIUS
from hitchopt.checks.violations import infeasible_error
from hitchopt.errors import InfeasibleError
from hitchopt.forming.approach import (
    Approach,
    DirectApproach,
    GatheredApproach,
    OverApproach,
    assign_pairs,
    assign_robots,
)
from hitchopt.forming.circles import FURTHER_SIZES, SIZES, CircleSize, CircularHitches
from hitchopt.forming.prehitch import PreHitch, find_prehitch
from hitchopt.forming.swap_settings import SwapSettings
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.hitch import ALTITUDE_TOLERANCE
from hitchopt.hitch.requirements import LANDING, Requirements
from hitchopt.hitch.team import Assignment
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.motion import Motion, Phase, concatenated
from hitchopt.planners.along import action_plan, vertical_motion
from hitchopt.planners.candidates import Candidate, Effort, first_certified
from hitchopt.planners.ends import RolledLegs, SlackSplit, end_of_action, split_hitch
from hitchopt.planners.morph.actions import adjust
from hitchopt.planners.rests import check_at_rest, check_hover, rest_plan
from hitchopt.planners.routes import RouteSearch, plan_to_hitch
from hitchopt.planners.stages import hover_altitude, reversed_stages, stage, straight_lines
from hitchopt.planners.task import StepPlan, StepTask, require_certified, require_tracking
from hitchopt.values import Array
from hitchopt.values.fields import with_fields

T = TypeVar("T")

CABLE_MARGINS = (1.5, 1.25)
"""Preferred clearances of drones from cables during tightening, in ``separation.cable``."""


def end_of_form(
    team: Team,
    outline: Outline,
    altitude: float,
    legs: SlackSplit | None,
    requirements: Requirements,
) -> Hitch:
    """Return the hitch that is tied; without ``legs`` with the largest feasible cable margin."""
    if legs is not None:
        return split_hitch(team, outline, altitude, legs, requirements)
    spread = split_hitch(team, outline, altitude, "spread", requirements)
    same_roll = RolledLegs("spread", spread.roll)
    clearance = rest_plan(spread, requirements).certificate["cable_clearance"].worst
    for margin in CABLE_MARGINS:
        preferred = margin * requirements.separation.cable
        if clearance >= preferred:
            break
        separation = with_fields(requirements.separation, cable=preferred)
        wider = replace(requirements, separation=separation)
        hitch = split_hitch(team, outline, altitude, same_roll, wider)
        if rest_plan(hitch, wider).certificate.certified:
            return hitch
    return spread


SLACK_EVENNESS = (0.0, 1.0, 10.0, 100.0)
"""Costs of uneven slack in the assignment of unequal cables, in the order of the search."""


def holding_assignment(
    team: Team,
    drones: Array,
    outline: Outline,
    requirements: Requirements,
    goal: Callable[[Team], Hitch],
) -> Assignment:
    """Return the assignment of robots to edges with the shortest flights of drones (2n, 3) [m].

    It is the first one with which the hitch of the assigned team, its ``goal``, holds at rest: if
    short flights leave some cables too little slack, or others too much, slack is to be more even.
    """
    leg = requirements.limits.leg

    def holding(evenness: float) -> Assignment:
        """Return the assignment with a cost of uneven slack, if the hitch holds at rest."""
        assignment = assign_robots(team, drones, outline, leg, evenness)
        check_at_rest(goal(assignment.team(team)), requirements, "")
        return assignment

    even = (Candidate("assignment", partial(holding, evenness)) for evenness in SLACK_EVENNESS)
    shortest = Candidate("any slack", partial(assign_robots, team, drones, outline, leg))
    return first_certified([*even, shortest], Effort())


SWAP = "swap"  # Name of the settings of turns in what steps leave to later ones


def tyings(task: StepTask, goal: Hitch, swap: SwapSettings) -> Iterator[Candidate[StepPlan]]:
    """Yield the ways to tie the goal.

    Drones swap to tie the goal directly, or another hitch on a circle that becomes the goal.
    """
    requirements = task.requirements

    def directly(settings: SwapSettings, larger_errors: float) -> StepPlan:
        """Return the plan that ties the goal, planned for larger errors [m]."""
        needed = requirements.with_larger_errors(larger_errors)
        tying = find_prehitch(goal, needed, settings).clear_of_ground(needed)
        return require_certified(tied_plan(task, tying, goal))

    def on_circle(tying: PreHitch) -> StepPlan:
        """Return the plan that ties a hitch on a circle, and morphs it to the goal."""
        tying = tying.clear_of_ground(requirements)
        return morphed_plan(task, tied_plan(task, tying, tying.hitch), goal)

    for way in swap_ways(swap):
        yield with_larger_errors(f"{way.name}swaps", partial(directly, way.settings))
        for tying in tyings_on_circles(goal, requirements, way):
            yield Candidate(f"{way.name}circle", partial(on_circle, tying))


def untyings(task: StepTask) -> Iterator[Candidate[StepPlan]]:
    """Yield the ways to untie the hitch.

    Drones swap to untie the hitch as it is, or one on a circle in its place.
    """
    requirements = task.requirements
    hitch = task.hitch
    senses = task.before.assumed_senses

    def directly(swap: SwapSettings, larger_errors: float) -> StepPlan:
        """Return the plan that unties the hitch as it is, planned for larger errors [m]."""
        needed = requirements.with_larger_errors(larger_errors)
        tying = find_prehitch(hitch, needed, swap).with_senses(senses)
        plan = require_untied(untied_plan(task, tying.clear_of_ground(needed), hitch), senses)
        require_tracking(plan.motion, task.stated)
        return plan

    def on_circle(tying: PreHitch) -> StepPlan:
        """Return the plan that unties a hitch on a circle in its place."""
        tying = tying.with_senses(senses).clear_of_ground(requirements)
        return unmorphed_plan(task, tying)

    for way in swap_ways(task.before.kept.get(SWAP, SwapSettings())):
        yield with_larger_errors(f"{way.name}swaps", partial(directly, way.settings))
        for tying in tyings_on_circles(hitch, requirements, way):
            yield Candidate(f"{way.name}circle", partial(on_circle, tying))


MAX_TIED = 12  # Maximum number of hitches on circles that are tried
MAX_SHAPES = 3  # Maximum number of their shapes, each of which is turned


class SwapWay(NamedTuple):
    """Swaps with some settings: of the hitch itself, and of hitches on circles."""

    name: str  # Start of the names of its candidates
    settings: SwapSettings  # The settings
    sizes: tuple[CircleSize, ...]  # Sizes of hitches on circles


STEEP_TILT = math.radians(60.0)
"""[rad] Tilt of swaps that keep drones farther from short cables, and take longer."""

STEEP_RADIUS = 0.25  # [m] Smallest semi-axis of these swaps


def swap_ways(swap: SwapSettings) -> Iterator[SwapWay]:
    """Yield swaps in the order of the search: as they are set, then steeper if that is free."""
    yield SwapWay("", swap, SIZES)
    default = SwapSettings()
    if (swap.tilt, swap.radius) == (default.tilt, default.radius):
        steeper = replace(swap, tilt=STEEP_TILT, radius=STEEP_RADIUS)
        yield SwapWay("steeper ", steeper, SIZES + FURTHER_SIZES)


def tyings_on_circles(goal: Hitch, requirements: Requirements, way: SwapWay) -> Iterator[PreHitch]:
    """Yield pre-hitches of hitches on circles near a closed goal, to be morphed to it.

    Their shapes are feasible; their altitude is that of the goal.
    """
    if not goal.team.layout.closed:
        return
    circles = CircularHitches(goal, requirements)
    feasible = (
        shape
        for shape in circles.shapes(way.sizes)
        if not find_prehitch(shape, requirements, way.settings).doubtful
    )
    shapes = list(itertools.islice(feasible, MAX_SHAPES))
    by_phase = zip(*map(circles.placed, shapes), strict=True)  # all shapes at one turn, then next
    placed = itertools.chain.from_iterable(by_phase)
    for hitch in itertools.islice(placed, MAX_TIED):
        yield find_prehitch(hitch, requirements, way.settings)


def tied_plan(task: StepTask, tying: PreHitch, goal: Hitch) -> StepPlan:
    """Return the plan that ties a hitch of the goal's shape elsewhere and lowers it to the goal.

    Drones fly to where cables hang clear of each other and of the ground, and tie the hitch there.
    """
    requirements = task.requirements
    tied = concatenated(tying.stages(requirements, task.index))
    if tying.doubtful:  # no approach helps if tying is infeasible
        require_certified(StepPlan(tied, task.before))
    require_tracking(tied, task.stated)
    motions = [approach_motion(task, tying.drones_hanging), tied]
    if abs(tying.hitch.altitude - goal.altitude) > ALTITUDE_TOLERANCE:
        lower = Phase("lower", task.index, 0.0, 0.0, HEIGHT_REMARK)
        motions.append(vertical_motion(tying.hitch, goal.altitude, requirements, lower))
    after = replace(task.before, hitch=goal, drones=goal.drones, senses=tying.senses)
    return StepPlan(concatenated(motions), after)


def morphed_plan(task: StepTask, tied: StepPlan, goal: Hitch) -> StepPlan:
    """Return a certified plan that continues to the goal, with shape and altitude at once."""
    phase = Phase("morph", task.index, 0.0, 0.0, CIRCLE_REMARK)
    plan = reshaped(task.within(task.requirements, tied.after), goal, phase)
    return require_certified(replace(plan, motion=concatenated([tied.motion, plan.motion])))


def untied_plan(task: StepTask, tying: PreHitch, hitch: Hitch) -> StepPlan:
    """Return the plan that unties the task's hitch, with the legs of ``hitch``."""
    requirements = task.requirements
    motions = adjusting_motions(task, hitch.q_legs)
    if abs(tying.hitch.altitude - hitch.altitude) > ALTITUDE_TOLERANCE:
        higher = Phase("raise", task.index, 0.0, 0.0, HEIGHT_REMARK)
        motions.append(vertical_motion(hitch, tying.hitch.altitude, requirements, higher))
    motions += reversed_stages(tying.stages(requirements, task.index))
    drones = tying.drones_hanging
    after = replace(task.before, drones=drones, hitch=None, senses=None)
    return StepPlan(concatenated(motions), after)


def unmorphed_plan(task: StepTask, tying: PreHitch) -> StepPlan:
    """Return the plan that morphs the task's hitch to one on a circle, and unties that."""
    phase = Phase("morph", task.index, 0.0, 0.0, CIRCLE_REMARK)
    morph = reshaped(task, tying.hitch, phase)
    untied = untied_plan(task.within(task.requirements, morph.after), tying, tying.hitch)
    whole = replace(untied, motion=concatenated([morph.motion, untied.motion]))
    return require_untied(whole, tying.senses)


def require_untied(plan: StepPlan, senses: Array) -> StepPlan:
    """Return a certified plan that unties a hitch tied with turning senses (clasps,).

    By itself a hitch counts as tied with every q going up first. How others interlace follows from
    the motion that tied them, in the certificate of the whole plan.
    """
    if np.all(senses > 0.0):
        return require_certified(plan)
    certificate = plan.certificate
    limited = tuple(check for check in certificate.limited if check.name != INTERLACING.name)
    if all(check.holds for check in limited):
        return plan
    raise infeasible_error(replace(certificate, limited=limited), plan.motion)


def reshaped(task: StepTask, end: Hitch, phase: Phase) -> StepPlan:
    """Return the plan of a morph, for a share of the task's effort."""
    effort = Effort(MORPH_EFFORT_PER_ROBOT * task.before.team.robots, whole=task.effort)
    return plan_to_hitch(replace(task, effort=effort), end, phase)


MORPH_EFFORT_PER_ROBOT = 4e3
"""Effort per robot of the morph between a hitch on a circle and the goal: twice the largest one of
eight irregular hitches that are tied so; where it does not suffice, another circle is faster."""


def approach_motion(task: StepTask, goal: Array) -> Motion:
    """Return the motion of free cables along the first feasible route, or raise one error."""
    before = task.before
    requirements = task.requirements

    def certified(kind: type[Approach], larger_errors: float) -> Motion:
        """Return the certified motion of a kind of approach, planned for larger errors [m]."""
        needed = requirements.with_larger_errors(larger_errors)
        approach = kind(before.team, before.drones, goal, needed, task.index)
        motion = concatenated(approach.solve()).replaced(requirements=requirements)
        require_certified(StepPlan(motion, before))
        require_tracking(motion, task.stated)
        return motion

    kinds: list[type[Approach]] = [DirectApproach, GatheredApproach]
    if requirements.objects:
        kinds.append(OverApproach)
    ways = (with_larger_errors(kind.name, partial(certified, kind)) for kind in kinds)
    return first_certified(ways, task.effort, task.progress)


def flight_over(task: StepTask, spots: Array, *, in_order: bool) -> StepPlan:
    """Return the plan of free cables to hover over landing spots (2n, 2) [m].

    Spots are those of q0, r0, q1, … ``in_order``; otherwise robots are assigned to pairs of spots
    with the shortest flights. Drones do not descend on the way.
    """
    before = task.before
    team = before.team
    places = team.listed
    if not in_order:
        pairs = spots.reshape(-1, 2, 2)
        spans = np.linalg.norm(pairs[:, 1] - pairs[:, 0], axis=-1)
        too_far = spans >= team.cable_length[:, None]
        places = assign_pairs(before.drones, pairs, excluded=too_far).drones
    goal = np.zeros(before.drones.shape)
    goal[places, :2] = spots
    goal[:, 2] = task.requirements.ground_for(LANDING)
    check_hover(task, goal, "landed")
    altitude = hover_altitude(team, goal, task.requirements)
    goal[:, 2] = max(altitude, float(np.max(before.drones[:, 2])))
    check_hover(task, goal, "over the spots")
    return StepPlan(approach_motion(task, goal), replace(before, drones=goal))


def descent(task: StepTask) -> StepPlan:
    """Return the plan of free cables whose drones descend straight to the ground."""
    before = task.before
    requirements = task.requirements
    flat = np.array([1.0, 1.0, 0.0])
    floor = requirements.ground_for(LANDING) * np.array([0.0, 0.0, 1.0])
    landed = before.drones * flat + floor
    flight = straight_lines(before.team, requirements.limits, before.drones, landed)
    motion = stage("land", flight, before.team, requirements, task.index, CableState.GROUND)
    return StepPlan(motion, replace(before, drones=landed))


MIN_LARGER_ERRORS = 1e-3  # [m] Smallest increase of errors for which free cables are planned again

ERROR_FACTOR = 2.0
"""Factor on the missing radius of tracking errors by which free cables are planned for larger ones:
heights of hanging cables grow faster than errors."""

MAX_LARGER_ERRORS = 0.05  # [m] Largest increase of errors for which free cables are planned


def with_larger_errors(
    name: str, planner: Callable[[float], T], larger_errors: float = 0.0
) -> Candidate[T]:
    """Return a candidate that is amended to one for the tracking errors that it lacks, if few.

    ``planner`` returns the certified plan for errors larger by a distance [m].
    """

    def amended(error: InfeasibleError) -> Candidate[T] | None:
        """Return the candidate for larger errors."""
        missing = missing_radius(error)
        larger = larger_errors + max(ERROR_FACTOR * missing, MIN_LARGER_ERRORS)
        if not missing or larger > MAX_LARGER_ERRORS:
            return None
        return with_larger_errors(name, planner, larger)

    whole_name = f"{name}{' with larger errors' if larger_errors else ''}"
    return Candidate(whole_name, partial(planner, larger_errors), amended)


def missing_radius(error: InfeasibleError) -> float:
    """Return what lacks to the radius of tracking errors [m]; 0 if another limit is broken."""
    radii = [each for each in error.violations if each.constraint == TRACKING_RADIUS.name]
    if len(radii) < len(error.violations):
        return 0.0
    return max((each.limit - each.value for each in radii), default=0.0)


CIRCLE_REMARK = "tied as a polygon on a circle, since the goal cannot be tied directly"
"""Remark on morphs between a hitch and one on a circle that is tied or untied in its place."""

HEIGHT_REMARK = "hanging cables need more height above the ground than the hitch"
"""Remark on motions of a hitch to and from the altitude at which it is tied."""


def adjusting_motions(task: StepTask, q_legs: Array) -> list[Motion]:
    """Return the motion in which cables slide to q-legs; no motion if they have them."""
    hitch = task.hitch
    if np.array_equal(q_legs, hitch.q_legs):
        return []
    direct = replace(task, optimiser=False)  # other splits are faster to try than other routes
    action = adjust(hitch, hitch.polygon)
    end = end_of_action(action, RolledLegs(q_legs, hitch.roll), task.requirements).hitch
    phase = Phase("adjust", task.index, 0.0, 0.0)
    own = partial(action_plan, direct, action, end, phase, None, "legs are to change")
    plan = RouteSearch(direct, end, phase, own).plan()
    return [plan.motion]
