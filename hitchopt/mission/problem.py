"""A problem: team, limits, a start and steps that fit, or single drones; not yet planned."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from hitchopt.errors import InputError, OneLine, UnitWarning
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Swarm, Team
from hitchopt.hitch.hitch import FAR_OFF, checked_polygon
from hitchopt.hitch.requirements import (
    Arena,
    Limits,
    Prism,
    Requirements,
    Separation,
    check_requirements,
)
from hitchopt.motion.plan_file import request_fields
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import check_placed
from hitchopt.planners.carrying.planner import LOOSE
from hitchopt.steps import STEPS, FollowVertex, Form, Step, Transport
from hitchopt.steps.carrying import PullStep, goal_of
from hitchopt.steps.moving import MoveStep
from hitchopt.steps.step import SlackSplit, Stage, slack_split
from hitchopt.values import Array, coordinate, instance, points, positive, sequence, text
from hitchopt.values.units import HEIGHT, check_unit, warn_of_unit


def resolved_steps(problem: Problem, steps: tuple[Step, ...]) -> tuple[Step, ...]:
    """Return steps with their polygons as outlines and their legs as arrays.

    Raises InputError: a step that does not fit the team, the outline it meets, the object that is
    held, or the next step; its key is that of the problem file, from ``mission`` on.
    """
    team, outline = problem.team, problem.start_outline
    fitted, held = list[Step](), _Held()
    for i, given in enumerate(steps):
        try:
            step = given.resolved_for(team)
            held = held.after(step, problem.objects)
            outline = step.checked_polygon_after(team, outline)
            if step.blends and (problem.complete or i + 1 < len(steps)):
                _check_blend(steps[i + 1 :])
            if step.blends or (i > 0 and steps[i - 1].blends):
                _check_untimed(step)
        except InputError as error:
            raise error.within(f"mission[{i}].{given.name}") from None
        fitted.append(step)
    return tuple(fitted)


@dataclass(frozen=True)
class _Held:
    """Stage of a hitch with an object, and whether its outline is that of an earlier step."""

    stage: Stage = Stage.FREE
    name: str = ""
    known: bool = True

    def after(self, step: Step, objects: Mapping[str, SolidObject]) -> _Held:
        """Return the stage after a step; raise InputError if the step does not follow on it."""
        name = text("object", getattr(step, "object", self.name))
        if name and name not in objects:
            bound = f"one of objects: {', '.join(objects)}" if objects else "an object of the file"
            raise InputError("object", name, bound, "list it under objects")
        if step.stages is None:
            return self
        begin, end = step.stages
        if self.stage is not begin:
            kinds = "enclose, grasp, lift, carry, set_down, loosen and leave"
            remedy = f"{kinds} an object, in this order"
            raise InputError("", str(self.stage), f"{begin}, which {step.name} needs", remedy)
        if begin is not Stage.FREE and name != self.name:
            raise InputError("object", name, f"{self.name}, the one enclosed", "leave that before")
        if not self.known and isinstance(step, MoveStep | FollowVertex):
            bound = "given an outline of the file"
            raise InputError("", "the outline around an object", bound, "morph before")
        shaped = getattr(step, "polygon", None) is not None
        known = shaped or (self.known and not hasattr(step, "object"))
        return _Held(end, "" if end is Stage.FREE else name, known)


def _check_blend(following: tuple[Step, ...]) -> None:
    """Raise InputError where a step cannot go on into those that follow without a stop."""
    if not following:
        raise InputError("blend", True, "false in the last step", "leave it out: nothing follows")
    if not following[0].blendable:
        names = ", ".join(kind.name for kind in STEPS if kind.blendable)
        remedy = f"leave it out: only {names} go on into one another"
        raise InputError("blend", True, f"false before a {following[0].name}", remedy)


def _check_untimed(step: Step) -> None:
    """Raise InputError where a step that is blended is to be optimised, or has a duration."""
    for key in ("optimize", "tension", "duration"):
        if vars(step).get(key):
            bound = "left out: it is not allowed on blended steps"
            raise InputError(key, vars(step)[key], bound, f"leave out {key} or blend")


@dataclass(frozen=True, eq=False)
class HitchStart(OneLine):
    """Start as a formed hitch.

    Parameters
    ----------
    polygon: its outline, or its points (n, 2) [m] until a Problem knows the topology.
    altitude: [m]
    legs: ``balanced``, ``spread`` or (n,) ``d_k`` [m].
    """

    polygon: Outline
    altitude: float
    legs: SlackSplit = "spread"

    def __post_init__(self) -> None:
        object.__setattr__(self, "altitude", coordinate("altitude", self.altitude))
        check_unit("altitude", self.altitude, HEIGHT)


@dataclass(frozen=True, eq=False)
class DronesStart(OneLine):
    """Start as drones on free cables, at rest: hovering, or on the ground.

    Parameters
    ----------
    q, r: (n, 3) [m], where the drones of every robot are.
    """

    q: Array
    r: Array

    def __post_init__(self) -> None:
        for name, place in vars(self).items():
            given = points(name, place, (2, 3), "(n, 3)", "give one point [x, y, z] a robot")
            object.__setattr__(self, name, given)

    @property
    def drones(self) -> Array:
        """Starts of all drones (2n, 3) [m]: q0, r0, q1, r1, …."""
        return np.stack([self.q, self.r], axis=1).reshape(-1, 3)


Start = HitchStart | Hitch | DronesStart
"""Start as a hitch to be made, as one that is there, or as drones on free cables."""


@dataclass(frozen=True, eq=False)
class Problem(OneLine):
    """All that a planner needs to know.

    Parameters
    ----------
    team, start, mission: who, from where, and the steps in order (at least one).
    limits, separation, arena, title: what to keep, and what to call it.
    objects: carried objects and obstacles by name.

    Raises
    ------
    InputError: objects or steps that do not fit one another, the team or the outline; no step.
    """

    complete: ClassVar[bool] = True  # whether no step follows
    team: Team
    start: Start
    mission: tuple[Step, ...]
    limits: Limits = field(default_factory=Limits)
    separation: Separation = field(default_factory=Separation)
    arena: Arena | None = None
    title: str = ""
    objects: Mapping[str, SolidObject] = field(default_factory=dict)

    def __post_init__(self) -> None:
        instance("team", self.team, Team)
        instance("start", self.start, HitchStart, Hitch, DronesStart)
        check_requirements(self)
        text("title", self.title)
        steps = sequence("mission", self.mission)
        for i, step in enumerate(steps):
            instance(f"mission[{i}]", step, Step)
        if not isinstance(self.objects, Mapping):
            remedy = "write {'box': hitchopt.SolidObject(…)}"
            raise InputError("objects", self.objects, "a dict of objects by name", remedy)
        for name, body in self.objects.items():
            instance(f"objects.{name}", body, SolidObject)
        object.__setattr__(self, "objects", dict(self.objects))
        object.__setattr__(self, "start", fitting_start(self.team, self.start))
        if self.complete:
            check_placed(self.objects, self.requirements.floor)
            if not steps:
                bound = "a list of at least one step"
                raise InputError("mission", [], bound, "add a morph or a hold")
        object.__setattr__(self, "mission", resolved_steps(self, steps))

    @property
    def requirements(self) -> Requirements:
        """Requirements of the plan."""
        own = Requirements(self.limits, self.separation, self.arena, objects=self.objects)
        return own.flown_by(self.team)

    @property
    def asked(self) -> dict[str, Any]:
        """The plan's request as plan files store it (``hitchopt.motion.plan_file``)."""
        start: dict[str, Any] = {"drones": self.start}
        if not isinstance(self.start, DronesStart):
            altitude = self.start.altitude
            start = {"hitch": {"polygon": self.start.polygon.vertices, "altitude": altitude}}
        return request_fields(self.team, self.requirements, start, [*_asked_steps(self)])

    @property
    def start_outline(self) -> Outline | None:
        """The outline at the start; None where cables are free."""
        return None if isinstance(self.start, DronesStart) else self.start.polygon


def _asked_steps(problem: Problem) -> Iterator[dict[str, Any]]:
    """Yield the request of every step, as ``plan_file.mission_of``, without choices of planners.

    The planner decides outlines around objects, and how high they are.
    """
    team, requirements = problem.team, problem.requirements
    outline, held, hold, pulls = problem.start_outline, _Held(), None, None
    altitude = getattr(problem.start, "altitude", None)  # None where it is not known
    for step in problem.mission:
        name, objects = getattr(step, "object", held.name), {**requirements.objects}
        if isinstance(step, PullStep):
            pull = [team.tension, team.tension if step.tension is None else step.tension]
            pulls = min(LOOSE[0], *map(np.min, pull)), max(map(np.max, pull))
            hold = name, step.held_by(objects[name])
        outline, held = step.checked_polygon_after(team, outline), held.after(step, objects)
        if name:
            moved = {name: objects[name].moved_to(goal_of(step, requirements, name))}
            requirements = replace(requirements, objects=objects | moved)
        if isinstance(step, Form | Transport):
            altitude = step.altitude if isinstance(step, Form) else float(step.to[2])
        altitude = None if hasattr(step, "object") else altitude
        asked_step = {
            "tension": getattr(step, "tension", None) if hold is None else pulls,
            "holds": [] if hold is None else [hold],
            "objects": {key: each.pose for key, each in requirements.objects.items()},
        }
        if outline is None:
            asked_step |= {"polygon": None, "altitude": None}
        elif held.known and not step.blends:
            asked_step["polygon"] = outline.vertices
        if outline is not None and altitude is not None:
            asked_step["altitude"] = altitude
        if step.given_duration is not None:
            asked_step["seconds"] = step.given_duration
        if held.stage in (Stage.FREE, Stage.AROUND):
            hold = None
        yield asked_step


def fitting_start(team: Team, start: Start) -> Start:
    """Return the start with its polygon as an outline and its legs as an array, if it is a hitch.

    Raises InputError where it does not fit the team, with the key of the problem file.
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
    for name, given in vars(start).items():
        if len(given) != team.robots:
            key, bound = f"start.drones.{name}", f"a list of {team.robots} points"
            remedy = "add or remove points, or change team.robots"
            raise InputError(key, f"{len(given)} points", bound, remedy)
    apart = np.linalg.norm(start.q - start.r, axis=1)
    k = int(np.argmax(apart / team.cable_length))
    if apart[k] > FAR_OFF * team.cable_length[k]:
        words = f"{apart[k]:.4g} m from q[{k}] on a cable of {team.cable_length[k]:g} m"
        meant = "if millimetres were meant, write metres"
        warn_of_unit(UnitWarning(f"start.drones.r[{k}]", f"{words}; {meant}"))
    return start


@dataclass(frozen=True, eq=False)
class SwarmProblem(OneLine):
    """All that the separation planner needs to know.

    Parameters
    ----------
    team: who.
    start, goal: (N, 3) [m]
    limits, separation, arena, keep_out, title: what to keep, and what to call it.
    duration: of the flight, exactly [s], or None: as fast as is found.
    objects: by name; they stand where they are, and the drones stay off them.
    """

    team: Swarm
    start: Array
    goal: Array
    limits: Limits = field(default_factory=Limits)
    separation: Separation = field(default_factory=Separation)
    arena: Arena | None = None
    keep_out: tuple[Prism, ...] = ()
    duration: float | None = None
    title: str = ""
    objects: Mapping[str, SolidObject] = field(default_factory=dict)

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
        instance("team", self.team, Swarm)
        for name in ("start", "goal"):
            bound, remedy = "a list of points [x, y, z]", "give three numbers per drone"
            given = points(name, getattr(self, name), (1, 3), bound, remedy)
            if len(given) != self.team.drones:
                words = f"{self.team.drones} points, one per drone", "change team.drones, or these"
                raise InputError(name, f"{len(given)} points", *words)
            object.__setattr__(self, name, given)
        object.__setattr__(self, "keep_out", sequence("keep_out", self.keep_out))
        check_requirements(self)
        object.__setattr__(self, "objects", dict(self.objects))
        check_placed(self.objects, self.requirements.floor)
        text("title", self.title)
        if self.duration is not None:
            object.__setattr__(self, "duration", positive("duration", self.duration))
