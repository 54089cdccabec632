"""Outlines: convex polygons and convex arcs in the plane, clockwise."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import EXCHANGED, InputError
from hitchopt.geometry.vectors import cross, rotated, turn
from hitchopt.values import Array, ByValue, Points, finite, integer, points, positive
from hitchopt.values.fields import suggest_keywords

MIN_EXTERIOR_ANGLE = 1e-6
"""[rad] Smallest exterior angle: a clasp at a flatter vertex would hold nothing."""

MIN_EDGE = 1e-6  # [m] Smallest edge: closer points count as coincident


@dataclass(frozen=True, eq=False)
class Outline(ByValue, ABC):
    """A sequence of points that turns right at every corner.

    Parameters
    ----------
    vertices: (points, 2) [m], at least three. Copied and set read-only.

    Raises
    ------
    InputError: wrong shape, not finite, coincident points, not clockwise or not convex.
    """

    vertices: Array
    closed: ClassVar[bool]

    def __init__(self, vertices: Outline | Points) -> None:
        if isinstance(vertices, Outline):
            vertices = vertices.vertices
        bound, remedy = "a list of at least 3 points [x, y]", "write [[x, y], …] in metres"
        object.__setattr__(self, "vertices", points("polygon", vertices, (3, 2), bound, remedy))
        lengths = self.edge_lengths
        shortest = int(np.argmin(lengths))
        if lengths[shortest] < MIN_EDGE:
            bound = f"at least {MIN_EDGE:g} m away from polygon[{(shortest + 1) % len(self)}]"
            remedy = "remove or move one of the coincident points"
            raise self._error(bound, remedy, shortest)
        self._check_turns()

    def __len__(self) -> int:
        return len(self.vertices)

    def __iter__(self) -> Iterator[Array]:
        return iter(self.vertices)

    @cached_property
    def edge_vectors(self) -> Array:
        """(edges, 2) [m]: ``p_{k+1} - p_k``, read-only."""
        edges: Array = np.concatenate([self.vertices[1:], self.vertices[:1]]) - self.vertices
        edges.setflags(write=False)
        return edges if self.closed else edges[:-1]

    @property
    @abstractmethod
    def centroid(self) -> Array:
        """(2,) [m]: centre, the fixed point of scaling."""

    @property
    def corners(self) -> NDArray[np.intp]:
        """(corners,): indices of the points between two edges."""
        return np.arange(len(self)) if self.closed else np.arange(1, len(self) - 1)

    @cached_property
    def edge_lengths(self) -> Array:
        """(edges,) [m]: ``l_k``, read-only."""
        lengths: Array = np.hypot(*self.edge_vectors.T)
        lengths.setflags(write=False)
        return lengths

    @property
    def edge_directions(self) -> Array:
        """(edges, 2): unit vectors ``u_k``, eq. (1) of the paper."""
        return self.edge_vectors / self.edge_lengths[:, None]

    @property
    def exterior_angles(self) -> Array:
        """(corners,) [rad]: right turn of the outline at each corner."""
        edges = self.edge_vectors
        ahead, behind = edges[self.corners], edges[self.corners - 1]
        return turn(ahead, behind)

    def translated(self, offset: ArrayLike) -> Self:
        """Return the outline translated by ``offset`` (2,) [m]."""
        bound, remedy = "a displacement [dx, dy]", "specify two numbers [m]"
        return type(self)(self.vertices + points("offset", [offset], (1, 2), bound, remedy))

    def rotated(self, angle: float) -> Self:
        """Return the outline rotated counter-clockwise about the origin by ``angle`` [rad]."""
        return type(self)(rotated(self.vertices, finite("angle", angle)))

    def scaled(self, factor: float) -> Self:
        """Return the outline scaled about its centroid by ``factor`` > 0."""
        centre = self.centroid
        return type(self)(centre + positive("factor", factor) * (self.vertices - centre))

    def mirrored(self) -> Self:
        """Return the mirror image in the y axis, in reverse order to stay clockwise."""
        return type(self)((self.vertices * [-1.0, 1.0])[::-1])

    def _check_turns(self) -> None:
        angles = self.exterior_angles
        if (angles < 0.0).all():
            remedy = f"list its points in the reverse order{EXCHANGED}"
            raise self._error("in clockwise order seen from above", remedy)
        flattest = int(np.argmin(angles))
        if angles[flattest] < MIN_EXTERIOR_ANGLE:
            if self._is_straight:
                raise self._error("an outline: its points are on one line", "move one off the line")
            turn, min_turn = np.degrees([angles[flattest], MIN_EXTERIOR_ANGLE])
            is_left = f"left by {-turn:.4g}°, where clockwise outlines turn right"
            is_flat = f"right by {turn:.4g}°, not by at least {min_turn:.2g}°"
            bound = f"a convex corner: it turns {is_left if turn < 0.0 else is_flat}"
            remedy = "move the point outward"
            if turn < 0.0:
                remedy += ", or list the points in clockwise order"
            raise self._error(bound, remedy, int(self.corners[flattest]))

    @property
    def _is_straight(self) -> bool:
        """Whether all points are on one line, up to MIN_EXTERIOR_ANGLE."""
        offsets = self.vertices - np.mean(self.vertices, axis=0)
        length, width = np.linalg.svd(offsets, compute_uv=False)
        return bool(width <= MIN_EXTERIOR_ANGLE * length)

    def _error(self, bound: str, remedy: str, point: int | None = None) -> InputError:
        """Return an InputError about all points, or about one of them."""
        if point is None:
            return InputError("polygon", self.vertices.tolist(), bound, remedy)
        return InputError(f"polygon[{point}]", self.vertices[point].tolist(), bound, remedy)


class ConvexArc(Outline):
    """An open arc of points (n + 1, 2) [m], n ≥ 2, that turns by less than a full turn in total."""

    closed: ClassVar[bool] = False

    @property
    def centroid(self) -> Array:
        """(2,) [m]: centroid of the arc's length."""
        midpoints = 0.5 * (self.vertices[1:] + self.vertices[:-1])
        centroid: Array = np.average(midpoints, axis=0, weights=self.edge_lengths)
        return centroid

    def _check_turns(self) -> None:
        super()._check_turns()
        total = float(np.sum(self.exterior_angles))
        if total >= 2.0 * math.pi:
            turn = f"it turns by {math.degrees(total):.6g}°"
            remedy = "open the chain, or close it and write topology: closed"
            raise self._error(f"an arc that turns by less than 360° in all ({turn})", remedy)


def centroids(polygons: Array) -> Array:
    """Return the centroids (…, 2) [m] of the areas of polygons (…, n, 2) [m]."""
    points = polygons - polygons[..., :1, :]
    next_points = np.roll(points, -1, axis=-2)
    areas = cross(points, next_points)
    moments = np.sum((points + next_points) * areas[..., None], axis=-2)
    centres: Array = polygons[..., 0, :] + moments / (3.0 * np.sum(areas, axis=-1))[..., None]
    return centres


class ConvexPolygon(Outline):
    """A strictly convex polygon of vertices (n, 2) [m], n ≥ 3, clockwise seen from above."""

    closed: ClassVar[bool] = True

    @property
    def centroid(self) -> Array:
        """(2,) [m]: centroid of the polygon's area."""
        centroid: Array = centroids(self.vertices)
        return centroid

    @property
    def area(self) -> float:
        """Enclosed area [m²]."""
        x, y = (self.vertices - self.vertices[0]).T
        return -0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))

    def renumbered(self, shift: int) -> ConvexPolygon:
        """Return the same outline, starting at this one's vertex ``shift``."""
        return ConvexPolygon(np.roll(self.vertices, -shift, axis=0))

    def _check_turns(self) -> None:
        super()._check_turns()
        turns = round(float(np.sum(self.exterior_angles)) / (2.0 * math.pi))
        if turns != 1:
            remedy = "list its points in clockwise order along the outline"
            raise self._error(f"a simple polygon (it goes {turns} times around)", remedy)


@suggest_keywords
def regular_polygon(n: int, edge: float, angle: float = 0.0) -> ConvexPolygon:
    """Return the regular n-gon about the origin with edges of length ``edge`` [m].

    Vertex 0 lies at the angle ``angle``, counter-clockwise from +x [rad].

    Raises
    ------
    InputError: n below 3, or an edge that is not positive.
    """
    integer("n", n, 3)
    radius = 0.5 * positive("edge", edge) / math.sin(math.pi / n)
    angles = finite("angle", angle) - 2.0 * math.pi * np.arange(n) / n
    return ConvexPolygon(radius * np.column_stack([np.cos(angles), np.sin(angles)]))
