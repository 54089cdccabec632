"""Steps that carry an object: enclose, grasp, lift, carry, set down, loosen, leave, or all."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, ClassVar, Literal

import numpy as np

from hitchopt.checks.objects import GRIP_LIMIT
from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.geometry import ConvexPolygon, Outline
from hitchopt.hitch.holding import Grip, grip_capacity, rest_capacity
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Hold, HoldBy, Motion, joined_motions
from hitchopt.objects import Rim, SolidObject
from hitchopt.objects.placing import TOUCH, footing, poses_of, stacked_on, surface_below
from hitchopt.planners.carrying.holds import GripHold, RestHold, polygon_at
from hitchopt.planners.carrying.moves import Move
from hitchopt.planners.carrying.planner import (
    BELOW_RIM,
    LIFT_SPEED,
    GraspState,
    MovePlanner,
    check_opens,
    check_pull,
    one_phase,
)
from hitchopt.planners.carrying.polygons import ROOM, HoldPolygons, grip_polygons, rest_polygons
from hitchopt.steps.moving import Morph, Transport
from hitchopt.steps.step import (
    Knob,
    ObjectOf,
    Place,
    RolledLegs,
    Seconds,
    Stage,
    Step,
    StepPlan,
    StepTask,
    Yaw,
    checks_relaxed_by,
)
from hitchopt.values import Array
from hitchopt.values.fields import Key, points, words
from hitchopt.values.units import LENGTH, TENSION

AROUND_SPEED, OVER = 0.15, 0.10
"""Vertical speed around an object [m/s]; height of the lowest drone over objects below, besides
``separation.radius`` [m]."""

SPREAD, MORE_ROLL = 1.03, (1.3, 2.5, 3.5)
"""Distances with which legs close below a rim, over their limits, since the motion takes some of
them; and factors of the least roll, in order: a load brings legs nearer to each other, and drones
may pass the other legs of their cables as legs close."""

MIN_FOOTING = 0.02
"""[m] Smallest distance of centres of mass within the edges of what an object is set down on: the
error of an object's place."""

SAME = 1e-6
"""[m] Places that differ by less are the same."""

MAX_VIA = 100
"""Most places on the way of one object."""

PAST = frozenset({"keep_out", "object_clearance"})
"""Checks of obstacles, which an object is carried over or around."""

LOAD_LIMITED = frozenset({"load", "thrust", "tilt", "equilibrium", "grip"})
"""Limits that only less weight, or more capacity, satisfies."""


def object_of(task: StepTask, name: str) -> SolidObject:
    """Return an object, where it is by now; raise InputError unless it can be held."""
    objects, key = task.requirements.objects, f"objects.{name}"
    body = objects[name]
    if not task.before.team.layout.closed:
        raise InputError("team.topology", "open", "closed where objects are held", "close it")
    if body.fixed:
        raise InputError(f"{key}.fixed", True, "false where it is held", "leave it out")
    if body.friction == 0.0:
        bound, remedy = "above 0 where it is held", "nothing else takes it along as cables move"
        raise InputError(f"{key}.friction", 0.0, bound, remedy)
    for other in stacked_on(objects, name, task.requirements.floor):
        at, bound = objects[other].at.tolist(), f"off objects.{name}, which is held on its own"
        raise InputError(f"objects.{other}.at", at, bound, f"carry objects.{other} away before")
    return body


def planner_of(task: StepTask) -> MovePlanner:
    """Return the planner of moves with the object that the hitch is around, or holds."""
    return MovePlanner(task.grasp, task.requirements, task.index)


def goal_of(step: Step, requirements: Requirements, name: str) -> Array:
    """Return the place (4,) of a held object's base after a step."""
    objects = requirements.objects
    below, _ = surface_below(objects, poses_of(objects), name, requirements.floor)
    goal = step.place_after(objects[name], below)
    return objects[name].place if goal is None else goal


def joined(step: Step, task: StepTask, parts: Sequence[Motion], hold: Hold | None = None) -> Motion:
    """Return motions in a row as a step's phase of its duration; an object may be held."""
    motion = one_phase(parts, task.requirements, task.index, step.name, hold)
    return step.lasting(task, motion)


def held_plan(step: Step, task: StepTask, after: GraspState, moves: Sequence[Move]) -> StepPlan:
    """Return the plan of moves in a row, slowed together, that ends in a state."""
    motion = step.lasting(task, planner_of(task).motion(moves, step.name))
    return plan_to(task, after, motion, moves[-1].end, moves[-1].below[1])


def plan_to(
    task: StepTask, after: GraspState, motion: Motion, place: Array, below: float = 0.0
) -> StepPlan:
    """Return the plan of a motion that ends in a state, with the object's base at a place (4,).

    Its clasps are ``below`` its rim [m].
    """
    objects = dict(task.requirements.objects)
    body = objects[after.object] = objects[after.object].moved_to(place)
    hitch, hold = task.hitch, after.hold
    if hold is not None:
        depth = below + float(hold.drop(after.tension, float(after.borne)))
        hitch = hold.hitch(body, depth)
    drones = motion.drones.at(motion.duration)
    return StepPlan(
        motion, replace(task.before, drones=drones, hitch=hitch, grasp=after, objects=objects)
    )


def check_hold(task: StepTask, planner: MovePlanner) -> None:
    """Raise InfeasibleError if the hitch breaks limits at rest, or as it rises to a rim."""
    from hitchopt.steps.certified_motions import checked

    hold, name = planner.hold, f"objects.{planner.state.object}"
    bearing, when = planner.from_state(borne=True), f"with {name} off its support"
    try:
        if isinstance(hold, RestHold):
            hold.check_unbent(planner.state.tension)
        checked(StepPlan(bearing.motion([bearing.rest(1.0)], "hold"), task.before), when)
        if isinstance(hold, RestHold):
            when = f"as the clasps take {name}"
            moves = planner.rim_move(planner.gap, 0.0), planner.transfer(0.0, 1.0)
            checked(StepPlan(planner.motion(moves, "lift"), task.before), when)
    except InfeasibleError as error:
        robots = "use more robots, as hitchopt fit counts them"
        last = robots if hold.by is HoldBy.REST else "use rougher cables, or give it a rim"
        words, most = capacities(planner, task.requirements)
        remedy = f"lower {name}.mass, or ask for another tension, or {last}{words}"
        own, violations = planner.body.mass, list[Violation]()
        if own > most:
            heavy = Violation("load", own, most, "max", "kg", (planner.state.object,), when, remedy)
            violations.append(heavy)
        for each in error.violations:
            more = ", or raise limits.tilt_deg" if each.constraint == "tilt" else ""
            more += "" if each.constraint in LOAD_LIMITED else f", or {each.remedy}"
            violations.append(replace(each, when=when, remedy=remedy + more))
        raise InfeasibleError(violations) from None


def capacities(planner: MovePlanner, requirements: Requirements) -> tuple[str, float]:
    """Return in words which masses the hold bears, and a gripped outline as a rim; or nothing.

    And the largest mass of the hold [kg], inf if not known.
    """
    hold, team, body = planner.hold, planner.hold.team, planner.body
    tension, kind = float(np.min(planner.state.tension)), team.quadrotor[0]
    length, texts, most = float(np.min(team.cable_length)), list[str](), np.inf
    rests, height = hold.closed, float(body.centre_of_mass[2]) - hold.height
    with contextlib.suppress(InfeasibleError):
        if isinstance(hold, GripHold):
            grip = Grip.of(body.section, hold.closed, length, tension, team.cable_friction)
            bears = grip_capacity(grip, kind, body.friction, GRIP_LIMIT)
            texts, most = [f"a grip holds {bears.mass:.2g} kg"], bears.mass
            rim = replace(body, rim=Rim(body.section, body.lower))
            rests = rest_polygons(planner.state.object, rim, team.robots, planner.gap).closed
            height = float(body.centre_of_mass[2]) - body.lower
        shape = ConvexPolygon(rests)
        bears = rest_capacity(shape, length, tension, kind, requirements, height)
        texts.append(f"a rim {'' if texts else 'holds '}{bears.mass:.2g} kg")
        most = min(most, bears.mass) if hold.by is HoldBy.REST else most
    return (f" ({', '.join(texts)})" if texts else ""), most


def in_turn(steps: Sequence[Step], task: StepTask) -> StepPlan:
    """Return the plan of steps in a row, without transports that change nothing."""
    motions, here = [], task
    for step in steps:
        place = np.append(here.hitch.polygon.centroid, here.hitch.altitude)
        if isinstance(step, Transport) and np.max(np.abs(place - step.to)) < SAME:
            continue
        planned = step.plan(here)
        motions.append(planned.motion)
        here = task.within(planned.after.at_objects(task.requirements), planned.after)
    return StepPlan(joined_motions(motions), here.before)


def altitude_over(task: StepTask) -> float:
    """Return the hitch's altitude [m], or a higher one that clears all objects."""
    requirements, hitch = task.requirements, task.hitch
    tops = [float(each.at[2]) + each.upper for each in requirements.objects.values()]
    sink = max(hitch.altitude - float(np.min(hitch.drones[:, 2])), 0.0)
    over = requirements.separation.radius + OVER + sink
    return max(hitch.altitude, *(top + over for top in tops))


def slowly(requirements: Requirements) -> Requirements:
    """Return requirements with the speed of hitches that come down around objects."""
    limits = requirements.limits
    speed, vertex_speed = (min(x, AROUND_SPEED) for x in (limits.speed, limits.vertex_speed))
    return replace(requirements, limits=replace(limits, speed=speed, vertex_speed=vertex_speed))


def beside(task: StepTask, name: str) -> Requirements:
    """Return requirements of slow motion next to an object that cables may touch."""
    others = {key: each for key, each in task.requirements.objects.items() if key != name}
    return slowly(replace(task.requirements, objects=others))


@dataclass(frozen=True)
class Enclose(Step):
    """The hitch goes above an object, takes a polygon around it, and comes down around it.

    It ends just below the object's rim, or, without one, as high as the centre of mass.
    """

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.FREE, Stage.AROUND)
    object: ObjectOf
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan from anywhere to around the object."""
        requirements, hitch, team = task.requirements, task.hitch, task.before.team
        body, gap = object_of(task, self.object), requirements.separation.object + ROOM
        if body.rim is None:
            polygons = grip_polygons(self.object, body, team, requirements, gap)
            inside = float(body.at[2] + body.centre_of_mass[2])
        else:
            polygons = rest_polygons(self.object, body, len(hitch.polygon), gap)
            below = requirements.separation.object + BELOW_RIM
            inside = float(body.at[2]) + body.rim.height - below
        least, height = requirements.separation.object, inside - requirements.floor
        if height < least - TOUCH:
            name, where = f"objects.{self.object}", ("ground",)
            remedy = f"make {name} or its rim higher, or stand it on something"
            margin, when = ("object_clearance", height, least), f"with the hitch around {name}"
            raise InfeasibleError([Violation(*margin, "min", "m", where, when, remedy)])
        polygons, polygon = _numbered(polygons, body, hitch.polygon)
        wide = float(np.max(np.linalg.norm(polygon.vertices - polygon.centroid, axis=1)))
        remedy = f"tie the hitch as large as around objects.{self.object}, {wide:.2g} m in radius"
        check_opens(hitch, polygon.vertices, requirements, remedy)
        places = hitch.polygon.centroid, polygon.centroid
        up, there = (Transport(np.append(place, altitude_over(task))) for place in places)
        above = in_turn([up, there, Morph(polygon)], task)
        slow = task.within(slowly(requirements), above.after)
        down = Transport(np.append(polygon.centroid, inside)).plan(slow)
        grasp = GraspState(self.object, polygons, team.tension)
        motion = joined(self, task, [above.motion, down.motion])
        return StepPlan(motion, replace(down.after, grasp=grasp))


def _numbered(
    polygons: HoldPolygons, body: SolidObject, polygon: Outline
) -> tuple[HoldPolygons, ConvexPolygon]:
    """Return the polygons numbered for the shortest paths of vertices, and the one around.

    Polygons about a disc are turned for them, too.
    """
    here = polygon.vertices - polygon.centroid
    if body.rim is None and body.section.radius is not None:
        there, goal = (points @ np.array([1.0, 1.0j]) for points in (polygons.around, here))
        products = [np.vdot(np.roll(there, -k), goal) for k in range(len(there))]
        angle = float(np.angle(max(products, key=abs))) - body.yaw
        c, s = math.cos(angle), math.sin(angle)
        turn = np.array([[c, s], [-s, c]])
        polygons = HoldPolygons(polygons.around @ turn, polygons.closed @ turn)
    around = polygon_at(body, polygons.around)
    there = around.vertices - around.centroid
    squares = [np.sum((np.roll(there, -k, axis=0) - here) ** 2) for k in range(len(there))]
    best = int(np.argmin(squares))
    rolled = (np.roll(each, -best, axis=0) for each in (polygons.around, polygons.closed))
    return HoldPolygons(*rolled), around.renumbered(best)


By = Literal["rest", "grip"]
"""How an object is held."""

BY = words("rest", "grip")

BY_TEXT = "rest: its rim lies on the clasps; grip: cables are wrapped around it"

Pull = Annotated[
    float | None,
    Key(TENSION, "Of all cables while it is held; without it the team's"),
]

BALANCE = frozenset({"equilibrium", "keep_out"})
"""Checks that a higher or a lower tension may satisfy."""


class PullStep(Step):
    """A step that sets how an object is held, and the tension of all cables."""

    by: By | None
    tension: float | None

    def held_by(self, body: SolidObject) -> By:
        """Return how it holds an object."""
        return self.by or ("rest" if body.rim else "grip")

    def knobs(self) -> Iterator[Knob]:
        """Yield the tension and the knobs of all steps."""
        yield from super().knobs()
        if self.tension is not None:
            pull = Knob("tension", self.tension, "N", covers=BALANCE | {"load", "grip"})
            yield pull
            covers = (
                BALANCE | checks_relaxed_by("tension") | checks_relaxed_by("length") | {"crossing"}
            )
            yield replace(pull, sign=-1, covers=covers)


@dataclass(frozen=True)
class Grasp(PullStep):
    """The hitch closes below the object's rim and rises to it, or closes around it and grips it."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.AROUND, Stage.GRASPED)
    object: ObjectOf
    by: Annotated[By, Key(BY, BY_TEXT)] = "rest"
    tension: Pull = None
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan from around the object to clasps below its rim, or edges that grip."""
        from hitchopt.steps.certified_motions import end_of_morph, first_planned

        body, team = object_of(task, self.object), task.before.team
        tension = team.tension if self.tension is None else np.full(team.robots, self.tension)
        if self.by == "grip":
            return self._grip(task, body, tension)
        if body.rim is None:
            key, bound = f"objects.{self.object}.rim", "given where it is held by rest"
            raise InputError(key, None, bound, "give it a rim, or grasp it by: grip")
        closed = task.grasp.polygons.closed
        below, free = polygon_at(body, closed), beside(task, self.object)
        far = {key: SPREAD * value for key, value in vars(free.separation).items()}
        spaced = replace(free, separation=replace(free.separation, **far))
        near = end_of_morph(task.hitch, below, None, spaced).hitch  # as near as limits allow
        closings = (Morph(below, RolledLegs(near.q_legs, x * near.roll)) for x in MORE_ROLL)
        within = task.within(free, task.before)
        closing = first_planned(partial(each.plan, within) for each in closings)
        hitch = closing.after.hitch
        assert hitch is not None
        hold = RestHold(team, body, closed, body.rim.height, hitch.fractions, hitch.roll)
        planner = planner_of(task).from_state(tension=tension, hold=hold)
        check_hold(task, planner)
        moves = [*planner.retension(team.tension, tension), planner.rim_move(planner.gap, 0.0)]
        rising = planner.motion(moves, self.name)
        motion = joined(self, task, [closing.motion, rising], rising.phases[0].hold)
        return plan_to(task, planner.state, motion, body.place)

    def _grip(self, task: StepTask, body: SolidObject, tension: Array) -> StepPlan:
        """Return the plan from around the object to cables that grip it with tensions (n,) [N]."""
        team, polygons = task.before.team, task.grasp.polygons
        if body.rim is not None:
            key = f"mission[{task.index}].{self.name}.by"
            bound = "rest where the object has a rim, which the hitch is below"
            raise InputError(key, "grip", bound, "leave out the rim")
        check_pull(float(np.max(tension)), team, task.requirements)
        height, equal, flat = (
            float(body.centre_of_mass[2]),
            np.full(team.robots, 0.5),
            np.zeros(team.robots),
        )
        shape = polygons.closed, height, equal, flat, polygons.around, task.hitch.fractions
        hold = GripHold(team, body, *shape)
        planner = planner_of(task).from_state(tension=tension, hold=hold)
        check_hold(task, planner)
        motion = self.lasting(task, planner.close_grip(team.tension, self.name))
        return plan_to(task, planner.state, motion, body.place)


@dataclass(frozen=True)
class Lift(Step):
    """The object's weight passes to the clasps, and it is lifted straight up."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.GRASPED, Stage.LIFTED)
    by: Annotated[float, Key(LENGTH, "How far up", 0.5)]
    duration: Seconds = None

    def place_after(self, body: SolidObject, below: float) -> Array:  # noqa: ARG002
        """Return the place that much higher."""
        return np.array([*body.at[:2], body.at[2] + self.by, body.yaw])

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan straight up."""
        planner = planner_of(task)
        to = goal_of(self, task.requirements, planner.state.object)
        moves = [planner.transfer(0.0, 1.0), planner.carry(to, LIFT_SPEED)]
        return held_plan(self, task, replace(task.grasp, borne=True), moves)


@dataclass(frozen=True, eq=False)
class Carry(Step):
    """The object goes on a straight line and turns, so gently that it stays on its supports."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.LIFTED, Stage.LIFTED)
    object: ObjectOf
    to: Place
    yaw: Yaw = 0.0
    duration: Seconds = None

    def place_after(self, body: SolidObject, below: float) -> Array:  # noqa: ARG002
        """Return the given place, turned by its yaw."""
        return np.append(self.to, body.yaw + self.yaw)

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan along the line."""
        to = goal_of(self, task.requirements, self.object)
        move = planner_of(task).carry(to, task.requirements.limits.speed)
        return held_plan(self, task, task.grasp, [move])


@dataclass(frozen=True)
class SetDown(Step):
    """The object goes straight down until it stands, and its weight passes to its support."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.LIFTED, Stage.GRASPED)
    object: ObjectOf
    duration: Seconds = None

    def place_after(self, body: SolidObject, below: float) -> Array:
        """Return the place straight below."""
        return np.array([*body.at[:2], below - body.lower, body.yaw])

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan straight down, to a place in which the object stands well."""
        objects, planner = task.requirements.objects, planner_of(task)
        body, to = objects[self.object], goal_of(self, task.requirements, self.object)
        inside = footing({**objects, self.object: body.moved_to(to)}, self.object)
        if inside < MIN_FOOTING:
            bound = (
                f"where the centre of mass of objects.{self.object} is {MIN_FOOTING:g} m within "
                f"the edges of what it stands on, not {max(inside, 0.0):.3g} m"
            )
            place = [round(float(x), 9) for x in to[:3]]
            remedy = "set it down farther in, or on something wider"
            raise InputError(f"mission[{task.index}]", place, bound, remedy)
        down = planner.carry(to, LIFT_SPEED)
        moves = [down, replace(planner.transfer(1.0, 0.0), start=to, end=to)]
        return held_plan(self, task, replace(task.grasp, borne=False), moves)


@dataclass(frozen=True)
class Loosen(Step):
    """The hitch opens around the object, having sunk below its rim, and pulls as the team does."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.GRASPED, Stage.AROUND)
    object: ObjectOf
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan from clasps below the rim to a hitch around the object."""
        body, planner, team = object_of(task, self.object), planner_of(task), task.before.team
        freed, hold = replace(task.grasp, tension=team.tension, hold=None), planner.hold
        if isinstance(hold, GripHold):
            motion = self.lasting(task, planner.open_grip(team.tension, self.name))
            after = plan_to(task, freed, motion, body.place).after
            return StepPlan(motion, replace(after, hitch=hold.opened.hitch(body)))
        lower = planner.retension(planner.state.tension, team.tension)
        sinking = planner.motion([planner.rim_move(0.0, planner.gap), *lower], self.name)
        loose = replace(freed, hold=hold)
        low = plan_to(task, loose, sinking, body.place, planner.gap).after
        around = Morph(polygon_at(body, freed.polygons.around))
        opening = around.plan(task.within(beside(task, self.object), low))
        motion = joined(self, task, [sinking, opening.motion], sinking.phases[0].hold)
        return StepPlan(motion, replace(opening.after, grasp=freed))


@dataclass(frozen=True)
class Leave(Step):
    """The hitch goes straight up until it is above all objects."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.AROUND, Stage.FREE)
    object: ObjectOf
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan straight up."""
        over = Transport(np.append(task.hitch.polygon.centroid, altitude_over(task)))
        planned = over.plan(task.within(slowly(task.requirements), task.before))
        motion = joined(self, task, [planned.motion])
        return StepPlan(motion, replace(planned.after, grasp=None))


@dataclass(frozen=True, eq=False)
class TransportObject(PullStep):
    """The hitch takes an object and sets it down elsewhere, in seven steps, or more by ``via``."""

    object: ObjectOf
    to: Place
    by: Annotated[By | None, Key(BY, f"{BY_TEXT}; without it rest if it has a rim")] = None
    tension: Pull = None
    yaw: Yaw = 0.0
    lift: Annotated[
        float,
        Key(LENGTH, "How far above the higher of the two places"),
    ] = 0.3
    via: Annotated[
        Array | None,
        Key(points((None, 3), "x, y, z", 1, MAX_VIA), "Where its base goes between, at rest there"),
    ] = None

    def knobs(self) -> Iterator[Knob]:
        """Yield the height of the flight, and the knobs of all such steps."""
        yield from super().knobs()
        yield Knob("lift", self.lift, "m", covers=PAST)

    def place_after(self, body: SolidObject, below: float) -> Array:  # noqa: ARG002
        """Return the given place, turned by its yaw."""
        return np.append(self.to, body.yaw + self.yaw)

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of the seven steps; ``to`` must be on the surface below it."""
        body = object_of(task, self.object)
        high = max(float(body.at[2]), float(self.to[2])) + self.lift
        steps = [
            Enclose(self.object),
            Grasp(self.object, self.held_by(body), self.tension),
            Lift(high - float(body.at[2])),
            *(Carry(self.object, place) for place in ([] if self.via is None else self.via)),
            Carry(self.object, np.append(self.to[:2], high), self.yaw),
            SetDown(self.object),
            Loosen(self.object),
            Leave(self.object),
        ]
        planned = in_turn(steps, task)
        height = float(planned.after.at_objects(task.requirements).objects[self.object].at[2])
        if abs(height - self.to[2]) > TOUCH:
            key, bound = f"mission[{task.index}].{self.name}.to", "on what is below it"
            remedy = f"write {[*self.to[:2].tolist(), round(height, 9)]}"
            raise InputError(key, self.to.tolist(), f"{bound}, at {height:.6g} m", remedy)
        return planned
