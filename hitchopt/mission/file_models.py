"""The models of a whole problem file; those of its steps are made from the steps' own keys."""

from __future__ import annotations

from dataclasses import MISSING, Field, fields
from typing import Annotated, Any, ClassVar, Literal, cast, get_type_hints

from pydantic import Field as FileField
from pydantic import create_model

from hitchopt.mission.object_keys import MAX_OBJECTS, ObjectKeys
from hitchopt.mission.schema import (
    KINDS,
    MAX_STEPS,
    MAX_TITLE,
    ArenaKeys,
    Keys,
    LimitsKeys,
    ObjectName,
    OneKey,
    SeparationKeys,
    StartKeys,
    TeamKeys,
    key,
    section,
)
from hitchopt.steps import STEPS, Step
from hitchopt.steps.keys import REQUIRED, TRIANGLE, Key, Section


def _model(name: str, text: str, keys: dict[str, tuple[Key, object]]) -> type[Keys]:
    """Return the model with keys by name, each with its default."""
    entries: dict[str, Any] = {
        key: _entry(value, default) for key, (value, default) in keys.items()
    }
    return create_model(name, __base__=Keys, __doc__=text, **entries)


def _entry(key: Key, default: object) -> tuple[Any, Any]:
    kind: Any
    options: dict[str, Any] = {"description": key.text, **key.bounds}
    if isinstance(key.kind, Section):
        section = key.kind
        inner = {name: (value, value.default) for name, value in section.keys.items()}
        kind = _model(section.name, section.text, inner)
        if default is not None:
            options["default_factory"] = kind
    else:
        named = isinstance(key.kind, str)
        kind = KINDS[cast("str", key.kind)] if named else Literal[key.kind]
        if default is not REQUIRED:
            options["default"] = default
    if default is None:
        kind, options["default"] = kind | None, None
    if key.examples:
        options["examples"] = list(key.examples)
    return kind, FileField(**options)


def step_model(kind: type[Step]) -> type[Keys]:
    """Return the model of a step's keys, made from the annotations of its fields."""
    hints = get_type_hints(kind, include_extras=True)
    keys = {
        key.name or field.name: (key, _default(field))
        for field in fields(kind)
        for key in hints[field.name].__metadata__
    }
    return _model(f"{kind.__name__}Keys", str(kind.__doc__).partition("\n")[0], keys)


def _default(field: Field[Any]) -> object:
    has_none = field.default is MISSING and field.default_factory is MISSING
    return REQUIRED if has_none else field.default


STEP_KINDS = {kind.name: kind for kind in STEPS}
"""Kinds of steps by their keys in a problem file."""


class _Step(OneKey):
    """One step of the mission."""

    example: ClassVar[str] = "one step per list entry, such as hold: {seconds: 1.0}"


StepKeys = create_model(
    "StepKeys",
    __base__=_Step,
    __doc__=_Step.__doc__,
    **{
        kind.name: (step_model(kind) | None, FileField(default=None, description=kind.summary))
        for kind in STEPS
    },
)  # type: ignore[call-overload]


class ProblemKeys(Keys):
    """Problem file of hitchopt: a team of quadrotors, a cable hitch, and what to do with it."""

    title: str = key("What to call the plan", "", max_length=MAX_TITLE)
    team: TeamKeys = key(str(TeamKeys.__doc__), examples=[{"robots": 3, "cable_length": 2.4}])
    limits: LimitsKeys = section(LimitsKeys)
    separation: SeparationKeys = section(SeparationKeys)
    arena: ArenaKeys | None = key(str(ArenaKeys.__doc__), None)
    objects: Annotated[dict[ObjectName, ObjectKeys], FileField(max_length=MAX_OBJECTS)] = key(
        "Objects that are carried or stand in the way, by name", default_factory=dict
    )
    start: StartKeys = key(
        str(StartKeys.__doc__), examples=[{"hitch": {"polygon": TRIANGLE, "altitude": 1.0}}]
    )
    mission: Annotated[list[StepKeys], FileField(min_length=1, max_length=MAX_STEPS)] = key(  # type: ignore[valid-type]
        "Steps, one after the other", examples=[[{"hold": {"seconds": 1.0}}]]
    )
