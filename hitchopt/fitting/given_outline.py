"""The convex section of an outline that is given as points, a radius, a geometry or a drawing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull, QhullError

from hitchopt.errors import InputError
from hitchopt.objects import Section
from hitchopt.outlines.outline_file import object_outline, outline_of_geometry
from hitchopt.values import Array, points


def section_of(outline: Any) -> tuple[Array | None, Section, list[str]]:
    """Return the outline as given, its convex section, and what is to be said of it."""
    if isinstance(outline, Section):
        return outline.outline, outline, []
    if isinstance(outline, int | float | np.number) and not isinstance(outline, bool):
        return None, Section(radius=float(outline)), []
    if isinstance(outline, str | Path):
        found = object_outline(outline)
    elif hasattr(outline, "__geo_interface__"):
        found = outline_of_geometry(outline)
    else:
        found = _points(outline)
    found = points("outline", found, (3, 2), "points [x, y]", "write [[x, y], …] in metres")
    try:
        return found, Section(found), []
    except InputError:
        hull = _hull(found)
    corners = len(hull)
    note = f"the outline is concave: its convex hull of {corners} corners is used"
    return found, Section(hull), [note]


def _points(outline: Sequence[Any] | ArrayLike) -> Array:
    return points(
        "outline", outline, (3, 2), "a list of at least 3 points [x, y]",
        "give points in metres, a radius, or a drawing",
    )  # fmt: skip


def _hull(found: Array) -> Array:
    """Return the corners of the convex hull, counter-clockwise."""
    try:
        return found[ConvexHull(found).vertices]
    except QhullError:
        bound, remedy = "an outline around an area", "give three points that are not in line"
        raise InputError("outline", found.tolist(), bound, remedy) from None
