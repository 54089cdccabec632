"""Steps that carry an object: enclose, grasp, lift, carry, set down, loosen, leave, or all."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np

from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.geometry import ConvexPolygon, Outline
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import HoldBy
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import TOUCH, footing, poses_of, surface_below
from hitchopt.steps.moving import Morph, Transport
from hitchopt.steps.step import (
    Holding,
    Knob,
    Situation,
    Stage,
    Step,
    StepPlan,
    StepTask,
    eased,
)
from hitchopt.steps.step_keys import (
    Key,
    ObjectOf,
    Place,
    Positive,
    RolledLegs,
    Seconds,
    Yaw,
    one_of,
)
from hitchopt.values import Array, positive

if TYPE_CHECKING:
    from hitchopt.planners.carrying.rest import HoldPolygons

AROUND_SPEED = 0.15
"""[m/s] Speed upright around an object."""

SPREAD, MORE_ROLL = 1.03, 1.3
"""Distances with which legs close below a rim, over those to be kept, since the motion takes some
of them; and factor of the least roll."""

OVER = 0.10
"""[m] Room between drones' lowest places and objects below, besides ``separation.radius``."""


@dataclass(frozen=True)
class Enclose(Step):
    """The hitch goes above an object, takes a polygon around it, and comes down around it.

    It ends just below the object's rim, or, without one, as high as the centre of mass.

    Parameters
    ----------
    object: its name.
    duration: of the whole step, exactly that long [s]; None for as fast as the limits allow.
    """

    name: ClassVar[str] = "enclose"
    summary: ClassVar[str] = "Come down around an object"
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.FREE, Stage.AROUND)
    object: ObjectOf
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan from anywhere to around the object.

        Raises
        ------
        InfeasibleError: no polygon, one that is close to the ground, or clasps that rub on each
            other and do not open so far.
        """
        from hitchopt.planners.carrying.grip import check_opens, grip_polygons
        from hitchopt.planners.carrying.rest import rest_polygons
        from hitchopt.steps import held_moves as held

        requirements, hitch = task.requirements, task.hitch
        body, gap = held.object_of(task, self.object), held.gap_around(requirements)
        if body.rim is None:
            found = grip_polygons(self.object, body, task.before.team, requirements, gap)
            inside = float(body.at[2] + body.centre_of_mass[2])
        else:
            found = rest_polygons(self.object, body, len(hitch.polygon), gap)
            inside = float(body.at[2]) + body.rim.height - held.gap_below(requirements)
        self._check_height(task, inside)
        polygons, polygon = _numbered(found, body, hitch.polygon)
        wide = float(np.max(np.linalg.norm(polygon.vertices - polygon.centroid, axis=1)))
        remedy = f"tie the hitch as large as around objects.{self.object}, {wide:.2g} m in radius"
        check_opens(hitch, polygon.vertices, requirements, remedy)
        over = altitude_over(task)
        there = Transport(np.append(polygon.centroid, over))
        ways: list[Transport | Morph] = [
            Transport(np.append(hitch.polygon.centroid, over)),
            there,
            Morph(polygon),
        ]
        above = held.in_turn(self, ways, task)
        down = self.part(
            Transport(np.append(polygon.centroid, inside)),
            task.within(slowly(requirements), above.after),
        )
        motion = held.one_phase([above.motion, down.motion], task, self.name)
        holding = Holding(self.object, polygons, task.before.team.tension)
        return StepPlan(self.lasting(task, motion), replace(down.after, holding=holding))

    def _check_height(self, task: StepTask, inside: float) -> None:
        """Raise InfeasibleError where the hitch around the object would be close to the ground."""
        requirements = task.requirements
        least, height = requirements.separation.object, inside - requirements.floor
        if height < least - TOUCH:
            body = requirements.objects[self.object]
            name = f"objects.{self.object}"
            remedy = "stand it on something"
            if body.rim is None or body.stem is not None:
                higher = f"make {name} higher" if body.rim is None else f"raise {name}.rim.at"
                remedy = f"{higher}, or {remedy}"
            where, when = ("ground",), f"with the hitch around objects.{self.object}"
            broken = Violation("object_clearance", height, least, "min", "m", where, when, remedy)
            raise InfeasibleError([broken])


def altitude_over(task: StepTask) -> float:
    """Return the hitch's altitude, or a higher one at which it passes above all objects [m]."""
    requirements = task.requirements
    tops = [float(each.at[2]) + each.upper for each in requirements.objects.values()]
    over = requirements.separation.radius + OVER
    sink = task.hitch.altitude - float(np.min(task.hitch.drones[:, 2]))
    return max(task.hitch.altitude, *(top + over + max(sink, 0.0) for top in tops))


def slowly(requirements: Requirements) -> Requirements:
    """Return requirements with the speed at which hitches come down around objects."""
    limits = requirements.limits
    slow = replace(
        limits,
        speed=min(limits.speed, AROUND_SPEED),
        vertex_speed=min(limits.vertex_speed, AROUND_SPEED),
    )
    return replace(requirements, limits=slow)


def _numbered(
    found: HoldPolygons, body: SolidObject, polygon: Outline
) -> tuple[HoldPolygons, ConvexPolygon]:
    """Return the polygons numbered so that vertices have the shortest paths, and that around."""
    from hitchopt.steps.held_moves import polygon_at

    here = polygon.vertices - polygon.centroid
    if body.rim is None and body.section.radius is not None:
        found = _turned(found, body, here)
    around = polygon_at(body, found.around)
    there = around.vertices - around.centroid
    lengths = [np.sum((np.roll(there, -k, axis=0) - here) ** 2) for k in range(len(there))]
    best = int(np.argmin(lengths))
    around_, closed = (np.roll(p, -best, axis=0) for p in (found.around, found.closed))
    return replace(found, around=around_, closed=closed), around.renumbered(best)


def _turned(found: HoldPolygons, body: SolidObject, here: Array) -> HoldPolygons:
    """Return polygons around a circle, turned so that vertices have the shortest paths.

    Parameters
    ----------
    here: (n, 2) [m], vertices of the hitch about its centroid.
    """
    there, goal = (points @ np.array([1.0, 1.0j]) for points in (found.around, here))
    alike = [np.vdot(np.roll(there, -k), goal) for k in range(len(there))]
    angle = float(np.angle(max(alike, key=abs))) - body.yaw
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, s], [-s, c]])
    return replace(found, around=found.around @ turn, closed=found.closed @ turn)


By = Literal["rest", "grip"]
"""How an object is held."""

PULL_TEXT = "Of all cables while it is held [N]; without it the team's"

Pull = Annotated[float | None, Key(Positive, PULL_TEXT, check=positive)]


BALANCE = frozenset({"equilibrium", "keep_out"})
"""Checks that another tension may satisfy as well as forces and distances."""


class PullStep(Step):
    """A step that says how hard cables pull from here on."""

    tension: float | None

    def knobs(self) -> Iterator[Knob]:
        """Yield the tension, and what else repair may change."""
        yield from super().knobs()
        if self.tension is not None:
            pull = Knob("tension", self.tension, "N")
            yield replace(pull, covers=BALANCE | {"load", "grip"})
            yield replace(
                pull, sign=-1, covers=BALANCE | eased("tension") | eased("length") | {"crossing"}
            )


@dataclass(frozen=True)
class Grasp(PullStep):
    """The hitch closes below the object's rim and rises to it, or closes around it and grips it.

    Parameters
    ----------
    object: its name.
    by: ``rest``: its rim lies on the clasps; ``grip``: cables are wrapped around it.
    tension: of all cables from here on [N]; None for the team's.
    duration: as of Enclose.
    """

    name: ClassVar[str] = "grasp"
    summary: ClassVar[str] = "Close around an object"
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.AROUND, Stage.GRASPED)
    object: ObjectOf
    by: Annotated[
        By, Key(By, "rest: its rim lies on the clasps; grip: cables around it", check=one_of(By))
    ] = "rest"
    tension: Pull = None
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan from around the object to clasps below its rim, or edges that grip."""
        from hitchopt.steps import held_moves as held
        from hitchopt.steps.holds import grip_closed

        if self.by == "grip":
            return grip_closed(self, task, self.tension)
        body, team = held.object_of(task, self.object), task.before.team
        if body.rim is None:
            key, bound = f"objects.{self.object}.rim", "given where it is held by rest"
            raise InputError(key, None, bound, "give it a rim, or grasp it by: grip")
        asked = team.tension if self.tension is None else np.full(team.robots, self.tension)
        closing, here = self._closing(task, body, asked)
        gap = held.gap_below(task.requirements)
        moves = [*held.tension_moves(here, team.tension, asked, gap), held.rim_move(here, gap, 0.0)]
        touching = held.held_motion(here, moves, self.name)
        motion = held.one_phase(
            [closing.motion, touching], task, self.name, touching.phases[0].hold
        )
        motion = self.lasting(task, motion)
        return held.ended_holding(task, here.holding, motion, held.place_of(body))

    def _closing(
        self, task: StepTask, body: SolidObject, asked: Array
    ) -> tuple[StepPlan, StepTask]:
        """Return the plan of closing below the rim, and the task of holding the object after it.

        Legs end as near to the current fractions as limits allow, distances a little larger than
        they have to be; rolled legs are rolled more, since a load brings them nearer to each
        other.

        Parameters
        ----------
        body: to be held.
        asked: (n,) [N], tensions with which it is held.
        """
        from hitchopt.planners.carrying.rest import HeldHitch
        from hitchopt.steps.held_moves import polygon_at, rolling_morph
        from hitchopt.steps.holds import check_held, spaced
        from hitchopt.steps.route_choice import end_of_morph

        team, polygons = task.before.team, task.holding.polygons
        below = polygon_at(body, polygons.closed)
        free = task.within(slowly(without(task, self.object)), task.before)
        assert body.rim is not None
        places = np.column_stack([polygons.closed, np.full(team.robots, body.rim.height)])
        wide = spaced(free.requirements, SPREAD)
        near = end_of_morph(task.hitch, below, None, wide).hitch
        legs = RolledLegs(near.q_legs, MORE_ROLL * near.roll)
        plan = rolling_morph(self, Morph(below, legs), free)
        hitch = plan.after.hitch
        assert hitch is not None
        held = HeldHitch(team, body, places, hitch.fractions, hitch.roll)
        holding = Holding(self.object, polygons, asked, held)
        here = replace(task, before=replace(plan.after, holding=holding))
        check_held(here)
        return plan, here


def without(task: StepTask, name: str) -> Requirements:
    """Return the requirements without an object that cables may touch."""
    others = {key: each for key, each in task.requirements.objects.items() if key != name}
    return replace(task.requirements, objects=others)


@dataclass(frozen=True)
class Lift(Step):
    """The object's weight passes to the clasps, and it is lifted.

    Parameters
    ----------
    by: how far [m].
    duration: as of Enclose.
    """

    name: ClassVar[str] = "lift"
    summary: ClassVar[str] = "Lift what is held"
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.GRASPED, Stage.LIFTED)
    by: Annotated[float, Key(Positive, "How far up [m]", (0.5,), check=positive)]
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan straight up."""
        from hitchopt.steps import held_moves as held

        start = held.place_of(task.requirements.objects[task.holding.name])
        to = start + np.array([0.0, 0.0, self.by, 0.0])
        moves = [
            held.transferred(task, 0.0, 1.0),
            held.carried_move(task, start, to, held.LIFT_SPEED),
        ]
        return held.held_plan(self, task, replace(task.holding, borne=True), moves)


@dataclass(frozen=True, eq=False)
class Carry(Step):
    """The object goes on a straight line and turns, so gently that it stays on its supports.

    Parameters
    ----------
    object: its name.
    to: (3,) [m], where the origin of its base goes.
    yaw: by how much it turns, counter-clockwise [rad].
    duration: as of Enclose.
    """

    name: ClassVar[str] = "carry"
    summary: ClassVar[str] = "Carry what is held elsewhere"
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.LIFTED, Stage.LIFTED)
    object: ObjectOf
    to: Place
    yaw: Yaw = 0.0
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan along the line."""
        from hitchopt.steps.held_moves import carried_move, held_plan, place_of

        start = place_of(task.requirements.objects[self.object])
        to = np.append(self.to, start[3] + self.yaw)
        moves = [carried_move(task, start, to, task.requirements.limits.speed)]
        return held_plan(self, task, task.holding, moves)


INSIDE = 0.02
"""[m] Centres of mass are set down this far within the edges of what is below: so far may an object
be from where it was planned to be."""


@dataclass(frozen=True)
class SetDown(Step):
    """The object goes straight down until it stands, and its weight passes to what it stands on.

    Parameters
    ----------
    object: its name.
    duration: as of Enclose.
    """

    name: ClassVar[str] = "set_down"
    summary: ClassVar[str] = "Set down what is held"
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.LIFTED, Stage.GRASPED)
    object: ObjectOf
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan straight down.

        Raises
        ------
        InputError: it would stand too close to the edge of what is below it.
        """
        from hitchopt.steps import held_moves as held

        objects, floor = task.requirements.objects, task.requirements.floor
        body = objects[self.object]
        surface, _ = surface_below(objects, poses_of(objects), self.object, floor)
        start = held.place_of(body)
        to = np.concatenate([start[:2], [surface - body.lower], start[3:]])
        self._check_footing(task, held.moved_to(body, to))
        unloading = replace(held.transferred(task, 1.0, 0.0), start=to, end=to)
        moves = [held.carried_move(task, start, to, held.LIFT_SPEED), unloading]
        return held.held_plan(self, task, replace(task.holding, borne=False), moves)

    def _check_footing(self, task: StepTask, body: SolidObject) -> None:
        """Raise InputError where an object would stand at an edge."""
        inside = footing({**task.requirements.objects, self.object: body}, self.object)
        if inside < INSIDE:
            bound = (
                f"where the centre of mass of objects.{self.object} is {INSIDE:g} m within the "
                f"edges of what it stands on, not {max(inside, 0.0):.3g} m"
            )
            place = [round(float(x), 9) for x in body.at]
            remedy = "set it down farther in, or on something wider"
            raise InputError(f"mission[{task.index}]", place, bound, remedy)


@dataclass(frozen=True)
class Loosen(Step):
    """The hitch opens around the object, having sunk below its rim, and pulls as the team does.

    Parameters
    ----------
    object: its name.
    duration: as of Enclose.
    """

    name: ClassVar[str] = "loosen"
    summary: ClassVar[str] = "Open around an object"
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.GRASPED, Stage.AROUND)
    object: ObjectOf
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan from clasps below the rim to a hitch around the object."""
        from hitchopt.steps import held_moves as held
        from hitchopt.steps.holds import grip_opened

        body, team, holding = held.object_of(task, self.object), task.before.team, task.holding
        assert holding.held is not None
        if holding.held.by is HoldBy.GRIP:
            return grip_opened(self, task)
        gap = held.gap_below(task.requirements)
        lower = held.tension_moves(task, holding.tension, team.tension, gap)
        sinking = held.held_motion(task, [held.rim_move(task, 0.0, gap), *lower], self.name)
        freed = replace(holding, tension=team.tension)
        low = held.ended_holding(task, freed, sinking, held.place_of(body), gap).after
        around = Morph(held.polygon_at(body, holding.polygons.around))
        slow = slowly(without(task, self.object))
        opening = held.rolling_morph(self, around, task.within(slow, low))
        motion = held.one_phase([sinking, opening.motion], task, self.name, sinking.phases[0].hold)
        after = replace(opening.after, holding=replace(freed, held=None))
        return StepPlan(self.lasting(task, motion), after)


@dataclass(frozen=True)
class Leave(Step):
    """The hitch goes straight up until it is above all objects.

    Parameters
    ----------
    object: its name.
    duration: as of Enclose.
    """

    name: ClassVar[str] = "leave"
    summary: ClassVar[str] = "Go up from around an object"
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.AROUND, Stage.FREE)
    object: ObjectOf
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan straight up."""
        from hitchopt.steps.held_moves import one_phase

        over = np.append(task.hitch.polygon.centroid, altitude_over(task))
        planned = self.part(Transport(over), task.within(slowly(task.requirements), task.before))
        motion = one_phase([planned.motion], task, self.name)
        return StepPlan(self.lasting(task, motion), replace(planned.after, holding=None))


LIFT = 0.3
"""[m] An object is lifted this far above the higher of the two places that it stands on."""


@dataclass(frozen=True, eq=False)
class TransportObject(PullStep):
    """An object is taken from where it stands and set down elsewhere, in seven steps.

    Parameters
    ----------
    object: its name.
    to: (3,) [m], where the origin of its base goes.
    by: as of Grasp; None for ``rest`` if it has a rim, else ``grip``.
    tension: as of Grasp.
    yaw: by how much it turns, counter-clockwise [rad].
    lift: how far it is lifted above the higher of the two places [m].
    """

    name: ClassVar[str] = "transport_object"
    summary: ClassVar[str] = "Enclose, grasp, lift, carry, set down, loosen and leave an object"
    object: ObjectOf
    to: Place
    by: Annotated[
        By | None,
        Key(By, "How it is held, as in grasp; without it rest if it has a rim", check=one_of(By)),
    ] = None
    tension: Pull = None
    yaw: Yaw = 0.0
    lift: Annotated[float, Key(Positive, "How far it is lifted [m]", check=positive)] = LIFT

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of the seven steps.

        Raises
        ------
        InputError: no surface to stand on at ``to``.
        """
        from hitchopt.motion.motion import joined_motions
        from hitchopt.steps.held_moves import object_of

        body = object_of(task, self.object)
        high = max(float(body.at[2]), float(self.to[2])) + self.lift
        steps: list[Step] = [
            Enclose(self.object),
            Grasp(self.object, self.by or ("rest" if body.rim else "grip"), self.tension),
            Lift(high - float(body.at[2])),
            Carry(self.object, np.append(self.to[:2], high), self.yaw),
            SetDown(self.object),
            Loosen(self.object),
            Leave(self.object),
        ]
        motions = []
        situation = task.before
        for step in steps:
            planned = step.plan(task.within(situation.at_objects(task.requirements), situation))
            motions.append(planned.motion)
            situation = planned.after
            if isinstance(step, SetDown):
                self._check_place(situation, task.index)
        return StepPlan(joined_motions(motions), situation)

    def _check_place(self, situation: Situation, index: int) -> None:
        """Raise InputError where the object does not stand as high as was asked."""
        objects = situation.objects or {}
        height = float(objects[self.object].at[2])
        if abs(height - self.to[2]) > TOUCH:
            raise InputError(
                f"mission[{index}].{self.name}.to",
                self.to.tolist(),
                f"on what is below it, which is at {height:.6g} m",
                f"write {[*self.to[:2].tolist(), round(height, 9)]}",
            )
