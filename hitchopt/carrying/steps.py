"""Steps that carry an object: enclose, grasp, lift, carry, set down, loosen, leave; or all."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, ClassVar, Literal

import numpy as np

from hitchopt.carrying.detours import CarrySearch
from hitchopt.carrying.enclosing import (
    enclosing_plan,
    enclosing_planners,
    first_plan,
    gripping_plan,
    leaving_plan,
    loosening_plan,
    object_of,
    require_lift,
    resting_plan,
)
from hitchopt.carrying.held import grasp_of, held_of, plan_of_moves
from hitchopt.carrying.moves import Move
from hitchopt.carrying.planner import LIFT_SPEED
from hitchopt.errors import RequestError
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import STANDING, Requirements, Separation
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import CONTACT_GAP, footing, poses_of, surface_below
from hitchopt.planners.along import OBSTACLE_CHECKS
from hitchopt.planners.candidates import Candidate, first_certified
from hitchopt.planners.task import StepPlan, StepTask, plan_in_sequence, require_certified
from hitchopt.steps.keys import ObjectOf, Place, Seconds, Yaw
from hitchopt.steps.knob import Knob, checks_relaxed_by
from hitchopt.steps.step import Stage, Step
from hitchopt.values import Array, Points
from hitchopt.values.fields import Key, documented, points, with_fields, words
from hitchopt.values.units import LENGTH, TENSION

__all__ = [  # noqa: RUF022, in the order of the keys of problem files
    "Enclose",
    "Grasp",
    "Lift",
    "Carry",
    "SetDown",
    "Loosen",
    "Leave",
    "TransportObject",
]

MIN_FOOTING = 0.02
"""Minimum distance of a centre of mass from the edges of its support after setting down [m]: the
position error of objects."""

MAX_VIA = 100  # Maximum number of waypoints of one object


def goal_of(step: Step, requirements: Requirements, name: str) -> Array:
    """Return the pose (4,) of a held object's base after a step: x, y, z [m], yaw [rad]."""
    objects = requirements.objects
    ground = requirements.ground_for(STANDING)
    below, _ = surface_below(objects, poses_of(objects), name, ground)
    goal = step.place_after(objects[name], below)
    return objects[name].place if goal is None else goal


@documented
@dataclass(frozen=True)
class Enclose(Step):
    """Rise above what is on the way to an object, change to a polygon around it, and descend.

    It ends just below the object's rim, or at the height of its centre of mass if it has none.
    """

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.FREE, Stage.AROUND)
    object: ObjectOf
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Plan the change to a hitch around the object, in the first feasible orientation."""
        return enclosing_plan(task, self.object, self.prescribed_duration)


HoldMethod = Literal["rest", "grip"]  # Method of holding an object

BY = words("rest", "grip")

BY_TEXT = "rest: its rim lies on the clasps; grip: cables are wrapped around it"

HoldTension = Annotated[
    float | None, Key(TENSION, "Tension of all cables while it is held; default: the team's")
]

BALANCE_CHECKS = frozenset({"equilibrium", "keep_out"})
"""Checks that a higher or a lower tension may satisfy."""


class TensionStep(Step):
    """A step that sets the method of holding an object, and the tension of all cables."""

    by: HoldMethod | None
    tension: float | None

    def method_for(self, body: SolidObject) -> HoldMethod:
        """Return the method of holding an object."""
        return self.by or ("rest" if body.rim else "grip")

    def tension_for(self, team: Team) -> Array:
        """Return the tensions (n,) [N] while the object is held."""
        return team.tension if self.tension is None else np.full(team.robots, self.tension)

    def knobs(self) -> Iterator[Knob]:
        """Yield the tension, and the knobs of all steps."""
        yield from super().knobs()
        if self.tension is not None:
            knob = Knob("tension", self.tension, "N", covers=BALANCE_CHECKS | {"load", "grip"})
            yield knob
            covers = BALANCE_CHECKS | checks_relaxed_by("tension") | checks_relaxed_by("length")
            yield replace(knob, sign=-1, covers=covers | {"crossing"})


@documented
@dataclass(frozen=True)
class Grasp(TensionStep):
    """Close the hitch below the object's rim and rise to it, or close it around its body."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.AROUND, Stage.GRASPED)
    object: ObjectOf
    by: Annotated[HoldMethod, Key(BY, BY_TEXT)] = "rest"
    tension: HoldTension = None
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Plan how clasps close below the object's rim, or edges close around the object."""
        grasping_plan = gripping_plan if self.by == "grip" else resting_plan
        require_lift(task, self.object)
        tension = self.tension_for(task.before.team)
        return grasping_plan(task, self.object, tension, self.prescribed_duration)


@documented
@dataclass(frozen=True)
class Lift(Step):
    """Transfer the object's weight to the clasps, and lift it vertically."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.GRASPED, Stage.LIFTED)
    by: Annotated[float, Key(LENGTH, "Height to lift", 0.5)]
    duration: Seconds = None

    def place_after(self, body: SolidObject, below: float) -> Array:  # noqa: ARG002
        """Return the pose above the current one."""
        return np.array([*body.at[:2], body.at[2] + self.by, body.yaw])

    def plan(self, task: StepTask) -> StepPlan:
        """Plan the vertical ascent."""
        planner = held_of(task)
        to = goal_of(self, task.requirements, planner.state.object)
        moves = [planner.transfer(0.0, 1.0), planner.carry(to, LIFT_SPEED)]
        return plan_of_moves(self, task, replace(grasp_of(task), carried=True), moves)


@documented
@dataclass(frozen=True, eq=False)
class Carry(Step):
    """Fly the object along a straight line, gently enough that it stays on its supports.

    Where objects are in the way, it flies beside them, with a stop or two.
    """

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.LIFTED, Stage.LIFTED)
    object: ObjectOf
    to: Place
    yaw: Yaw = 0.0
    duration: Seconds = None

    def place_after(self, body: SolidObject, below: float) -> Array:  # noqa: ARG002
        """Return the goal, turned by ``yaw``."""
        return np.append(self.to, body.yaw + self.yaw)

    def plan(self, task: StepTask) -> StepPlan:
        """Plan the flight along the line, or past what is in its way."""
        to = goal_of(self, task.requirements, self.object)
        straight = Candidate("straight way", partial(self._through, [to], task))
        ways = CarrySearch(held_of(task), to).ways()
        beside = [Candidate("detour", partial(self._past, way, task)) for way in ways]
        return first_certified([*beside, straight], task.effort, task.progress)

    def _past(self, places: Sequence[Array], task: StepTask) -> StepPlan:
        """Return the certified plan through places (4,) beside obstacles."""
        plan = require_certified(self._through(places, task))
        stops = "once" if len(places) == 2 else f"{len(places) - 1} times"
        return plan.with_remark(f"stops {stops} on the way past obstacles")

    def _through(self, places: Sequence[Array], task: StepTask) -> StepPlan:
        """Return the plan through places (4,) x, y, z [m] and yaw [rad], at rest in each."""
        planner = held_of(task)
        requirements = task.requirements
        moves = list[Move]()
        for place in places:
            moves.append(planner.carry(place, requirements.limits.speed))
            objects = {**requirements.objects, self.object: planner.body.moved_to(place)}
            planner = replace(planner, requirements=replace(requirements, objects=objects))
        return plan_of_moves(self, task, grasp_of(task), moves)


@documented
@dataclass(frozen=True)
class SetDown(Step):
    """Lower the object onto its support, and transfer its weight to it."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.LIFTED, Stage.GRASPED)
    object: ObjectOf
    duration: Seconds = None

    def place_after(self, body: SolidObject, below: float) -> Array:
        """Return the pose straight below."""
        return np.array([*body.at[:2], below - body.lower, body.yaw])

    def plan(self, task: StepTask) -> StepPlan:
        """Plan the vertical descent to a stable support."""
        objects = task.requirements.objects
        planner = held_of(task)
        to = goal_of(self, task.requirements, self.object)
        set_down = objects[self.object].moved_to(to)
        margin = footing({**objects, self.object: set_down}, self.object)
        if margin < MIN_FOOTING:
            bound = (
                f"where the centre of mass of objects.{self.object} is {MIN_FOOTING:g} m within "
                f"the edges of what it stands on, not {max(margin, 0.0):.3g} m"
            )
            place = [round(float(coordinate), 9) for coordinate in to[:3]]
            remedy = "set it down farther from the edge, or on a wider support"
            raise RequestError(f"mission[{task.index}]", place, bound, remedy)
        down = planner.carry(to, LIFT_SPEED)
        unloading = replace(planner.transfer(1.0, 0.0), start=to, end=to)
        moves = [down, unloading]
        return plan_of_moves(self, task, replace(grasp_of(task), carried=False), moves)


@documented
@dataclass(frozen=True)
class Loosen(Step):
    """Open the hitch around the object, below its rim, and return to the team's tension."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.GRASPED, Stage.AROUND)
    object: ObjectOf
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Plan the change to a hitch around the object."""
        return loosening_plan(task, self.object, self.prescribed_duration)


@documented
@dataclass(frozen=True)
class Leave(Step):
    """Rise vertically until the hitch is above the object and those beside it."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.AROUND, Stage.FREE)
    object: ObjectOf
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Plan the vertical ascent."""
        return leaving_plan(task, self.prescribed_duration)


@documented
@dataclass(frozen=True, eq=False)
class TransportObject(TensionStep):
    """Carry an object to a new position, in seven steps, or more with ``via``."""

    object: ObjectOf
    to: Place
    by: Annotated[HoldMethod | None, Key(BY, f"{BY_TEXT}; default: rest if it has a rim")] = None
    tension: HoldTension = None
    yaw: Yaw = 0.0
    lift: Annotated[float, Key(LENGTH, "Height above the higher of start and goal")] = 0.3
    via: Annotated[
        Points | None,
        Key(
            points((None, 3), "x, y, z", 1, MAX_VIA),
            "Intermediate positions of its base, where it stops",
        ),
    ] = None

    def knobs(self) -> Iterator[Knob]:
        """Yield the height of the flight, the tension, and the knobs of all steps."""
        yield from super().knobs()
        yield Knob("lift", self.lift, "m", covers=OBSTACLE_CHECKS)

    def _obstacles(
        self, objects: Mapping[str, SolidObject], names: Sequence[str]
    ) -> list[SolidObject]:
        """Return the named objects, except the carried one."""
        return [body for name, body in objects.items() if name in names and name != self.object]

    def least_increase(
        self,
        knob: Knob,
        objects: Mapping[str, SolidObject],
        names: Sequence[str],
        separation: Separation,
    ) -> float:
        """Return the relative increase of the lift with which the object clears obstacles."""
        if knob.key != "lift":
            return super().least_increase(knob, objects, names, separation)
        tops = [body.at[2] + body.upper for body in self._obstacles(objects, names)]
        higher_place = max(np.asarray(self.to)[2], objects[self.object].at[2])
        lift = max(tops, default=0.0) + separation.object - higher_place
        return max(0.0, float(lift) / self.lift - 1.0)

    def advice(self, check: str, key: str) -> str:
        """Return the advice for keeping clear of obstacles."""
        is_obstacle = check in OBSTACLE_CHECKS
        return f"raise {key}.lift, or carry it around with {key}.via" if is_obstacle else ""

    def place_after(self, body: SolidObject, below: float) -> Array:  # noqa: ARG002
        """Return the goal, turned by ``yaw``."""
        return np.append(self.to, body.yaw + self.yaw)

    def flight_height(self, body: SolidObject) -> float:
        """Return the height of the object's base on its flight [m]."""
        return max(float(body.at[2]), float(np.asarray(self.to)[2])) + self.lift

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of the seven steps; ``to`` must be on the surface below it."""
        body = object_of(task, self.object)
        require_lift(task, self.object)
        flight_height = self.flight_height(body)
        to = np.asarray(self.to)
        self._check_goal(task, np.append(to[:2], flight_height))
        waypoints = [] if self.via is None else list(np.asarray(self.via))
        carrying: list[Step] = [
            Lift(flight_height - float(body.at[2])),
            *(Carry(self.object, place) for place in waypoints),
            Carry(self.object, np.append(to[:2], flight_height), self.yaw),
            SetDown(self.object),
        ]
        grasp = Grasp(self.object, self.method_for(body), self.tension)
        leaving = [Loosen(self.object).plan, Leave(self.object).plan]
        around = enclosing_planners(task, self.object)
        holds = [partial(plan_in_sequence, [enclose, grasp.plan]) for enclose in around]
        taking = partial(first_plan, "orientation", holds)
        return plan_in_sequence([taking, *(step.plan for step in carrying), *leaving], task)

    def _check_goal(self, task: StepTask, above: Array) -> None:
        """Raise RequestError unless ``to`` is on what is below a place (3,) [m] of the base."""
        name, requirements = self.object, task.requirements
        objects = requirements.objects
        flown = objects[name].moved_to(np.append(above, objects[name].yaw + self.yaw))
        standing = with_fields(requirements, objects={**objects, name: flown})
        height = float(goal_of(SetDown(name), standing, name)[2])
        to = np.asarray(self.to)
        if abs(height - to[2]) > CONTACT_GAP:
            key, bound = f"mission[{task.index}].{self.name}.to", "on what is below it"
            remedy = f"write {[*to[:2].tolist(), round(height, 9)]}"
            raise RequestError(key, to.tolist(), f"{bound}, at {height:.6g} m", remedy)
