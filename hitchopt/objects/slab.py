"""Upright convex bodies between two heights, to which drones and cables keep a distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.geometry.vectors import first_smallest, length, unit
from hitchopt.objects.section import Section
from hitchopt.values import Array


@dataclass(frozen=True, eq=False)
class Clearance:
    """Distances of points to a body.

    Attributes
    ----------
    distance: signed distances (…) [m]; inside, minus the depth below the nearest face.
    normals: unit vectors (…, 3) along which the distance grows.
    """

    distance: Array
    normals: Array


@dataclass(frozen=True, eq=False)
class Slab:
    """A section between two heights.

    Attributes
    ----------
    section: seen from above.
    lower, upper: heights of its floor and its ceiling [m]
    """

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
        across, ways = self.section.clearance(places[..., :2])
        below, above = self.lower - places[..., 2], places[..., 2] - self.upper
        vertical = np.maximum(below, above)
        upward = np.where(above >= below, 1.0, -1.0)
        beside, beyond = np.maximum(across, 0.0), np.maximum(vertical, 0.0)
        offset = np.concatenate([beside[..., None] * ways, (beyond * upward)[..., None]], axis=-1)
        outside = (beside > 0.0) | (beyond > 0.0)
        behind = np.stack([across, below, above], axis=-1)
        shallow = first_smallest(-behind, np.max(np.abs(behind), axis=-1))[..., None]
        faces = np.zeros((*shallow.shape, 3)).reshape(*shallow.shape[:-1], 3)
        level = shallow == 0
        faces[..., :2] = np.where(level, ways, 0.0)
        faces[..., 2] = np.where(level[..., 0], 0.0, np.where(shallow[..., 0] == 1, -1.0, 1.0))
        normals = np.where(outside[..., None], unit(offset), faces)
        inside = np.take_along_axis(behind, shallow, axis=-1)[..., 0]
        return Clearance(np.where(outside, length(offset), inside), normals)
