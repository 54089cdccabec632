"""Upright rigid bodies: convex sections seen from above, slabs between two heights, objects."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InputError, OneLine
from hitchopt.geometry import ConvexPolygon, differences, shortest_offset
from hitchopt.geometry.vectors import dot, first_smallest, length, unit
from hitchopt.values import (
    Array,
    as_array,
    check_instance,
    coordinate,
    finite,
    flag,
    nonnegative,
    points,
    positive,
)

STRAIGHT = 1e-9
"""Share of an outline's size by which a point may lie inside of the convex hull of all points."""


@dataclass(frozen=True, eq=False)
class Section(OneLine):
    """A convex section about its object's origin: a polygon or a circle.

    Parameters
    ----------
    outline: (m, 2) [m], in either sense; stored clockwise, without points between two others on a
        straight line. None for a circle.
    radius: of a circle about the origin [m]; None for a polygon.

    Raises
    ------
    InputError: both or neither, too few points, or an outline that is not convex.
    """

    outline: Array | None
    radius: float | None

    def __init__(self, outline: ArrayLike | None = None, radius: float | None = None) -> None:
        if (outline is None) == (radius is None):
            remedy = "give either an outline or a circle's radius"
            raise InputError("outline", outline, "given where no radius is", remedy)
        size = None if radius is None else coordinate("radius", positive("radius", radius))
        object.__setattr__(self, "outline", None if outline is None else _clockwise(outline))
        object.__setattr__(self, "radius", size)

    @property
    def core(self) -> Array:
        """(m, 2) [m]: corners, or a circle's centre; all within ``rounding`` is the section."""
        return np.zeros((1, 2)) if self.outline is None else self.outline

    @property
    def rounding(self) -> float:
        """Radius [m] of the discs about the core that make the section; 0 for a polygon."""
        return 0.0 if self.radius is None else self.radius

    @property
    def area(self) -> float:
        """Area [m²]."""
        round_ = math.pi * self.rounding**2
        return round_ if self.outline is None else ConvexPolygon(self.outline).area

    @property
    def centroid(self) -> Array:
        """(2,) [m]: centre of its area."""
        return np.zeros(2) if self.outline is None else ConvexPolygon(self.outline).centroid

    @property
    def circumradius(self) -> float:
        """Radius [m] of the smallest circle about the origin around all of it."""
        return float(np.max(length(self.core))) + self.rounding

    @property
    def sides(self) -> Array:
        """(m, 2, 2) [m]: the core's corners, each with the next one."""
        core = self.core
        return np.stack([core, np.concatenate([core[1:], core[:1]])], axis=1)

    @property
    def _outward(self) -> Array:
        """(m, 2): unit vectors out of the sides of a polygon."""
        edges = self.sides[:, 1] - self.sides[:, 0]  # clockwise
        return unit(np.stack([-edges[:, 1], edges[:, 0]], axis=-1))

    def support(self, directions: Array) -> Array:
        """Return the largest scalar products (…) [m] of directions (…, 2) with its points."""
        reach: Array = np.max(directions @ self.core.T, axis=-1)
        return reach + self.rounding * length(directions)

    def clearance(self, places: Array) -> tuple[Array, Array]:
        """Return signed distances (…) [m] of points (…, 2), negative within, and their gradients.

        These are unit vectors (…, 2) along which the distance grows.
        """
        if self.outline is None:
            return length(places) - self.rounding, unit(places, [1.0, 0.0])
        # By coordinates, (m, …): products of many short vectors take several times as long.
        columns, outward = _sides_of(self)
        columns = columns.reshape(*columns.shape, *(1,) * (places.ndim - 1))
        x, y, along_x, along_y, squared, out_x, out_y = columns
        x, y = places[..., 0] - x, places[..., 1] - y
        depths = x * out_x + y * out_y  # before each side, negative behind it
        share = np.clip((x * along_x + y * along_y) / squared, 0.0, 1.0)
        x, y = x - share * along_x, y - share * along_y
        nearest = np.argmin(x * x + y * y, axis=0)[None]
        chosen = [np.take_along_axis(each, nearest, axis=0)[0] for each in (x, y)]
        offset = np.stack(chosen, axis=-1)
        depth, far = np.max(depths, axis=0), length(offset)
        inside = (depth <= 0.0) | (far == 0.0)
        shallow = outward[np.argmax(depths, axis=0)]
        normals = np.where(inside[..., None], shallow, unit(offset))
        return np.where(depth <= 0.0, depth, far), normals

    def reach(self, places: Array, directions: Array) -> Array:
        """Return distances (…) [m] to the edge from points (…, 2) within, along unit vectors."""
        if self.outline is None:
            along = dot(places, directions)
            squared = self.rounding**2 - dot(places, places) + along**2
            return np.asarray(np.sqrt(np.maximum(squared, 0.0)) - along)
        outward = self._outward
        depths = dot(outward, self.outline) - places @ outward.T
        speeds = directions @ outward.T
        reached = np.divide(depths, speeds, out=np.full_like(speeds, np.inf), where=speeds > 0.0)
        return np.asarray(np.min(reached, axis=-1))

    def segment_distance(self, first: Array, last: Array) -> Array:
        """Return distances (…) [m] of segments between points (…, 2), zero where they meet."""
        ends = np.stack([first, last], axis=-2)[..., None, :, :]
        apart = np.min(length(shortest_offset(differences(ends, self.sides))), axis=-1)
        within = self.clearance(first)[0] <= 0.0
        return np.where(within, 0.0, np.maximum(apart - self.rounding, 0.0))


@lru_cache(maxsize=256)
def _sides_of(section: Section) -> tuple[Array, Array]:
    """Return the columns (7, m) of a polygon's sides, and the unit vectors (m, 2) out of them.

    The columns are first corners, vectors, squared lengths, and the unit vectors.
    """
    along, outward = section.sides[:, 1] - section.sides[:, 0], section._outward
    return np.column_stack([section.core, along, dot(along, along), outward]).T, outward


def _clockwise(outline: ArrayLike) -> Array:
    """Return the corners of a convex outline, clockwise, beginning with its first one."""
    from scipy.spatial import ConvexHull, QhullError

    bound, remedy = "a list of at least 3 points [x, y]", "write [[x, y], …] in metres"
    given = points("outline", outline, (3, 2), bound, remedy)
    try:
        hull = ConvexHull(given)
    except QhullError:
        bound, remedy = "an outline around an area", "give three points that are not in line"
        raise InputError("outline", given.tolist(), bound, remedy) from None
    depths = np.max(given @ hull.equations[:, :2].T + hull.equations[:, 2], axis=1)
    k = int(np.argmin(depths))
    if depths[k] < -STRAIGHT * float(np.max(np.ptp(given, axis=0))):
        bound = f"on the convex hull ({-depths[k]:.3g} m inside of it)"
        remedy = f"give the hull: {given[hull.vertices[::-1]].round(4).tolist()}"
        raise InputError(f"outline[{k}]", given[k].tolist(), bound, remedy)
    corners = given[np.sort(hull.vertices)]
    x, y = corners.T
    if np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) > 0.0:
        corners = np.roll(corners[::-1], 1, axis=0)
    try:
        return ConvexPolygon(corners).vertices
    except InputError as error:
        raise InputError("outline", error.value, error.bound, error.remedy) from None


@dataclass(frozen=True, eq=False)
class Clearance:
    """Signed distances (…) [m] of points to a body, and unit vectors (…, 3) along which they grow.

    Inside it is minus the depth below the nearest face.
    """

    distance: Array
    normals: Array


@dataclass(frozen=True, eq=False)
class Slab:
    """A section, seen from above, between a floor and a ceiling [m]."""

    section: Section
    lower: float
    upper: float

    @property
    def size(self) -> float:
        """Largest coordinate [m] of its points."""
        return max(self.section.circumradius, abs(self.lower), abs(self.upper))

    def support(self, directions: Array) -> Array:
        """Return the largest scalar products (…) [m] of directions (…, 3) with its points."""
        upward = directions[..., 2]
        level: Array = self.section.support(directions[..., :2])
        return level + np.maximum(self.lower * upward, self.upper * upward)

    def clearance(self, places: Array) -> Clearance:
        """Return the distances of points (…, 3) [m] and the directions out of the body."""
        across, gradient = self.section.clearance(places[..., :2])
        below, above = self.lower - places[..., 2], places[..., 2] - self.upper
        deepest = np.maximum(np.maximum(across, below), above)
        side, rise = np.maximum(across, 0.0), np.maximum(above, 0.0) - np.maximum(below, 0.0)
        within = deepest <= 0.0
        if np.any(within):  # the nearest of side, floor and ceiling
            behind = np.stack([across, below, above], axis=-1)
            nearest = first_smallest(-behind, np.max(np.abs(behind), axis=-1))
            side = np.where(within, nearest == 0, side)
            rise = np.where(within, np.array([0.0, -1.0, 1.0])[nearest], rise)
        offset = np.concatenate([side[..., None] * gradient, rise[..., None]], axis=-1)
        return Clearance(np.where(within, deepest, length(offset)), unit(offset))


@dataclass(frozen=True, eq=False)
class Rim(OneLine):
    """A thin rim or tray that may rest on cables: its section, and height above the base [m]."""

    section: Section
    height: float

    def __post_init__(self) -> None:
        check_instance("section", self.section, Section)
        object.__setattr__(self, "height", coordinate("height", self.height))


@dataclass(frozen=True, eq=False)
class SolidObject(OneLine):
    """An upright rigid object; its mass is spread evenly between its two heights.

    Parameters
    ----------
    section: of its body, about its own origin.
    lower, upper: heights of the body's floor and ceiling above its base [m]
    mass: [kg]
    friction: coefficient between it and cables, and its support.
    at: (3,) [m], the origin of its base.
    yaw: its heading there, counter-clockwise [rad].
    rim: its rim, or None. That of a flat tray is its underside.
    fixed: whether it never moves, as tables do; a fixed one may stand on anything or nothing.

    Raises
    ------
    InputError: a number out of its range, or a rim off the body.
    """

    section: Section
    lower: float
    upper: float
    mass: float
    friction: float
    at: Array
    yaw: float = 0.0
    rim: Rim | None = None
    fixed: bool = False

    def __init__(
        self,
        section: Section,
        lower: float = 0.0,
        upper: float = 0.3,
        mass: float = 0.1,
        friction: float = 0.5,
        at: ArrayLike = (0.0, 0.0, 0.0),
        yaw: float = 0.0,
        rim: Rim | None = None,
        fixed: bool = False,
    ) -> None:
        check_instance("section", section, Section)
        if rim is not None:
            check_instance("rim", rim, Rim)
        given = as_array(at)
        if given.shape != (3,):
            raise InputError("at", at, "a point [x, y, z]", "give three numbers in metres")
        place = np.array([coordinate(f"at[{i}]", x) for i, x in enumerate(given.tolist())])
        place.setflags(write=False)
        values = {
            "section": section,
            "lower": coordinate("lower", lower),
            "upper": coordinate("upper", upper),
            "mass": positive("mass", mass),
            "friction": nonnegative("friction", friction),
            "at": place,
            "yaw": finite("yaw", yaw),
            "rim": rim,
            "fixed": flag("fixed", fixed),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
        if self.lower >= self.upper:
            bound, remedy = f"above its floor, {self.lower:g} m", "exchange the heights"
            raise InputError("upper", self.upper, bound, remedy)
        if rim is not None and not self.lower <= rim.height <= self.upper:
            bound = f"from the body's floor, {self.lower:g} m, to its ceiling, {self.upper:g} m"
            raise InputError("rim.height", rim.height, bound, "put the rim on the body")
        if rim is not None and rim.section.clearance(section.centroid)[0] >= 0.0:
            bound = f"around the body's centre, {section.centroid.tolist()}"
            raise InputError("rim.section", rim.section, bound, "put the rim on the body")

    @property
    def slabs(self) -> tuple[Slab, ...]:
        """Its convex parts in its own frame: the body, and the rim as thin as a sheet."""
        body = Slab(self.section, self.lower, self.upper)
        if self.rim is None:
            return (body,)
        return body, Slab(self.rim.section, self.rim.height, self.rim.height)

    @property
    def stem(self) -> Section | None:
        """The section that clasps below its rim are around; None for a flat tray."""
        flat = self.rim is not None and self.rim.height == self.lower
        return None if flat else self.section

    @property
    def centre_of_mass(self) -> Array:
        """Point (3,) [m], seen from its base: centroid of the section, half of the height."""
        return np.append(self.section.centroid, 0.5 * (self.lower + self.upper))

    @property
    def place(self) -> Array:
        """(4,): x, y, z [m] of its base, and its yaw [rad]."""
        return np.append(self.at, self.yaw)

    def moved_to(self, place: Array) -> SolidObject:
        """Return the object with its base at a place (4,), as ``place``."""
        return replace(self, at=place[:3], yaw=float(place[3]))

    @property
    def pose(self) -> Array:
        """(5,): x, y, z [m] of its base, and cosine and sine of its yaw."""
        return np.array([*self.at, np.cos(self.yaw), np.sin(self.yaw)])

    @property
    def circumradius(self) -> float:
        """Radius [m] of a circle about its origin around body and rim, seen from above."""
        return max(slab.section.circumradius for slab in self.slabs)
