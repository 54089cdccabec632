"""Steps of a hitch without an object: moves, morphs and transports."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, ClassVar, Self

import numpy as np

from hitchopt.checks.drones import VERTEX_SPEED
from hitchopt.checks.registry import RULE_OF, distances_of, names_of
from hitchopt.errors import InfeasibleError, InputError, RequestError, Violation
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.casadi_model import CostFunction
from hitchopt.hitch.hitch import checked_polygon
from hitchopt.motion.motion import Motion
from hitchopt.planners.along import plan_like, rigid_plan, straight_plan
from hitchopt.planners.candidates import Candidate
from hitchopt.planners.ends import End, end_of_morph, end_of_transport, moved_points
from hitchopt.planners.rests import hover_motion, rest_motion
from hitchopt.planners.routes import RouteSearch
from hitchopt.planners.task import StepPlan, StepTask, plan_in_sequence, require_certified
from hitchopt.slices import hooks
from hitchopt.steps.hitch_step import ActionStep, HitchStep, NonstopStep, ShapeStep
from hitchopt.steps.keys import (
    AUTO,
    LEGS,
    LEGS_TEXT,
    POINT2,
    POINT3,
    Blend,
    Legs,
    LegsAtEnd,
    Polygon,
    Seconds,
    SettleAtEnd,
    WhichPoint,
    Yaw,
)
from hitchopt.steps.knob import PLAN_DURATION, Edit, Edits, Knob, checks_relaxed_by, scaled_points
from hitchopt.steps.step import Stage
from hitchopt.values import Array, Points, as_array, bounded_points, known, plain
from hitchopt.values.fields import (
    FLAGS,
    Key,
    documented,
    either,
    list_of,
    mapping_of,
    points,
    with_fields,
)
from hitchopt.values.units import DURATION, SPEED, TENSION

__all__ = [  # noqa: RUF022, in the order of the keys of problem files
    "Morph",
    "Hold",
    "MoveVertex",
    "MoveEdge",
    "Adjust",
    "FollowVertex",
    "Transport",
]


@documented
@dataclass(frozen=True)
class Hold(HitchStep):
    """Keep everything at rest."""

    needs_hitch: ClassVar[bool | None] = None
    stages: ClassVar[tuple[Stage, Stage] | None] = None
    time_key: ClassVar[str] = "seconds"
    seconds: Annotated[float, Key(DURATION, "Duration", 1.0)]

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of a hitch, or of drones on free cables, at rest."""
        for rest in hooks("held_rest") if task.before.kept else ():
            plan: StepPlan | None = rest(self, task, self.seconds)
            if plan is not None:
                return plan
        if task.before.hitch is None:
            return StepPlan(hover_motion(task, self.seconds), task.before)
        motion = rest_motion(task.hitch, task.requirements, self.seconds, self.phase(task))
        return task.plan_ending(motion, task.hitch)


@dataclass(frozen=True)
class TensionRange:
    """A range of tensions."""

    min: Annotated[float, Key(TENSION, "Smallest", 0.3)]
    max: Annotated[float, Key(TENSION, "Largest", 0.6)]


def _checked_range(key: str, value: object) -> tuple[float, float]:
    """Return a smallest and a largest tension [N], or raise InputError."""
    checked = _RANGE_FORMS.check(key, value)
    low, high = (checked.min, checked.max) if isinstance(checked, TensionRange) else checked
    if low > high:
        raise InputError(f"{key}.max", high, f"at least {key}.min, {low:g} N", "swap the two")
    return low, high


_RANGE_FORMS = either(mapping_of(TensionRange), list_of(TENSION, 2, 2))
TENSION_RANGE = replace(_RANGE_FORMS, check=_checked_range)

OPTIMIZE_TEXT = (
    "Search for a faster route even if the straight one is feasible, by default only if that takes "
    "more than 1.3 times its lower bound; then refine the route together with its speed, within a "
    "fixed amount of work"
)


@documented
@dataclass(frozen=True, eq=False)
class Morph(ShapeStep):
    """Change the polygon: every vertex moves to its goal."""

    polygon: Polygon
    legs: LegsAtEnd = None
    duration: Seconds = None
    blend: Blend = False
    optimize: Annotated[bool, Key(FLAGS, OPTIMIZE_TEXT)] = False
    tension: Annotated[
        tuple[float, float] | None, Key(TENSION_RANGE, "Range of tensions during the step")
    ] = None
    settle: SettleAtEnd = AUTO
    cost: CostFunction | None = None  # of scripts: problem files have no functions
    like: Motion | None = None  # of scripts: an earlier motion between nearly the same hitches

    @property
    def outline(self) -> Outline:
        """The polygon of the resolved step."""
        return known(self.goal_outline)

    def resolved_for(self, team: Team) -> Self:
        """Return the step for a team.

        Raises InputError if the team's tensions exceed its range, or for an unsuitable cost.
        """
        step = super().resolved_for(team)
        low, high = self.tension or (0.0, math.inf)
        if self.cost is not None:
            from hitchopt.planners.optimise.cost import FlightCost

            FlightCost(team, self.cost)
        smallest, largest = float(np.min(team.tension)), float(np.max(team.tension))
        if not low <= smallest <= largest <= high:
            bound = f"such that team.tension lies within ({smallest:g} to {largest:g} N)"
            remedy = "widen it: a step begins and ends with the team's tensions"
            raise InputError("tension", {"min": low, "max": high}, bound, remedy)
        return step

    def end(self, task: StepTask) -> End:
        """Return the hitch on the polygon."""
        return end_of_morph(task.hitch, self.outline, self.split, task.requirements)

    def candidates(self, task: StepTask) -> Iterator[Candidate[StepPlan]]:
        """Yield the plan on the route of an earlier one, if any, before all others."""
        if self.like is not None:
            ends = self.end(task).hitch, self.phase(task), self.duration
            yield Candidate("earlier route", partial(plan_like, task, self.like, *ends))
        yield from super().candidates(task)

    def search(self, task: StepTask, end: End) -> RouteSearch:
        """Return the search of a route, also of a faster one, with the step's options."""
        return replace(
            super().search(task, end),
            phase=replace(self.phase(task), tension=self.tension),
            replaces_slow=True,
            refines=self.optimize,
            cost=self.cost,
        )

    def direct_plan(self, task: StepTask, end: End) -> StepPlan:
        """Return the plan along straight lines."""
        return straight_plan(task, end.hitch, self.phase(task), self.duration)


class MoveStep(ActionStep):
    """An action that moves points ``to`` a position or ``by`` an offset."""

    moves_points: ClassVar[bool] = True
    to: Points | None
    by: Points | None

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.to is None) == (self.by is None):
            value = None if self.to is None else np.asarray(self.to).tolist()
            bound = "given if and only if by is omitted"
            raise InputError("to", value, bound, "specify either to or by")

    @abstractmethod
    def moved_points(self, team: Team, count: int) -> list[int]:
        """Return the indices of the points that move, of an outline of ``count`` points."""

    def polygon_after(self, team: Team, outline: Outline) -> Outline:
        """Return the outline with the moved points."""
        points = outline.vertices.copy()
        moved = self.moved_points(team, len(points))
        points[moved] = (
            points[moved] + np.asarray(self.by) if self.to is None else np.asarray(self.to)
        )
        return _convex(team, points, *self.moved_key)

    @property
    def moved_key(self) -> tuple[str, Points | None]:
        """Key of the goal or the offset, and its value."""
        return ("by", self.by) if self.to is None else ("to", self.to)

    def scaled(self, factor: float, centre: Array) -> tuple[Edits, Array]:
        """Return the edit that scales its goal about ``centre``, or its offset."""
        key, value = self.moved_key
        origin = np.zeros(2) if key == "by" else centre
        return (Edit(key, scaled_points(np.asarray(value), factor, origin).tolist()),), centre


def _convex(team: Team, points: Array, key: str, value: Points | None) -> Outline:
    """Return the points as an outline; an error names the step's ``key`` and its ``value``."""
    try:
        return checked_polygon(team, points)
    except InputError as error:
        reason = f"{error.key} = {error.value} would have to be {error.bound}"
        bound = f"such that the outline stays convex and clockwise ({reason})"
        raise RequestError(
            key, np.asarray(value).tolist(), bound, "use a smaller displacement"
        ) from None


def _checked_index(key: str, index: int, count: int) -> int:
    """Return an index, or raise InputError unless it is less than ``count``."""
    if index >= count:
        raise InputError(key, index, f"from 0 to {count - 1}", "indices start at 0")
    return index


_ENDS = points((2, 2), "x, y")
_ENDS_TEXT = "Goals of its ends, [[x, y], [x, y]] [m], its first vertex first"

Offset = Annotated[Points | None, Key(POINT2, "Displacement [dx, dy] [m], instead of to")]


@documented
@dataclass(frozen=True, eq=False)
class MoveVertex(MoveStep):
    """Move one vertex.

    Only four drones move, those whose legs continue the two edges of the vertex; where a limit
    binds, further drones slide along their cables as well.
    """

    vertex: WhichPoint
    to: Annotated[Points | None, Key(POINT2, "Goal [x, y] [m]")] = None
    by: Offset = None
    legs: LegsAtEnd = None
    duration: Seconds = None
    blend: Blend = False
    settle: SettleAtEnd = AUTO

    def moved_points(self, team: Team, count: int) -> list[int]:  # noqa: ARG002
        """Return the index of the vertex."""
        return [_checked_index("vertex", self.vertex, count)]


@documented
@dataclass(frozen=True, eq=False)
class MoveEdge(MoveStep):
    """Move both ends of one edge.

    Edge k runs from vertex k to vertex k + 1. Four drones move, or six where edges turn.
    """

    action_fields: ClassVar[tuple[str, ...]] = ("edge",)
    edge: WhichPoint
    to: Annotated[Points | None, Key(_ENDS, _ENDS_TEXT)] = None
    by: Offset = None
    legs: LegsAtEnd = None
    duration: Seconds = None
    blend: Blend = False
    settle: SettleAtEnd = AUTO

    def moved_points(self, team: Team, count: int) -> list[int]:
        """Return the indices of the edge's ends."""
        return [_checked_index("edge", self.edge, team.robots), (self.edge + 1) % count]


@documented
@dataclass(frozen=True, eq=False)
class Adjust(ActionStep):
    """Slide cables through their clasps; the outline does not change."""

    action_fields: ClassVar[tuple[str, ...]] = ()

    legs: Annotated[Legs, Key(LEGS, LEGS_TEXT, "balanced")] = "balanced"
    duration: Seconds = None
    blend: Blend = False
    settle: SettleAtEnd = AUTO


MIN_GAP = 1e-3  # [s] Minimum time between two points; less is a typing error
MAX_TIME = 1e5  # [s] Maximum time of a point

MIN_STRETCH = 1e-3
"""[m] Minimum distance of two points without times; a smooth path cannot turn within less."""

LEG_CHECKS = names_of(distances_of("drones", "cables", "vertices"))
"""Limits that legs may keep if they roll on a path."""

RIGHT_ANGLE = 1e-9
"""[m²] Products of two stretches of a path up to this size are those of right angles."""

_PATH_TEXT = (
    "Points [t, x, y] [s, m, m], t from the step's start, increasing; the vertex rests between "
    "equal consecutive points; with a speed also points [x, y]"
)

_SPEED_TEXT = (
    "Largest speed of the vertex on its path through points [x, y]; null: limits.vertex_speed"
)

_POINTS = points((None, 3), "t, x, y", largest=MAX_TIME)
_PLACES = points((None, 2), "x, y")


def _vertex_path(key: str, value: object) -> Array:
    """Return points (J, 3) whose times increase, or positions (J, 2); or raise InputError."""
    rows = plain(key, value)
    is_list = isinstance(rows, list | tuple | np.ndarray) and len(rows) > 0
    if is_list and as_array(f"{key}[0]", rows[0]).shape == (2,):
        places: Array = _PLACES.check(key, value)
        if np.min(np.linalg.norm(np.diff(places, axis=0), axis=1), initial=np.inf) < MIN_STRETCH:
            bound = f"points [x, y] at least {MIN_STRETCH:g} m apart"
            raise InputError(key, places.tolist(), bound, "remove repeated points")
        return places
    path: Array = _POINTS.check(key, value)
    bounded_points(key, path[:, 1:])
    times = path[:, 0]
    gaps = np.diff(times, prepend=0.0)
    if times[0] == 0.0:  # the point at the start
        gaps = gaps[1:]
    if len(gaps) == 0 or np.min(gaps) < MIN_GAP:
        bound = f"a path whose times increase from 0 on by {MIN_GAP:g} s or more, and end after it"
        raise InputError(key, path.tolist(), bound, _remedy_for_times(times))
    return path


def _remedy_for_times(times: Array) -> str:
    """Return what to change of the times (J,) [s] of a path that are too close or not in order."""
    if np.any(np.diff(times) < 0.0):
        return "sort its points by time"
    if times[0] < 0.0:
        return "count times from the start of the step"
    if times[-1] == 0.0:
        return "add a point with a later time"
    return f"leave {MIN_GAP:g} s or more before each of its points"


_PATH = replace(_POINTS, check=_vertex_path, schema={"anyOf": [_POINTS, _PLACES]})


@documented
@dataclass(frozen=True, eq=False)
class FollowVertex(ActionStep):
    """Move one vertex through points, at rest before and after.

    It meets timed points at their times. With a speed, points need no times: it moves at this speed
    on a smooth path through them. It stops where the path turns by more than 90°, and slows down
    where a drone's limit binds.
    """

    blendable: ClassVar[bool] = False
    moves_points: ClassVar[bool] = True
    action_fields: ClassVar[tuple[str, ...]] = ("vertex", "path")
    vertex: WhichPoint
    path: Annotated[Points, Key(_PATH, _PATH_TEXT, [[1.0, 0.0, -0.9]])]
    legs: LegsAtEnd = None
    speed: Annotated[float | None, Key(SPEED, _SPEED_TEXT)] = None
    settle: SettleAtEnd = AUTO

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.is_timed and self.speed is None:
            bound = "points [t, x, y], or points [x, y] with a speed"
            raise InputError("path", self.points.tolist(), bound, "add times, or the step's speed")

    @property
    def points(self) -> Array:
        """The points of the path (J, 3), or (J, 2) without times."""
        return np.asarray(self.path)

    @property
    def is_timed(self) -> bool:
        """Return whether its points have times."""
        return int(self.points.shape[1]) == 3

    @property
    def duration(self) -> float | None:
        """Time of the last point [s]; None without times."""
        return float(self.points[-1, 0]) if self.is_timed else None

    def advice(self, check: str, key: str) -> str:  # noqa: ARG002
        """Return advice on lowering a rate."""
        is_rate = check in RULE_OF and RULE_OF[check].derivative > 0
        return "allow more time for the points" if is_rate else ""

    def polygon_after(self, team: Team, outline: Outline) -> Outline:
        """Return the outline with the vertex at the last point."""
        points = outline.vertices.copy()
        points[_checked_index("vertex", self.vertex, len(points))] = self.points[-1, -2:]
        return _convex(team, points, "path", self.points)

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of the step, from stop to stop."""
        *first, last = self._stretches(task.hitch.polygon.vertices[self.vertex])
        if not first:
            return super().plan(task)
        steps = [replace(self, path=stretch, legs=None) for stretch in first]
        steps.append(replace(self, path=last))
        return plan_in_sequence([step.plan for step in steps], task)

    def _stretches(self, start: Array) -> list[Array]:
        """Return the path from a start (2,) [m], split where it turns by more than 90°."""
        if self.is_timed:
            return [self.points]
        places = np.vstack([start, self.points])
        along = np.diff(places, axis=0)
        turns_back = np.sum(along[1:] * along[:-1], axis=1) < -RIGHT_ANGLE
        return np.split(self.points, np.flatnonzero(turns_back) + 1)

    def candidates(self, task: StepTask) -> Iterator[Candidate[StepPlan]]:
        """Yield the plans of the whole path, and of parts between whose ends legs are spread.

        Where legs come too close on the whole path, a plan follows on which they roll.
        """
        for candidate, legs in zip(super().candidates(task), (self.legs, "spread"), strict=False):
            yield replace(candidate, amended=partial(with_fields(self, legs=legs).rolling, task))
        count = len(self.points)
        for parts in () if self.is_timed else sorted({2, 4, count}):
            if 1 < parts <= count:
                yield Candidate(f"{parts}-part path", partial(self._in_parts, parts, task))

    def rolling(self, task: StepTask, error: InfeasibleError) -> Candidate[StepPlan] | None:
        """Return the flight with legs that roll, after an error of one without; None if unneeded.

        Rolling legs pass above each other.
        """
        if not any(violation.constraint in LEG_CHECKS for violation in error.violations):
            return None
        return Candidate(
            "flight with legs that roll", partial(self._flight, self.rolling_plan, task)
        )

    def _in_parts(self, parts: int, task: StepTask) -> StepPlan:
        """Return the plan that stops at the ends of a number of parts, with legs spread there."""
        spread = replace(self, legs="spread")
        pieces = [replace(spread, path=path) for path in np.array_split(self.points, parts)]
        pieces[-1] = replace(pieces[-1], legs=self.legs or "spread")
        plan = plan_in_sequence([piece.plan_route for piece in pieces], task)
        stops = "once" if parts == 2 else f"{parts - 1} times"
        return plan.with_remark(f"stops {stops} on the way, where legs are spread")

    def plan_route(self, task: StepTask) -> StepPlan:
        """Return the plan along the points, with legs that slide if necessary."""
        return self._flight(self.direct_plan, task)

    def _flight(self, plan_to: Callable[[StepTask, End], StepPlan], task: StepTask) -> StepPlan:
        """Return the plan along the points, at the step's speed."""
        end = self.end(task)
        self.check_end(end.hitch, task)
        if self.speed is None:
            return self._with_legs_apart(plan_to(task, end))
        limits = task.requirements.limits
        steps = (self.phase(task).place,)
        if self.speed > limits.vertex_speed:
            where = (f"p{self.vertex}",)
            remedy = "lower the step's speed, or raise limits.vertex_speed"
            violation = Violation(
                "vertex_speed",
                self.speed,
                limits.vertex_speed,
                "max",
                "m/s",
                where,
                "",
                remedy,
                steps,
            )
            raise InfeasibleError([violation])
        slow = replace(task.requirements, limits=with_fields(limits, vertex_speed=self.speed))
        plan = plan_to(task.within(slow, task.before), end)
        motion = plan.motion
        check = VERTEX_SPEED.check(motion)
        if check is not None and not check.holds and self.is_timed:
            remedy = "allow more time for the points, omit their times, or raise the step's speed"
            when = f"at t = {check.time:.4g} s"
            raise InfeasibleError([check.violation(when, remedy, steps=steps)])
        plan = self._with_legs_apart(plan)
        return replace(plan, motion=motion.replaced(requirements=task.requirements))

    def _with_legs_apart(self, plan: StepPlan) -> StepPlan:
        """Return a certified plan, or one of timed points whose legs are far enough apart.

        Only more time helps its other limits, as the mission's certificate shows.
        """
        violated = {check.name for check in plan.certificate.violated}
        if self.is_timed and violated.isdisjoint(LEG_CHECKS):
            return plan
        return require_certified(plan)

    def knobs(self) -> Iterator[Knob]:
        """Yield the speed, and the times of points, to be scaled up or down."""
        if self.speed is not None:
            relaxed = {PLAN_DURATION, "vertex_speed"} if self.is_timed else {PLAN_DURATION}
            yield Knob("speed", self.speed, "m/s", covers=frozenset(relaxed))
            yield Knob("speed", self.speed, "m/s", sign=-1, covers=frozenset({"vertex_speed"}))
        if not self.is_timed:
            return

        def scale_times(factor: float) -> Edits:
            """Return the edit that multiplies the points' times by a factor."""
            times = scaled_points(self.points[:, 0], factor, np.zeros(1))
            return (Edit("path", np.column_stack([times, self.points[:, 1:]]).tolist()),)

        covers = checks_relaxed_by("time") | checks_relaxed_by("tension") | {"duration"}
        knob = Knob(
            "path",
            1.0,
            "times",
            make_edits=scale_times,
            covers=covers,
            words="times of its points",
        )
        yield knob
        yield replace(knob, sign=-1, covers=frozenset({PLAN_DURATION}))

    def scaled(self, factor: float, centre: Array) -> tuple[Edits, Array]:
        """Return the edit that scales its points about ``centre``."""
        points = scaled_points(self.points[:, -2:], factor, centre)
        return (Edit("path", np.column_stack([self.points[:, :-2], points]).tolist()),), centre


MAX_PASSED_TURN = math.radians(15.0)
"""[rad] Largest turn between two hitches that a transport passes in a flight without a stop."""


@documented
@dataclass(frozen=True, eq=False)
class Transport(NonstopStep):
    """Move the whole hitch and turn it about its centroid, without changing its shape or legs.

    In a flight without a stop it has them at its joints; near these they still change a little.
    """

    to: Annotated[Points, Key(POINT3, "Goal [x, y, z] of its centroid [m]", [0, 0, 1])]
    yaw: Yaw = 0.0
    duration: Seconds = None
    blend: Blend = False

    def polygon_after(self, team: Team, outline: Outline) -> Outline:
        """Return the outline turned about its centroid and moved to the goal."""
        points = moved_points(outline, np.asarray(self.to), self.yaw)
        return _convex(team, points, "to", self.to)

    def end(self, task: StepTask) -> End:
        """Return the hitch at the goal."""
        return End(end_of_transport(task.hitch, np.asarray(self.to), self.yaw))

    def on_way(self, task: StepTask, count: int) -> list[Hitch]:
        """Return hitches on the straight way to the goal, turned by MAX_PASSED_TURN at most."""
        start = task.hitch
        centroid = np.append(start.polygon.centroid, start.altitude)
        parts = max(count + 1, math.ceil(abs(self.yaw) / MAX_PASSED_TURN))
        shares = np.arange(1, parts) / parts
        steps = (
            replace(
                self, to=centroid + share * (np.asarray(self.to) - centroid), yaw=share * self.yaw
            )
            for share in shares.tolist()
        )
        return [step.end(task).hitch for step in steps]

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of a rigid motion."""
        return rigid_plan(task, np.asarray(self.to), self.yaw, self.phase(task), self.duration)

    def scaled(self, factor: float, centre: Array) -> tuple[Edits, Array]:  # noqa: ARG002
        """Return no edits, and the goal as the new centre."""
        return (), np.asarray(self.to)[:2]
