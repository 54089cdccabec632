"""The problem file key by key, its JSON Schema, and messages of invalid files.

What one value alone cannot tell (a polygon's shape, one entry per robot) is checked by the records
that ``loading`` makes of these models. Those of steps are made from the steps' own fields.
"""

from __future__ import annotations

import difflib
import json
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import MISSING
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import ConfigDict, Field, Tag, ValidationError, create_model, model_validator
from pydantic.json_schema import GenerateJsonSchema, models_json_schema

from hitchopt.errors import InputError, one_or_all
from hitchopt.hitch import Quadrotor
from hitchopt.hitch.flight_controller import CONTROLLERS
from hitchopt.hitch.requirements import Limits, Separation
from hitchopt.hitch.team import MAX_DRONES, MAX_ROBOTS
from hitchopt.steps import STEPS, Step
from hitchopt.steps.step import (
    EACH,
    FAULT,
    FLAG,
    FORM,
    LEGS_TEXT,
    MAPPING,
    MIN_QUANTITY,
    ONE,
    OUTLINE_TEXT,
    TRIANGLE,
    WORD,
    Keys,
    Legs,
    NotNegative,
    Number,
    ObjectName,
    OneOrEach,
    OutlinePoints,
    PerClasp,
    PerRobot,
    Point2,
    Point3,
    Positive,
    RobotsList,
    TwoGains,
    fault,
    key,
    keys_of,
)
from hitchopt.storage.yaml_file import key_path

MAX_TITLE, MAX_STEPS, MAX_OBJECTS, MAX_PRISMS, MAX_CORNERS = 200, 1000, 100, 1000, 1000
"""Characters of a title; steps, objects and prisms of a problem; corners of one outline."""


def section(model: type[Keys]) -> Any:
    """Return the field of a mapping that has its model's own defaults unless it is given."""
    return key(str(model.__doc__), default_factory=model)


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
        if isinstance(data, dict) and len(data) != 1:
            keys = ", ".join(cls.model_fields)
            raise fault(f"a mapping with exactly one of the keys {keys}", f"write {cls.example}")
        for name, value in data.items() if isinstance(data, dict) else ():
            if value is None and name in cls.model_fields:
                raise fault(f"a mapping, also after {name}", f"write {name}: {{…}} with its keys")
        return data


Gain = OneOrEach[NotNegative, TwoGains] | None


class GainsKeys(Keys):
    """Gains of the position loop, one for all axes or [level, upright]; null: the default."""

    kp: Gain = key("Force by offset [N/m]", None)
    kd: Gain = key("Force by velocity [N s/m]", None)
    ki: Gain = key("Force by offset and time [N/(m s)]", None)


class QuadrotorKeys(Keys):
    """One kind of quadrotor."""

    mass: Positive = key("Mass [kg]", Quadrotor.mass)
    max_thrust: Positive = key("Largest collective thrust [N]", Quadrotor.max_thrust)
    stiffness: Positive | None = key("Of the position loop [N/m]; null: rigid", Quadrotor.stiffness)
    integral: bool | None = key(
        "Whether position errors are driven to zero; null: false", Quadrotor.integral
    )
    feed_forward: bool | None = key(
        "Whether cable forces of set points are added; null: true", Quadrotor.feed_forward
    )
    controller: Literal[CONTROLLERS] | None = key(  # type: ignore[valid-type]
        "Flight controller, from which these three follow", Quadrotor.controller
    )
    gains: GainsKeys | None = key("Its gains; null: its defaults", Quadrotor.gains)


OneKind = Annotated[QuadrotorKeys, Tag(MAPPING)]


class TeamKeys(Keys):
    """The team: drones, cables and tensions."""

    robots: int = key(
        "Number of cables; each has two quadrotors", ge=2, le=MAX_ROBOTS, examples=[3]
    )
    topology: Literal["closed", "open"] = key("closed: a polygon; open: a convex arc", "closed")
    cable_length: PerRobot[Positive] = key("[m], one for all or one per robot", examples=[2.4])
    cable_density: NotNegative = key("Mass per length [kg/m]", 0.0)
    load: PerClasp = key("What hangs at the clasps [kg], one for all or one per clasp", 0.0)
    cable_friction: NotNegative = key("Coefficient of friction at the clasps", 0.0)
    tension: PerRobot[Positive] = key("Of the cables [N], one for all or one per robot", 0.4)
    quadrotor: Annotated[OneKind | Annotated[RobotsList[QuadrotorKeys], Tag(EACH)], FORM] = key(
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
    body_rate_deg: Positive | None = key("Turning rate of the thrust [°/s]; null: any", None)
    duration: Positive | None = key("Of the whole plan [s], or null for no limit", Limits.duration)
    reserve: Annotated[float, Field(ge=MIN_QUANTITY, le=1.0)] = key(
        "Share of acceleration and jerk that the plan uses; below 1 stops can begin at every time",
        Limits.reserve,
    )
    tracking: NotNegative | None = key(
        "How far all drones may be off at once [m]; null: the controllers' own, if named",
        Limits.tracking,
    )


class LimitsKeys(MotionLimitsKeys):
    """Limits of a hitch; all norms are Euclidean."""

    vertex_speed: Positive = key("How fast a vertex of the hitch may go [m/s]", Limits.vertex_speed)
    leg: Positive = key("Shortest leg, vertex to drone, while the hitch holds [m]", Limits.leg)


class EllipsoidKeys(Keys):
    """The ellipsoids that must not overlap."""

    radius: Positive = key("Horizontal semi-axis, and distance to prisms [m]", Separation.radius)
    height: Positive = key("Vertical semi-axis of a drone's ellipsoid [m]", Separation.height)


class SeparationKeys(EllipsoidKeys):
    """Distances to keep."""

    cable: NotNegative = key("Drone to other cables and to its own edge [m]", Separation.cable)
    crossing: NotNegative = key(
        "Taut parts of cables without a common clasp [m]", Separation.crossing
    )
    object: NotNegative = key("Cables, and a held object, to objects [m]", Separation.object)


class ArenaKeys(Keys):
    """The box that the drones stay in."""

    lower: Point3 = key("Corner with the least x, y, z [m]", examples=[[-4, -4, 0]])
    upper: Point3 = key("Corner with the greatest x, y, z [m]", examples=[[4, 4, 3]])


class HitchKeys(Keys):
    """A formed hitch."""

    polygon: OutlinePoints = key(OUTLINE_TEXT, examples=[TRIANGLE])
    altitude: Number = key("Height of the hitch's plane [m]", 1.0)
    legs: Legs = key(LEGS_TEXT, "spread")


class DronesKeys(Keys):
    """Start of the drones of a hitch that is to be formed."""

    q: RobotsList[Point3] = key("One [x, y, z] [m] per robot", examples=[[[0, 0, 1], [1, 0, 1]]])
    r: RobotsList[Point3] = key("One [x, y, z] [m] per robot", examples=[[[0, 1, 1], [1, 1, 1]]])


class StartKeys(OneKey):
    """Start of the plan."""

    example: ClassVar[str] = "hitch: {polygon: [[x, y], …], altitude: 1.0}"
    hitch: HitchKeys | None = key("A formed hitch, at rest", None)
    drones: DronesKeys | None = key("Drones of a hitch that is to be formed, at rest", None)


Corners = Annotated[list[Point2], Field(min_length=3, max_length=MAX_CORNERS)]
CORNERS_TEXT = "Corners [x, y] [m] of a convex outline, in either sense"


class SectionKeys(Keys):
    """A convex section."""

    outline: Corners | None = key(CORNERS_TEXT, None)
    circle: Positive | None = key("Radius [m] of a circle", None)

    @model_validator(mode="before")
    @classmethod
    def _check_shape(cls, data: object) -> object:
        names = [name for name in ("outline", "circle", "file") if name in cls.model_fields]
        if isinstance(data, dict) and sum(data.get(name) is not None for name in names) != 1:
            words = f"a mapping with exactly one of {', '.join(names)}"
            raise fault(words, "write circle: 0.2, for example")
        return data


class RimKeys(SectionKeys):
    """A rim or tray that may rest on cables."""

    at: Number = key("Height above the object's base [m]", 0.2)


class ObjectKeys(SectionKeys):
    """An upright object, carried or an obstacle."""

    file: Annotated[str, Field(min_length=1, max_length=1000)] | None = key(
        "Drawing of its outline, in metres, relative to this file", None
    )
    from_: Number = key("Height of its floor above its base [m]", 0.0, alias="from")
    to: Number = key("Height of its ceiling above its base [m]", 0.3)
    mass: Positive = key("Mass [kg]", 0.1)
    friction: NotNegative = key("Coefficient of friction, with cables", 0.5)
    at: Point3 = key("Where the origin of its base stands [m]", examples=[[1, 0, 0]])
    yaw_deg: Number = key("By how much it is turned there, counter-clockwise [°]", 0.0)
    rim: RimKeys | None = key(str(RimKeys.__doc__), None)
    fixed: bool = key("Whether it never moves, as tables do", False)


def step_model(kind: type[Step]) -> type[Keys]:
    """Return the model of a step's keys, made from the annotations of its fields."""
    entries: dict[str, Any] = {}
    for name, (file_key, default) in keys_of(kind).items():
        options: dict[str, Any] = {"examples": list(file_key.examples)} if file_key.examples else {}
        if isinstance(default, type):  # a record, which has its own keys
            options["default_factory"] = file_key.kind
        entries[file_key.name or name] = (
            file_key.kind | None if default is None else file_key.kind,
            key(file_key.text, ... if default is MISSING else default, **options),
        )
    return create_model(f"{kind.__name__}Keys", __base__=Keys, __doc__=summary(kind), **entries)


def summary(kind: type[Step]) -> str:
    """Return the summary of a kind of step: the first line of its docstring."""
    return str(kind.__doc__).partition("\n")[0]


STEP_KINDS = {kind.name: kind for kind in STEPS}
"""Kinds of steps by their keys in a problem file."""


class _Step(OneKey):
    """One step of the mission."""

    example: ClassVar[str] = "one step per list entry, such as hold: {seconds: 1.0}"


StepKeys = create_model(
    "StepKeys",
    __base__=_Step,
    __doc__=_Step.__doc__,
    **{kind.name: (step_model(kind) | None, key(summary(kind), None)) for kind in STEPS},
)  # type: ignore[call-overload]


class ProblemKeys(Keys):
    """Problem file of hitchopt: a team of quadrotors, a cable hitch, and what to do with it."""

    title: str = key("What to call the plan", "", max_length=MAX_TITLE)
    team: TeamKeys = key(str(TeamKeys.__doc__), examples=[{"robots": 3, "cable_length": 2.4}])
    limits: LimitsKeys = section(LimitsKeys)
    separation: SeparationKeys = section(SeparationKeys)
    arena: ArenaKeys | None = key(str(ArenaKeys.__doc__), None)
    objects: Annotated[dict[ObjectName, ObjectKeys], Field(max_length=MAX_OBJECTS)] = key(
        "Carried objects and obstacles, by name", default_factory=dict
    )
    start: StartKeys = key(
        str(StartKeys.__doc__), examples=[{"hitch": {"polygon": TRIANGLE, "altitude": 1.0}}]
    )
    mission: Annotated[list[StepKeys], Field(min_length=1, max_length=MAX_STEPS)] = key(  # type: ignore[valid-type]
        "Steps, one after the other", examples=[[{"hold": {"seconds": 1.0}}]]
    )


Points = Annotated[list[Point3], Field(min_length=1, max_length=MAX_DRONES)]
Kinds = Annotated[list[QuadrotorKeys], Field(min_length=1, max_length=MAX_DRONES)]


class SwarmTeamKeys(Keys):
    """The team of single drones without cables."""

    drones: int = key("Number of drones", ge=1, le=MAX_DRONES, examples=[2])
    quadrotor: Annotated[OneKind | Annotated[Kinds, Tag(EACH)], FORM] = key(
        "Kind of quadrotor, one for all or a list of one per drone", default_factory=QuadrotorKeys
    )


class PrismKeys(Keys):
    """An upright prism that the drones stay out of."""

    polygon: Corners = key(
        "Corners [x, y] [m] of a convex outline, clockwise seen from above",
        examples=[[[0, 0], [0, 1], [1, 1]]],
    )
    lower: Number = key("Altitude of its floor [m]", examples=[0.0])
    upper: Number = key("Altitude of its ceiling [m]", examples=[3.0])


class SwarmKeys(Keys):
    """Problem file of hitchopt: single drones that trade places out of each other's downwash."""

    title: str = key("What to call the plan", "", max_length=MAX_TITLE)
    team: SwarmTeamKeys = key(str(SwarmTeamKeys.__doc__), examples=[{"drones": 2}])
    limits: MotionLimitsKeys = section(MotionLimitsKeys)
    separation: EllipsoidKeys = section(EllipsoidKeys)
    arena: ArenaKeys | None = key(str(ArenaKeys.__doc__), None)
    keep_out: Annotated[list[PrismKeys], Field(max_length=MAX_PRISMS)] = key(
        "Prisms that the drones stay out of", default_factory=list
    )
    objects: Annotated[dict[ObjectName, ObjectKeys], Field(max_length=MAX_OBJECTS)] = key(
        "Obstacles, by name", default_factory=dict
    )
    start: Points = key(
        "Where the drones are at rest, one [x, y, z] [m] per drone",
        examples=[[[-1, 0, 1], [1, 0, 1]]],
    )
    goal: Points = key(
        "Where they come to rest, in the same order [m]", examples=[[[1, 0, 1], [-1, 0, 1]]]
    )
    duration: Positive | None = key("Exactly that long [s]; without it as fast as is found", None)


# The JSON Schema, and messages of errors.

SCHEMA_FILE = Path(__file__).with_name("problem.schema.json")
"""File of the schema in the package."""

Schema = dict[str, Any]


class _Untitled(GenerateJsonSchema):
    """A generator without titles that only repeat a key's or a model's name."""

    def field_title_should_be_set(self, schema: Any) -> bool:  # noqa: ARG002
        return False


def problem_schema() -> Schema:
    """Return the JSON Schema (draft 2020-12) of a problem file: of a hitch, or of single drones."""
    kinds: tuple[type[Keys], ...] = (ProblemKeys, SwarmKeys)
    _, schema = models_json_schema(
        [(model, "validation") for model in kinds], schema_generator=_Untitled
    )
    for definition in schema["$defs"].values():
        del definition["title"]
    forms = [{"$ref": f"#/$defs/{model.__name__}"} for model in kinds]
    dialect = "https://json-schema.org/draft/2020-12/schema"
    return {"$schema": dialect, "title": "hitchopt problem file", "anyOf": forms, **schema}


def schema_text() -> str:
    """Return the JSON Schema as the package's file holds it."""
    return json.dumps(problem_schema(), indent=2, ensure_ascii=False) + "\n"


def _properties_at(schema: Schema, path: Sequence[str | int]) -> dict[str, Schema]:
    """Return the keys that the mapping at a path may have, with what the schema says of each."""
    forms = list(_forms(schema, schema))
    for part in path:
        inner = [
            form["items"] if isinstance(part, int) else _under(form, part)
            for form in forms
            if ("items" in form if isinstance(part, int) else form.get("type") == "object")
        ]
        forms = [form for entry in inner for form in _forms(schema, entry)]
    return {key: each for form in forms for key, each in form.get("properties", {}).items()}


def _under(form: Schema, key: str) -> Schema:
    """Return the schema of a key, or of all names that users give."""
    others = [*form.get("patternProperties", {}).values(), form.get("additionalProperties")]
    subschema: Schema = form.get("properties", {}).get(key) or others[0] or {}
    return subschema


def _forms(schema: Schema, entry: Schema) -> Iterator[Schema]:
    """Yield the schemas that an entry may follow."""
    if "$ref" in entry:
        entry = schema["$defs"][entry["$ref"].rsplit("/", 1)[1]]
    choices = [*entry.get("oneOf", ()), *entry.get("anyOf", ())]
    for choice in choices:
        yield from _forms(schema, choice)
    if not choices:
        yield entry


class _Missing:
    """Stands for the value of a key that is not there."""

    def __repr__(self) -> str:
        return "(missing)"


NUMBER = "give a plain number in SI units"

WORDS = {
    "int_type": ("a whole number", "write it without a fraction"),
    "int_parsing_size": ("a smaller number", NUMBER),
    "float_type": ("a number", NUMBER),
    "string_type": ("text", "put it in quotes if it is meant as text"),
    "bool_type": ("true or false", "write true or false"),
    "list_type": ("a list", "write a list in brackets"),
    "dict_type": ("a mapping", "write its keys indented below it, or in braces"),
    "finite_number": ("finite", "nan and inf are no quantities; give a plain number"),
    "string_pattern_mismatch": ("of letters, digits, spaces, - and _", "use another name"),
    "string_too_short": ("a text", "write at least one character"),
    "string_too_long": ("at most {max_length} characters long", "shorten it"),
    "too_short": ("a list of at least {min_length} entries", "make it longer"),
    "too_long": ("a list of at most {max_length} entries", "shorten it"),
    "greater_than": ("above {gt:g}", "give a larger number"),
    "greater_than_equal": ("at least {ge:g}", "give a larger number"),
    "less_than": ("below {lt:g}", "give a smaller number"),
    "less_than_equal": ("at most {le:g}", "give a smaller number"),
    FAULT: ("{bound}", "{remedy}"),
}
"""Bound and remedy of pydantic's types of errors, filled with their contexts."""

ALIKE = {"int_from_float": "int_type", "model_type": "dict_type", "int_parsing": "int_type"}
"""Types of errors that share the message of others."""


def translated(error: ValidationError, model: type[Keys] = ProblemKeys) -> InputError:
    """Return pydantic's errors in a file of one of the kinds as InputError."""
    schema = model.model_json_schema(schema_generator=_Untitled)
    return one_or_all([_translated(entry, schema) for entry in error.errors(include_url=False)])


def _translated(entry: Any, schema: Schema) -> InputError:
    """Return one of pydantic's errors as an InputError."""
    forms = {ONE, EACH, WORD, MAPPING, FLAG}
    path = [part for part in entry["loc"] if part not in forms]
    kind, value, context = entry["type"], entry["input"], entry.get("ctx", {})
    kind = ALIKE.get(kind, kind)
    if isinstance(value, float) and not math.isfinite(value):
        kind = "finite_number"
    if kind == "missing":
        value, example = _Missing(), _properties_at(schema, path[:-1])[path[-1]].get("examples")
        shown = json.dumps(example[0]).replace('"', "") if example else "…"
        bound, remedy = "given", f"add {path[-1]}: {shown}"
    elif kind == "extra_forbidden":
        known = list(_properties_at(schema, path[:-1]))
        bound, remedy = "a known key", _closest_word(str(path[-1]), known)
    elif kind == "literal_error":
        bound = context["expected"].replace("'", "")
        remedy = _closest_word(str(value), bound.replace(" or ", ", ").split(", "))
    elif kind == "union_tag_invalid":
        bound = context["expected_tags"].strip("'").replace("', '", " or ")
        remedy = NUMBER if ONE in bound else f"write {bound}"
    else:
        bound, remedy = (words.format(**context) for words in WORDS[kind])
    if kind == "greater_than_equal" and context["ge"] == MIN_QUANTITY and value <= 0:
        bound, remedy = "greater than 0", "give a positive number"
    elif value is None:
        remedy = "remove the key, or write its value after it"
    elif ONE in bound and isinstance(value, str) and re.fullmatch(r"[-+.\deE]+", value):
        remedy = "remove the quotes"
    elif path[-1:] == ["by"] and isinstance(value, int | float):
        remedy = f"{remedy}; a height belongs to lift: {value:g}"
    return InputError(key_path(path) or "problem", value, bound, remedy)


def _closest_word(word: str, known: Sequence[str]) -> str:
    """Return the closest valid word, else all of them."""
    close = difflib.get_close_matches(word[:60], known, n=1, cutoff=0.5)
    return f"did you mean {close[0]}?" if close else f"use one of {', '.join(known)}"


if __name__ == "__main__":
    SCHEMA_FILE.write_text(schema_text(), encoding="utf-8")
