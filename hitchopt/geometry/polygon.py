"""Convex polygons, numbered clockwise as in the paper. They have no cables."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from hitchopt.errors import InputError
from hitchopt.geometry.outline import Outline
from hitchopt.values import Array, finite, positive, whole


class ConvexPolygon(Outline):
    """A strictly convex polygon whose vertices run clockwise seen from above.

    Parameters
    ----------
    vertices: (n, 2) [m], n ≥ 3. Copied and set read-only.

    Raises
    ------
    InputError: wrong shape, not finite, coincident points, not clockwise or not convex.
    """

    closed: ClassVar[bool] = True

    @property
    def centroid(self) -> Array:
        """(2,) [m]: centre of the polygon's area."""
        origin = self.vertices[0]
        points = self.vertices - origin
        following = np.roll(points, -1, axis=0)
        cross = points[:, 0] * following[:, 1] - points[:, 1] * following[:, 0]
        moments: Array = np.sum((points + following) * cross[:, None], axis=0)
        centroid: Array = origin + moments / (3.0 * np.sum(cross))
        return centroid

    @property
    def area(self) -> float:
        """Enclosed area [m²]."""
        points = self.vertices - self.vertices[0]
        following = np.roll(points, -1, axis=0)
        return -0.5 * float(np.sum(points[:, 0] * following[:, 1] - points[:, 1] * following[:, 0]))

    def renumbered(self, shift: int) -> ConvexPolygon:
        """Return the same outline whose vertex 0 is this one's vertex ``shift``."""
        return ConvexPolygon(np.roll(self.vertices, -shift, axis=0))

    def _check_turns(self) -> None:
        super()._check_turns()
        turns = round(float(np.sum(self.exterior_angles)) / (2.0 * math.pi))
        if turns != 1:
            raise InputError(
                "polygon",
                self.vertices.tolist(),
                f"a simple polygon (it goes {turns} times around)",
                "list its points in clockwise order along the outline",
            )


def regular_polygon(n: int, edge: float, angle: float = 0.0) -> ConvexPolygon:
    """Return the regular n-gon about the origin.

    Parameters
    ----------
    n: number of vertices, at least 3.
    edge: length of an edge [m].
    angle: direction in which vertex 0 lies, counter-clockwise from +x [rad].

    Raises
    ------
    InputError: n below 3, or an edge that is not positive.
    """
    whole("n", n, 3)
    radius = 0.5 * positive("edge", edge) / math.sin(math.pi / n)
    angles = finite("angle", angle) - 2.0 * math.pi * np.arange(n) / n
    return ConvexPolygon(radius * np.column_stack([np.cos(angles), np.sin(angles)]))
