"""Upright rigid bodies: convex horizontal sections, slabs between two heights, and objects."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InputError
from hitchopt.geometry import ConvexPolygon, differences, shortest_offset
from hitchopt.geometry.vectors import dot, first_smallest, left_of, length, unit
from hitchopt.values import (
    Array,
    ByValue,
    Points,
    as_array,
    check_instance,
    coordinate,
    finite,
    flag,
    nonnegative,
    points,
    positive,
)
from hitchopt.values.fields import points as points_kind
from hitchopt.values.fields import suggest_keywords, with_fields, with_suggestions
from hitchopt.values.units import (
    FRICTION,
    OBJECT_HEIGHT,
    OBJECT_MASS,
    OBJECT_RADIUS,
    USUAL_OUTLINE,
    within_usual,
)

CONVEXITY_TOLERANCE = 1e-9
"""Largest depth of an outline's point inside the convex hull, relative to the outline's size."""


CORNERS = within_usual(points_kind((None, 2), "x, y", 3), USUAL_OUTLINE, 0.2)


@dataclass(frozen=True, eq=False)
class Section(ByValue):
    """A convex horizontal section in its object's frame: a polygon, or a circle about the origin.

    Parameters
    ----------
    outline: (m, 2) [m], in either sense; stored clockwise, without collinear points. None for a
        circle.
    radius: radius of a circle [m]; None for a polygon.

    Raises
    ------
    InputError: both or neither, too few points, or an outline that is not convex.
    """

    outline: Array | None
    radius: float | None

    @suggest_keywords
    def __init__(self, outline: Points | None = None, radius: float | None = None) -> None:
        if (outline is None) == (radius is None):
            remedy = "specify either an outline or a circle's radius"
            raise InputError("outline", outline, "given if there is no radius", remedy)
        size = None if radius is None else coordinate("radius", positive("radius", radius))
        object.__setattr__(self, "outline", None if outline is None else _clockwise(outline))
        object.__setattr__(self, "radius", size)

    @property
    def core(self) -> Array:
        """(m, 2) [m]: corners, or a circle's centre. The section extends by ``rounding``."""
        return np.zeros((1, 2)) if self.outline is None else self.outline

    @property
    def rounding(self) -> float:
        """Radius [m] by which the section extends beyond its core; 0 for a polygon."""
        return 0.0 if self.radius is None else self.radius

    @property
    def area(self) -> float:
        """Area [m²]."""
        disc = math.pi * self.rounding**2
        return disc if self.outline is None else ConvexPolygon(self.outline).area

    @property
    def centroid(self) -> Array:
        """(2,) [m]: centroid of its area."""
        return np.zeros(2) if self.outline is None else ConvexPolygon(self.outline).centroid

    @cached_property
    def circumradius(self) -> float:
        """Radius [m] of the smallest circle about the origin that contains the section."""
        return float(np.max(length(self.core))) + self.rounding

    @property
    def friction_radius(self) -> float:
        """Moment of friction with a support over its force [m], for a disc of the same area.

        Evenly pressed sections of other shapes have a larger one.
        """
        return 2.0 / 3.0 * math.sqrt(self.area / math.pi)

    @property
    def sides(self) -> Array:
        """(m, 2, 2) [m]: ends of the core's sides."""
        core = self.core
        return np.stack([core, np.concatenate([core[1:], core[:1]])], axis=1)

    @property
    def _normals(self) -> Array:
        """(m, 2): outward unit normals of a polygon's sides."""
        edges = self.sides[:, 1] - self.sides[:, 0]  # clockwise
        return unit(left_of(edges))

    def widened(self, distance: float) -> Section:
        """Return the section, offset outward by a distance [m]."""
        if self.outline is None:
            return Section(radius=self.rounding + distance)
        normals = self._normals
        meeting = np.stack([np.roll(normals, 1, axis=0), normals], axis=-2)
        moves = np.linalg.solve(meeting, np.full((len(normals), 2, 1), distance))
        return Section(self.outline + moves[..., 0])

    def support(self, directions: Array) -> Array:
        """Return the support function (…) [m]: largest products of directions (…, 2) and points."""
        reach: Array = np.max(directions @ self.core.T, axis=-1)
        return reach + self.rounding * length(directions)

    def clearance(self, positions: Array) -> tuple[Array, Array]:
        """Return signed distances (…) [m] of points (…, 2), negative inside, and their gradients.

        Gradients are unit vectors (…, 2).
        """
        if self.outline is None:
            return length(positions) - self.rounding, unit(positions, [1.0, 0.0])
        # Separate coordinates (m, points): products of many short vectors take far longer.
        columns, normals = self._columns
        x, y, along_x, along_y, squared, out_x, out_y = columns
        (east, north), each = positions.reshape(-1, 2).T, np.arange(positions.size // 2)
        x, y = east - x, north - y
        depths = x * out_x + y * out_y  # signed distances from the lines of all sides
        fraction = np.minimum(np.maximum((x * along_x + y * along_y) / squared, 0.0), 1.0)
        x, y = x - fraction * along_x, y - fraction * along_y
        nearest, face = (x * x + y * y).argmin(axis=0), depths.argmax(axis=0)
        offset = np.array([x[nearest, each], y[nearest, each]]).T
        depth, gap = depths[face, each], length(offset)
        inside = (depth <= 0.0) | (gap == 0.0)
        normals = np.where(inside[:, None], normals[face], unit(offset))
        distance = np.where(depth <= 0.0, depth, gap)
        return distance.reshape(positions.shape[:-1]), normals.reshape(positions.shape)

    def reach(self, positions: Array, directions: Array) -> Array:
        """Return distances (…) [m] from inner points (…, 2) to the boundary along unit vectors."""
        if self.outline is None:
            along = dot(positions, directions)
            squared = self.rounding**2 - dot(positions, positions) + along**2
            return np.asarray(np.sqrt(np.maximum(squared, 0.0)) - along)
        normals = self._normals
        depths = dot(normals, self.outline) - positions @ normals.T
        speeds = directions @ normals.T
        distances = np.divide(depths, speeds, out=np.full_like(speeds, np.inf), where=speeds > 0.0)
        return np.asarray(np.min(distances, axis=-1))

    @cached_property
    def _columns(self) -> tuple[Array, Array]:
        """Columns (7, m, 1) that describe a polygon's sides, and their outward normals (m, 2).

        The columns are first corners, vectors, squared lengths, and normals.
        """
        along, normals = self.sides[:, 1] - self.sides[:, 0], self._normals
        columns = np.column_stack([self.core, along, dot(along, along), normals]).T
        return columns[..., None], normals

    def segment_distance(self, first: Array, last: Array) -> Array:
        """Return distances (…) [m] of segments between points (…, 2), zero if they intersect."""
        ends = np.stack([first, last], axis=-2)[..., None, :, :]
        gaps = np.min(length(shortest_offset(differences(ends, self.sides))), axis=-1)
        inside = self.clearance(first)[0] <= 0.0
        return np.where(inside, 0.0, np.maximum(gaps - self.rounding, 0.0))


def _clockwise(outline: Points) -> Array:
    """Return the corners of a convex outline clockwise, starting with its first one."""
    from scipy.spatial import ConvexHull, QhullError

    bound, remedy = "a list of at least 3 points [x, y]", "write [[x, y], …] in metres"
    vertices = points("outline", outline, (3, 2), bound, remedy)
    try:
        hull = ConvexHull(vertices)
    except QhullError:
        bound, remedy = "an outline around an area", "specify three points that are not in line"
        raise InputError("outline", vertices.tolist(), bound, remedy) from None
    depths = np.max(vertices @ hull.equations[:, :2].T + hull.equations[:, 2], axis=1)
    k = int(np.argmin(depths))
    if depths[k] < -CONVEXITY_TOLERANCE * float(np.max(np.ptp(vertices, axis=0))):
        bound = f"on the convex hull ({-depths[k]:.3g} m inside it)"
        remedy = f"specify the hull: {vertices[hull.vertices[::-1]].round(4).tolist()}"
        raise InputError(f"outline[{k}]", vertices[k].tolist(), bound, remedy)
    corners = vertices[np.sort(hull.vertices)]
    x, y = corners.T
    if np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) > 0.0:
        corners = np.roll(corners[::-1], 1, axis=0)
    try:
        return ConvexPolygon(corners).vertices
    except InputError as error:
        raise InputError("outline", error.value, error.bound, error.remedy) from None


@dataclass(frozen=True, eq=False)
class Clearance:
    """Signed distances (…) [m] of points from a body, and their gradients, unit vectors (…, 3).

    Inside, the distance is minus the depth below the nearest face.
    """

    distance: Array
    normals: Array


@dataclass(frozen=True, eq=False)
class Slab:
    """A horizontal section, extruded between a floor and a ceiling [m]."""

    section: Section
    lower: float
    upper: float

    @property
    def size(self) -> float:
        """Bound of the coordinates [m] of its points."""
        return max(self.section.circumradius, abs(self.lower), abs(self.upper))

    def support(self, directions: Array) -> Array:
        """Return the support function (…) [m]: largest products of directions (…, 3) and points."""
        upward = directions[..., 2]
        horizontal: Array = self.section.support(directions[..., :2])
        return horizontal + np.maximum(self.lower * upward, self.upper * upward)

    def clearance(self, positions: Array) -> Clearance:
        """Return the signed distances of points (…, 3) [m] and their gradients."""
        sideways, gradient = self.section.clearance(positions[..., :2])
        below, above = self.lower - positions[..., 2], positions[..., 2] - self.upper
        deepest = np.maximum(np.maximum(sideways, below), above)
        side, rise = np.maximum(sideways, 0.0), np.maximum(above, 0.0) - np.maximum(below, 0.0)
        inside = deepest <= 0.0
        if np.any(inside):  # nearest face: side, floor or ceiling
            depths = np.stack([sideways, below, above], axis=-1)
            nearest = first_smallest(-depths, np.max(np.abs(depths), axis=-1))
            side = np.where(inside, nearest == 0, side)
            rise = np.where(inside, np.array([0.0, -1.0, 1.0])[nearest], rise)
        offset = np.concatenate([side[..., None] * gradient, rise[..., None]], axis=-1)
        return Clearance(np.where(inside, deepest, length(offset)), unit(offset))


@with_suggestions
@dataclass(frozen=True, eq=False)
class Rim(ByValue):
    """A thin rim or tray that may rest on cables: its section and its height above the base [m]."""

    section: Section
    height: float

    def __post_init__(self) -> None:
        check_instance("section", self.section, Section)
        object.__setattr__(self, "height", coordinate("height", self.height))


def _warn_of_units(section: Section, rim: Rim | None) -> None:
    """Warn of sizes of an object that seem to be in another unit."""
    sections = {"section": section} | ({} if rim is None else {"rim.section": rim.section})
    for key, each in sections.items():
        if each.radius is not None:
            OBJECT_RADIUS.check(f"{key}.radius", each.radius)
        else:
            CORNERS.check(f"{key}.outline", each.outline)
    if rim is not None:
        OBJECT_HEIGHT.check("rim.height", rim.height)


@dataclass(frozen=True, eq=False)
class SolidObject(ByValue):
    """An upright rigid object of uniform density.

    Parameters
    ----------
    section: section of its body, about its own origin.
    lower, upper: heights of the body's floor and ceiling above its base [m]
    mass: [kg]
    friction: coefficient of friction with cables and with its support.
    at: (3,) [m], the origin of its base.
    yaw: heading, counter-clockwise [rad].
    rim: its rim, or None. The rim of a flat tray is its underside.
    fixed: whether it never moves, like a table; fixed objects need no support.

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

    @suggest_keywords
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
        position = as_array("at", at)
        if position.shape != (3,):
            raise InputError("at", at, "a point [x, y, z]", "specify three numbers in metres")
        position = np.array([coordinate(f"at[{i}]", x) for i, x in enumerate(position.tolist())])
        position.setflags(write=False)
        _warn_of_units(section, rim)
        values = {
            "section": section,
            "lower": coordinate("lower", OBJECT_HEIGHT.check("lower", lower)),
            "upper": coordinate("upper", OBJECT_HEIGHT.check("upper", upper)),
            "mass": OBJECT_MASS.check("mass", positive("mass", mass)),
            "friction": FRICTION.check("friction", nonnegative("friction", friction)),
            "at": position,
            "yaw": finite("yaw", yaw),
            "rim": rim,
            "fixed": flag("fixed", fixed),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
        if self.lower >= self.upper:
            bound, remedy = f"above its floor, {self.lower:g} m", "swap the heights"
            raise InputError("upper", self.upper, bound, remedy)
        if rim is not None and not self.lower <= rim.height <= self.upper:
            bound = f"from the body's floor, {self.lower:g} m, to its ceiling, {self.upper:g} m"
            raise InputError("rim.height", rim.height, bound, "put the rim on the body")
        if rim is not None and rim.section.clearance(section.centroid)[0] >= 0.0:
            bound = f"around the body's centre, {section.centroid.tolist()}"
            raise InputError("rim.section", rim.section, bound, "put the rim on the body")

    @property
    def slabs(self) -> tuple[Slab, ...]:
        """Its convex parts in its own frame: the body, and the rim as a slab of no thickness."""
        body = Slab(self.section, self.lower, self.upper)
        if self.rim is None:
            return (body,)
        return body, Slab(self.rim.section, self.rim.height, self.rim.height)

    @property
    def stem(self) -> Section | None:
        """Section of the body that clasps below the rim surround; None for a flat tray."""
        flat = self.rim is not None and self.rim.height == self.lower
        return None if flat else self.section

    @property
    def centre_of_mass(self) -> Array:
        """(3,) [m], in the frame of the base: centroid of the section, at half of the height."""
        return np.append(self.section.centroid, 0.5 * (self.lower + self.upper))

    @property
    def place(self) -> Array:
        """(4,): x, y, z [m] of its base, and yaw [rad]."""
        return np.append(self.at, self.yaw)

    def moved_to(self, place: Array) -> SolidObject:
        """Return the object with its base at a pose (4,): x, y, z [m] and yaw [rad]."""
        return with_fields(self, at=place[:3], yaw=float(place[3]))

    @property
    def pose(self) -> Array:
        """(5,): x, y, z [m] of its base, cosine and sine of yaw."""
        return np.array([*self.at, np.cos(self.yaw), np.sin(self.yaw)])

    @property
    def circumradius(self) -> float:
        """Radius [m] of a vertical cylinder about its origin that contains body and rim."""
        return max(slab.section.circumradius for slab in self.slabs)
