"""Keys of a problem file: their types, and how a step's fields say what they are there."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from functools import cache, partial
from typing import Annotated, Any, Final, Literal, TypeVar, get_args, get_type_hints

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag
from pydantic_core import PydanticCustomError

from hitchopt.errors import InputError, UnitWarning
from hitchopt.geometry import Outline
from hitchopt.hitch import Team
from hitchopt.hitch.hitch import checked_roll
from hitchopt.hitch.team import MAX_ROBOTS
from hitchopt.values import (
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
"""Forms of a value, as messages call them; tags of what a key takes in several forms."""


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
"""Word for what is chosen: a duration, or a roll that is none unless limits need it."""


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
    """Return what a user wrote for ``legs``, checked.

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
    texts = {name: said.text.replace("°", "rad") for name, (said, _) in keys_of(kind).items()}
    lines = [f"{name}: {text[0].lower()}{text[1:]}." for name, text in texts.items()]
    return "\n".join(line for line in lines if not line.startswith(f"{without}:"))


# Checks of what Python users give; each takes the key for messages, and the value.


def of_shape(shape: tuple[int | None, ...], words: str) -> Callable[[str, object], Array]:
    """Return the check of finite numbers of a shape, None for one or more; words describe it."""

    def numbers(key: str, value: object) -> Array:
        array = as_array(value)
        fits = array.ndim == len(shape) and all(
            size == wanted if wanted is not None else size > 0
            for size, wanted in zip(array.shape, shape, strict=True)
        )
        value = value.tolist() if isinstance(value, np.ndarray) else value
        if not fits:
            raise InputError(key, value, words, "give plain numbers in SI units")
        if not np.all(np.isfinite(array)):
            raise InputError(key, value, "finite", "nan and inf are no quantities")
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
