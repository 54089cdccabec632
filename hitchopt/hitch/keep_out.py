"""Where no drone may be: upright prisms over convex outlines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InputError
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch.values import finite

Array = NDArray[np.float64]


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

    def nearest(self, points: Array) -> Array:
        """Return the points of the prism that are nearest to ``points`` (…, 3), of that shape."""
        flat = np.reshape(points, (-1, 3))
        corners = self.polygon.vertices
        edges = self.polygon.edge_vectors
        away = flat[:, None, :2] - corners  # (points, m, 2)
        along = np.sum(away * edges, axis=-1) / np.sum(edges * edges, axis=-1)
        feet = corners + np.clip(along, 0.0, 1.0)[..., None] * edges
        closest = np.argmin(np.sum((flat[:, None, :2] - feet) ** 2, axis=-1), axis=1)
        # Clockwise: what lies to the right of every edge is inside.
        inside = np.all(edges[:, 0] * away[..., 1] - edges[:, 1] * away[..., 0] <= 0.0, axis=1)
        across = np.where(inside[:, None], flat[:, :2], feet[np.arange(len(flat)), closest])
        upward = np.clip(flat[:, 2:], self.lower, self.upper)
        return np.concatenate([across, upward], axis=1).reshape(np.shape(points))
