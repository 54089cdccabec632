"""Requirements of a plan: limits of motion, distances, the arena and keep-out volumes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InputError
from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.vectors import first_smallest
from hitchopt.values import Array, acute, finite, not_negative, positive


@dataclass(frozen=True)
class Limits:
    """Limits of motion; all norms are Euclidean.

    Parameters
    ----------
    speed: largest speed of every drone [m/s]
    acceleration: largest acceleration of every drone [m/s²]
    jerk: largest jerk of every drone [m/s³]
    tilt: largest angle of the thrust from vertical [rad], below π/2
    vertex_speed: largest speed of every vertex of the hitch [m/s]
    leg: shortest leg, vertex to drone, while the hitch holds [m]
    duration: largest duration of the whole plan [s], or None
    body_rate: largest turning rate of every drone's thrust vector [rad/s], or None
    """

    speed: float = 1.0
    acceleration: float = 2.0
    jerk: float = 20.0
    tilt: float = math.radians(45.0)
    vertex_speed: float = 0.5
    leg: float = 0.15
    duration: float | None = None
    body_rate: float | None = None

    def __post_init__(self) -> None:
        for name in ("speed", "acceleration", "jerk", "tilt", "vertex_speed", "leg"):
            object.__setattr__(self, name, positive(name, getattr(self, name)))
        acute("tilt", self.tilt)
        for name in ("duration", "body_rate"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, positive(name, getattr(self, name)))


@dataclass(frozen=True)
class Separation:
    """Smallest distances between drones and cables.

    Parameters
    ----------
    radius, height: semi-axes of a drone's ellipsoid [m] (Preiss et al. 2017)
    cable: distance of a drone to any cable but its own, and to its own edge [m]
    crossing: distance of taut cable parts that share no clasp [m]
    """

    radius: float = 0.12
    height: float = 0.30
    cable: float = 0.10
    crossing: float = 0.05

    def __post_init__(self) -> None:
        for name in ("radius", "height"):
            object.__setattr__(self, name, positive(name, getattr(self, name)))
        for name in ("cable", "crossing"):
            object.__setattr__(self, name, not_negative(name, getattr(self, name)))

    @property
    def scale(self) -> Array:
        """Factors (3,) [1/m]: ``separation`` is the norm of two drones' offset times these."""
        across, upward = 0.5 / self.radius, 0.5 / self.height
        return np.array([across, across, upward])


@dataclass(frozen=True, eq=False)
class Arena:
    """A box that the drones stay in.

    Parameters
    ----------
    lower, upper: opposite corners (3,) [m]
    """

    lower: Array
    upper: Array

    def __init__(
        self, lower: Sequence[float] | ArrayLike, upper: Sequence[float] | ArrayLike
    ) -> None:
        for name, corner in (("lower", lower), ("upper", upper)):
            try:
                given = list(corner)  # type: ignore[arg-type]
            except TypeError:
                given = []
            if len(given) != 3:
                raise InputError(name, corner, "a point [x, y, z]", "give three numbers in metres")
            point = np.array([finite(f"{name}[{i}]", x) for i, x in enumerate(given)])
            point.setflags(write=False)
            object.__setattr__(self, name, point)
        if not np.all(self.lower < self.upper):
            bound = f"greater than lower {self.lower.tolist()} on every axis"
            remedy = "exchange the corners or move them apart"
            raise InputError("upper", self.upper.tolist(), bound, remedy)


@dataclass(frozen=True, eq=False)
class Clearance:
    """Distances of points to a prism.

    Attributes
    ----------
    distance: signed distances (…) [m]; inside, minus the depth below the nearest face.
    normals: unit vectors (…, 3) along which the distance grows.
    """

    distance: Array
    normals: Array


@dataclass(frozen=True, eq=False)
class Prism:
    """An upright prism to which drones keep a distance of at least ``Separation.radius``.

    Parameters
    ----------
    polygon: its outline, (m, 2) [m], convex, clockwise seen from above.
    lower, upper: altitudes of its floor and its ceiling [m]

    Raises
    ------
    InputError: the outline is not convex and clockwise, or the ceiling is not above the floor.
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
            bound = f"greater than lower {self.lower:g}"
            remedy = "exchange the altitudes or move them apart"
            raise InputError("upper", self.upper, bound, remedy)

    @property
    def corners(self) -> Array:
        """Corners of floor and ceiling (2 m, 3) [m]."""
        outline = self.polygon.vertices
        levels = np.repeat([self.lower, self.upper], len(outline))
        return np.column_stack([np.vstack([outline, outline]), levels])

    def clearance(self, points: Array) -> Clearance:
        """Return the distances of points (…, 3) [m] to the prism and the directions out of it."""
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


@dataclass(frozen=True, eq=False)
class Requirements:
    """All that a plan must satisfy at every time.

    Parameters
    ----------
    limits: limits of motion.
    separation: distances between drones and cables.
    arena: the box that the drones stay in, or None.
    keep_out: prisms that the drones stay out of.
    """

    limits: Limits = field(default_factory=Limits)
    separation: Separation = field(default_factory=Separation)
    arena: Arena | None = None
    keep_out: tuple[Prism, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "keep_out", tuple(self.keep_out))

    @property
    def floor(self) -> float:
        """Height of the ground [m]: the arena's floor, or 0 where there is no arena."""
        return 0.0 if self.arena is None else float(self.arena.lower[2])

    @property
    def untimed(self) -> Requirements:
        """The same requirements without a limit on the plan's duration."""
        return replace(self, limits=replace(self.limits, duration=None))
