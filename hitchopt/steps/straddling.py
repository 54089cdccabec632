"""Steps of two robots: tie their cables around an object, and untie them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Self

import numpy as np

from hitchopt.checks.arena import CEILING, FLOOR
from hitchopt.checks.grips import MIN_HINGE
from hitchopt.errors import InfeasibleError, RequestError, Violation
from hitchopt.geometry.vectors import rotated, turn
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion, concatenated
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import in_world
from hitchopt.planners.carrying.holds import GripHold
from hitchopt.planners.carrying.planner import MovePlanner, check_pull, tying_tension
from hitchopt.planners.carrying.polygons import grip_clasps
from hitchopt.planners.task import StepPlan, StepTask
from hitchopt.planners.tying import approach_motion
from hitchopt.steps.step import (
    ALTITUDE_CHECKS,
    Knob,
    ObjectOf,
    Seconds,
    Stage,
    Step,
    plan_to,
    planner_of,
)
from hitchopt.steps.tying import check_rollable
from hitchopt.support import Feature, Neighbour, refused_value
from hitchopt.values import Array
from hitchopt.values.fields import Key, documented
from hitchopt.values.units import LENGTH, TENSION

__all__ = [
    "Tie",
    "Untie",
]

PREFERRED_HINGE = 0.15
"""[m] Preferred height of clasps above a centre of mass, as far below the top as drones may be off.
In simulation drums tilted by up to 29° at 10 cm, and by 14° at 15 cm."""

NO_TURN = math.radians(2.0)
"""[rad] Angle up to which hanging cables need not turn about an object."""

EDGE = 0.02
"""[m] Minimum distance of clasps to the top and the bottom of an object."""

RIM_DISTANCE = 0.03
"""[m] Preferred distance of clasps to a rim above them, which cables must not touch."""

HEIGHT_ROUNDING = 1e-9
"""[m] Rounding of a height that equals its limit."""

MILLIMETRE_ROUNDING = 1e-3
"""[mm] Rounding of a suggested height, which is in whole millimetres."""


def _height_error(requirements: Requirements) -> float:
    """Return the largest height error of drones [m]."""
    tube = requirements.limits.tube
    return tube.level * tube.ratio or requirements.position_error * requirements.height_ratio


def needed_height(body: SolidObject, requirements: Requirements) -> float:
    """Return the lowest height of two clasps above an object's base [m] with which it hangs."""
    return float(body.centre_of_mass[2]) + MIN_HINGE + _height_error(requirements)


def check_hinge(planner: MovePlanner) -> None:
    """Raise InfeasibleError if an object would tip over on two clasps that lift it."""
    hold = planner.hold
    body = planner.body
    if hold.team.robots != 2:
        return
    needed = needed_height(body, planner.requirements)
    if hold.height >= needed - HEIGHT_ROUNDING:
        return
    centre = float(body.centre_of_mass[2])
    highest = body.upper - EDGE
    suggested = math.ceil(1e3 * needed - MILLIMETRE_ROUNDING) / 1e3
    remedy = f"tie it at {suggested:g} m or higher above its base"
    if needed > highest:
        error = _height_error(planner.requirements)
        largest_error = highest - centre - MIN_HINGE
        allowed = "this object is too low"
        if largest_error > 0.0:
            allowed = f"this object allows {largest_error:.3g} m"
        remedy = (
            f"two clasps can be at most {highest:.3g} m above its base, where it tips over if "
            f"drones may be off by {error:.3g} m in height; {allowed}"
        )
    where = (planner.state.object,)
    when = "above the centre of mass, while it is lifted"
    value = hold.height - centre
    violation = Violation("hinge", value, needed - centre, "min", "m", where, when, remedy)
    raise InfeasibleError([violation])


def _check_two(team: Team, remedy: str) -> None:
    """Raise InputError with a remedy unless the team has two robots."""
    if team.robots != 2:
        bound = "2 where cables are tied around an object"
        raise RequestError("robots", team.robots, bound, remedy)
    if not team.layout.closed:
        feature, neighbour = Feature.TWO_CABLES, Neighbour.CHAINS
        raise refused_value(feature, neighbour, team.topology, RequestError)


@documented
@dataclass(frozen=True)
class Tie(Step):
    """Lay two cables past both sides of an object, tie them beyond it, and draw them taut.

    The cables are lowered next to the object and bent around it, and each pair of drones makes a
    full turn. They then grip the object with the team's tension.
    """

    needs_hitch: ClassVar[bool | None] = False
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.FREE, Stage.GRASPED)
    object_key: ClassVar[str] = "around"
    of_two_robots: ClassVar[bool] = True
    around: ObjectOf
    at: Annotated[
        float | None,
        Key(
            LENGTH,
            "Height of the clasps above its base; null: as high as is safe, but below its rim",
            0.3,
        ),
    ] = None
    tension: Annotated[
        float | None,
        Key(
            TENSION,
            "Tension of all cables while they are tied; null: as low as their weight permits",
            0.3,
        ),
    ] = None
    duration: Seconds = None

    @property
    def object(self) -> str:
        """Name of the object."""
        return self.around

    def resolved_for(self, team: Team) -> Self:
        """Return the step, or raise InputError unless the team has two robots."""
        _check_two(team, "form a hitch, and enclose and grasp the object")
        return super().resolved_for(team)

    def tension_for(self, team: Team) -> Array:
        """Return the tensions (n,) [N] with which cables are tied."""
        return np.full(team.robots, tying_tension(team) if self.tension is None else self.tension)

    def height_for(self, body: SolidObject, requirements: Requirements) -> float:
        """Return the height of the clasps above the object's base [m]."""
        if self.at is not None:
            return self.at
        lowest = needed_height(body, requirements)
        highest = body.upper - max(EDGE, _height_error(requirements))
        if body.rim is not None and body.rim.height - RIM_DISTANCE >= lowest:
            highest = min(highest, body.rim.height - RIM_DISTANCE)
        preferred = min(float(body.centre_of_mass[2]) + PREFERRED_HINGE, highest)
        return min(max(lowest, preferred), body.upper - EDGE)

    def plan(self, task: StepTask) -> StepPlan:
        """Plan how to tie the cables around the object."""
        return self.plan_to_grip(task, task.before.team.tension)

    def plan_to_grip(self, task: StepTask, tension: Array) -> StepPlan:
        """Plan how cables grip the object with tensions (n,) [N]."""
        from hitchopt.planners.carrying.straddle_planner import find_straddle

        requirements = task.requirements
        team = task.before.team
        body = requirements.objects[self.around]
        check_rollable(f"step {task.index} ({self.name})", team)
        self._check_friction(body)
        height = self._checked_height(task, body)
        check_pull(float(np.max(tension)), team, requirements)

        clasps = grip_clasps(self.around, body, team, requirements)
        numbered = _numbered(clasps, body, task.before.drones)
        hold = GripHold.tied(team, body, numbered, height)
        planner = find_straddle(
            self.around,
            hold,
            self.tension_for(team),
            requirements,
            task.index,
            task.before.drones,
        )
        approach = _approach_motions(task, planner.hanging.drones, body)
        motions = [*approach, *planner.stages(), *planner.draw_grip(tension)]
        motion = self.with_duration(task, concatenated(motions))
        return plan_to(task, replace(planner.state, tension=tension), motion, body.place)

    def _check_friction(self, body: SolidObject) -> None:
        """Raise InputError for an object that cables cannot hold."""
        if body.friction == 0.0:
            key = f"objects.{self.around}.friction"
            raise RequestError(key, 0.0, "above 0 if it is held", "cables hold it by friction")

    def _checked_height(self, task: StepTask, body: SolidObject) -> float:
        """Return the height of the clasps above the base [m]; raise InputError if it is off it."""
        height = self.height_for(body, task.requirements)
        lowest = body.lower + EDGE
        highest = body.upper - EDGE
        if not lowest <= height <= highest:
            key = f"mission[{task.index}].{self.name}.at"
            bound = f"from {lowest:g} to {highest:g} m, on objects.{self.around}"
            raise RequestError(key, height, bound, "tie it there")
        return height

    def advice(self, check: str, key: str) -> str:
        """Return the advice for keeping below a ceiling, or above the floor."""
        if check == CEILING:
            return f"tie it lower ({key}.at), or use shorter cables"
        return f"tie it higher ({key}.at)" if check == FLOOR else ""

    def knobs(self) -> Iterator[Knob]:
        """Yield the height, and the knobs of all steps."""
        yield from super().knobs()
        if self.at is not None:
            knob = Knob("at", self.at, "m", covers=ALTITUDE_CHECKS | {"hinge"})
            yield knob
            yield replace(knob, sign=-1, covers=ALTITUDE_CHECKS)


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
    from hitchopt.planners.carrying.straddle_planner import MAX_TURN
    from hitchopt.planners.forming.stages import Keyframe, straight_stages

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


@documented
@dataclass(frozen=True)
class Untie(Step):
    """Untie the cables in the reverse order of tying, until they hang next to the object."""

    needs_hitch: ClassVar[bool | None] = None
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.GRASPED, Stage.FREE)
    of_two_robots: ClassVar[bool] = True
    duration: Seconds = None

    def resolved_for(self, team: Team) -> Self:
        """Return the step, or raise InputError unless the team has two robots."""
        _check_two(team, "loosen and leave the object, and release the hitch")
        return super().resolved_for(team)

    def plan(self, task: StepTask) -> StepPlan:
        """Plan how to untie the cables until they hang."""
        from hitchopt.planners.carrying.straddle_planner import find_straddle
        from hitchopt.planners.forming.stages import reversed_stages

        requirements = task.requirements
        team = task.before.team
        held = planner_of(task)
        tension = np.full(team.robots, tying_tension(team))
        hold = replace(held.grip, body=held.body)
        planner = find_straddle(held.state.object, hold, tension, requirements, task.index)
        loosened = planner.from_state(tension=held.state.tension).open_grip(tension, "loosen")
        untied = reversed_stages(planner.stages())
        motion = self.with_duration(task, concatenated([loosened, *untied]))
        after = replace(
            task.before,
            drones=motion.drones.at(motion.duration),
            hitch=None,
            grasp=None,
            objects=dict(requirements.objects),
        )
        return StepPlan(motion, after)
