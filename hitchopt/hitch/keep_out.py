"""Where no drone may be: upright prisms over convex outlines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InputError
from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.vectors import first_smallest
from hitchopt.hitch.values import finite

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Clearance:
    """Where points are with respect to a prism.

    Attributes
    ----------
    distance: (…) [m], negative within it: how deep below the nearest face.
    normals: (…, 3), unit vectors along which the distance grows.
    """

    distance: Array
    normals: Array


@dataclass(frozen=True, eq=False)
class Prism:
    """An upright prism that drones stay out of, by ``Separation.radius`` or more.

    Parameters
    ----------
    polygon: its outline, (m, 2) [m], convex, clockwise seen from above.
    lower, upper: altitudes of its floor and its ceiling [m]

    Raises
    ------
    InputError: an outline that is not convex and clockwise, or a ceiling not above the floor.
    """

    polygon: ConvexPolygon
    lower: float
    upper: float

    def __init__(self, polygon: ConvexPolygon | ArrayLike, lower: float, upper: float) -> None:
        outline = polygon if isinstance(polygon, ConvexPolygon) else ConvexPolygon(polygon)
        object.__setattr__(self, "polygon", outline)
        object.__setattr__(self, "lower", finite("lower", lower))
        object.__setattr__(self, "upper", finite("upper", upper))
        if self.lower >= self.upper:
            raise InputError(
                "upper",
                self.upper,
                f"greater than lower {self.lower:g}",
                "exchange the altitudes or move them apart",
            )

    @property
    def corners(self) -> Array:
        """(2 m, 3) [m]."""
        outline = self.polygon.vertices
        levels = np.repeat([self.lower, self.upper], len(outline))
        return np.column_stack([np.vstack([outline, outline]), levels])

    def clearance(self, points: Array) -> Clearance:
        """Return how far points (…, 3) are from the prism, and the way out of it."""
        flat = np.reshape(points, (-1, 3))
        corners = self.polygon.vertices
        edges = self.polygon.edge_vectors
        lengths = np.linalg.norm(edges, axis=1)
        outward = np.column_stack([-edges[:, 1], edges[:, 0]]) / lengths[:, None]  # clockwise
        away = flat[:, None, :2] - corners  # (points, m, 2)
        along = np.sum(away * edges, axis=-1) / lengths**2
        feet = corners + np.clip(along, 0.0, 1.0)[..., None] * edges
        closest = np.argmin(np.sum((flat[:, None, :2] - feet) ** 2, axis=-1), axis=1)
        depths = np.sum(away * outward, axis=-1)  # before each side, negative behind it
        within = np.all(depths <= 0.0, axis=1)
        across = np.where(within[:, None], flat[:, :2], feet[np.arange(len(flat)), closest])
        nearest = np.column_stack([across, np.clip(flat[:, 2], self.lower, self.upper)])
        offset = flat - nearest
        distance = np.linalg.norm(offset, axis=1)
        sides = np.column_stack([outward, np.zeros(len(outward))])
        faces = np.vstack([sides, [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]])
        behind = np.column_stack([depths, self.lower - flat[:, 2], flat[:, 2] - self.upper])
        shallow = first_smallest(-behind, np.max(np.abs(behind), axis=1))
        outside = distance > 0.0
        safe = np.where(outside, distance, 1.0)
        normals = np.where(outside[:, None], offset / safe[:, None], faces[shallow])
        signed = np.where(outside, distance, behind[np.arange(len(flat)), shallow])
        shape = np.shape(points)
        return Clearance(signed.reshape(shape[:-1]), normals.reshape(shape))
