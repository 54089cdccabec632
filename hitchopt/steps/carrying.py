"""Steps that carry an object: enclose, grasp, lift, carry, set down, loosen, leave, or all."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal

import numpy as np

from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.geometry import ConvexPolygon, Outline
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import HoldBy, joined_motions
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import TOUCH, footing
from hitchopt.planners.carrying.grip import check_opens, grip_polygons
from hitchopt.planners.carrying.rest import ROOM, HeldHitch, HoldPolygons, rest_polygons
from hitchopt.steps import holds
from hitchopt.steps.holds import check_held, object_of, one_phase, polygon_at
from hitchopt.steps.moving import Morph, Transport
from hitchopt.steps.step import (
    Holding,
    Key,
    Knob,
    ObjectOf,
    Place,
    Positive,
    RolledLegs,
    Seconds,
    Stage,
    Step,
    StepPlan,
    StepTask,
    Yaw,
    eased,
    one_of,
)
from hitchopt.values import Array, positive

AROUND_SPEED, OVER = 0.15, 0.10
"""Speed upright around an object [m/s]; room between drones' lowest places and objects below,
besides ``separation.radius`` [m]."""

SPREAD, MORE_ROLL = 1.03, 1.3
"""Distances with which legs close below a rim, over those to be kept, since the motion takes some
of them; and factor of the least roll, since a load brings legs nearer to each other."""

INSIDE = 0.02
"""[m] Centres of mass are set down this far within the edges of what is below: so far may an object
be from where it was planned to be."""

SAME = 1e-6
"""[m] Places that differ by less are the same."""


def in_turn(steps: Sequence[Step], task: StepTask) -> StepPlan:
    """Return the plan of steps in a row; transports to where the hitch is are left out."""
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
    """Return the hitch's altitude, or a higher one at which it passes above all objects [m]."""
    requirements, hitch = task.requirements, task.hitch
    tops = [float(each.at[2]) + each.upper for each in requirements.objects.values()]
    sink = max(hitch.altitude - float(np.min(hitch.drones[:, 2])), 0.0)
    over = requirements.separation.radius + OVER + sink
    return max(hitch.altitude, *(top + over for top in tops))


def slowly(requirements: Requirements) -> Requirements:
    """Return requirements with the speed at which hitches come down around objects."""
    limits = requirements.limits
    speed, vertex_speed = (min(x, AROUND_SPEED) for x in (limits.speed, limits.vertex_speed))
    return replace(requirements, limits=replace(limits, speed=speed, vertex_speed=vertex_speed))


def beside(task: StepTask, name: str) -> Requirements:
    """Return requirements for slow motion beside an object that cables may touch."""
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
        body, gap = holds.object_of(task, self.object), requirements.separation.object + ROOM
        if body.rim is None:
            found = grip_polygons(self.object, body, team, requirements, gap)
            inside = float(body.at[2] + body.centre_of_mass[2])
        else:
            found = rest_polygons(self.object, body, len(hitch.polygon), gap)
            inside = float(body.at[2]) + body.rim.height - holds.gap_below(requirements)
        least, height = requirements.separation.object, inside - requirements.floor
        if height < least - TOUCH:
            name, where = f"objects.{self.object}", ("ground",)
            remedy = f"make {name} or its rim higher, or stand it on something"
            told = "object_clearance", height, least, "min", "m", where
            raise InfeasibleError([Violation(*told, f"with the hitch around {name}", remedy)])
        polygons, polygon = _numbered(found, body, hitch.polygon)
        wide = float(np.max(np.linalg.norm(polygon.vertices - polygon.centroid, axis=1)))
        remedy = f"tie the hitch as large as around objects.{self.object}, {wide:.2g} m in radius"
        check_opens(hitch, polygon.vertices, requirements, remedy)
        places = hitch.polygon.centroid, polygon.centroid
        up, there = (Transport(np.append(place, altitude_over(task))) for place in places)
        above = in_turn([up, there, Morph(polygon)], task)
        slow = task.within(slowly(requirements), above.after)
        down = Transport(np.append(polygon.centroid, inside)).plan(slow)
        motion = holds.one_phase([above.motion, down.motion], task, self.name)
        holding = Holding(self.object, polygons, team.tension)
        return StepPlan(self.lasting(task, motion), replace(down.after, holding=holding))


def _numbered(
    found: HoldPolygons, body: SolidObject, polygon: Outline
) -> tuple[HoldPolygons, ConvexPolygon]:
    """Return the polygons numbered so that vertices have the shortest paths, and that around."""
    here = polygon.vertices - polygon.centroid
    if body.rim is None and body.section.radius is not None:
        there, goal = (points @ np.array([1.0, 1.0j]) for points in (found.around, here))
        alike = [np.vdot(np.roll(there, -k), goal) for k in range(len(there))]
        angle = float(np.angle(max(alike, key=abs))) - body.yaw
        c, s = math.cos(angle), math.sin(angle)
        turn = np.array([[c, s], [-s, c]])
        found = replace(found, around=found.around @ turn, closed=found.closed @ turn)
    around = polygon_at(body, found.around)
    there = around.vertices - around.centroid
    lengths = [np.sum((np.roll(there, -k, axis=0) - here) ** 2) for k in range(len(there))]
    best = int(np.argmin(lengths))
    around_, closed = (np.roll(p, -best, axis=0) for p in (found.around, found.closed))
    return replace(found, around=around_, closed=closed), around.renumbered(best)


By = Literal["rest", "grip"]
"""How an object is held."""

BY_TEXT = "rest: its rim lies on the clasps; grip: cables are wrapped around it"

Pull = Annotated[
    float | None,
    Key(Positive, "Of all cables while it is held [N]; without it the team's", check=positive),
]

BALANCE = frozenset({"equilibrium", "keep_out"})
"""Checks that another tension may satisfy as well as forces and distances."""


class PullStep(Step):
    """A step that says how an object is held, and how hard cables pull from here on."""

    by: By | None
    tension: float | None

    def held_by(self, body: SolidObject) -> By:
        """Return how it holds an object."""
        return self.by or ("rest" if body.rim else "grip")

    def knobs(self) -> Iterator[Knob]:
        """Yield the tension, and what else repair may change."""
        yield from super().knobs()
        if self.tension is not None:
            pull = Knob("tension", self.tension, "N", covers=BALANCE | {"load", "grip"})
            yield pull
            covers = BALANCE | eased("tension") | eased("length") | {"crossing"}
            yield replace(pull, sign=-1, covers=covers)


@dataclass(frozen=True)
class Grasp(PullStep):
    """The hitch closes below the object's rim and rises to it, or closes around it and grips it."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.AROUND, Stage.GRASPED)
    object: ObjectOf
    by: Annotated[By, Key(By, BY_TEXT, check=one_of(By))] = "rest"
    tension: Pull = None
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan from around the object to clasps below its rim, or edges that grip."""
        from hitchopt.steps.certified_motions import end_of_morph

        body, team = holds.object_of(task, self.object), task.before.team
        asked = team.tension if self.tension is None else np.full(team.robots, self.tension)
        if self.by == "grip":
            return holds.grip_closed(self, task, asked)
        if body.rim is None:
            key, bound = f"objects.{self.object}.rim", "given where it is held by rest"
            raise InputError(key, None, bound, "give it a rim, or grasp it by: grip")
        polygons = task.holding.polygons
        below, free = polygon_at(body, polygons.closed), beside(task, self.object)
        far = {key: SPREAD * value for key, value in vars(free.separation).items()}
        spaced = replace(free, separation=replace(free.separation, **far))
        near = end_of_morph(task.hitch, below, None, spaced).hitch  # as near as limits allow
        legs = RolledLegs(near.q_legs, MORE_ROLL * near.roll)
        closing = Morph(below, legs).plan(task.within(free, task.before))
        hitch = closing.after.hitch
        assert hitch is not None
        places = np.column_stack([polygons.closed, np.full(team.robots, body.rim.height)])
        held = HeldHitch(team, body, places, hitch.fractions, hitch.roll)
        holding = Holding(self.object, polygons, asked, held)
        here = replace(task, before=replace(closing.after, holding=holding))
        check_held(here)
        gap = holds.gap_below(task.requirements)
        moves = holds.tension_moves(here, team.tension, asked, gap)
        touching = holds.held_motion(here, [*moves, holds.rim_move(here, gap, 0.0)], self.name)
        parts, hold = [closing.motion, touching], touching.phases[0].hold
        motion = self.lasting(task, holds.one_phase(parts, task, self.name, hold))
        return holds.ended_holding(task, here.holding, motion, holds.place_of(body))


@dataclass(frozen=True)
class Lift(Step):
    """The object's weight passes to the clasps, and it is lifted straight up."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.GRASPED, Stage.LIFTED)
    by: Annotated[float, Key(Positive, "How far up [m]", (0.5,), check=positive)]
    duration: Seconds = None

    def place_after(self, body: SolidObject, below: float) -> Array:  # noqa: ARG002
        """Return the place that much higher."""
        return np.array([*body.at[:2], body.at[2] + self.by, body.yaw])

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan straight up."""
        start, to = holds.places(self, task.requirements, task.holding.name)
        up = holds.carried_move(task, start, to, holds.LIFT_SPEED)
        moves = [holds.transferred(task, 0.0, 1.0), up]
        return holds.held_plan(self, task, replace(task.holding, borne=True), moves)


@dataclass(frozen=True, eq=False)
class Carry(Step):
    """The object goes on a straight line and turns, so gently that it stays on its supports."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.LIFTED, Stage.LIFTED)
    object: ObjectOf
    to: Place
    yaw: Yaw = 0.0
    duration: Seconds = None

    def place_after(self, body: SolidObject, below: float) -> Array:  # noqa: ARG002
        """Return the place that it is given, turned by its yaw."""
        return np.append(self.to, body.yaw + self.yaw)

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan along the line."""
        start, to = holds.places(self, task.requirements, self.object)
        move = holds.carried_move(task, start, to, task.requirements.limits.speed)
        return holds.held_plan(self, task, task.holding, [move])


@dataclass(frozen=True)
class SetDown(Step):
    """The object goes straight down until it stands, and its weight passes to what it stands on."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.LIFTED, Stage.GRASPED)
    object: ObjectOf
    duration: Seconds = None

    def place_after(self, body: SolidObject, below: float) -> Array:
        """Return the place straight below."""
        return np.array([*body.at[:2], below - body.lower, body.yaw])

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan straight down, to where the object stands well."""
        objects, body = task.requirements.objects, task.requirements.objects[self.object]
        start, to = holds.places(self, task.requirements, self.object)
        inside = footing({**objects, self.object: holds.moved_to(body, to)}, self.object)
        if inside < INSIDE:
            bound = (
                f"where the centre of mass of objects.{self.object} is {INSIDE:g} m within the "
                f"edges of what it stands on, not {max(inside, 0.0):.3g} m"
            )
            place = [round(float(x), 9) for x in to[:3]]
            remedy = "set it down farther in, or on something wider"
            raise InputError(f"mission[{task.index}]", place, bound, remedy)
        down = holds.carried_move(task, start, to, holds.LIFT_SPEED)
        moves = [down, replace(holds.transferred(task, 1.0, 0.0), start=to, end=to)]
        return holds.held_plan(self, task, replace(task.holding, borne=False), moves)


@dataclass(frozen=True)
class Loosen(Step):
    """The hitch opens around the object, having sunk below its rim, and pulls as the team does."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.GRASPED, Stage.AROUND)
    object: ObjectOf
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan from clasps below the rim to a hitch around the object."""
        body, team, holding = holds.object_of(task, self.object), task.before.team, task.holding
        assert holding.held is not None
        if holding.held.by is HoldBy.GRIP:
            return holds.grip_opened(self, task)
        gap = holds.gap_below(task.requirements)
        lower = holds.tension_moves(task, holding.tension, team.tension, gap)
        sinking = holds.held_motion(task, [holds.rim_move(task, 0.0, gap), *lower], self.name)
        freed = replace(holding, tension=team.tension)
        low = holds.ended_holding(task, freed, sinking, holds.place_of(body), gap).after
        around = Morph(holds.polygon_at(body, holding.polygons.around))
        opening = around.plan(task.within(beside(task, self.object), low))
        parts, hold = [sinking, opening.motion], sinking.phases[0].hold
        motion = self.lasting(task, holds.one_phase(parts, task, self.name, hold))
        return StepPlan(motion, replace(opening.after, holding=replace(freed, held=None)))


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
        motion = self.lasting(task, one_phase([planned.motion], task, self.name))
        return StepPlan(motion, replace(planned.after, holding=None))


@dataclass(frozen=True, eq=False)
class TransportObject(PullStep):
    """An object is taken from where it stands and set down elsewhere, in seven steps."""

    object: ObjectOf
    to: Place
    by: Annotated[
        By | None,
        Key(By, f"{BY_TEXT}; without it rest if it has a rim", check=one_of(By)),
    ] = None
    tension: Pull = None
    yaw: Yaw = 0.0
    lift: Annotated[
        float,
        Key(Positive, "How far above the higher of the two places [m]", check=positive),
    ] = 0.3

    def place_after(self, body: SolidObject, below: float) -> Array:  # noqa: ARG002
        """Return the place that it is given, turned by its yaw."""
        return np.append(self.to, body.yaw + self.yaw)

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of the seven steps; what is below ``to`` has to be as high as it says."""
        body = object_of(task, self.object)
        high = max(float(body.at[2]), float(self.to[2])) + self.lift
        steps = [
            Enclose(self.object),
            Grasp(self.object, self.held_by(body), self.tension),
            Lift(high - float(body.at[2])),
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
