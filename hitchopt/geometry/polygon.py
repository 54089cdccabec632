"""Convex polygons, numbered clockwise as in the paper. They know no cable."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InputError

MIN_EXTERIOR_ANGLE = 1e-6
"""[rad] A flatter vertex is no vertex: the clasp there would hold nothing."""

MIN_EDGE = 1e-6
"""[m] Points closer than this are taken to be the same."""

MAX_COORDINATE = 1e5
"""[m] Beyond this double precision no longer resolves the tolerances of a plan."""


@dataclass(frozen=True, eq=False)
class ConvexPolygon:
    """A strictly convex polygon whose vertices run clockwise seen from above.

    Parameters
    ----------
    vertices: (n, 2) [m], n ≥ 3. Copied and set read-only.

    Raises
    ------
    InputError: wrong shape, not finite, coincident points, not clockwise or not convex.
    """

    vertices: NDArray[np.float64]

    def __init__(self, vertices: ArrayLike) -> None:
        points = _as_points(vertices)
        points.setflags(write=False)
        object.__setattr__(self, "vertices", points)
        self._check_shape()

    def __len__(self) -> int:
        return len(self.vertices)

    def __iter__(self) -> Iterator[NDArray[np.float64]]:
        return iter(self.vertices)

    @property
    def edge_vectors(self) -> NDArray[np.float64]:
        """(n, 2) [m]: ``p_{k+1} - p_k``."""
        return np.roll(self.vertices, -1, axis=0) - self.vertices

    @property
    def edge_lengths(self) -> NDArray[np.float64]:
        """(n,) [m]: ``l_k``."""
        edges = self.edge_vectors
        lengths: NDArray[np.float64] = np.hypot(edges[:, 0], edges[:, 1])
        return lengths

    @property
    def edge_directions(self) -> NDArray[np.float64]:
        """(n, 2): unit vectors ``u_k``, eq. (1) of the paper."""
        return self.edge_vectors / self.edge_lengths[:, None]

    @property
    def exterior_angles(self) -> NDArray[np.float64]:
        """(n,) [rad]: by how much the outline turns right at each vertex; they sum to 2π."""
        ahead = self.edge_vectors
        behind = np.roll(ahead, 1, axis=0)
        right = behind[:, 1] * ahead[:, 0] - behind[:, 0] * ahead[:, 1]
        angles: NDArray[np.float64] = np.arctan2(right, np.sum(behind * ahead, axis=1))
        return angles

    @property
    def centroid(self) -> NDArray[np.float64]:
        """(2,) [m]: centre of the polygon's area."""
        origin = self.vertices[0]
        points = self.vertices - origin
        following = np.roll(points, -1, axis=0)
        cross = points[:, 0] * following[:, 1] - points[:, 1] * following[:, 0]
        moments: NDArray[np.float64] = np.sum((points + following) * cross[:, None], axis=0)
        centroid: NDArray[np.float64] = origin + moments / (3.0 * np.sum(cross))
        return centroid

    @property
    def area(self) -> float:
        """Enclosed area [m²]."""
        points = self.vertices - self.vertices[0]
        following = np.roll(points, -1, axis=0)
        return -0.5 * float(np.sum(points[:, 0] * following[:, 1] - points[:, 1] * following[:, 0]))

    def translated(self, offset: ArrayLike) -> ConvexPolygon:
        """Return the polygon moved by ``offset`` (2,) [m]."""
        return ConvexPolygon(self.vertices + np.asarray(offset, dtype=np.float64))

    def rotated(self, angle: float) -> ConvexPolygon:
        """Return the polygon turned counter-clockwise about the origin by ``angle`` [rad]."""
        c, s = math.cos(angle), math.sin(angle)
        return ConvexPolygon(self.vertices @ np.array([[c, s], [-s, c]]))

    def scaled(self, factor: float) -> ConvexPolygon:
        """Return the polygon scaled about its centroid by ``factor`` > 0."""
        centre = self.centroid
        return ConvexPolygon(centre + factor * (self.vertices - centre))

    def renumbered(self, shift: int) -> ConvexPolygon:
        """Return the same outline whose vertex 0 is this one's vertex ``shift``."""
        return ConvexPolygon(np.roll(self.vertices, -shift, axis=0))

    def mirrored(self) -> ConvexPolygon:
        """Return the mirror image in the y axis; the order is reversed to stay clockwise."""
        return ConvexPolygon((self.vertices * [-1.0, 1.0])[::-1])

    def _check_shape(self) -> None:
        lengths = self.edge_lengths
        shortest = int(np.argmin(lengths))
        n = len(self)
        if lengths[shortest] < MIN_EDGE:
            raise InputError(
                f"polygon[{shortest}]",
                self.vertices[shortest].tolist(),
                f"at least {MIN_EDGE:g} m away from polygon[{(shortest + 1) % n}]",
                "remove or move one of the coincident points",
            )
        angles = self.exterior_angles
        if np.all(angles < 0.0):
            raise InputError(
                "polygon",
                self.vertices.tolist(),
                "in clockwise order seen from above",
                "list its points in the reverse order",
            )
        flattest = int(np.argmin(angles))
        if angles[flattest] < MIN_EXTERIOR_ANGLE:
            raise InputError(
                f"polygon[{flattest}]",
                self.vertices[flattest].tolist(),
                f"a convex corner (it turns right by {math.degrees(angles[flattest]):.6g}°, "
                f"at least {math.degrees(MIN_EXTERIOR_ANGLE):.2g}° are needed)",
                "move the point outward, or list the points in clockwise order",
            )
        turns = round(float(np.sum(angles)) / (2.0 * math.pi))
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
    if n < 3:
        raise InputError("n", n, "at least 3", "a polygon has three vertices or more")
    radius = 0.5 * edge / math.sin(math.pi / n)
    angles = angle - 2.0 * math.pi * np.arange(n) / n
    return ConvexPolygon(radius * np.column_stack([np.cos(angles), np.sin(angles)]))


def _as_points(vertices: ArrayLike) -> NDArray[np.float64]:
    try:
        points = np.array(vertices, dtype=np.float64)
    except (TypeError, ValueError):
        points = np.empty(0)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3:
        raise InputError(
            "polygon", vertices, "a list of at least 3 points [x, y]", "write [[x, y], …] in metres"
        )
    bad = ~np.all(np.abs(points) <= MAX_COORDINATE, axis=1)  # also catches nan
    if np.any(bad):
        k = int(np.argmax(bad))
        raise InputError(
            f"polygon[{k}]",
            points[k].tolist(),
            f"finite and within ±{MAX_COORDINATE:g} m",
            "check the point's coordinates",
        )
    return points
