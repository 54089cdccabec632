"""The problem file key by key: types, counts, signs and defaults of single values.

What one value alone cannot tell (a polygon's shape, one entry per robot) is checked by the records
that ``loading`` makes of these models.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator
from pydantic_core import PydanticCustomError

from hitchopt.hitch import Quadrotor
from hitchopt.hitch.team import MAX_ROBOTS
from hitchopt.requirements import Limits, Separation
from hitchopt.steps.keys import LEGS_TEXT, OUTLINE_TEXT, SHARING_TEXT, TRIANGLE

MIN_QUANTITY = 1e-9
"""Smallest quantity, in SI units: smaller ones are typing errors and would only underflow."""

MAX_QUANTITY = 1e9
"""Largest quantity, in SI units: larger ones are typing errors and would only overflow."""

MAX_STEPS = 1000
"""Steps of one mission."""

MAX_TITLE = 200
"""Characters of a title."""

FAULT = "hitchopt"
"""Type of the errors that carry their own ``bound`` and ``remedy``."""

ONE, EACH, WORD, MAPPING = "<one>", "<each>", "<word>", "<mapping>"
"""Tags of the forms of a value: once for all robots, one per robot, as a word, as a mapping."""


def one_or_each(value: object) -> str:
    """Return the tag of a value that is given once, or as a list of one per robot."""
    return EACH if isinstance(value, list) else ONE


def word_one_or_each(value: object) -> str:
    """Return the tag of a value that is a word, given once, or a list."""
    return WORD if isinstance(value, str) else one_or_each(value)


def legs_form(value: object) -> str:
    """Return the tag of legs that are a word, a list, or a mapping."""
    return MAPPING if isinstance(value, dict | Keys) else one_or_each(value)


def fault(bound: str, remedy: str) -> PydanticCustomError:
    """Return an error that carries its own words."""
    return PydanticCustomError(FAULT, "{bound}; {remedy}", {"bound": bound, "remedy": remedy})


Number = Annotated[float, Field(ge=-MAX_QUANTITY, le=MAX_QUANTITY)]
Positive = Annotated[float, Field(ge=MIN_QUANTITY, le=MAX_QUANTITY)]
NotNegative = Annotated[float, Field(ge=0.0, le=MAX_QUANTITY)]
Roll = Annotated[float, Field(gt=-90.0, lt=90.0)]
Index = Annotated[int, Field(ge=0, lt=MAX_ROBOTS)]
Point2 = Annotated[list[Number], Field(min_length=2, max_length=2)]
Point3 = Annotated[list[Number], Field(min_length=3, max_length=3)]
TimedPoint = Annotated[list[Number], Field(min_length=3, max_length=3)]
Outline = Annotated[list[Point2], Field(min_length=3, max_length=MAX_ROBOTS + 1)]
T = TypeVar("T")
M = TypeVar("M")
OneOrEach = Annotated[Annotated[T, Tag(ONE)] | Annotated[M, Tag(EACH)], Discriminator(one_or_each)]
RobotsList = Annotated[list[T], Field(min_length=2, max_length=MAX_ROBOTS)]
ClaspsList = Annotated[list[T], Field(min_length=1, max_length=MAX_ROBOTS)]
PerRobot = OneOrEach[T, RobotsList[T]]
PerClasp = OneOrEach[NotNegative, ClaspsList[NotNegative]]
Sharing = OneOrEach[Literal["balanced", "spread"], RobotsList[NotNegative]]


class Keys(BaseModel):
    """A mapping of known keys; models are built when they are first used."""

    model_config = ConfigDict(
        strict=True, extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True
    )


def key(text: str, default: Any = ..., **options: Any) -> Any:
    """Return the field of a key that the text describes; it is required without a default."""
    given = options if "default_factory" in options else {"default": default, **options}
    return Field(description=text, **given)


def section(model: type[Keys]) -> Any:
    """Return the field of a mapping that has its model's own defaults unless it is given."""
    return key(str(model.__doc__), default_factory=model)


class RolledLegsKeys(Keys):
    """Legs that are rolled out of their plane."""

    sharing: Sharing = key(SHARING_TEXT, "spread")
    roll_deg: Annotated[
        Annotated[Literal["auto"], Tag(WORD)]
        | Annotated[Roll, Tag(ONE)]
        | Annotated[ClaspsList[Roll], Tag(EACH)],
        Discriminator(word_one_or_each),
    ] = key(
        "Roll of the legs about their clasps [°], q up and r down, one for all or one "
        "per clasp; auto: none unless legs without it break a limit",
        "auto",
    )


Legs = Annotated[
    Annotated[Literal["balanced", "spread"], Tag(ONE)]
    | Annotated[RobotsList[NotNegative], Tag(EACH)]
    | Annotated[RolledLegsKeys, Tag(MAPPING)],
    Discriminator(legs_form),
]

ObjectName = Annotated[str, Field(min_length=1, max_length=50, pattern=r"^[A-Za-z0-9_ -]+$")]
"""What an object may be called."""

KINDS: dict[str, Any] = {
    "Angle": float,
    "Flag": bool,
    "Index": Index,
    "Name": ObjectName,
    "Legs": Legs,
    "Number": Number,
    "Outline": Outline,
    "Point2": Point2,
    "Point3": Point3,
    "Positive": Positive,
    "TimedPath": Annotated[list[TimedPoint], Field(min_length=1)],
    "TwoPoints": Annotated[list[Point2], Field(min_length=2, max_length=2)],
}
"""Types of the keys of steps, by the names that ``hitchopt.steps.keys.Key`` gives them."""


def _without_null(schema: dict[str, Any]) -> None:
    """Show in the JSON Schema that exactly one key is given, and not as null."""
    schema["minProperties"] = schema["maxProperties"] = 1
    for name, entry in schema["properties"].items():
        choices = [choice for choice in entry.pop("anyOf") if choice.get("type") != "null"]
        entry.pop("default", None)
        schema["properties"][name] = {**choices[0], **entry}


class OneKey(Keys):
    """A mapping with exactly one of its keys."""

    model_config = ConfigDict(json_schema_extra=_without_null)
    example: ClassVar[str]

    @model_validator(mode="before")
    @classmethod
    def _check_one_key(cls, data: object) -> object:
        if isinstance(data, dict):
            if len(data) != 1:
                raise fault(
                    f"a mapping with exactly one of the keys {', '.join(cls.model_fields)}",
                    f"write {cls.example}",
                )
            ((key, value),) = data.items()
            if value is None and key in cls.model_fields:
                raise fault(f"a mapping, also after {key}", f"write {key}: {{…}} with its keys")
        return data


class QuadrotorKeys(Keys):
    """One kind of quadrotor."""

    mass: Positive = key("Mass [kg]", Quadrotor.mass)
    max_thrust: Positive = key("Largest collective thrust [N]", Quadrotor.max_thrust)
    stiffness: Positive | None = key(
        "Stiffness of the position loop [N/m], or null for a rigid one", Quadrotor.stiffness
    )
    integral: bool = key(
        "Whether the controller drives the position error to zero", Quadrotor.integral
    )
    feed_forward: bool = key(
        "Whether the controller adds the cable force that set points hold", Quadrotor.feed_forward
    )


class TeamKeys(Keys):
    """Who flies, on which cables, pulling how hard."""

    robots: int = key(
        "Number of catenary robots, that is of cables; each has two quadrotors",
        ge=2,
        le=MAX_ROBOTS,
        examples=[3],
    )
    topology: Literal["closed", "open"] = key(
        "closed: a polygon; open: a chain along a convex arc", "closed"
    )
    cable_length: PerRobot[Positive] = key(
        "Length of the cables [m], one for all or one per robot", examples=[2.4]
    )
    cable_density: NotNegative = key("Mass per length [kg/m]", 0.0)
    load: PerClasp = key(
        "What hangs at the clasps [kg], one for all, or one per vertex of a polygon "
        "and inner point of a chain",
        0.0,
    )
    cable_friction: NotNegative = key(
        "Friction at the clasps, a coefficient: legs lean against it as cables slide", 0.0
    )
    tension: PerRobot[Positive] = key(
        "Tension of the cables [N], one for all or one per robot", 0.4
    )
    quadrotor: PerRobot[QuadrotorKeys] = key(
        "Kind of quadrotor, one for all or a list of one per robot", default_factory=QuadrotorKeys
    )


class MotionLimitsKeys(Keys):
    """Limits of what drones do, with cables or without; all norms are Euclidean."""

    speed: Positive = key("Of every drone [m/s]", Limits.speed)
    acceleration: Positive = key("Of every drone [m/s²]", Limits.acceleration)
    jerk: Positive = key("Of every drone [m/s³]", Limits.jerk)
    tilt_deg: Annotated[float, Field(ge=MIN_QUANTITY, lt=90.0)] = key(
        "Largest angle of the thrust from vertical [°]", 45.0
    )
    body_rate_deg: Positive | None = key(
        "Largest turning rate of the thrust [°/s], or null for no limit", None
    )
    duration: Positive | None = key("Of the whole plan [s], or null for no limit", Limits.duration)
    reserve: Annotated[float, Field(ge=MIN_QUANTITY, le=1.0)] = key(
        "Share of acceleration and jerk that the plan uses; below 1 stops can begin at every time",
        Limits.reserve,
    )


class LimitsKeys(MotionLimitsKeys):
    """Limits of a hitch; all norms are Euclidean."""

    vertex_speed: Positive = key("How fast a vertex of the hitch may go [m/s]", Limits.vertex_speed)
    leg: Positive = key("Shortest leg, vertex to drone, while the hitch holds [m]", Limits.leg)


class EllipsoidKeys(Keys):
    """The ellipsoids that must not overlap."""

    radius: Positive = key(
        "Horizontal semi-axis of a drone's ellipsoid, and its distance to prisms [m]",
        Separation.radius,
    )
    height: Positive = key("Vertical semi-axis of a drone's ellipsoid [m]", Separation.height)


class SeparationKeys(EllipsoidKeys):
    """Distances to keep."""

    cable: NotNegative = key(
        "Drone to any cable but its own, and to its own edge [m]", Separation.cable
    )
    crossing: NotNegative = key(
        "Cable to cable where they share no clasp, taut parts [m]", Separation.crossing
    )
    object: NotNegative = key(
        "A cable's centre line, and a held object, to objects [m]", Separation.object
    )


class ArenaKeys(Keys):
    """The box that the drones stay in."""

    lower: Point3 = key("Corner with the least x, y, z [m]", examples=[[-4, -4, 0]])
    upper: Point3 = key("Corner with the greatest x, y, z [m]", examples=[[4, 4, 3]])


class HitchKeys(Keys):
    """A formed hitch."""

    polygon: Outline = key(OUTLINE_TEXT, examples=[TRIANGLE])
    altitude: Number = key("Height of the hitch's plane [m]", 1.0)
    legs: Legs = key(LEGS_TEXT, "spread")


class DronesKeys(Keys):
    """Where the drones are of a hitch that is to be formed."""

    q: Annotated[list[Point3], Field(min_length=2, max_length=MAX_ROBOTS)] = key(
        "Drones q, one [x, y, z] [m] per robot", examples=[[[0, 0, 1], [1, 0, 1]]]
    )
    r: Annotated[list[Point3], Field(min_length=2, max_length=MAX_ROBOTS)] = key(
        "Drones r, one [x, y, z] [m] per robot", examples=[[[0, 1, 1], [1, 1, 1]]]
    )


class StartKeys(OneKey):
    """Where the plan starts."""

    example: ClassVar[str] = "hitch: {polygon: [[x, y], …], altitude: 1.0}"
    hitch: HitchKeys | None = key("A formed hitch, at rest", None)
    drones: DronesKeys | None = key("Drones of a hitch that is to be formed, at rest", None)
