"""Steps that carry an object: enclose, grasp, lift, carry, set down, loosen, leave; or all."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np

from hitchopt.checks.objects import GRIP_LIMIT
from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.geometry import ConvexPolygon, Outline
from hitchopt.geometry.vectors import length, rotated, unit
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.holding import Grip, grip_capacity, rest_capacity
from hitchopt.hitch.requirements import Requirements, Separation
from hitchopt.hitch.slack_split import LegTask
from hitchopt.motion.motion import HoldBy, Motion, PhaseHold
from hitchopt.objects import Rim, SolidObject
from hitchopt.objects.placing import (
    CONTACT_GAP,
    footing,
    in_world,
    poses_of,
    stacked_on,
    surface_below,
)
from hitchopt.planners.carrying.holds import GripHold, RestHold, polygon_at
from hitchopt.planners.carrying.planner import (
    BELOW_RIM,
    LIFT_SPEED,
    GraspState,
    MovePlanner,
    check_opens,
    check_pull,
    one_phase,
)
from hitchopt.planners.carrying.polygons import (
    EDGE_MARGIN,
    HoldPolygons,
    grip_polygons,
    rest_polygons,
)
from hitchopt.steps.certified_motions import (
    end_of_morph,
    excess,
    nearest_feasible,
    require_certified,
)
from hitchopt.steps.moving import Morph, Transport
from hitchopt.steps.step import (
    Knob,
    ObjectOf,
    Place,
    RequestedHold,
    RolledLegs,
    Seconds,
    Stage,
    Step,
    StepPlan,
    StepTask,
    Yaw,
    checks_relaxed_by,
    moves_plan,
    plan_in_sequence,
    plan_to,
    planner_of,
)
from hitchopt.steps.straddling import Tie, Untie, check_hinge, hold_by_tying
from hitchopt.values import Array
from hitchopt.values.fields import Key, documented, points, with_fields, words
from hitchopt.values.units import LENGTH, TENSION

AROUND_SPEED = 0.15
"""[m/s] Speed around an object."""

OBJECT_MARGIN = 0.10
"""[m] Clearance of the lowest drone over objects, in addition to ``separation.radius``."""

CLOSING_MARGIN = 1.03
"""Factor of the separation limits as legs close below a rim, since motion reduces distances."""

ROLL_RESERVE = 1.3
"""Factor of the smallest roll of unloaded legs: a load brings legs closer together."""

HELD_ROLLS = tuple(math.radians(angle) for angle in (0.0, 9.0, 18.0, 27.0, 36.0, 45.0))
"""[rad] Other rolls of legs that hold an object by its rim, in the order of the search."""

HELD_SPLITS = (0.5, 0.4, 0.6, 0.3, 0.7)
"""Slack splits for each roll, all cables alike, after the one nearest to the hitch's own."""

MIN_FOOTING = 0.02
"""Minimum distance of a centre of mass from the edges of its support after setting down [m]: the
position error of objects."""

PLACE_TOLERANCE = 1e-6  # Places that differ by less are the same [m]
MAX_VIA = 100  # Maximum number of waypoints of one object

OBSTACLE_CHECKS = frozenset({"keep_out", "object_clearance"})
"""Checks of obstacles, over or around which an object is carried."""

LOAD_LIMITED = frozenset({"load", "thrust", "tilt", "equilibrium", "grip"})
"""Constraints that only less weight or more capacity satisfies."""


def object_of(task: StepTask, name: str) -> SolidObject:
    """Return an object at its current place; raise InputError if it cannot be held."""
    objects, key = task.requirements.objects, f"objects.{name}"
    body = objects[name]
    if not task.before.team.layout.closed:
        raise InputError("team.topology", "open", "closed if objects are held", "close it")
    if body.fixed:
        remedy = "omit it, or only tie two cables around it"
        raise InputError(f"{key}.fixed", True, "false if it is lifted", remedy)
    if body.friction == 0.0:
        bound, remedy = "above 0 if it is held", "only friction moves it along with the cables"
        raise InputError(f"{key}.friction", 0.0, bound, remedy)
    for other in stacked_on(objects, name, task.requirements.floor):
        at, bound = objects[other].at.tolist(), f"off objects.{name}, which is held alone"
        raise InputError(f"objects.{other}.at", at, bound, f"carry objects.{other} away first")
    return body


def goal_of(step: Step, requirements: Requirements, name: str) -> Array:
    """Return the place (4,) of a held object's base after a step: x, y, z [m], yaw [rad]."""
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


def require_hold(task: StepTask, planner: MovePlanner) -> None:
    """Raise InfeasibleError if the hold breaks limits at rest, or as the hitch rises to a rim."""
    hold, name = planner.hold, f"objects.{planner.state.object}"
    lifted, when = planner.from_state(carried=True), f"with {name} off its support"
    try:
        if isinstance(hold, RestHold):
            hold.check_unbent(planner.state.tension)
            hold.check_rim(planner.state.tension)
        require_certified(StepPlan(lifted.motion([lifted.rest(1.0)], "hold"), task.before), when)
        if isinstance(hold, RestHold):
            when = f"as the clasps take {name}"
            moves = planner.rim_move(planner.gap, 0.0), planner.transfer(0.0, 1.0)
            require_certified(StepPlan(planner.motion(moves, "lift"), task.before), when)
    except InfeasibleError as error:
        violations = [replace(each, when=when) for each in error.violations]
        raise InfeasibleError(violations, error.note) from None


def check_hold(task: StepTask, planner: MovePlanner) -> None:
    """Raise the error of ``require_hold``, with the capacity of the hold."""
    try:
        require_hold(task, planner)
    except InfeasibleError as error:
        raise hold_error(task, planner, error) from None


def hold_error(task: StepTask, planner: MovePlanner, error: InfeasibleError) -> InfeasibleError:
    """Return the error of a hold, with its capacity and a suggested change."""
    hold, name = planner.hold, f"objects.{planner.state.object}"
    robots = "use more robots, as hitchopt fit counts them"
    capacities, max_mass, rim_mass = hold_capacity(planner, task.requirements)
    rim = "rest it on a rim with three robots" if hold.team.robots == 2 else "give it a rim"
    rim = f", or {rim}" if rim_mass >= planner.body.mass else ""
    hardware = robots if hold.by is HoldBy.REST else f"use rougher cables{rim}"
    remedy = f"lower {name}.mass, or request another tension, or {hardware}{capacities}"
    mass, violations = planner.body.mass, list[Violation]()
    if mass > max_mass:
        where, when = (planner.state.object,), error.violations[0].when
        violations.append(Violation("load", mass, max_mass, "max", "kg", where, when, remedy))
    for each in error.violations:
        extra = ", or raise limits.tilt_deg" if each.constraint == "tilt" else ""
        extra += "" if each.constraint in LOAD_LIMITED else f", or {each.remedy}"
        violations.append(replace(each, remedy=remedy + extra))
    return InfeasibleError(violations)


def hold_capacity(planner: MovePlanner, requirements: Requirements) -> tuple[str, float, float]:
    """Describe the capacities of the hold and of a rim; return also their maximum masses [kg].

    The hold's mass is inf if it cannot be computed, the rim's 0; at least three robots rest it.
    """
    hold, team, body = planner.hold, planner.hold.team, planner.body
    tension, kind = float(np.min(planner.state.tension)), team.quadrotor[0]
    length, texts = float(np.min(team.cable_length)), list[str]()
    max_mass, rim_mass, robots = np.inf, 0.0, max(team.robots, 3)
    rim_outline, height = hold.polygon, float(body.centre_of_mass[2]) - hold.height
    with contextlib.suppress(InfeasibleError):
        if isinstance(hold, GripHold):
            grip = Grip.of(body.section, hold.polygon, length, tension, team.cable_friction)
            max_mass = grip_capacity(grip, kind, body.friction, GRIP_LIMIT).mass
            texts = [f"a grip holds {max_mass:.2g} kg"]
            rim = with_fields(body, rim=Rim(body.section, body.lower))
            rests = rest_polygons(planner.state.object, rim, robots, planner.gap)
            rim_outline = rests[0].clasps
            height = float(body.centre_of_mass[2]) - body.lower
        shape = ConvexPolygon(rim_outline)
        rim_mass = rest_capacity(shape, length, tension, kind, requirements, height).mass
        texts.append(f"a rim {'' if texts else 'holds '}{rim_mass:.2g} kg")
        max_mass = rim_mass if hold.by is HoldBy.REST else max_mass
    return (f" ({', '.join(texts)})" if texts else ""), max_mass, rim_mass


def altitude_over(task: StepTask) -> float:
    """Return the lowest altitude [m], not below the hitch's, that clears all objects."""
    requirements, hitch = task.requirements, task.hitch
    tops = [float(body.at[2]) + body.upper for body in requirements.objects.values()]
    sink = max(hitch.altitude - float(np.min(hitch.drones[:, 2])), 0.0)
    clearance = requirements.separation.radius + OBJECT_MARGIN + sink
    return max(hitch.altitude, *(top + clearance for top in tops))


def at_around_speed(requirements: Requirements) -> Requirements:
    """Return requirements with the speed limit of hitches around objects."""
    limits = requirements.limits
    speed, vertex_speed = (min(x, AROUND_SPEED) for x in (limits.speed, limits.vertex_speed))
    return replace(requirements, limits=with_fields(limits, speed=speed, vertex_speed=vertex_speed))


def requirements_near(task: StepTask, name: str) -> Requirements:
    """Return requirements at low speed without the object that cables may touch."""
    others = {key: each for key, each in task.requirements.objects.items() if key != name}
    return at_around_speed(replace(task.requirements, objects=others))


@documented
@dataclass(frozen=True)
class Enclose(Step):
    """Rise above an object, change to a polygon around it, and descend.

    It ends just below the object's rim, or at the height of its centre of mass if it has none.
    """

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.FREE, Stage.AROUND)
    object: ObjectOf
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Plan the change to a hitch around the object, in the first feasible orientation."""
        return first_orientation(self.orientations(task), task)

    def orientations(self, task: StepTask) -> list[Callable[[StepTask], StepPlan]]:
        """Return the planners of hitches around the object, in order of decreasing capacity.

        There are several if obstacles may be in the way of some.
        """
        requirements, team = task.requirements, task.before.team
        body, gap = object_of(task, self.object), requirements.separation.object + EDGE_MARGIN
        if body.rim is None:
            polygons = grip_polygons(self.object, body, team, requirements, gap)
            orientations = _turned(polygons, body, task.hitch.polygon)
        else:
            rests = rest_polygons(self.object, body, team.robots, gap)
            orientations = [_renumbered(each, body, task.hitch.polygon) for each in rests]
        obstacles = len(requirements.objects) > 1 or requirements.keep_out or requirements.arena
        count = len(orientations) if obstacles else 1
        return [
            partial(self._around, body=body, polygons=polygons, polygon=polygon)
            for polygons, polygon in orientations[:count]
        ]

    def _around(
        self, task: StepTask, body: SolidObject, polygons: HoldPolygons, polygon: ConvexPolygon
    ) -> StepPlan:
        """Plan the change to a polygon around the object."""
        requirements, hitch, team = task.requirements, task.hitch, task.before.team
        clearance = requirements.separation.object
        altitude = float(body.at[2] + body.centre_of_mass[2])
        if body.rim is not None:
            altitude = float(body.at[2]) + body.rim.height - (clearance + BELOW_RIM)
        height = altitude - requirements.floor
        if height < clearance - CONTACT_GAP:
            name, where = f"objects.{self.object}", ("ground",)
            remedy = f"make {name} or its rim higher, or stand it on something"
            values, when = ("object_clearance", height, clearance), f"with the hitch around {name}"
            raise InfeasibleError([Violation(*values, "min", "m", where, when, remedy)])
        radius = float(np.max(np.linalg.norm(polygon.vertices - polygon.centroid, axis=1)))
        remedy = f"tie the hitch as large as around objects.{self.object}, {radius:.2g} m in radius"
        check_opens(hitch, polygon.vertices, requirements, remedy)
        start = np.append(hitch.polygon.centroid, hitch.altitude)
        up, over = (
            np.append(place, altitude_over(task))
            for place in (hitch.polygon.centroid, polygon.centroid)
        )
        moves = [
            Transport(end).plan
            for begin, end in pairwise((start, up, over))
            if np.max(np.abs(end - begin)) >= PLACE_TOLERANCE
        ]
        above = plan_in_sequence([*moves, Morph(polygon).plan], task)
        slow = task.within(at_around_speed(requirements), above.after)
        down = Transport(np.append(polygon.centroid, altitude)).plan(slow)
        grasp = GraspState(self.object, polygons, team.tension)
        motion = step_motion(self, task, [above.motion, down.motion])
        return StepPlan(motion, replace(down.after, grasp=grasp))


def first_orientation(
    planners: Sequence[Callable[[StepTask], StepPlan]], task: StepTask
) -> StepPlan:
    """Return the first certified plan of several orientations, or the plan of the only one."""
    if len(planners) == 1:
        return planners[0](task)
    return nearest_feasible(partial(planner, task) for planner in planners)


GRIP_TURNS = 6
"""Number of turns about a disc, within its grip's symmetry."""


def _turned(
    polygons: HoldPolygons, body: SolidObject, polygon: Outline
) -> list[tuple[HoldPolygons, ConvexPolygon]]:
    """Return the polygons of a grip and the one around, the nearest first.

    They are turned about a disc, and by half a turn about a section that is symmetric to it.
    """
    nearest, around = _renumbered(polygons, body, polygon)
    centre, core = body.section.centroid, body.section.core
    if body.section.radius is not None:
        symmetry = 2.0 * math.pi / len(polygon)
        turns = [symmetry * k / GRIP_TURNS for k in (1, -1, 2, -2, 3)]
    else:
        opposite = length(2.0 * centre - core[:, None] - core)
        turns = [math.pi] if np.max(np.min(opposite, axis=1)) < PLACE_TOLERANCE else []
    turned = [(nearest, around)]
    for turn in turns:
        around_it, clasps = (
            centre + rotated(x - centre, turn) for x in (nearest.around, nearest.clasps)
        )
        both = HoldPolygons(around_it, clasps)
        turned.append(_renumbered(both, body, polygon, turn=False))
    return turned


def _renumbered(
    polygons: HoldPolygons, body: SolidObject, polygon: Outline, *, turn: bool = True
) -> tuple[HoldPolygons, ConvexPolygon]:
    """Return the polygons numbered for the shortest paths of vertices, and the one around.

    With ``turn`` polygons about a disc are also turned.
    """
    start = polygon.vertices - polygon.centroid
    if turn and body.rim is None and body.section.radius is not None:
        end, goal = (points @ np.array([1.0, 1.0j]) for points in (polygons.around, start))
        products = [np.vdot(np.roll(end, -k), goal) for k in range(len(end))]
        angle = float(np.angle(max(products, key=abs))) - body.yaw
        polygons = HoldPolygons(rotated(polygons.around, angle), rotated(polygons.clasps, angle))
    around = polygon_at(body, polygons.around)
    end = around.vertices - around.centroid
    squares = [np.sum((np.roll(end, -k, axis=0) - start) ** 2) for k in range(len(end))]
    shift = int(np.argmin(squares))
    numbered = HoldPolygons(
        np.roll(polygons.around, -shift, axis=0),
        np.roll(polygons.clasps, -shift, axis=0),
        tuple(np.roll(each, -shift, axis=0) for each in polygons.outer),
    )
    return numbered, around.renumbered(shift)


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

    def requested_hold(self, team: Team, body: SolidObject) -> RequestedHold | None:
        """Return the hold with the team's tension and its own."""
        by = HoldBy(self.method_for(body))
        return RequestedHold.with_tensions(by, team, team.tension, self.tension_for(team))

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
            raise InputError(key, None, bound, "give it a rim, or grasp it by: grip")
        polygons, requirements = task.grasp.polygons, requirements_near(task, self.object)
        own = requirements.separation
        wider = {key: CLOSING_MARGIN * value for key, value in vars(own).items()}
        with_margin = replace(requirements, separation=replace(own, **wider))
        closing_task, failures = task.within(requirements, task.before), list[HoldFailure]()
        for clasps in polygons.below_rim:
            below = polygon_at(body, clasps)
            goal = end_of_morph(task.hitch, below, None, with_margin).hitch
            for hitch in hitches_below(goal, with_margin):
                fractions, legs = hitch.fractions, RolledLegs(hitch.q_legs, hitch.roll)
                hold = RestHold(team, body, clasps, body.rim.height, fractions, hitch.roll)
                planner = planner_of(task).from_state(tension=tension, hold=hold)
                moves = [
                    *planner.retension(team.tension, tension),
                    planner.rim_move(planner.gap, 0.0),
                ]
                try:
                    require_hold(task, planner)
                    closing = require_certified(Morph(below, legs).plan(closing_task))
                    rising = planner.motion(moves, self.name)
                    parts = [closing.motion, rising]
                    motion = step_motion(self, task, parts, rising.phases[0].hold)
                    if np.any(hitch.roll):  # drones and cables sink toward the ground
                        require_certified(StepPlan(motion, task.before))
                except InfeasibleError as error:
                    failures.append(HoldFailure(planner, error))
                    continue
                return plan_to(task, planner.state, motion, body.place)
        raise best_hold_error(task, failures)

    def _grip(self, task: StepTask, body: SolidObject, tension: Array) -> StepPlan:
        """Plan how cables grip the object with tensions (n,) [N]."""
        team, polygons = task.before.team, task.grasp.polygons
        if body.rim is not None:
            key = f"mission[{task.index}].{self.name}.by"
            bound = "rest if the hitch is below the object's rim"
            raise InputError(key, "grip", bound, "omit the rim")
        check_pull(float(np.max(tension)), team, task.requirements)
        height = float(body.centre_of_mass[2])
        fractions, roll = np.full(team.robots, 0.5), np.zeros(team.robots)
        gripping = polygons.clasps, height, fractions, roll
        hold = GripHold(team, body, *gripping, polygons.around, task.hitch.fractions)
        planner = planner_of(task).from_state(tension=tension, hold=hold)
        check_hold(task, planner)
        motion = self.with_duration(task, planner.close_grip(team.tension, self.name))
        return plan_to(task, planner.state, motion, body.place)


class HoldFailure(NamedTuple):
    """Legs that do not hold an object, or to which the hitch does not close."""

    planner: MovePlanner  # with the hold
    error: InfeasibleError


def best_hold_error(task: StepTask, failures: Sequence[HoldFailure]) -> InfeasibleError:
    """Return the error of the legs whose violations are smallest."""
    best = min(failures, key=lambda failure: excess(failure.error))
    return hold_error(task, best.planner, best.error)


def hitches_below(goal: Hitch, requirements: Requirements) -> Iterator[Hitch]:
    """Yield hitches below a rim that may hold it: the goal first, then others with all distances.

    A load moves drones, which may require another slack split or roll than without it.
    """
    team, polygon, altitude = goal.team, goal.polygon, goal.altitude
    yield Hitch(team, polygon, altitude, goal.q_legs, ROLL_RESERVE * goal.roll)
    sign = -1.0 if np.sum(goal.roll) < 0.0 else 1.0
    splits = [goal.q_legs, *(split * goal.slack for split in HELD_SPLITS)]
    shortest = requirements.limits.leg
    for roll in HELD_ROLLS:
        rolls = np.full(team.robots, sign * roll)
        for q_legs in splits:
            if np.min([q_legs, goal.slack - q_legs]) < shortest:
                continue
            arguments = polygon.vertices[None], q_legs[None], shortest, 1.0
            with contextlib.suppress(InfeasibleError):
                task = LegTask(team, requirements, *arguments, roll=rolls)
                if task.reference_margin() >= 1.0:
                    yield Hitch(team, polygon, altitude, q_legs, rolls)


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
        """Return the place above the current one."""
        return np.array([*body.at[:2], body.at[2] + self.by, body.yaw])

    def plan(self, task: StepTask) -> StepPlan:
        """Plan the vertical ascent."""
        planner = planner_of(task)
        object_of(task, planner.state.object)  # two cables may be tied around any
        check_hinge(planner)
        to = goal_of(self, task.requirements, planner.state.object)
        moves = [planner.transfer(0.0, 1.0), planner.carry(to, LIFT_SPEED)]
        return moves_plan(self, task, replace(task.grasp, carried=True), moves)


@documented
@dataclass(frozen=True, eq=False)
class Carry(Step):
    """Fly the object along a straight line, gently enough that it stays on its supports."""

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
        """Plan the flight along the line."""
        to = goal_of(self, task.requirements, self.object)
        move = planner_of(task).carry(to, task.requirements.limits.speed)
        return moves_plan(self, task, task.grasp, [move])


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
        """Return the place straight below."""
        return np.array([*body.at[:2], below - body.lower, body.yaw])

    def plan(self, task: StepTask) -> StepPlan:
        """Plan the vertical descent to a stable support."""
        objects, planner = task.requirements.objects, planner_of(task)
        body, to = objects[self.object], goal_of(self, task.requirements, self.object)
        margin = footing({**objects, self.object: body.moved_to(to)}, self.object)
        if margin < MIN_FOOTING:
            bound = (
                f"where the centre of mass of objects.{self.object} is {MIN_FOOTING:g} m within "
                f"the edges of what it stands on, not {max(margin, 0.0):.3g} m"
            )
            place = [round(float(x), 9) for x in to[:3]]
            remedy = "set it down farther in, or on something wider"
            raise InputError(f"mission[{task.index}]", place, bound, remedy)
        down = planner.carry(to, LIFT_SPEED)
        moves = [down, replace(planner.transfer(1.0, 0.0), start=to, end=to)]
        return moves_plan(self, task, replace(task.grasp, carried=False), moves)


@documented
@dataclass(frozen=True)
class Loosen(Step):
    """Open the hitch around the object, below its rim, and return to the team's tension."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.GRASPED, Stage.AROUND)
    object: ObjectOf
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Plan the change to a hitch around the object."""
        body, planner, team = object_of(task, self.object), planner_of(task), task.before.team
        freed, hold = replace(task.grasp, tension=team.tension, hold=None), planner.hold
        if isinstance(hold, GripHold):
            motion = self.with_duration(task, planner.open_grip(team.tension, self.name))
            after = plan_to(task, freed, motion, body.place).after
            return StepPlan(motion, replace(after, hitch=hold.opened.hitch(body)))
        lower = planner.retension(planner.state.tension, team.tension)
        sinking = planner.motion([planner.rim_move(0.0, planner.gap), *lower], self.name)
        low = plan_to(task, replace(freed, hold=hold), sinking, body.place, planner.gap).after
        around = Morph(polygon_at(body, freed.polygons.around))
        opening = around.plan(task.within(requirements_near(task, self.object), low))
        motion = step_motion(self, task, [sinking, opening.motion], sinking.phases[0].hold)
        return StepPlan(motion, replace(opening.after, grasp=freed))


@documented
@dataclass(frozen=True)
class Leave(Step):
    """Rise vertically until the hitch is above all objects."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.AROUND, Stage.FREE)
    object: ObjectOf
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Plan the vertical ascent."""
        over = Transport(np.append(task.hitch.polygon.centroid, altitude_over(task)))
        plan = over.plan(task.within(at_around_speed(task.requirements), task.before))
        motion = step_motion(self, task, [plan.motion])
        return StepPlan(motion, replace(plan.after, grasp=None))


@documented
@dataclass(frozen=True, eq=False)
class TransportObject(TensionStep):
    """Carry an object to another place, in seven steps, or more with ``via``.

    Two robots tie their cables around it, and untie them.
    """

    of_two_robots: ClassVar[bool] = True
    needs_hitch: ClassVar[bool | None] = None

    object: ObjectOf
    to: Place
    by: Annotated[HoldMethod | None, Key(BY, f"{BY_TEXT}; without it rest if it has a rim")] = None
    tension: HoldTension = None
    yaw: Yaw = 0.0
    lift: Annotated[float, Key(LENGTH, "Height above the higher of the two places")] = 0.3
    via: Annotated[
        Array | None,
        Key(
            points((None, 3), "x, y, z", 1, MAX_VIA),
            "Intermediate places of its base, at rest there",
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
        higher_place = max(self.to[2], objects[self.object].at[2])
        lift = max(tops, default=0.0) + separation.object - higher_place
        return max(0.0, float(lift) / self.lift - 1.0)

    def detours(
        self, objects: Mapping[str, SolidObject], names: Sequence[str], distance: float
    ) -> Iterator[Array]:
        """Yield waypoints on both sides of obstacles, unless it has waypoints."""
        if self.via is not None:
            return
        start, end = objects[self.object].at, self.to
        altitude = float(max(start[2], end[2])) + self.lift
        along = unit(end[:2] - start[:2])
        across = np.array([-along[1], along[0]])
        for body in self._obstacles(objects, names):
            section, centre = body.section, body.section.centroid
            radius = float(np.max(length(section.core - centre))) + section.rounding
            offset = in_world(body.pose, np.append(centre, 0.0))[:2] - start[:2]
            for side in (across, -across):
                sideways = (offset @ side + (distance + radius)) * side
                yield np.array([*(start[:2] + (offset @ along) * along + sideways), altitude])

    def requested_hold(self, team: Team, body: SolidObject) -> RequestedHold | None:
        """Return the hold; two robots tie their cables around the object."""
        if team.robots == 2:
            return hold_by_tying(team, self.tension_for(team))
        return super().requested_hold(team, body)

    def advice(self, check: str, key: str) -> str:
        """Return the advice for keeping clear of obstacles."""
        is_obstacle = check in OBSTACLE_CHECKS
        return f"raise {key}.lift, or lead it around by {key}.via" if is_obstacle else ""

    def place_after(self, body: SolidObject, below: float) -> Array:  # noqa: ARG002
        """Return the goal, turned by ``yaw``."""
        return np.append(self.to, body.yaw + self.yaw)

    def shown_at_end(self, team: Team, requirements: Requirements) -> dict[str, Any]:  # noqa: ARG002
        """Return the route of the object: its greatest height, and its waypoints."""
        via = [] if self.via is None else self.via.tolist()
        highest = max([self.flight_height(requirements.objects[self.object]), *(x[2] for x in via)])
        return {"route": {"object": self.object, "highest": highest, "via": via}}

    def flight_height(self, body: SolidObject) -> float:
        """Return the height of the object's base on its flight [m]."""
        return max(float(body.at[2]), float(self.to[2])) + self.lift

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of the seven steps; ``to`` must be on the surface below it."""
        body = object_of(task, self.object)
        flight_height = self.flight_height(body)
        carrying: list[Step] = [
            Lift(flight_height - float(body.at[2])),
            *(Carry(self.object, place) for place in ([] if self.via is None else self.via)),
            Carry(self.object, np.append(self.to[:2], flight_height), self.yaw),
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
            holds = [partial(plan_in_sequence, [each, grasp.plan]) for each in around]
            taking = partial(first_orientation, holds)
        plan = plan_in_sequence([taking, *(step.plan for step in carrying), *leaving], task)
        height = float(plan.after.with_objects(task.requirements).objects[self.object].at[2])
        if abs(height - self.to[2]) > CONTACT_GAP:
            key, bound = f"mission[{task.index}].{self.name}.to", "on what is below it"
            remedy = f"write {[*self.to[:2].tolist(), round(height, 9)]}"
            raise InputError(key, self.to.tolist(), f"{bound}, at {height:.6g} m", remedy)
        return plan
