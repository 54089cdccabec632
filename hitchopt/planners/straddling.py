"""Tying two cables around an object, and untying them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import chain

import numpy as np

from hitchopt.checks.grips import GRIP_LIMIT
from hitchopt.checks.registry import RULE_OF
from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry.vectors import rotated, turn
from hitchopt.hitch import GRAVITY
from hitchopt.motion.motion import Motion, concatenated
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import in_world
from hitchopt.planners.candidates import Candidate, error_of, first_certified
from hitchopt.planners.carrying.holds import GripHold
from hitchopt.planners.carrying.planner import untying_tensions
from hitchopt.planners.carrying.polygons import grip_clasps
from hitchopt.planners.carrying.straddle_planner import MAX_TURN, StraddlePlanner, find_straddle
from hitchopt.planners.enclosing import first_plan
from hitchopt.planners.forming.stages import Keyframe, reversed_stages, straight_stages
from hitchopt.planners.task import StepPlan, StepTask
from hitchopt.planners.tying import approach_motion
from hitchopt.values import Array

NO_TURN = math.radians(2.0)  # [rad] Angle up to which hanging cables need not turn about an object


def tied_around(
    task: StepTask,
    name: str,
    height: float,
    tying: Array,
    tension: Array,
    *,
    lifts: bool,
) -> StepPlan:
    """Return the plan that ties two cables around an object, and draws them taut.

    Parameters
    ----------
    name: of the object.
    height: of the clasps above its base [m].
    tying: tensions (n,) [N] while cables are tied.
    tension: tensions (n,) [N] to which they are drawn.
    lifts: whether they lift it then, for which a grip that is too weak is refused.
    """
    requirements = task.requirements
    team = task.before.team
    body = requirements.objects[name]
    drones = task.before.drones

    def around(clasps: Array) -> StraddlePlanner:
        """Return the planner of a grip with clasps (2, 2) [m]."""
        hold = GripHold.tied(team, body, _numbered(clasps, body, drones), height)
        return find_straddle(name, hold, tying, requirements, task.index, drones)

    ways = grip_clasps(name, body, team, requirements)
    strongest = next(ways)
    grips = (Candidate("grip", partial(around, clasps)) for clasps in chain([strongest], ways))
    planner = first_certified(grips, task.effort, task.progress)
    if lifts:
        _check_grip(name, planner.grip, tension, partial(around, strongest))
    approach = _approach_motions(task, planner.hanging.drones, body)
    motion = concatenated([*approach, *planner.stages(), *planner.draw_grip(tension)])
    return task.plan_with_object(motion, replace(planner.state, tension=tension), body.place)


def _check_grip(
    name: str, hold: GripHold, tension: Array, strongest: Callable[[], StraddlePlanner]
) -> None:
    """Raise InfeasibleError if a grip with tensions (n,) [N] does not bear an object at rest.

    Its note says why it is not the ``strongest`` one.
    """
    body = hold.body
    slip_load = float(hold.grip(tension).slip_load(body.friction))
    ratio = slip_load / (body.mass * GRAVITY)
    if ratio >= GRIP_LIMIT:
        return
    remedy = RULE_OF["grip"].remedy
    violation = Violation(
        "grip", ratio, GRIP_LIMIT, "min", "ratio", (name,), "at rest", remedy, object=name
    )
    untied_for = error_of(strongest)
    note = ""
    if untied_for is not None:
        reason = replace(untied_for.violations[0], remedy="")
        note = f"the strongest grip cannot be tied: {str(reason).rstrip('; ')}"
    raise InfeasibleError([violation], note)


def untied(task: StepTask) -> StepPlan:
    """Return the plan that unties two cables from an object, until they hang next to it.

    Their tension is so low that they leave the object where it stands, if such a plan is certified.
    """
    hold = replace(task.held.grip, body=task.held.body)
    planners = [
        partial(_untied_with, hold=hold, tension=tension) for tension in untying_tensions(hold)
    ]
    return first_plan("tension", planners, task)


def _untied_with(task: StepTask, hold: GripHold, tension: float) -> StepPlan:
    """Return the plan that opens a grip and unties its cables with a tension [N]."""
    state = task.held.state
    requirements = task.requirements
    tensions = np.full(hold.team.robots, tension)
    planner = find_straddle(state.object, hold, tensions, requirements, task.index)
    loosened = planner.from_state(tension=state.tension).open_grip(tensions, "loosen")
    largest = planner.path.hold.standing_tension
    if tension > largest:
        remark = f"above {largest:.2g} N, one cable alone could drag {state.object}"
        loosened = StepPlan(loosened, task.before).with_remark(remark).motion
    motion = concatenated([loosened, *reversed_stages(planner.stages())])
    after = replace(
        task.before,
        drones=motion.drones.at(motion.duration),
        hitch=None,
        grasp=None,
        objects=dict(requirements.objects),
    )
    return StepPlan(motion, after)


def _along(drones: Array) -> Array:
    """Return the direction (2,) along both cables, that of cable 0, from drones (4, 3) [m]."""
    pairs = drones.reshape(2, 2, 3)[..., :2]
    first_chord = pairs[0, 1] - pairs[0, 0]
    second_chord = pairs[1, 1] - pairs[1, 0]
    return np.asarray(first_chord - second_chord)


def _numbered(clasps: Array, body: SolidObject, drones: Array) -> Array:
    """Return the clasps (2, 2) [m] in the order for drones (4, 3) [m]; turned about a disc.

    Cable 0 runs from the first to the second one, in the direction of its drones.
    """
    angle = float(turn(rotated(clasps[1] - clasps[0], body.yaw), _along(drones)))
    if body.section.radius is not None:
        return rotated(clasps, angle)
    return clasps if abs(angle) <= 0.5 * math.pi else clasps[::-1].copy()


def _approach_motions(task: StepTask, goal: Array, body: SolidObject) -> list[Motion]:
    """Return the motions of free cables to a goal (4, 3) [m], one on each side of an object.

    They turn about the object if they are not along its clasps.
    """
    before = task.before
    centre = in_world(body.pose, body.centre_of_mass)[:2]
    angle = float(turn(_along(goal), _along(before.drones)))

    def turned(share: float) -> Array:
        """Return the goal (4, 3) [m] turned by a share of the angle about the object."""
        level = centre + rotated(goal[:, :2] - centre, share * angle)
        return np.column_stack([level, goal[:, 2]])

    turns = max(0, math.ceil((abs(angle) - NO_TURN) / MAX_TURN))
    remaining_shares = np.linspace(1.0, 0.0, turns + 1)[1:].tolist()
    keyframes = [Keyframe("turn", turned(share)) for share in remaining_shares]
    beside = turned(1.0 if turns else 0.0)
    turning = straight_stages(beside, keyframes, before.team, task.requirements, task.index)
    return [approach_motion(task, beside), *turning]
