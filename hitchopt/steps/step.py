"""Base of all steps: a record with its keys, its planning and the knobs of repair."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from enum import StrEnum
from functools import cache, cached_property, partial
from typing import Annotated, Any, ClassVar, Final, Literal, Self, TypeVar, get_args, get_type_hints

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag
from pydantic_core import PydanticCustomError

from hitchopt.checks import Certificate, certify
from hitchopt.checks.registry import MERGEABLE_REPORTS, RULES
from hitchopt.errors import InputError, OneLine, UnitWarning
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.hitch import checked_polygon, checked_roll
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import MAX_ROBOTS
from hitchopt.motion.motion import Motion
from hitchopt.objects import SolidObject
from hitchopt.planners.carrying.planner import GraspState
from hitchopt.planners.forming import SwapSettings
from hitchopt.values import (
    MAX_COORDINATE,
    Array,
    as_array,
    choice,
    coordinate,
    finite,
    flag,
    not_negative,
    per_robot,
    positive,
    whole,
)
from hitchopt.values.units import DURATION, HEIGHT, check_unit, warn_of_unit

MIN_QUANTITY, MAX_QUANTITY = 1e-9, 1e9
"""Smallest and largest quantity, in SI units: others are typing errors."""

FAULT = "hitchopt"
"""Type of the errors that carry their own ``bound`` and ``remedy``."""


class Keys(BaseModel):
    """A mapping of known keys; models are built when they are first used."""

    model_config = ConfigDict(
        strict=True, extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True
    )


WORD, FLAG, EACH, MAPPING, ONE = "a word", "true or false", "a list", "a mapping", "a number"
"""Forms of a value, as messages call them; tags of keys that take several forms."""


def form_of(value: object) -> str:
    """Return the tag of a value's form."""
    forms = ((str, WORD), (bool, FLAG), (list, EACH), (dict | Keys, MAPPING))
    return next((tag for kind, tag in forms if isinstance(value, kind)), ONE)


def fault(bound: str, remedy: str) -> PydanticCustomError:
    """Return an error that carries its own words."""
    return PydanticCustomError(FAULT, "{bound}; {remedy}", {"bound": bound, "remedy": remedy})


T = TypeVar("T")
M = TypeVar("M")
FORM = Discriminator(form_of)
Number = Annotated[float, Field(ge=-MAX_QUANTITY, le=MAX_QUANTITY)]
Positive = Annotated[float, Field(ge=MIN_QUANTITY, le=MAX_QUANTITY)]
NotNegative = Annotated[float, Field(ge=0.0, le=MAX_QUANTITY)]
Roll = Annotated[float, Field(gt=-90.0, lt=90.0)]
Index = Annotated[int, Field(ge=0, lt=MAX_ROBOTS)]
Point2 = Annotated[list[Number], Field(min_length=2, max_length=2)]
Point3 = Annotated[list[Number], Field(min_length=3, max_length=3)]
OutlinePoints = Annotated[list[Point2], Field(min_length=3, max_length=MAX_ROBOTS + 1)]
TwoPoints = Annotated[list[Point2], Field(min_length=2, max_length=2)]
TimedPath = Annotated[list[Point3], Field(min_length=1)]
TwoGains = Annotated[list[NotNegative], Field(min_length=2, max_length=2)]
OneOrEach = Annotated[Annotated[T, Tag(ONE)] | Annotated[M, Tag(EACH)], FORM]
RobotsList = Annotated[list[T], Field(min_length=2, max_length=MAX_ROBOTS)]
ClaspsList = Annotated[list[T], Field(min_length=1, max_length=MAX_ROBOTS)]
PerRobot = OneOrEach[T, RobotsList[T]]
PerClasp = OneOrEach[NotNegative, ClaspsList[NotNegative]]
Split = Annotated[Literal["balanced", "spread"], Tag(WORD)]
SplitLegs = Annotated[RobotsList[NotNegative], Tag(EACH)]
Auto = Annotated[Literal["auto"], Tag(WORD)]
ObjectName = Annotated[str, Field(min_length=1, max_length=50, pattern=r"^[A-Za-z0-9_ -]+$")]


def key(text: str, default: Any = ..., **options: Any) -> Any:
    """Return the field of a key that the text describes; it is required without a default."""
    given = options if "default_factory" in options else {"default": default, **options}
    return Field(description=text, **given)


OUTLINE_TEXT = (
    "Vertices [x, y] [m] of a convex polygon, clockwise seen from above, one per robot; one more "
    "of the convex arc of an open chain"
)
SHARING_TEXT = "How cables share their slack: balanced, spread, or a list of q-legs d_k [m]"
LEGS_TEXT = f"{SHARING_TEXT}; or that as sharing, with a roll_deg"
DURATION_TEXT = "Exactly that long [s]; without it as fast as the limits allow"

TRIANGLE = [[0, -1], [-0.4, 0.5], [0.4, 0.5]]
"""Points [m] of an example."""

AUTO: Final = "auto"
"""Word for an automatic choice: a duration, or a roll that is 0 unless limits need it."""


class RolledLegsKeys(Keys):
    """Legs that are rolled out of their plane."""

    sharing: Annotated[Split | SplitLegs, FORM] = key(SHARING_TEXT, "spread")
    roll_deg: Annotated[
        Auto | Annotated[Roll, Tag(ONE)] | Annotated[ClaspsList[Roll], Tag(EACH)], FORM
    ] = key(
        "Roll of the legs about their clasps [°], q up and r down, one for all or one "
        "per clasp; auto: none unless legs without it break a limit",
        AUTO,
    )


Legs = Annotated[Split | SplitLegs | Annotated[RolledLegsKeys, Tag(MAPPING)], FORM]


@dataclass(frozen=True, eq=False)
class RolledLegs:
    """Legs that are rolled out of their plane."""

    sharing: Literal["balanced", "spread"] | Array  # how cables share their slack, as without roll
    roll: Array | None = None  # (clasps,) [rad]; None for none unless legs break a limit without


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
    if isinstance(legs, RolledLegs):
        roll = None if legs.roll is None else checked_roll(team, legs.roll)
        return RolledLegs(_sharing(legs.sharing, team), roll)
    if not isinstance(legs, Mapping):
        return _sharing(legs, team)
    for name in sorted(legs.keys() - {"sharing", "roll_deg"}):
        raise InputError(f"legs.{name}", legs[name], "left out", "use sharing and roll_deg")
    sharing, given = _sharing(legs.get("sharing", "spread"), team), legs.get("roll_deg", AUTO)
    if isinstance(given, str):
        choice("legs.roll_deg", given, [AUTO])
        return RolledLegs(sharing)
    degrees = per_robot("legs.roll_deg", given, len(team.layout.clasps), finite, "clasp")
    worst = float(np.max(np.abs(degrees)))
    if worst >= 90.0:
        raise InputError("legs.roll_deg", worst, "within ±90°", "give a smaller angle")
    return RolledLegs(sharing, checked_roll(team, degrees * (math.pi / 180.0)))


def _sharing(legs: Any, team: Team) -> Literal["balanced", "spread"] | Array:
    """Return a word or checked q-legs (n,) [m]."""
    if isinstance(legs, str) and legs == "balanced":
        return "balanced"
    if isinstance(legs, str) and legs == "spread":
        return "spread"
    if isinstance(legs, str | int | float):
        raise InputError("legs", legs, "balanced, spread or a list of d_k", "write legs: spread")
    q_legs = per_robot("legs", legs, team.robots, not_negative)
    zero = np.flatnonzero(team.layout.has_leg[:, 0] & (q_legs == 0.0))
    if len(zero) > 0:
        positive(f"legs[{zero[0]}]", 0.0)
    return q_legs


@dataclass(frozen=True, eq=False)
class Key:
    """A step's field as a problem file has it."""

    kind: Any  # its type there; a model of keys for a mapping
    text: str  # what it is, with its unit
    examples: tuple[object, ...] = ()  # values that may be written
    name: str = ""  # in the file, where it is not that of the field
    # gives the field's value for one that a Python user wrote, of a name; or refuses it
    check: Callable[[str, Any], Any] | None = None


@cache
def keys_of(kind: type[Any]) -> dict[str, tuple[Key, object]]:
    """Return the keys of a kind of step with their defaults, MISSING for none, by its fields."""
    hints = get_type_hints(kind, include_extras=True)
    return {
        item.name: (
            next(each for each in hints[item.name].__metadata__ if isinstance(each, Key)),
            item.default if item.default_factory is MISSING else item.default_factory,
        )
        for item in fields(kind)
    }


def parameters(kind: Any, without: str = "") -> str:
    """Return the fields of a kind of step as a docstring lists them, angles in radians."""
    texts = {
        name: file_key.text.replace("°", "rad") for name, (file_key, _) in keys_of(kind).items()
    }
    lines = [f"{name}: {text[0].lower()}{text[1:]}." for name, text in texts.items()]
    return "\n".join(line for line in lines if not line.startswith(f"{without}:"))


# Checks of what Python users give; each takes the key for messages, and the value.


def of_shape(shape: tuple[int, ...], words: str) -> Callable[[str, object], Array]:
    """Return the check of finite numbers of a shape, which words describe."""

    def numbers(key: str, value: object) -> Array:
        array = as_array(value)
        value = value.tolist() if isinstance(value, np.ndarray) else value
        if array.shape != shape:
            raise InputError(key, value, words, "give plain numbers in SI units")
        if not np.all(np.abs(array) <= MAX_COORDINATE):  # nan neither
            bound = f"finite and within ±{MAX_COORDINATE:g} m"
            raise InputError(key, value, bound, "check the point's coordinates")
        array.setflags(write=False)
        return array

    return numbers


point = of_shape((3,), "a point [x, y, z]")


def seconds(key: str, value: object) -> float:
    """Return a duration [s], or raise InputError."""
    number = positive(key, value)
    check_unit(key, number, DURATION)
    return number


def auto_seconds(key: str, value: object) -> float | str:
    """Return a duration [s] or ``auto``, or raise InputError."""
    return AUTO if isinstance(value, str) and value == AUTO else seconds(key, value)


def altitude(key: str, value: object) -> float:
    """Return a height of a hitch [m], or raise InputError."""
    number = coordinate(key, value)
    check_unit(key, number, HEIGHT)
    return number


def one_of(words: Any) -> Callable[[str, Any], str]:
    """Return the check of a value that is one of the words of a Literal."""

    def checked(key: str, value: Any) -> str:
        choice(key, value, get_args(words))
        return str(value)

    return checked


MAX_TURNS = 5
"""Most turns of one step: a bounded number of polynomials would not follow more closely."""


def turned(key: str, value: object) -> float:
    """Return a turn [rad], or raise InputError for too many; warn of whole numbers."""
    yaw = finite(key, value)
    meant = f"if degrees were meant, {math.radians(yaw):.3g}"
    if abs(yaw) > MAX_TURNS * 2.0 * math.pi:
        bound = f"at most {MAX_TURNS} turns either way"
        raise InputError(key, yaw, bound, f"turn in several steps; {meant}")
    if abs(yaw) > 2.0 * math.pi and yaw == round(yaw):  # rarely of radians
        warn_of_unit(UnitWarning(key, f"{yaw:g} rad, more than a turn; {meant}"))
    return yaw


TURNS = Annotated[float, Field(ge=-360 * MAX_TURNS, le=360 * MAX_TURNS)]
_Auto = Auto | Annotated[Positive, Tag(ONE)]
AutoSeconds = Annotated[_Auto, FORM]
AutoSecondsOrNot = Annotated[_Auto | Annotated[Literal[False], Tag(FLAG)], FORM]
Seconds = Annotated[float | None, Key(Positive, DURATION_TEXT, check=seconds)]
Blend = Annotated[bool, Key(bool, "Go on into the next step without a stop", check=flag)]
LegsAtEnd = Annotated[SlackSplit | None, Key(Legs, f"{LEGS_TEXT}, at the step's end")]
WhichPoint = Annotated[int, Key(Index, "Which, from 0", (0,), check=partial(whole, least=0))]
ObjectOf = Annotated[str, Key(ObjectName, "Name of the object", ("box",))]
Place = Annotated[
    Array, Key(Point3, "Where its base goes, [x, y, z] [m]", ([1, 0, 0],), check=point)
]
Yaw = Annotated[
    float, Key(TURNS, "By how much it turns, counter-clockwise [°]", name="yaw_deg", check=turned)
]
Polygon = Annotated[Outline, Key(OutlinePoints, OUTLINE_TEXT, (TRIANGLE,))]


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
    # the object that the hitch is around or holds; ``hitch`` is then as if it carried nothing
    grasp: GraspState | None = None
    # where objects are by now; None where the problem has them
    objects: Mapping[str, SolidObject] | None = None

    @classmethod
    def formed(cls, hitch: Hitch) -> RestState:
        """Return the state of a hitch that exists at the start."""
        return cls(hitch.team, hitch.drones, hitch)

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
    """Stage of a hitch with an object."""

    FREE = "no object"
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
        for name, (key, default) in keys_of(type(self)).items():
            value = getattr(self, name)
            if key.check is not None and (value is not None or default is not None):
                object.__setattr__(self, name, key.check(name, value))

    @classmethod
    def from_file(cls, values: dict[str, Any]) -> Self:
        """Return the step with the values of a problem file, in which angles are in degrees."""
        return cls(
            **{
                key.removesuffix("_deg"): math.radians(value) if key.endswith("_deg") else value
                for key, value in values.items()
            }
        )

    @property
    def given_duration(self) -> float | None:
        """The duration that was given [s], or None."""
        seconds = getattr(self, self.time_key, None)
        return seconds if isinstance(seconds, float) else None

    @property
    def blends(self) -> bool:
        """Whether it goes on into the next step without a stop."""
        return bool(getattr(self, "blend", False))

    def resolved_for(self, team: Team) -> Self:
        """Return the step for a team: polygon as an outline, legs as an array."""
        polygon, legs = (vars(self).get(key) for key in ("polygon", "legs"))
        changed: dict[str, Any] = {}
        if polygon is not None:
            changed["polygon"] = checked_polygon(team, polygon)
        if legs is not None:
            changed["legs"] = slack_split(legs, team)
        return replace(self, **changed) if changed else self

    def checked_polygon_after(self, team: Team, outline: Outline | None) -> Outline | None:
        """Return ``polygon_after`` if the step fits the hitch before it, else raise InputError."""
        if self.needs_hitch is True and outline is None:
            raise InputError("", "no hitch", "given a hitch at that point", "form one before")
        if self.needs_hitch is False and outline is not None:
            bound = "given drones on free cables at that point"
            raise InputError("", "a hitch", bound, "release it before")
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
