"""Objects in a problem file, key by key, and the records made of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from hitchopt.errors import InputError
from hitchopt.mission.faults import Collector
from hitchopt.mission.schema import Keys, NotNegative, Number, Point2, Point3, Positive, fault, key
from hitchopt.objects import Rim, Section, SolidObject
from hitchopt.outlines.outline_file import object_outline

MAX_OBJECTS = 100
"""Objects of one problem."""

MAX_CORNERS = 1000
"""Corners of one outline."""

SHAPES = ("outline", "circle", "file")
"""Keys of which an object has exactly one; a rim the first or the second."""

KEYS = {"lower": "from", "upper": "to", "rim.height": "rim.at", "rim.section": "rim"}
"""Keys of files for the arguments of ``SolidObject`` that have other names."""

Corners = Annotated[list[Point2], Field(min_length=3, max_length=MAX_CORNERS)]


def _one_of(values: object, names: tuple[str, ...]) -> None:
    """Raise a fault unless exactly one of the names is given."""
    if isinstance(values, dict) and sum(values.get(name) is not None for name in names) != 1:
        words = ", ".join(names)
        raise fault(f"a mapping with exactly one of {words}", "write circle: 0.2, for example")


class RimKeys(Keys):
    """A rim or tray that may rest on cables."""

    outline: Corners | None = key("Corners [x, y] [m] of a convex outline, in either sense", None)
    circle: Positive | None = key("Radius [m] of a circle", None)
    at: Number = key("Height above the object's base [m]", 0.2)

    @model_validator(mode="before")
    @classmethod
    def _check_shape(cls, data: object) -> object:
        _one_of(data, SHAPES[:2])
        return data


class ObjectKeys(Keys):
    """An upright object that is carried, or stands in the way."""

    outline: Corners | None = key("Corners [x, y] [m] of a convex outline, in either sense", None)
    circle: Positive | None = key("Radius [m] of a circle", None)
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

    @model_validator(mode="before")
    @classmethod
    def _check_shape(cls, data: object) -> object:
        _one_of(data, SHAPES)
        return data


def objects_of(
    keys: Mapping[str, ObjectKeys], folder: Path | None, faults: Collector
) -> dict[str, SolidObject]:
    """Return the objects that ``keys`` describe, by name.

    Parameters
    ----------
    keys: by name.
    folder: that of the problem file, in which drawings are looked for.
    faults: gathers what is wrong.
    """
    made = {
        name: faults.attempt(f"objects.{name}", partial(_object, given, folder))
        for name, given in keys.items()
    }
    return {name: each for name, each in made.items() if each is not None}


def _object(keys: ObjectKeys, folder: Path | None) -> SolidObject:
    """Return the object that ``keys`` describe."""
    values: dict[str, Any] = keys.model_dump()
    rim, file = values.pop("rim"), values.pop("file")
    outline, circle = values.pop("outline"), values.pop("circle")
    if file is not None:
        try:
            outline = object_outline(Path(file) if folder is None else folder / file)
        except InputError as error:
            raise InputError("file", file, error.bound, error.remedy) from None
    if rim is not None:
        rim = Rim(Section(rim["outline"], rim["circle"]), rim["at"])
    yaw = math.radians(values.pop("yaw_deg"))
    lower, upper = values.pop("from_"), values.pop("to")
    try:
        return SolidObject(Section(outline, circle), lower, upper, yaw=yaw, rim=rim, **values)
    except InputError as error:
        key = KEYS.get(error.key, error.key)
        if file is not None and key.partition("[")[0] == "outline":
            bound = f"an outline that is {error.bound.removeprefix('an outline that is ')}"
            raise InputError("file", file, bound, error.remedy) from None
        raise InputError(key, error.value, error.bound, error.remedy) from None
