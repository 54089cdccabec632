"""Base of all steps: a record with its keys, its planning and the knobs of repair."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cache, cached_property
from typing import Annotated, Any, ClassVar, Final, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.checks import Certificate, certify
from hitchopt.checks.registry import MERGEABLE_REPORTS, RULES
from hitchopt.errors import InputError, OneLine, UnitWarning
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.hitch import checked_polygon, checked_roll
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import MAX_ROBOTS, PartTeam
from hitchopt.motion.motion import Motion
from hitchopt.objects import SolidObject
from hitchopt.planners.carrying.planner import GraspState
from hitchopt.planners.forming import SwapSettings
from hitchopt.values import Array, Indices, finite, per_robot
from hitchopt.values.fields import (
    FLAGS,
    Key,
    either,
    integers,
    list_of,
    mapping_of,
    one_or_each,
    points,
    store,
    strings,
    words,
)
from hitchopt.values.units import (
    DURATION,
    LENGTH,
    LENGTH_OR_ZERO,
    ROLL,
    quantity,
    warn_of_unit,
)

# Kinds of values, and fields that several kinds of steps have.

OBJECT_NAME = strings(50, 1, "[A-Za-z0-9_ -]+", "of letters, digits, spaces, - and _")
POINT2, POINT3 = points((2,), "x, y"), points((3,), "x, y, z")
OUTLINE = points((None, 2), "x, y", 3, MAX_ROBOTS + 1, Outline)
INDEX = integers(0, MAX_ROBOTS - 1)

OUTLINE_TEXT = (
    "Vertices [x, y] [m] of a convex polygon, clockwise seen from above, one per robot; one more "
    "of the convex arc of an open chain"
)
SPLIT_TEXT = "How cables share their slack: balanced, spread, or a list of q-legs d_k"
LEGS_TEXT = f"{SPLIT_TEXT}; or that as sharing, with a roll_deg"

TRIANGLE = [[0, -1], [-0.4, 0.5], [0.4, 0.5]]
"""Points [m] of an example."""

AUTO: Final = "auto"
"""Word for an automatic choice: a duration, or a roll that is 0 unless limits need it."""

SPLIT = either(words("balanced", "spread"), list_of(LENGTH_OR_ZERO, 2, MAX_ROBOTS))


@dataclass(frozen=True, eq=False)
class RolledLegs:
    """Legs that are rolled out of their plane."""

    sharing: Annotated[Literal["balanced", "spread"] | Array, Key(SPLIT, SPLIT_TEXT)] = "spread"
    roll: Annotated[
        Array | None,
        Key(
            either(words(auto=None), one_or_each(ROLL, 1, MAX_ROBOTS)),
            "Roll of the legs about their clasps, q up and r down, one for all or one per clasp; "
            "auto: none unless legs without it break a limit",
        ),
    ] = None


LEGS = either(SPLIT, mapping_of(RolledLegs))

SlackSplit = Literal["balanced", "spread"] | Array | RolledLegs
"""The slack split of a hitch: ``balanced``, ``spread``, or (n,) [m] the q-legs ``d_k``; or one of
these with a roll. Spread legs without one are rolled where they break a limit otherwise."""


def slack_split(
    legs: str | Sequence[float] | ArrayLike | Mapping[str, Any] | RolledLegs, team: Team
) -> SlackSplit:
    """Return the value of ``legs`` after checks.

    A mapping has ``sharing`` and ``roll_deg``: ``auto``, one angle, or one per clasp [deg]. A list
    has one positive length per robot, none of them zero but the first of a chain.
    """
    given = LEGS.check("legs", legs)
    if not isinstance(given, RolledLegs):
        return _split(given, team)
    roll = given.roll
    if roll is not None:
        clasps = len(team.layout.clasps)
        roll = checked_roll(team, per_robot("legs.roll_deg", roll, clasps, finite, "clasp"))
    return RolledLegs(_split(given.sharing, team), roll)


def _split(legs: Any, team: Team) -> Literal["balanced", "spread"] | Array:
    """Return a word or checked q-legs (n,) [m]."""
    if isinstance(legs, str):
        return "balanced" if legs == "balanced" else "spread"
    q_legs = per_robot("legs", legs, team.robots, LENGTH_OR_ZERO.check)
    zero = np.flatnonzero(team.layout.has_leg[:, 0] & (q_legs == 0.0))
    if len(zero) > 0:
        LENGTH.check(f"legs[{zero[0]}]", 0.0)
    return q_legs


MAX_TURNS = 5
"""Most turns of one step: a bounded number of polynomials would not follow more closely."""


def _turned(key: str, value: object) -> float:
    """Return a turn [rad], or raise InputError for too many; warn of whole numbers."""
    yaw = finite(key, value)
    meant = f"if degrees were meant, {math.radians(yaw):.3g}"
    if abs(yaw) > MAX_TURNS * 2.0 * math.pi:
        bound = f"at most {MAX_TURNS} turns either way"
        raise InputError(key, yaw, bound, f"turn in several steps; {meant}")
    if abs(yaw) > 2.0 * math.pi and yaw == round(yaw):  # rarely of radians
        warn_of_unit(UnitWarning(key, f"{yaw:g} rad, more than a turn; {meant}"))
    return yaw


_LIMIT = MAX_TURNS * 2.0 * math.pi
TURN = replace(quantity("rad", (-_LIMIT, _LIMIT), (-_LIMIT, _LIMIT)), check=_turned)
AUTO_SECONDS = either(words(AUTO), DURATION)

Seconds = Annotated[
    float | None, Key(DURATION, "Exactly that long; without it as fast as the limits allow")
]
Blend = Annotated[bool, Key(FLAGS, "Go on into the next step without a stop")]
LegsAtEnd = Annotated[SlackSplit | None, Key(LEGS, f"{LEGS_TEXT}, at the step's end")]
WhichPoint = Annotated[int, Key(INDEX, "Which, from 0", 0)]
ObjectOf = Annotated[str, Key(OBJECT_NAME, "Name of the object", "box")]
Place = Annotated[Array, Key(POINT3, "Where its base goes, [x, y, z] [m]", [1, 0, 0])]
Yaw = Annotated[float, Key(TURN, "By how much it turns, counter-clockwise")]
Polygon = Annotated[Outline, Key(OUTLINE, OUTLINE_TEXT, TRIANGLE)]


# Records of planning and repair.

IDLE = 0.01
"""Duration [s] of a step that moves nothing and was given none."""

DECIMALS, LEAST_LEFT = 9, 0.1
"""Decimals of numbers in edits, and share of a quantity that is left where it is lowered."""

PLAN_DURATION = "plan duration"
"""Constraint of the plan's duration, distinct from a step's, which is too short."""


@cache
def checks_relaxed_by(by: Literal["length", "time", "tension"]) -> frozenset[str]:
    """Return the checks relaxed by a larger length, a longer time or a lower tension."""
    return frozenset(rule.name for rule in RULES if rule.ease == by)


@dataclass(frozen=True)
class Edit(OneLine):
    """A change of one value in a problem file."""

    key: str  # path such as ``mission[0].morph.polygon``; of a step's own edits, within the step
    value: object  # number, word, list or mapping, in the file's units


Edits = tuple[Edit, ...]
"""Edits that are made together."""


@dataclass(frozen=True, eq=False)
class Knob:
    """A number that repair may raise or lower."""

    key: str  # as the file has it; of a step's number, within the step
    old: float  # its value
    unit: str  # of the value; ``times`` for a factor
    # gives what to write for another value; None for the value itself under the key
    written: Callable[[float], Edits] | None = None
    sign: int = 1  # 1 where it is raised, -1 where it is lowered, to LEAST_LEFT of it at most
    # constraints that it can repair; where others are broken too it is not tried
    covers: frozenset[str] = frozenset()
    words: str = ""  # what it is, where the key does not tell
    extent: float | None = None  # what sizes are relative to [unit]; the old value unless given
    least: float = 0.0  # sizes below are known not to do
    most: float = math.inf  # sizes above make no sense

    def __post_init__(self) -> None:
        if self.sign < 0 and self.extent is None:
            object.__setattr__(self, "most", min(self.most, 1.0 - LEAST_LEFT))

    def edits(self, value: float) -> Edits:
        """Return the edits for another value."""
        return (Edit(self.key, value),) if self.written is None else self.written(value)


def points_scaled(points: Array, factor: float, centre: Array) -> Array:
    """Return the points (…, 2) [m] moved away from ``centre`` by a factor."""
    return np.round(centre + factor * (points - centre), DECIMALS)


def outline_edit(key: str, outline: Outline, factor: float) -> Edit:
    """Return the edit of an outline that is scaled about its centroid."""
    return Edit(key, points_scaled(outline.vertices, factor, outline.centroid).tolist())


@dataclass(frozen=True, eq=False)
class RestState:
    """State at rest between two steps: a hitch, or drones on free cables."""

    team: Team  # who flies
    drones: Array  # (2n, 3) [m], in the order q0, r0, q1, r1, …
    hitch: Hitch | None = None  # what they hold, or None where cables are free
    # (clasps,), how pairs have turned to form it, 1 where q went up first; a hitch that was there
    # at first is taken to have been formed so
    senses: Array | None = None
    swap: SwapSettings = field(default_factory=SwapSettings)  # the settings of these turns
    # (n,), levels of cables that were laid, 0 the lowest; None of a hitch tied by turns
    levels: Indices | None = None
    # (clasps,) roll [rad], where one lies open; ``hitch`` is then as if it were closed
    opened: Array | None = None
    # all robots, and (2, 3) [m] the drones of those in no hitch, by their numbers, where any change
    whole: Team | None = None
    waiting: Mapping[int, Array] = field(default_factory=dict)
    # the object that the hitch is around or holds; ``hitch`` is then as if it carried nothing
    grasp: GraspState | None = None
    # where objects are by now; None where the problem has them
    objects: Mapping[str, SolidObject] | None = None

    @classmethod
    def formed(cls, hitch: Hitch) -> RestState:
        """Return the state of a hitch that exists at the start."""
        return cls(hitch.team, hitch.drones, hitch)

    @property
    def whole_team(self) -> Team:
        """All robots."""
        return self.team if self.whole is None else self.whole

    @property
    def known_senses(self) -> Array:
        """(clasps,): how pairs have turned, or are taken to have."""
        return np.ones(len(self.team.layout.clasps)) if self.senses is None else self.senses

    def followed_by(self, formed: RestState) -> RestState:
        """Return the state of a hitch that some robots have formed, all else as it is here."""
        return replace(formed, objects=self.objects, whole=self.whole, waiting=self.waiting)

    def part(self, ring: Sequence[int]) -> PartTeam:
        """Return the team of some robots."""
        return PartTeam.of(self.whole_team, ring)

    def regrouped(self, ring: Sequence[int]) -> RestState:
        """Return drones on free cables of which other robots are to form a hitch."""
        if self.whole is None or self.team.labels == tuple(ring):
            return self
        own = zip(self.team.labels, self.drones.reshape(-1, 2, 3), strict=True)
        pairs = {**self.waiting, **dict(own)}
        drones = np.concatenate([pairs.pop(robot) for robot in ring])
        return replace(self, team=self.part(ring), drones=drones, waiting=pairs)

    def with_waiting(self, motion: Motion, requirements: Requirements) -> Motion:
        """Return a motion that starts from here with the robots that wait besides."""
        from hitchopt.motion.chapters import with_waiting
        from hitchopt.planners.forming.joining import at_rest

        if self.whole is None or motion.changes:
            return motion
        waiting = {
            robot: at_rest(self.part((robot,)), places, requirements)
            for robot, places in self.waiting.items()
        }
        return with_waiting(motion, self.whole, waiting, motion.requirements)

    def at_objects(self, requirements: Requirements) -> Requirements:
        """Return requirements with objects where they are by now."""
        return requirements if self.objects is None else replace(requirements, objects=self.objects)


@dataclass(frozen=True, eq=False)
class StepPlan:
    """The motion of a step from rest to rest, and the state after it."""

    motion: Motion
    after: RestState

    @cached_property
    def certificate(self) -> Certificate:
        """Certificate of the motion alone, its duration left open; computed when first needed."""
        return certify(self.motion.untimed, reports=MERGEABLE_REPORTS)

    def remarked(self, words: str) -> StepPlan:
        """Return the same plan, the remarks of its phases with these words at their end."""
        phases = [
            replace(phase, remark=f"{phase.remark}; {words}" if phase.remark else words)
            for phase in self.motion.phases
        ]
        plan = StepPlan(self.motion.replaced(phases=tuple(phases)), self.after)
        if "certificate" in vars(self):  # independent of remarks
            vars(plan)["certificate"] = self.certificate
        return plan


@dataclass(frozen=True, eq=False)
class StepTask:
    """The task of planning a step."""

    before: RestState  # where the mission stands
    index: int  # of the step in its mission
    requirements: Requirements  # what the plan must satisfy
    optimiser: bool = True  # whether the optimiser may be used

    @property
    def hitch(self) -> Hitch:
        """The hitch at the start; problems are checked to have one."""
        assert self.before.hitch is not None
        return self.before.hitch

    @property
    def grasp(self) -> GraspState:
        """The object that the hitch is around or holds; a problem has no such step without it."""
        assert self.before.grasp is not None
        return self.before.grasp

    def within(self, requirements: Requirements, state: RestState) -> StepTask:
        """Return this task from another state, with other requirements."""
        return replace(self, before=state, requirements=requirements)

    def ended(self, motion: Motion, hitch: Hitch) -> StepPlan:
        """Return the plan of a motion that ends with a hitch."""
        return StepPlan(motion, replace(self.before, hitch=hitch, drones=hitch.drones))


class Stage(StrEnum):
    """Stage of a hitch with an object, or with a vertex that is open."""

    FREE = "no object"
    OPEN = "an open vertex"
    AROUND = "an enclosed object"
    GRASPED = "a grasped object"
    LIFTED = "a lifted object"


@dataclass(frozen=True, eq=False)
class Step(OneLine, ABC):
    """A step of a mission; its fields are annotated with the keys of the problem file."""

    name: ClassVar[str]  # in the problem file: that of the class, in words of lower case
    # whether a hitch must be there before it (True), must not (False), or may (None)
    needs_hitch: ClassVar[bool | None] = True
    blendable: ClassVar[bool] = False  # whether it can follow, or be followed, without a stop
    # where it begins and ends with respect to an object that is carried; None for anywhere
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.FREE, Stage.FREE)
    time_key: ClassVar[str] = "duration"  # name of the field that says how long, if it has one

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.name = re.sub(r"(?<=.)([A-Z])", r"_\1", cls.__name__).lower()

    def __post_init__(self) -> None:
        store(self, **vars(self))

    @property
    def given_duration(self) -> float | None:
        """The duration that was given [s], or None."""
        seconds = getattr(self, self.time_key, None)
        return seconds if isinstance(seconds, float) else None

    @property
    def blends(self) -> bool:
        """Whether it goes on into the next step without a stop."""
        return bool(getattr(self, "blend", False))

    def ring_after(self, ring: tuple[int, ...], team: Team) -> tuple[int, ...]:  # noqa: ARG002
        """Return the robots that hold the edges, in order, after the step.

        Raises InputError for robots that cannot.
        """
        return ring

    def resolved_for(self, team: Team) -> Self:
        """Return the step for a team: polygon as an outline, legs as an array."""
        polygon, legs = (vars(self).get(key) for key in ("polygon", "legs"))
        changed: dict[str, Any] = {}
        if polygon is not None:
            changed["polygon"] = checked_polygon(team, polygon)
        if legs is not None:
            changed["legs"] = slack_split(legs, team)
        return replace(self, **changed) if changed else self

    def checked_polygon_after(
        self, team: Team, outline: Outline | None, since: str = "start says so"
    ) -> Outline | None:
        """Return ``polygon_after`` if the step fits the hitch before it, else raise InputError.

        ``since`` is why there is a hitch before it, or none.
        """
        if self.needs_hitch is True and outline is None:
            bound, remedy = "given a hitch at that point", f"{since}: form one before"
            raise InputError("", "no hitch", bound, remedy)
        if self.needs_hitch is False and outline is not None:
            bound, remedy = (
                "given drones on free cables at that point",
                f"{since}: release it before",
            )
            raise InputError("", "a hitch", bound, remedy)
        return self.polygon_after(team, outline)

    def polygon_after(self, team: Team, outline: Any) -> Outline | None:
        """Return the outline that the step makes of ``outline``: its own polygon, if it has one."""
        own = vars(self).get("polygon", outline)
        return None if own is None else checked_polygon(team, own)

    def place_after(self, body: SolidObject, below: float) -> Array | None:  # noqa: ARG002
        """Return where the base of a held object goes: x, y, z [m], yaw [rad]; None if it stays.

        The surface ``below`` it is that high [m].
        """
        return None

    @abstractmethod
    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of the step, from rest to rest.

        Raises
        ------
        InfeasibleError: the end breaks a limit at rest, or no route was found.
        HitchoptError: a planner failed.
        """

    def lasting(self, task: StepTask, motion: Motion) -> Motion:
        """Return the motion slowed to last as long as the step was given, if it was."""
        from hitchopt.planners.timing.flight import check_duration

        duration = self.given_duration
        if duration is None:
            return motion
        check_duration(duration, motion.duration, f"of step {task.index} ({self.name})")
        return motion.slowed(duration / motion.duration)

    def knobs(self) -> Iterator[Knob]:
        """Yield the numbers that repair may change: a duration that was given."""
        seconds = self.given_duration
        if seconds is not None:
            yield Knob(self.time_key, seconds, "s", covers=frozenset({"duration"}))
            covers = frozenset({PLAN_DURATION})
            yield Knob(self.time_key, seconds, "s", sign=-1, covers=covers)

    def scaled(self, factor: float, centre: Array) -> tuple[Edits, Array]:
        """Return the edits that scale its outline by a factor, and the outline's centre after it.

        ``centre`` (2,) [m] is that of the outline before, about which points go; a polygon is
        scaled about its own centroid.
        """
        own: Outline | None = vars(self).get("polygon")
        return (
            ((), centre) if own is None else ((outline_edit("polygon", own, factor),), own.centroid)
        )
