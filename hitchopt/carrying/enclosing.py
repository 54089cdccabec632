"""Plans that enclose an object with a hitch, take it, let go of it, and leave it.

Each is one phase of a step, in the step's prescribed duration if it has one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TypeAlias

import numpy as np

from hitchopt.carrying.around import (
    PLACE_TOLERANCE,
    Orientation,
    altitude_over,
    orientations_around,
    requirements_closing,
    slowed_to,
)
from hitchopt.carrying.grasps import Closing, HoldJudge, altitude_around
from hitchopt.carrying.held import GRASP, grasp_of, held_of, plan_with_object
from hitchopt.carrying.holds import GripHold, polygon_at
from hitchopt.carrying.planner import (
    AROUND_SPEED,
    GraspState,
    check_opens,
    check_pull,
    one_phase,
)
from hitchopt.drones.quadrotor import GRAVITY
from hitchopt.errors import InfeasibleError, RequestError, Violation, rounded_down, rounded_up
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch.requirements import STANDING
from hitchopt.motion.motion import Motion, Phase, PhaseHold
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import CONTACT_GAP, stacked_on
from hitchopt.planners.along import transport_plan
from hitchopt.planners.candidates import Candidate, first_certified
from hitchopt.planners.ends import RolledLegs, end_of_morph
from hitchopt.planners.routes import morph_plan, plan_to_hitch
from hitchopt.planners.task import (
    StepPlan,
    StepTask,
    plan_in_sequence,
    require_certified,
    slowed_to_duration,
)
from hitchopt.support import Feature, Neighbour, refused_value
from hitchopt.values import Array
from hitchopt.values.fields import with_fields

Planner: TypeAlias = Callable[[StepTask], StepPlan]  # A planner of one motion


def object_of(task: StepTask, name: str) -> SolidObject:
    """Return an object at its current pose; raise InputError if it cannot be held."""
    objects, key = task.requirements.objects, f"objects.{name}"
    body = objects[name]
    if not task.before.team.layout.closed:
        raise refused_value(Feature.HOLDING, Neighbour.CHAINS, "open", RequestError)
    if body.fixed:
        raise RequestError(f"{key}.fixed", True, "false if it is lifted", "omit it")
    if body.friction == 0.0:
        bound, remedy = "above 0 if it is held", "only friction moves it along with the cables"
        raise RequestError(f"{key}.friction", 0.0, bound, remedy)
    for other in stacked_on(objects, name, task.requirements.ground_for(STANDING)):
        at, bound = objects[other].at.tolist(), f"off objects.{name}, which is held alone"
        raise RequestError(f"objects.{other}.at", at, bound, f"carry objects.{other} away first")
    return body


def require_lift(task: StepTask, name: str) -> None:
    """Raise InfeasibleError for an object that all drones cannot lift at full thrust.

    It says at once what no search of holds can change.
    """
    team = task.before.team
    mass = task.requirements.objects[name].mass
    largest = float(np.sum(team.max_thrust)) / GRAVITY - float(np.sum(team.mass))
    if mass > largest:
        spare = f"at full thrust these drones lift {rounded_down(largest, 3):g} kg"
        remedy = f"lower objects.{name}.mass, or use stronger drones or more robots: {spare}"
        raise InfeasibleError([Violation("load", mass, largest, "max", "kg", (name,), "", remedy)])


def _in_one_phase(
    task: StepTask,
    step: str,
    duration: float | None,
    parts: Sequence[Motion],
    hold: PhaseHold | None = None,
) -> Motion:
    """Return consecutive motions as one phase of a step, in its prescribed duration [s], if any."""
    motion = one_phase(parts, task.requirements, task.index, step, hold)
    return slowed_to_duration(motion, duration, motion.phases[0])


def certified_plan(planner: Planner, task: StepTask) -> StepPlan:
    """Return a planner's certified plan."""
    return require_certified(planner(task))


def first_plan(name: str, planners: Sequence[Planner], task: StepTask) -> StepPlan:
    """Return the first certified plan of several planners, or the plan of the only one.

    ``name`` is that of candidates: what planners differ in.
    """
    if len(planners) == 1:
        return planners[0](task)
    candidates = (Candidate(name, partial(certified_plan, each, task)) for each in planners)
    return first_certified(candidates, task.effort, task.progress)


def enclosing_plan(task: StepTask, name: str, duration: float | None) -> StepPlan:
    """Return the plan of a hitch around an object, in the first feasible orientation."""
    return first_plan("orientation", enclosing_planners(task, name, duration), task)


def enclosing_planners(task: StepTask, name: str, duration: float | None = None) -> list[Planner]:
    """Return the planners of hitches around an object, in order of decreasing capacity.

    They rise above what is on the way, change to a polygon around the object, and descend.

    Parameters
    ----------
    name: of the object.
    duration: prescribed duration [s]; None for the fastest one.
    """
    object_of(task, name)
    orientations = orientations_around(
        name, task.before.team, task.requirements, task.hitch.polygon
    )
    return [
        partial(_plan_around, name=name, orientation=orientation, duration=duration)
        for orientation in orientations
    ]


def _plan_around(
    task: StepTask, name: str, orientation: Orientation, duration: float | None
) -> StepPlan:
    """Return the plan of the change to a hitch around an object."""
    requirements = task.requirements
    hitch = task.hitch
    polygon = orientation.around
    clearance = requirements.separation.object
    altitude = altitude_around(requirements.objects[name], requirements.separation)
    height = altitude - requirements.ground_for(STANDING)
    if height < clearance - CONTACT_GAP:
        key = f"objects.{name}"
        when = f"with the hitch around {key}"
        remedy = f"use a taller {key} or a higher rim, or raise its support"
        where = ("ground",)
        violation = Violation(
            "object_clearance", height, clearance, "min", "m", where, when, remedy, object=name
        )
        raise InfeasibleError([violation])
    radius = float(np.max(np.linalg.norm(polygon.vertices - polygon.centroid, axis=1)))
    size = f"{rounded_up(radius, 2):.2g} m in radius"
    remedy = f"tie the hitch as large as it is around objects.{name} ({size})"
    check_opens(hitch, polygon.vertices, requirements, remedy)
    above = _plan_above(task, polygon, altitude)
    parts = [above.motion]
    near = task.within(requirements, above.after)
    top = max(altitude_over(near.hitch, polygon, requirements), altitude)
    slow = slowed_to(requirements, AROUND_SPEED)
    for level, within in ((top, requirements), (altitude, slow)):
        if near.hitch.altitude - level >= PLACE_TOLERANCE:
            goal = np.append(polygon.centroid, level)
            lower = transport_plan(near.within(within, near.before), goal)
            parts.append(lower.motion)
            near = near.within(requirements, lower.after)
    grasp = GraspState(name, orientation.polygons, task.before.team.tension)
    motion = _in_one_phase(task, "enclose", duration, parts)
    return StepPlan(motion, near.before.keeping(GRASP, grasp))


def _plan_above(task: StepTask, polygon: ConvexPolygon, altitude: float) -> StepPlan:
    """Return the plan of the change to a polygon above an altitude [m], and over all on the way.

    A hitch that is higher descends as it changes, if it can, and one that travels changes on the
    way, or else where it arrives.
    """
    hitch = task.hitch
    lowest = max(altitude_over(hitch, polygon, task.requirements), altitude)
    level = max(hitch.altitude, lowest)
    start = hitch.polygon.centroid
    rising = [partial(transport_plan, to=np.append(start, level))]
    if level - hitch.altitude < PLACE_TOLERANCE:
        rising = []
    changing = partial(morph_plan, polygon=polygon)
    travelling = partial(transport_plan, to=np.append(polygon.centroid, level))
    orders = list[list[Planner]]()
    if level - lowest >= PLACE_TOLERANCE:
        orders.append([partial(_descend, polygon, lowest)])
    orders.append([*rising, changing])
    if np.max(np.abs(polygon.centroid - start)) >= PLACE_TOLERANCE:
        orders.append([*rising, travelling, changing])
    last = orders.pop()
    ways = [partial(certified_plan, partial(plan_in_sequence, order), task) for order in orders]
    ways.append(partial(plan_in_sequence, last, task))
    candidates = [Candidate("way", way) for way in ways]
    return first_certified(candidates, task.effort, task.progress)


def _descend(polygon: ConvexPolygon, altitude: float, task: StepTask) -> StepPlan:
    """Return the plan of the change to a polygon at another altitude [m]."""
    level = end_of_morph(task.hitch, polygon, None, task.requirements).hitch
    end = with_fields(level, altitude=altitude)
    return plan_to_hitch(task, end, Phase("morph", task.index, 0.0, 0.0))


def hold_judge(task: StepTask, tension: Array) -> HoldJudge:
    """Return the judge of holds of the enclosed object, with tensions (n,) [N]."""
    return HoldJudge(held_of(task).from_state(tension=tension), task.hitch)


def resting_plan(task: StepTask, name: str, tension: Array, duration: float | None) -> StepPlan:
    """Return the plan of a hitch that closes below an object's rim and rises to it.

    Parameters
    ----------
    name: of the object.
    tension: (n,) [N], of the cables that hold it.
    duration: prescribed duration [s]; None for the fastest one.
    """
    body = object_of(task, name)
    if body.rim is None:
        key, bound = f"objects.{name}.rim", "given if it is held by rest"
        raise RequestError(key, None, bound, "add a rim, or grasp it by: grip")
    judge = hold_judge(task, tension)
    closing_task = task.within(requirements_closing(task.requirements, name), task.before)

    def held(closing: Closing, reserve: float) -> StepPlan:
        """Return the plan that closes the hitch below the rim and rises to it."""
        planner = judge.with_hold(closing[-1])
        moves = [
            *planner.retension(task.before.team.tension, tension),
            planner.rim_move(planner.gap, 0.0),
        ]
        hitches = [hold.hitch(body, planner.gap) for hold in closing]
        morphs = [
            partial(morph_plan, polygon=hitch.polygon, legs=RolledLegs(hitch.q_legs, hitch.roll))
            for hitch in hitches
        ]
        straight_task = replace(closing_task, optimiser=False)
        at_once = partial(certified_plan, morphs[-1], straight_task)
        in_turn = partial(certified_plan, partial(plan_in_sequence, morphs), closing_task)
        ways = [Candidate("closing", at_once), Candidate("closing", in_turn)]
        closed = first_certified(ways, task.effort)
        rising = planner.motion(moves, "grasp")
        parts = [closed.motion, rising]
        motion = _in_one_phase(task, "grasp", duration, parts, rising.phases[0].hold)
        if np.any(planner.hold.roll):  # drones and cables sink toward the ground
            require_certified(StepPlan(motion, task.before))
        plan = plan_with_object(task, motion, planner.state, body.place)
        return plan.with_remark(judge.remark_on(reserve))

    return first_certified(judge.candidates(held), task.effort, task.progress)


def gripping_plan(task: StepTask, name: str, tension: Array, duration: float | None) -> StepPlan:
    """Return the plan of cables that close around an object; parameters as of ``resting_plan``."""
    body = object_of(task, name)
    team = task.before.team
    if body.rim is not None:
        key = f"mission[{task.index}].grasp.by"
        bound = "rest if the hitch is below the object's rim"
        raise RequestError(key, "grip", bound, "omit the rim")
    check_pull(float(np.max(tension)), team, task.requirements)
    judge = hold_judge(task, tension)
    grips = judge.candidates(lambda closing, _: judge.with_hold(closing[-1]))
    planner = first_certified(grips, task.effort, task.progress)
    closing = planner.close_grip(team.tension, "grasp")
    motion = slowed_to_duration(closing, duration, closing.phases[0])
    return plan_with_object(task, motion, planner.state, body.place)


def loosening_plan(task: StepTask, name: str, duration: float | None) -> StepPlan:
    """Return the plan of a hitch that lets go of an object, with the team's tension at its end."""
    body = object_of(task, name)
    team = task.before.team
    planner = held_of(task)
    hold = planner.hold
    freed = replace(grasp_of(task), tension=team.tension, hold=None)
    if isinstance(hold, GripHold):
        opening = planner.open_grip(team.tension, "loosen")
        motion = slowed_to_duration(opening, duration, opening.phases[0])
        after = plan_with_object(task, motion, freed, body.place).after
        return StepPlan(motion, replace(after, hitch=hold.opened.hitch(body)))
    lower = planner.retension(planner.state.tension, team.tension)
    sinking = planner.motion([planner.rim_move(0.0, planner.gap), *lower], "loosen")
    held = replace(freed, hold=hold)
    low = plan_with_object(task, sinking, held, body.place, planner.gap).after
    slow = requirements_closing(task.requirements, name)
    around = morph_plan(task.within(slow, low), polygon_at(body, freed.polygons.around))
    parts = [sinking, around.motion]
    motion = _in_one_phase(task, "loosen", duration, parts, sinking.phases[0].hold)
    return StepPlan(motion, around.after.keeping(GRASP, freed))


def leaving_plan(task: StepTask, duration: float | None) -> StepPlan:
    """Return the plan of a hitch that rises above the object that it encloses, and what is near."""
    polygon = task.hitch.polygon
    altitude = max(task.hitch.altitude, altitude_over(task.hitch, polygon, task.requirements))
    slow = slowed_to(task.requirements, AROUND_SPEED)
    goal = np.append(polygon.centroid, altitude)
    rising = transport_plan(task.within(slow, task.before), goal)
    motion = _in_one_phase(task, "leave", duration, [rising.motion])
    return StepPlan(motion, rising.after.keeping(GRASP, None))
