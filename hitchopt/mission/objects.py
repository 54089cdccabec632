"""Objects in problem files: upright bodies with sections and rims, and drawings of outlines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from hitchopt.errors import Circumstance, FileError, InputError
from hitchopt.geometry.drawings import read_drawing
from hitchopt.hitch.requirements import MAX_CORNERS
from hitchopt.objects import Rim, Section, SolidObject
from hitchopt.steps.keys import OBJECT_NAME, POINT3
from hitchopt.values import Array
from hitchopt.values.fields import FLAGS, Key, dict_of, mapping_of, points, strings
from hitchopt.values.units import (
    ANGLE,
    FRICTION,
    OBJECT_HEIGHT,
    OBJECT_MASS,
    OBJECT_RADIUS,
    USUAL_OUTLINE,
    within_usual,
)

MAX_OBJECTS = 100
SECTION_KEYS = ("outline", "circle", "file")

CORNERS = within_usual(points((None, 2), "x, y", 3, MAX_CORNERS), USUAL_OUTLINE, 0.2)


@dataclass(frozen=True, eq=False)
class SectionKeys:
    """A convex section: exactly one of an outline and a circle, or a drawing of a body."""

    outline: Annotated[
        Array | None, Key(CORNERS, "Corners [x, y] [m] of a convex outline, in either sense")
    ] = None
    circle: Annotated[float | None, Key(OBJECT_RADIUS, "Radius of a circle")] = None

    def __post_init__(self) -> None:
        names = [name for name in SECTION_KEYS if hasattr(self, name)]
        specified = [name for name in names if getattr(self, name) is not None]
        if len(specified) != 1:
            bound = f"a mapping with exactly one of {', '.join(names)}"
            if specified:
                found = Circumstance(f"has {' and '.join(specified)}")
                raise InputError("", found, bound, "keep one of them")
            found = Circumstance(f"has none of {', '.join(names)}")
            raise InputError("", found, bound, "write circle: 0.2, for example")


@dataclass(frozen=True, eq=False)
class RimKeys(SectionKeys):
    """A rim or tray that may rest on cables."""

    at: Annotated[float, Key(OBJECT_HEIGHT, "Height above the object's base")] = 0.2

    def rim(self) -> Rim:
        """Return the rim."""
        return Rim(Section(self.outline, self.circle), self.at)


@dataclass(frozen=True, eq=False, kw_only=True)
class ObjectKeys(SectionKeys):
    """An upright object, carried or an obstacle."""

    file: Annotated[
        str | None,
        Key(strings(1000, 1), "Drawing of its outline, in metres, relative to this file"),
    ] = None
    lower: Annotated[
        float, Key(OBJECT_HEIGHT, "Height of its floor above its base", name="from")
    ] = 0.0
    upper: Annotated[
        float, Key(OBJECT_HEIGHT, "Height of its ceiling above its base", name="to")
    ] = 0.3
    mass: Annotated[float, Key(OBJECT_MASS, "Mass")] = 0.1
    friction: Annotated[float, Key(FRICTION, "Coefficient of friction with cables")] = 0.5
    at: Annotated[
        Array, Key(POINT3, "Position of the origin of its base, [x, y, z] [m]", [1, 0, 0])
    ]
    yaw: Annotated[float, Key(ANGLE, "Yaw of the object, counter-clockwise")] = 0.0
    rim: Annotated[Rim | None, Key(mapping_of(RimKeys, RimKeys.rim), "Rim or tray")] = None
    fixed: Annotated[bool, Key(FLAGS, "True for objects that never move, such as tables")] = False

    def body(self) -> SolidObject:
        """Return the object; errors have the keys of files."""
        values = {key: value for key, value in vars(self).items() if key not in SECTION_KEYS}
        try:
            return SolidObject(Section(self.outline, self.circle), **values)
        except InputError as error:
            raise error.renamed(lambda key: FILE_KEYS.get(key, key)) from None


FILE_KEYS = {"lower": "from", "upper": "to", "rim.height": "rim.at", "rim.section": "rim"}
"""Keys of files that differ from the arguments of ``SolidObject``."""

OBJECTS = dict_of(mapping_of(ObjectKeys, ObjectKeys.body), OBJECT_NAME, MAX_OBJECTS)


def with_outlines(data: Mapping[str, Any], folder: Path = Path()) -> dict[str, Any]:
    """Return a problem's mapping with outlines in place of drawings in ``folder``.

    Raises InputError for a drawing that cannot be read or has no outline.
    """
    objects = data.get("objects")
    if not isinstance(objects, Mapping):
        return dict(data)
    outlined = dict[str, Any](objects)
    for name, body in objects.items():
        file = body.get("file") if isinstance(body, Mapping) else None
        if not isinstance(file, str) or not file or body.keys() & {"outline", "circle"}:
            continue
        try:
            outline = read_drawing(folder / file).outline
            Section(outline)
        except InputError as error:
            bound = f"an outline: {error.bound}"
            raise InputError(f"objects.{name}.file", file, bound, error.remedy) from None
        except FileError as error:
            bound = "a drawing that can be read"
            raise InputError(f"objects.{name}.file", file, bound, str(error)) from None
        values = {key: value for key, value in body.items() if key != "file"}
        outlined[name] = values | {"outline": outline.tolist()}
    return {**data, "objects": outlined}
