"""Problems before planning: of a hitch with its team, start and steps, or of single drones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar

import numpy as np

from hitchopt.errors import InputError, OneLine, UnitWarning
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Swarm, Team
from hitchopt.hitch.hitch import UNIT_ERROR_RATIO, checked_polygon
from hitchopt.hitch.requirements import (
    Arena,
    Limits,
    Prism,
    Requirements,
    Separation,
    check_requirements,
)
from hitchopt.hitch.team import MAX_DRONES, MAX_ROBOTS, QUADROTOR, PartTeam
from hitchopt.mission.objects import OBJECTS
from hitchopt.mission.others import OTHERS, Other
from hitchopt.motion.request import request_fields
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import check_placed
from hitchopt.planners.carrying.planner import OPENING_TENSIONS
from hitchopt.steps import STEP_KINDS, STEPS, FollowVertex, Form, Step, Transport
from hitchopt.steps.carrying import TensionStep, goal_of
from hitchopt.steps.moving import MoveStep
from hitchopt.steps.step import LEGS, LEGS_TEXT, TRIANGLE, Polygon, SlackSplit, Stage, slack_split
from hitchopt.steps.tying import check_rollable
from hitchopt.values import Array, check_instance, closest_word, sequence, text
from hitchopt.values.fields import (
    Key,
    Record,
    documented,
    integers,
    list_of,
    mapping_of,
    one_or_each,
    points,
    single_key,
    store,
    strings,
)
from hitchopt.values.units import ALTITUDE, DURATION, warn_of_unit

ROLLING = {"open_vertex", "close_vertex", "join", "withdraw", "replace"}
"""Steps in which pairs roll, as in laying."""


def resolved_steps(problem: Problem, steps: tuple[Step, ...]) -> tuple[Step, ...]:
    """Return steps with their polygons as outlines and their legs as arrays.

    Raises InputError, with a key from ``mission`` on, for a step that does not fit the team, the
    outline, the held object or the next step.
    """
    outline, ring = problem.start_outline, problem.team.labels
    resolved, stage, changes = list[Step](), _ObjectStage(), False
    reason = "start has no hitch" if outline is None else "start is a hitch"
    for i, unresolved in enumerate(steps):
        try:
            team, ring = team_and_ring(problem.team, unresolved, ring)
            changes |= ring != problem.team.labels
            step = unresolved.resolved_for(team)
            stage = stage.after(step, problem.objects)
            before, outline = outline, step.checked_polygon_after(team, outline, reason)
            if step.name in ROLLING or (isinstance(step, Form) and step.by == "laying"):
                check_rollable(f"step {i} ({step.name})", problem.team, problem.requirements)
            if (before is None) is not (outline is None):
                reason = f"step {i} ({step.name}) {'untied' if outline is None else 'tied'} it"
            _check_blend(steps, i, complete=problem.complete)
        except InputError as error:
            raise error.within(f"mission[{i}].{unresolved.name}") from None
        resolved.append(step)
    for i, step in enumerate(resolved):
        if changes and hasattr(step, "object"):
            bound = "left out in missions in which robots wait, join or leave"
            key, remedy = f"mission[{i}].{step.name}.object", "carry in a mission of all robots"
            raise InputError(key, step.object, bound, remedy)
    return tuple(resolved)


def team_and_ring(whole: Team, step: Step, ring: tuple[int, ...]) -> tuple[Team, tuple[int, ...]]:
    """Return the team of a step, and the ring after it; ``form`` has the team that it forms."""
    after = step.ring_after(ring, whole)
    members = after if isinstance(step, Form) else ring
    return whole if members == whole.labels else PartTeam.of(whole, members), after


@dataclass(frozen=True)
class _ObjectStage:
    """Stage of a hitch with an object, by name, and whether the file specifies its outline."""

    stage: Stage = Stage.FREE
    name: str = ""
    outline_specified: bool = True

    def after(self, step: Step, objects: Mapping[str, SolidObject]) -> _ObjectStage:
        """Return the stage after a step; raise InputError if the step is not allowed."""
        name = text("object", getattr(step, "object", self.name))
        if name and name not in objects:
            bound = f"one of objects: {', '.join(objects) or 'there are none'}"
            remedy = closest_word(name, [*objects], "add it to objects")
            raise InputError("object", name, bound, remedy)
        if step.stages is None:
            return self
        begin, end = step.stages
        if self.stage is not begin:
            kinds = "enclose, grasp, lift, carry, set_down, loosen and leave"
            remedy = f"{kinds} an object, in this order"
            current, required = str(self.stage), str(begin)
            if Stage.OPEN in (self.stage, begin):
                remedy, closed = "open_vertex, then hold or close_vertex", "no open vertex"
                current, required = (x.replace(Stage.FREE, closed) for x in (current, required))
            raise InputError("", current, f"{required}, which {step.name} needs", remedy)
        if begin is not Stage.FREE and name != self.name:
            raise InputError("object", name, f"{self.name}, the one enclosed", "leave that before")
        if not self.outline_specified and isinstance(step, MoveStep | FollowVertex):
            bound = "given an outline of the file"
            raise InputError("", "the outline around an object", bound, "morph before")
        specified = getattr(step, "polygon", None) is not None
        specified |= self.outline_specified and not hasattr(step, "object")
        return _ObjectStage(end, "" if end is Stage.FREE else name, specified)


def _check_blend(steps: tuple[Step, ...], i: int, *, complete: bool) -> None:
    """Raise InputError if step i cannot continue into the next one, or has options of its own."""
    step, following = steps[i], steps[i + 1 : i + 2]
    if step.blends and complete and not following:
        raise InputError("blend", True, "false in the last step", "leave it out: nothing follows")
    if step.blends and following and not following[0].blendable:
        names = ", ".join(kind.name for kind in STEPS if kind.blendable)
        remedy = f"leave it out: only {names} go on into one another"
        raise InputError("blend", True, f"false before a {following[0].name}", remedy)
    is_blended = step.blends or (i > 0 and steps[i - 1].blends)
    for key in ("optimize", "tension", "duration") if is_blended else ():
        if vars(step).get(key):
            bound = "left out: it is not allowed on blended steps"
            raise InputError(key, vars(step)[key], bound, f"leave out {key} or blend")


@documented
@dataclass(frozen=True, eq=False)
class HitchStart(Record):
    """A formed hitch, at rest."""

    polygon: Polygon
    altitude: Annotated[float, Key(ALTITUDE, "Height of the hitch's plane")] = 1.0
    legs: Annotated[SlackSplit, Key(LEGS, LEGS_TEXT)] = "spread"


_PLACES = points((None, 3), "x, y, z", 2, MAX_ROBOTS)


@documented
@dataclass(frozen=True, eq=False)
class DronesStart(Record):
    """Drones of a hitch that is to be formed, at rest: hovering, or on the ground."""

    q: Annotated[
        Array, Key(_PLACES, "Places (n, 3) [m], [x, y, z] per robot", [[0, 0, 1], [1, 0, 1]])
    ]
    r: Annotated[
        Array, Key(_PLACES, "Places (n, 3) [m], [x, y, z] per robot", [[0, 1, 1], [1, 1, 1]])
    ]

    @property
    def drones(self) -> Array:
        """Starts of all drones (2n, 3) [m]: q0, r0, q1, r1, …."""
        return np.stack([self.q, self.r], axis=1).reshape(-1, 3)


Start = HitchStart | Hitch | DronesStart
"""Start with the description of a hitch, with a hitch, or with drones on free cables."""


MAX_TITLE, MAX_STEPS, MAX_PRISMS = 200, 1000, 1000
"""Maximum numbers of characters of a title, and of steps and prisms in a file."""


def _printable(key: str, value: object) -> str:
    """Return a title, or raise InputError if it has control characters."""
    title: str = strings(MAX_TITLE).check(key, value)
    if not title.isprintable():
        raise InputError(key, title, "printable text on one line", "remove such characters")
    return title


START = single_key(
    "Start",
    "Start of the plan.",
    {"hitch": HitchStart, "drones": DronesStart},
    "hitch: {polygon: [[x, y], …], altitude: 1.0}",
    (Hitch,),
)
STEP = single_key(
    "Step",
    "One step of the mission.",
    STEP_KINDS,
    "one step per list entry, such as hold: {seconds: 1.0}",
)

Others = Annotated[
    Mapping[str, Other], Key(OTHERS, "Plans that fly besides, by name, at rest before and after")
]
Title = Annotated[str, Key(replace(strings(MAX_TITLE), check=_printable), "Title of the plan")]
ArenaOrNone = Annotated[Arena | None, Key(mapping_of(Arena), "The box that the drones stay in")]


@documented
@dataclass(frozen=True, eq=False)
class Problem(OneLine):
    """A team of quadrotors, a cable hitch, and what to do with it.

    Raises
    ------
    InputError: objects or steps that do not fit one another, the team or the outline; no step.
    """

    complete: ClassVar[bool] = True  # whether the mission has all of its steps
    team: Annotated[Team, Key(mapping_of(Team), "The team", {"robots": 3, "cable_length": 2.4})]
    start: Annotated[
        Start, Key(START, "Start of the plan", {"hitch": {"polygon": TRIANGLE, "altitude": 1.0}})
    ]
    mission: Annotated[
        tuple[Step, ...],
        Key(
            list_of(STEP, 1, MAX_STEPS), "Steps, one after the other", [{"hold": {"seconds": 1.0}}]
        ),
    ]
    limits: Annotated[Limits, Key(mapping_of(Limits), "Limits of motion")] = field(
        default_factory=Limits
    )
    separation: Annotated[Separation, Key(mapping_of(Separation), "Distances to keep")] = field(
        default_factory=Separation
    )
    arena: ArenaOrNone = None
    title: Title = ""
    objects: Annotated[
        Mapping[str, SolidObject], Key(OBJECTS, "Carried objects and obstacles, by name")
    ] = field(default_factory=dict)
    others: Others = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_instance("team", self.team, Team)
        check_instance("start", self.start, HitchStart, Hitch, DronesStart)
        check_requirements(self)
        store(self, title=self.title, others=self.others)
        steps = sequence("mission", self.mission)
        for i, step in enumerate(steps):
            check_instance(f"mission[{i}]", step, Step)
        if not isinstance(self.objects, Mapping):
            remedy = "write {'box': hitchopt.SolidObject(…)}"
            raise InputError("objects", self.objects, "a dict of objects by name", remedy)
        for name, body in self.objects.items():
            check_instance(f"objects.{name}", body, SolidObject)
        object.__setattr__(self, "objects", dict(self.objects))
        object.__setattr__(self, "start", resolved_start(self.team, self.start))
        if self.complete:
            check_placed(self.objects, self.requirements.floor)
            if not steps:
                bound = "a list of at least one step"
                raise InputError("mission", [], bound, "add a morph or a hold")
        object.__setattr__(self, "mission", resolved_steps(self, steps))

    @property
    def requirements(self) -> Requirements:
        """Requirements of the plan."""
        parts = self.limits, self.separation, self.arena
        return Requirements(*parts, objects=self.objects).flown_by(self.team)

    @property
    def asked(self) -> dict[str, Any]:
        """The plan's request as plan files store it (``hitchopt.motion.plan_file``)."""
        start: dict[str, Any] = {"drones": self.start}
        if not isinstance(self.start, DronesStart):
            altitude = self.start.altitude
            start = {"hitch": {"polygon": self.start.polygon.vertices, "altitude": altitude}}
        return request_fields(self.team, self.requirements, start, [*_requested_steps(self)])

    @property
    def rings(self) -> tuple[tuple[int, ...], ...]:
        """Robots that hold the edges after each step, in order; all robots if none changes."""
        rings, ring = list[tuple[int, ...]](), self.team.labels
        for step in self.mission:
            ring = step.ring_after(ring, self.team)
            rings.append(ring)
        return tuple(rings)

    @property
    def changes(self) -> bool:
        """Whether some robots are not in the hitch at some time."""
        return any(ring != self.team.labels for ring in self.rings)

    @property
    def start_outline(self) -> Outline | None:
        """Outline at the start; None for free cables."""
        return None if isinstance(self.start, DronesStart) else self.start.polygon


def _requested_steps(problem: Problem) -> Iterator[dict[str, Any]]:
    """Yield the request of every step, as ``plan_file.mission_of``, without choices of planners.

    Planners choose outlines around objects, and their altitudes.
    """
    requirements, ring = problem.requirements, problem.team.labels
    outline, stage, hold, tension_range = problem.start_outline, _ObjectStage(), None, None
    altitude = getattr(problem.start, "altitude", None)  # None if the planner chooses it
    for step in problem.mission:
        team, ring = team_and_ring(problem.team, step, ring)
        name, objects = getattr(step, "object", stage.name), {**requirements.objects}
        if isinstance(step, TensionStep):
            tensions = [team.tension, team.tension if step.tension is None else step.tension]
            smallest = min(OPENING_TENSIONS[0], *map(np.min, tensions))
            tension_range = smallest, max(map(np.max, tensions))
            hold = name, step.method_for(objects[name])
        outline, stage = step.checked_polygon_after(team, outline), stage.after(step, objects)
        if name:
            moved = {name: objects[name].moved_to(goal_of(step, requirements, name))}
            requirements = replace(requirements, objects=objects | moved)
        if isinstance(step, Form | Transport):
            altitude = step.altitude if isinstance(step, Form) else float(step.to[2])
        altitude = None if hasattr(step, "object") else altitude
        request = {
            "tension": getattr(step, "tension", None) if hold is None else tension_range,
            "holds": [] if hold is None else [hold],
            "objects": {key: each.pose for key, each in requirements.objects.items()},
        }
        if outline is None:
            request |= {"polygon": None, "altitude": None}
        elif stage.outline_specified and not step.blends:
            request["polygon"] = outline.vertices
        if outline is not None and altitude is not None:
            request["altitude"] = altitude
        if problem.changes:
            request["ring"] = ring
        if step.prescribed_duration is not None:
            request["seconds"] = step.prescribed_duration
        if stage.stage in (Stage.FREE, Stage.AROUND):
            hold = None
        yield request


def resolved_start(team: Team, start: Start) -> Start:
    """Return the start; a hitch's polygon becomes an outline and its legs an array.

    Raises InputError, with the key of the problem file, if it does not fit the team.
    """
    if isinstance(start, Hitch):
        if start.team is not team:
            raise InputError("start", "a hitch", "a hitch of the problem's team", "give its team")
        return start
    if isinstance(start, HitchStart):
        try:
            outline, legs = checked_polygon(team, start.polygon), slack_split(start.legs, team)
        except InputError as error:
            raise error.within("start.hitch") from None
        return replace(start, polygon=outline, legs=legs)
    for name, places in vars(start).items():
        if len(places) != team.robots:
            key, bound = f"start.drones.{name}", f"a list of {team.robots} points"
            remedy = "add or remove points, or change team.robots"
            raise InputError(key, f"{len(places)} points", bound, remedy)
    distances = np.linalg.norm(start.q - start.r, axis=1)
    k = int(np.argmax(distances / team.cable_length))
    if distances[k] > UNIT_ERROR_RATIO * team.cable_length[k]:
        words = f"{distances[k]:.4g} m from q[{k}] on a cable of {team.cable_length[k]:g} m"
        remedy = "if millimetres were meant, write metres"
        warn_of_unit(UnitWarning(f"start.drones.r[{k}]", f"{words}; {remedy}"))
    return start


@dataclass(frozen=True, eq=False)
class SwarmTeam:
    """The team of single drones without cables."""

    drones: Annotated[int, Key(integers(1, MAX_DRONES), "Number N of drones", 2)]
    quadrotor: Annotated[
        Any,
        Key(
            one_or_each(QUADROTOR, 1, MAX_DRONES),
            "Kind of quadrotor or name of a model, one for all or one per drone; null: the default "
            "kind",
        ),
    ] = None

    def team(self) -> Swarm:
        """Return the team."""
        return Swarm(self.drones, quadrotor=self.quadrotor)


SWARM_TEAM = mapping_of(SwarmTeam, SwarmTeam.team)
SWARM_PLACES = points((None, 3), "x, y, z", 1, MAX_DRONES)
HITCH_LIMITS, HITCH_SEPARATION = ("vertex_speed", "leg"), ("cable", "crossing", "object")
"""Keys of limits and distances that do not apply to single drones."""

_LIMITS = mapping_of(Limits, exclude=HITCH_LIMITS)
_SEPARATION = mapping_of(Separation, exclude=HITCH_SEPARATION)


@documented
@dataclass(frozen=True, eq=False)
class SwarmProblem(OneLine):
    """Single drones that trade places out of each other's downwash."""

    team: Annotated[Swarm, Key(SWARM_TEAM, "The team", {"drones": 2})]
    start: Annotated[
        Array,
        Key(
            SWARM_PLACES,
            "Where drones are at rest (N, 3) [m], [x, y, z] per drone",
            [[-1, 0, 1], [1, 0, 1]],
        ),
    ]
    goal: Annotated[
        Array,
        Key(
            SWARM_PLACES,
            "Where they come to rest (N, 3) [m], in the same order",
            [[1, 0, 1], [-1, 0, 1]],
        ),
    ]
    limits: Annotated[Limits, Key(_LIMITS, "Limits of motion")] = field(default_factory=Limits)
    separation: Annotated[Separation, Key(_SEPARATION, "Distances to keep")] = field(
        default_factory=Separation
    )
    arena: ArenaOrNone = None
    keep_out: Annotated[
        tuple[Prism, ...],
        Key(list_of(mapping_of(Prism), 0, MAX_PRISMS), "Prisms that the drones stay out of"),
    ] = ()
    duration: Annotated[
        float | None, Key(DURATION, "Exactly that long; without it as fast as possible")
    ] = None
    title: Title = ""
    objects: Annotated[
        Mapping[str, SolidObject],
        Key(OBJECTS, "Obstacles, by name; they stand where they are, and drones stay off them"),
    ] = field(default_factory=dict)
    others: Others = field(default_factory=dict)

    @property
    def requirements(self) -> Requirements:
        """Requirements of the plan."""
        parts = self.limits, self.separation, self.arena, self.keep_out, self.objects
        return Requirements(*parts).flown_by(self.team)

    @property
    def asked(self) -> dict[str, Any]:
        """The plan's request as plan files store it (``hitchopt.motion.plan_file``)."""
        step: dict[str, Any] = {"drones": self.goal}
        step["objects"] = {name: each.pose for name, each in self.objects.items()}
        if self.duration is not None:
            step["seconds"] = self.duration
        return request_fields(self.team, self.requirements, {"drones": self.start}, [step])

    def __post_init__(self) -> None:
        check_instance("team", self.team, Swarm)
        values = vars(self)
        store(
            self, **{key: values[key] for key in ("start", "goal", "duration", "title", "others")}
        )
        for name in ("start", "goal"):
            if (count := len(getattr(self, name))) != self.team.drones:
                words = f"{self.team.drones} points, one per drone", "change team.drones, or these"
                raise InputError(name, f"{count} points", *words)
        object.__setattr__(self, "keep_out", sequence("keep_out", self.keep_out))
        check_requirements(self)
        object.__setattr__(self, "objects", dict(self.objects))
        check_placed(self.objects, self.requirements.floor)
