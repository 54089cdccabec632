"""Steps that carry an object: enclose, grasp, lift, carry, set down, loosen, leave; or all."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, ClassVar, Literal

import numpy as np

from hitchopt.errors import InfeasibleError, RequestError, Violation, rounded_up
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Requirements, Separation
from hitchopt.motion.motion import Motion, Phase, PhaseHold
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import CONTACT_GAP, footing, poses_of, stacked_on, surface_below
from hitchopt.planners.candidates import Candidate, first_certified
from hitchopt.planners.carrying.around import (
    PLACE_TOLERANCE,
    altitude_over,
    orientations_around,
    requirements_closing,
    slowed_to,
)
from hitchopt.planners.carrying.hinge import check_hinge
from hitchopt.planners.carrying.holds import GripHold, polygon_at
from hitchopt.planners.carrying.moves import Move
from hitchopt.planners.carrying.planner import (
    AROUND_SPEED,
    LIFT_SPEED,
    GraspState,
    check_opens,
    check_pull,
    one_phase,
)
from hitchopt.planners.carrying.polygons import HoldPolygons
from hitchopt.planners.compensation import with_friction_feedforward
from hitchopt.planners.ends import RolledLegs, end_of_morph
from hitchopt.planners.grasps import Closing, HoldJudge, altitude_around
from hitchopt.planners.routes import OBSTACLE_CHECKS, plan_to_hitch
from hitchopt.planners.task import StepPlan, StepTask, plan_in_sequence, require_certified
from hitchopt.steps.moving import Morph, Transport
from hitchopt.steps.step import Knob, ObjectOf, Place, Seconds, Stage, Step, Yaw, checks_relaxed_by
from hitchopt.steps.straddling import Tie, Untie
from hitchopt.support import Feature, Neighbour, refused_value
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

MAX_VIA = 100
"""Maximum number of waypoints of one object."""


def object_of(task: StepTask, name: str) -> SolidObject:
    """Return an object at its current pose; raise InputError if it cannot be held."""
    objects, key = task.requirements.objects, f"objects.{name}"
    body = objects[name]
    if not task.before.team.layout.closed:
        raise refused_value(Feature.HOLDING, Neighbour.CHAINS, "open", RequestError)
    if body.fixed:
        remedy = "omit it, or only tie two cables around it"
        raise RequestError(f"{key}.fixed", True, "false if it is lifted", remedy)
    if body.friction == 0.0:
        bound, remedy = "above 0 if it is held", "only friction moves it along with the cables"
        raise RequestError(f"{key}.friction", 0.0, bound, remedy)
    for other in stacked_on(objects, name, task.requirements.floor):
        at, bound = objects[other].at.tolist(), f"off objects.{name}, which is held alone"
        raise RequestError(f"objects.{other}.at", at, bound, f"carry objects.{other} away first")
    return body


def goal_of(step: Step, requirements: Requirements, name: str) -> Array:
    """Return the pose (4,) of a held object's base after a step: x, y, z [m], yaw [rad]."""
    objects = requirements.objects
    below, _ = surface_below(objects, poses_of(objects), name, requirements.floor)
    goal = step.place_after(objects[name], below)
    return objects[name].place if goal is None else goal


def step_motion(
    step: Step, task: StepTask, parts: Sequence[Motion], hold: PhaseHold | None = None
) -> Motion:
    """Return consecutive motions as one phase of a step, in its prescribed duration."""
    motion = one_phase(parts, task.requirements, task.index, step.name, hold)
    return step.with_duration(task, motion)


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
        return first_orientation(self.orientations(task), task)

    def orientations(self, task: StepTask) -> list[Callable[[StepTask], StepPlan]]:
        """Return the planners of hitches around the object, in order of decreasing capacity."""
        body = object_of(task, self.object)
        orientations = orientations_around(
            self.object, task.before.team, task.requirements, task.hitch.polygon
        )
        return [
            partial(self._around, body=body, polygons=polygons, polygon=around)
            for polygons, around in orientations
        ]

    def _around(
        self, task: StepTask, body: SolidObject, polygons: HoldPolygons, polygon: ConvexPolygon
    ) -> StepPlan:
        """Plan the change to a polygon around the object."""
        requirements = task.requirements
        hitch = task.hitch
        clearance = requirements.separation.object
        altitude = altitude_around(body, requirements.separation)
        height = altitude - requirements.floor
        if height < clearance - CONTACT_GAP:
            name = f"objects.{self.object}"
            when = f"with the hitch around {name}"
            remedy = f"use a taller {name} or a higher rim, or raise its support"
            violation = Violation(
                "object_clearance", height, clearance, "min", "m", ("ground",), when, remedy
            )
            raise InfeasibleError([violation])
        radius = float(np.max(np.linalg.norm(polygon.vertices - polygon.centroid, axis=1)))
        size = f"{rounded_up(radius, 2):.2g} m in radius"
        remedy = f"tie the hitch as large as it is around objects.{self.object} ({size})"
        check_opens(hitch, polygon.vertices, requirements, remedy)
        above = self._above(task, polygon, altitude)
        parts = [above.motion]
        near = task.within(requirements, above.after)
        top = max(altitude_over(near.hitch, polygon, requirements), altitude)
        slow = slowed_to(requirements, AROUND_SPEED)
        for height, within in ((top, requirements), (altitude, slow)):
            if near.hitch.altitude - height >= PLACE_TOLERANCE:
                down = Transport(np.append(polygon.centroid, height))
                lower = down.plan(near.within(within, near.before))
                parts.append(lower.motion)
                near = near.within(requirements, lower.after)
        grasp = GraspState(self.object, polygons, task.before.team.tension)
        return StepPlan(step_motion(self, task, parts), replace(near.before, grasp=grasp))

    def _above(self, task: StepTask, polygon: ConvexPolygon, altitude: float) -> StepPlan:
        """Plan the change to a polygon above an altitude [m], and over all that is passed.

        A hitch that is higher descends as it changes, if it can, and one that travels changes on
        the way, or else where it arrives.
        """
        hitch = task.hitch
        lowest = max(altitude_over(hitch, polygon, task.requirements), altitude)
        level = max(hitch.altitude, lowest)
        start = hitch.polygon.centroid
        rising = [Transport(np.append(start, level)).plan]
        if level - hitch.altitude < PLACE_TOLERANCE:
            rising = []
        changing = Morph(polygon).plan
        travelling = Transport(np.append(polygon.centroid, level)).plan
        orders = list[list[Callable[[StepTask], StepPlan]]]()
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
    """Plan the change to a polygon at another altitude [m]."""
    level = end_of_morph(task.hitch, polygon, None, task.requirements).hitch
    end = with_fields(level, altitude=altitude)
    plan = plan_to_hitch(task, end, Phase("morph", task.index, 0.0, 0.0))
    return with_friction_feedforward(plan, timed=False)


def first_orientation(
    planners: Sequence[Callable[[StepTask], StepPlan]], task: StepTask
) -> StepPlan:
    """Return the first certified plan of several orientations, or the plan of the only one."""
    if len(planners) == 1:
        return planners[0](task)
    orientations = (
        Candidate("orientation", partial(certified_plan, planner, task)) for planner in planners
    )
    return first_certified(orientations, task.effort, task.progress)


def certified_plan(planner: Callable[[StepTask], StepPlan], task: StepTask) -> StepPlan:
    """Return a planner's certified plan."""
    return require_certified(planner(task))


HoldMethod = Literal["rest", "grip"]  # Method of holding an object

BY = words("rest", "grip")

BY_TEXT = "rest: its rim lies on the clasps; grip: cables are wrapped around it"

HoldTension = Annotated[
    float | None, Key(TENSION, "Tension of all cables while it is held; default: the team's")
]

BALANCE_CHECKS = frozenset({"equilibrium", "keep_out"})
"""Checks that a higher or a lower tension may satisfy."""


def hold_judge(task: StepTask, tension: Array) -> HoldJudge:
    """Return the judge of holds of the enclosed object, with tensions (n,) [N]."""
    return HoldJudge(task.held.from_state(tension=tension), task.hitch)


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
        body, team = object_of(task, self.object), task.before.team
        tension = self.tension_for(team)
        if self.by == "grip":
            return self._grip(task, body, tension)
        if body.rim is None:
            key, bound = f"objects.{self.object}.rim", "given if it is held by rest"
            raise RequestError(key, None, bound, "add a rim, or grasp it by: grip")
        judge = hold_judge(task, tension)
        slow = requirements_closing(task.requirements, self.object)
        closing_task = task.within(slow, task.before)

        def held(closing: Closing, reserve: float) -> StepPlan:
            """Return the plan that closes the hitch below the rim and rises to it."""
            planner = judge.with_hold(closing[-1])
            moves = [
                *planner.retension(team.tension, tension),
                planner.rim_move(planner.gap, 0.0),
            ]
            hitches = [hold.hitch(body, planner.gap) for hold in closing]
            ends = [(each.polygon, RolledLegs(each.q_legs, each.roll)) for each in hitches]
            morphs = [Morph(*end).plan for end in ends]
            straight_task = replace(closing_task, optimiser=False)
            at_once = partial(certified_plan, morphs[-1], straight_task)
            in_turn = partial(certified_plan, partial(plan_in_sequence, morphs), closing_task)
            ways = [Candidate("closing", at_once), Candidate("closing", in_turn)]
            closed = first_certified(ways, task.effort)
            rising = planner.motion(moves, self.name)
            parts = [closed.motion, rising]
            motion = step_motion(self, task, parts, rising.phases[0].hold)
            if np.any(planner.hold.roll):  # drones and cables sink toward the ground
                require_certified(StepPlan(motion, task.before))
            plan = task.plan_with_object(motion, planner.state, body.place)
            return plan.with_remark(judge.remark_on(reserve))

        return first_certified(judge.candidates(held), task.effort, task.progress)

    def _grip(self, task: StepTask, body: SolidObject, tension: Array) -> StepPlan:
        """Plan how cables grip the object with tensions (n,) [N]."""
        team = task.before.team
        if body.rim is not None:
            key = f"mission[{task.index}].{self.name}.by"
            bound = "rest if the hitch is below the object's rim"
            raise RequestError(key, "grip", bound, "omit the rim")
        check_pull(float(np.max(tension)), team, task.requirements)
        judge = hold_judge(task, tension)
        grips = judge.candidates(lambda closing, _: judge.with_hold(closing[-1]))
        planner = first_certified(grips, task.effort, task.progress)
        motion = self.with_duration(task, planner.close_grip(team.tension, self.name))
        return task.plan_with_object(motion, planner.state, body.place)


@documented
@dataclass(frozen=True)
class Lift(Step):
    """Transfer the object's weight to the clasps, and lift it vertically."""

    of_two_robots: ClassVar[bool] = True
    needs_hitch: ClassVar[bool | None] = None  # two cables around an object have no outline
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.GRASPED, Stage.LIFTED)
    by: Annotated[float, Key(LENGTH, "Height to lift", 0.5)]
    duration: Seconds = None

    def place_after(self, body: SolidObject, below: float) -> Array:  # noqa: ARG002
        """Return the pose above the current one."""
        return np.array([*body.at[:2], body.at[2] + self.by, body.yaw])

    def plan(self, task: StepTask) -> StepPlan:
        """Plan the vertical ascent."""
        planner = task.held
        object_of(task, planner.state.object)  # two cables may be tied around any
        check_hinge(planner)
        to = goal_of(self, task.requirements, planner.state.object)
        moves = [planner.transfer(0.0, 1.0), planner.carry(to, LIFT_SPEED)]
        return self.plan_of_moves(task, replace(task.grasp, carried=True), moves)


@documented
@dataclass(frozen=True, eq=False)
class Carry(Step):
    """Fly the object along a straight line, gently enough that it stays on its supports.

    Where objects are in the way, it flies beside them, with a stop or two.
    """

    of_two_robots: ClassVar[bool] = True
    needs_hitch: ClassVar[bool | None] = None
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
        from hitchopt.planners.carrying.detours import CarrySearch  # heavy

        ways = CarrySearch(task.held, to).ways()
        beside = [Candidate("detour", partial(self._past, way, task)) for way in ways]
        return first_certified([*beside, straight], task.effort, task.progress)

    def _past(self, places: Sequence[Array], task: StepTask) -> StepPlan:
        """Return the certified plan through places (4,) beside obstacles."""
        plan = require_certified(self._through(places, task))
        stops = "once" if len(places) == 2 else f"{len(places) - 1} times"
        return plan.with_remark(f"stops {stops} on the way past obstacles")

    def _through(self, places: Sequence[Array], task: StepTask) -> StepPlan:
        """Return the plan through places (4,) x, y, z [m] and yaw [rad], at rest in each."""
        planner = task.held
        requirements = task.requirements
        moves = list[Move]()
        for place in places:
            moves.append(planner.carry(place, requirements.limits.speed))
            objects = {**requirements.objects, self.object: planner.body.moved_to(place)}
            planner = replace(planner, requirements=replace(requirements, objects=objects))
        return self.plan_of_moves(task, task.grasp, moves)


@documented
@dataclass(frozen=True)
class SetDown(Step):
    """Lower the object onto its support, and transfer its weight to it."""

    of_two_robots: ClassVar[bool] = True
    needs_hitch: ClassVar[bool | None] = None
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.LIFTED, Stage.GRASPED)
    object: ObjectOf
    duration: Seconds = None

    def place_after(self, body: SolidObject, below: float) -> Array:
        """Return the pose straight below."""
        return np.array([*body.at[:2], below - body.lower, body.yaw])

    def plan(self, task: StepTask) -> StepPlan:
        """Plan the vertical descent to a stable support."""
        objects = task.requirements.objects
        planner = task.held
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
        return self.plan_of_moves(task, replace(task.grasp, carried=False), moves)


@documented
@dataclass(frozen=True)
class Loosen(Step):
    """Open the hitch around the object, below its rim, and return to the team's tension."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.GRASPED, Stage.AROUND)
    object: ObjectOf
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Plan the change to a hitch around the object."""
        body = object_of(task, self.object)
        team = task.before.team
        planner = task.held
        hold = planner.hold
        freed = replace(task.grasp, tension=team.tension, hold=None)
        if isinstance(hold, GripHold):
            motion = self.with_duration(task, planner.open_grip(team.tension, self.name))
            after = task.plan_with_object(motion, freed, body.place).after
            return StepPlan(motion, replace(after, hitch=hold.opened.hitch(body)))
        lower = planner.retension(planner.state.tension, team.tension)
        sinking = planner.motion([planner.rim_move(0.0, planner.gap), *lower], self.name)
        held = replace(freed, hold=hold)
        low = task.plan_with_object(sinking, held, body.place, planner.gap).after
        around = Morph(polygon_at(body, freed.polygons.around))
        slow = requirements_closing(task.requirements, self.object)
        opening = around.plan(task.within(slow, low))
        motion = step_motion(self, task, [sinking, opening.motion], sinking.phases[0].hold)
        return StepPlan(motion, replace(opening.after, grasp=freed))


@documented
@dataclass(frozen=True)
class Leave(Step):
    """Rise vertically until the hitch is above the object and those beside it."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.AROUND, Stage.FREE)
    object: ObjectOf
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Plan the vertical ascent."""
        polygon = task.hitch.polygon
        altitude = max(task.hitch.altitude, altitude_over(task.hitch, polygon, task.requirements))
        over = Transport(np.append(polygon.centroid, altitude))
        plan = over.plan(task.within(slowed_to(task.requirements, AROUND_SPEED), task.before))
        motion = step_motion(self, task, [plan.motion])
        return StepPlan(motion, replace(plan.after, grasp=None))


@documented
@dataclass(frozen=True, eq=False)
class TransportObject(TensionStep):
    """Carry an object to a new position, in seven steps, or more with ``via``.

    Two robots tie their cables around it, and untie them.
    """

    of_two_robots: ClassVar[bool] = True
    needs_hitch: ClassVar[bool | None] = None

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
        flight_height = self.flight_height(body)
        to = np.asarray(self.to)
        waypoints = [] if self.via is None else list(np.asarray(self.via))
        carrying: list[Step] = [
            Lift(flight_height - float(body.at[2])),
            *(Carry(self.object, place) for place in waypoints),
            Carry(self.object, np.append(to[:2], flight_height), self.yaw),
            SetDown(self.object),
        ]
        grasp = Grasp(self.object, self.method_for(body), self.tension)
        leaving = [Loosen(self.object).plan, Leave(self.object).plan]
        if task.before.team.robots == 2:
            tension = self.tension_for(task.before.team)
            taking = partial(Tie(self.object).plan_to_grip, tension=tension)
            leaving = [Untie().plan]
        else:
            around = Enclose(self.object).orientations(task)
            holds = [partial(plan_in_sequence, [enclose, grasp.plan]) for enclose in around]
            taking = partial(first_orientation, holds)
        plan = plan_in_sequence([taking, *(step.plan for step in carrying), *leaving], task)
        height = float(plan.after.with_objects(task.requirements).objects[self.object].at[2])
        if abs(height - to[2]) > CONTACT_GAP:
            key, bound = f"mission[{task.index}].{self.name}.to", "on what is below it"
            remedy = f"write {[*to[:2].tolist(), round(height, 9)]}"
            raise RequestError(key, to.tolist(), f"{bound}, at {height:.6g} m", remedy)
        return plan
