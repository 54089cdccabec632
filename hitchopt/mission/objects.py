"""Objects in problem files: upright bodies with sections, rims and drawings of outlines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from hitchopt.errors import FileError, InputError
from hitchopt.geometry.drawings import read_drawing
from hitchopt.hitch.requirements import MAX_CORNERS
from hitchopt.objects import Rim, Section, SolidObject
from hitchopt.steps.step import OBJECT_NAME, POINT3
from hitchopt.values import Array
from hitchopt.values.fields import FLAGS, Key, dict_of, mapping_of, points, strings
from hitchopt.values.units import ANGLE, COORDINATE, LENGTH, NONNEGATIVE, POSITIVE

MAX_OBJECTS = 100

CORNERS = points((None, 2), "x, y", 3, MAX_CORNERS)


@dataclass(frozen=True, eq=False)
class SectionKeys:
    """A convex section: exactly one of an outline and a circle, or a drawing of a body."""

    outline: Annotated[
        Array | None, Key(CORNERS, "Corners [x, y] [m] of a convex outline, in either sense")
    ] = None
    circle: Annotated[float | None, Key(LENGTH, "Radius of a circle")] = None

    def __post_init__(self) -> None:
        names = [name for name in ("outline", "circle", "file") if hasattr(self, name)]
        given = [name for name in names if getattr(self, name) is not None]
        if len(given) != 1:
            bound = f"a mapping with exactly one of {', '.join(names)}"
            raise InputError("", given, bound, "write circle: 0.2, for example")


@dataclass(frozen=True, eq=False)
class RimKeys(SectionKeys):
    """A rim or tray that may rest on cables."""

    at: Annotated[float, Key(COORDINATE, "Height above the object's base")] = 0.2

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
    lower: Annotated[float, Key(COORDINATE, "Height of its floor above its base", name="from")] = (
        0.0
    )
    upper: Annotated[float, Key(COORDINATE, "Height of its ceiling above its base", name="to")] = (
        0.3
    )
    mass: Annotated[float, Key(POSITIVE, "Mass [kg]")] = 0.1
    friction: Annotated[float, Key(NONNEGATIVE, "Coefficient of friction, with cables")] = 0.5
    at: Annotated[
        Array, Key(POINT3, "Where the origin of its base stands, [x, y, z] [m]", [1, 0, 0])
    ]
    yaw: Annotated[float, Key(ANGLE, "By how much it is turned there, counter-clockwise")] = 0.0
    rim: Annotated[Rim | None, Key(mapping_of(RimKeys, RimKeys.rim), "Rim or tray")] = None
    fixed: Annotated[bool, Key(FLAGS, "Whether it never moves, as tables do")] = False

    def body(self) -> SolidObject:
        """Return the object; its errors have the keys of files."""
        values = {name: each for name, each in vars(self).items() if name not in SECTION_KEYS}
        try:
            return SolidObject(Section(self.outline, self.circle), **values)
        except InputError as error:
            key = FILE_KEYS.get(error.key, error.key)
            raise InputError(key, error.value, error.bound, error.remedy) from None


SECTION_KEYS = ("outline", "circle", "file")
FILE_KEYS = {"lower": "from", "upper": "to", "rim.height": "rim.at", "rim.section": "rim"}
"""Keys of files for the arguments of ``SolidObject`` that have other names."""

OBJECTS = dict_of(mapping_of(ObjectKeys, ObjectKeys.body), OBJECT_NAME, MAX_OBJECTS)


def with_outlines(data: Mapping[str, Any], folder: Path = Path()) -> dict[str, Any]:
    """Return a problem's mapping with outlines in place of drawings, relative to a folder.

    Raises InputError for a drawing that cannot be read, or has no outline.
    """
    objects = data.get("objects")
    if not isinstance(objects, Mapping):
        return dict(data)
    drawn = dict[str, Any](objects)
    for name, each in objects.items():
        file = each.get("file") if isinstance(each, Mapping) else None
        if not isinstance(file, str) or not file or each.keys() & {"outline", "circle"}:
            continue
        try:
            outline = read_drawing(folder / file).outline
            Section(outline)
        except InputError as error:
            words = f"an outline: {error.bound}", error.remedy
            raise InputError(f"objects.{name}.file", file, *words) from None
        except FileError as error:
            words = "a drawing that can be read", str(error)
            raise InputError(f"objects.{name}.file", file, *words) from None
        given = {key: value for key, value in each.items() if key != "file"}
        drawn[name] = given | {"outline": outline.tolist()}
    return {**data, "objects": drawn}
