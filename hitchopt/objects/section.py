"""Convex sections of upright objects, seen from above: polygons and circles."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InputError, OneLine
from hitchopt.geometry import ConvexPolygon, differences, shortest_offset
from hitchopt.geometry.vectors import length, unit
from hitchopt.values import MAX_COORDINATE, Array, points, positive

STRAIGHT = 1e-9
"""Share of an outline's size by which a point may lie inside of the convex hull of all points."""


@dataclass(frozen=True, eq=False)
class Section(OneLine):
    """A convex section about its object's origin: a polygon or a circle.

    Parameters
    ----------
    outline: (m, 2) [m], in either sense; stored clockwise as all outlines are. Points between two
        others on a straight line are left out. None of a circle.
    radius: of a circle about the origin [m]; None of a polygon.

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
        polygon = None if outline is None else _clockwise(outline)
        object.__setattr__(self, "outline", polygon)
        object.__setattr__(self, "radius", None if radius is None else _radius(radius))

    @property
    def core(self) -> Array:
        """(m, 2) [m]: corners, or a circle's centre: the section is all within ``rounding``."""
        return np.zeros((1, 2)) if self.outline is None else self.outline

    @property
    def rounding(self) -> float:
        """Radius [m] of the discs that make the section of its core; 0 of a polygon."""
        return 0.0 if self.radius is None else self.radius

    @property
    def polygon(self) -> ConvexPolygon | None:
        """The outline; None of a circle."""
        return None if self.outline is None else ConvexPolygon(self.outline)

    @property
    def area(self) -> float:
        """Area [m²]."""
        return math.pi * self.rounding**2 if self.polygon is None else self.polygon.area

    @property
    def centroid(self) -> Array:
        """(2,) [m]: centre of its area."""
        return np.zeros(2) if self.polygon is None else self.polygon.centroid

    @property
    def circumradius(self) -> float:
        """Radius [m] of the smallest circle about the origin that holds all of it."""
        return float(np.max(length(self.core))) + self.rounding

    def support(self, directions: Array) -> Array:
        """Return the largest scalar products (…) [m] of directions (…, 2) with its points."""
        reach: Array = np.max(directions @ self.core.T, axis=-1)
        return reach + self.rounding * length(directions)

    def clearance(self, places: Array) -> tuple[Array, Array]:
        """Return signed distances (…) [m] of points (…, 2), negative within, and the ways out.

        These are unit vectors (…, 2) along which the distance grows.
        """
        if self.outline is None:
            return length(places) - self.rounding, unit(places, [1.0, 0.0])
        corners = self.outline
        edges = np.roll(corners, -1, axis=0) - corners
        outward = unit(np.stack([-edges[:, 1], edges[:, 0]], axis=-1))  # of clockwise edges
        away = places[..., None, :] - corners
        along = np.sum(away * edges, axis=-1) / np.sum(edges * edges, axis=-1)
        offsets = away - np.clip(along, 0.0, 1.0)[..., None] * edges
        nearest = np.argmin(np.sum(offsets**2, axis=-1), axis=-1)[..., None, None]
        offset = np.take_along_axis(offsets, nearest, axis=-2)[..., 0, :]
        depths = np.sum(away * outward, axis=-1)  # before each side, negative behind it
        shallow = np.argmax(depths, axis=-1)
        depth = np.max(depths, axis=-1)
        within, far = depth <= 0.0, length(offset)
        inside = within | (far == 0.0)
        normals = np.where(inside[..., None], outward[shallow], unit(offset))
        return np.where(within, depth, far), normals

    def reach(self, places: Array, directions: Array) -> Array:
        """Return distances (…) [m] to the edge from points (…, 2) within, along unit vectors."""
        if self.outline is None:
            along = np.sum(places * directions, axis=-1)
            room = self.rounding**2 - np.sum(places * places, axis=-1) + along**2
            distance: Array = np.sqrt(np.maximum(room, 0.0)) - along
            return distance
        edges = np.roll(self.outline, -1, axis=0) - self.outline
        outward = unit(np.stack([-edges[:, 1], edges[:, 0]], axis=-1))  # of clockwise edges
        depths = np.sum(outward * self.outline, axis=-1) - places @ outward.T
        speeds = directions @ outward.T
        reached = np.divide(depths, speeds, out=np.full_like(speeds, np.inf), where=speeds > 0.0)
        nearest: Array = np.min(reached, axis=-1)
        return nearest

    def distance(self, places: Array) -> Array:
        """Return distances (…) [m] of points (…, 2), zero within."""
        return np.maximum(self.clearance(places)[0], 0.0)

    def segment_distance(self, first: Array, last: Array) -> Array:
        """Return distances (…) [m] of segments between points (…, 2), zero where they meet."""
        ends = np.stack([first, last], axis=-2)[..., None, :, :]
        sides = np.stack([self.core, np.roll(self.core, -1, axis=0)], axis=1)
        apart = np.min(length(shortest_offset(differences(ends, sides))), axis=-1)
        within = self.clearance(first)[0] <= 0.0
        distance: Array = np.where(within, 0.0, np.maximum(apart - self.rounding, 0.0))
        return distance

    def placed(self, at: ArrayLike, yaw: float) -> Array:
        """Return the core (m, 2) [m] turned by ``yaw`` [rad] and moved to ``at`` (2,) [m]."""
        c, s = math.cos(yaw), math.sin(yaw)
        placed: Array = self.core @ np.array([[c, s], [-s, c]]) + np.asarray(at)
        return placed


def _radius(radius: object) -> float:
    value = positive("radius", radius)
    if value > MAX_COORDINATE:
        raise InputError("radius", radius, f"at most {MAX_COORDINATE:g} m", "give it in metres")
    return value


def _clockwise(outline: ArrayLike) -> Array:
    """Return the corners of a convex outline, clockwise, from the one that was given first."""
    from scipy.spatial import ConvexHull, QhullError

    bound, remedy = "a list of at least 3 points [x, y]", "write [[x, y], …] in metres"
    given = points("outline", outline, (3, 2), bound, remedy)
    size = float(np.max(np.ptp(given, axis=0)))
    try:
        hull = ConvexHull(given)
    except QhullError:
        bound, remedy = "an outline around an area", "give three points that are not in line"
        raise InputError("outline", given.tolist(), bound, remedy) from None
    depths = np.max(given @ hull.equations[:, :2].T + hull.equations[:, 2], axis=1)
    deepest = int(np.argmin(depths))
    if depths[deepest] < -STRAIGHT * size:
        corners = given[hull.vertices[::-1]].round(4).tolist()
        raise InputError(
            f"outline[{deepest}]",
            given[deepest].tolist(),
            f"on the convex hull ({-depths[deepest]:.3g} m inside of it)",
            f"give the hull: {corners}",
        )
    kept = np.sort(hull.vertices)
    corners_in_order = given[kept]
    area = np.sum(
        corners_in_order[:, 0] * np.roll(corners_in_order[:, 1], -1)
        - corners_in_order[:, 1] * np.roll(corners_in_order[:, 0], -1)
    )
    found = corners_in_order if area < 0.0 else np.roll(corners_in_order[::-1], 1, axis=0)
    try:
        ConvexPolygon(found)
    except InputError as error:
        raise InputError("outline", error.value, error.bound, error.remedy) from None
    found = np.ascontiguousarray(found)
    found.setflags(write=False)
    return found
