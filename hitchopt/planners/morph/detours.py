"""Detours of a whole hitch around obstacles: translations along a path, which change no shape.

Where the shapes of a path are feasible, only obstacles, walls and the ground restrict translations.
On a line of offsets each body is off each obstacle outside of one interval, since both are convex.
Detours are the shortest ways between these intervals from the start to the end of the path, found
on a grid of offsets and pulled taut as splines.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.vectors import EAST, left_of, length, unit
from hitchopt.hitch.quadratic_program import QuadraticProgram, solve_qp
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import Layout
from hitchopt.objects import Slab
from hitchopt.planners.path import FlatPath, drones_along
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import summed
from hitchopt.trajectory.splines import bspline, evenly_interpolated
from hitchopt.values import Array, Indices

SAMPLES = 97  # Number of points of the path at which offsets are free or not

HEADINGS = 48
"""Number of horizontal normals between bodies and obstacles; fewer keep corners too far away."""

CLEARANCE = 0.01  # [m] Distance in addition to the limit, for what the path does between the points
CLEARANCE_RAMP = 0.05  # Distance from an end in s over which this distance rises
MAX_STEP = 0.2  # [m] Largest change of the offset between two points, which crosses no obstacle
OFFSETS = 48  # Number of offsets of the grid to either side
MAX_OFFSET = 8.0  # [m] Largest offset

MIN_TRAVEL = 1e-3
"""[m] Smallest displacement of the middle across which detours lead; for smaller ones they lead
north, up and between."""

TILTS = tuple(math.radians(angle) for angle in (0.0, 45.0, 90.0, 135.0))
"""[rad] Angles of the lines of offsets, from the left of the path upwards."""

STAY = 0.25  # Length in s of both parts of a path on which a hitch stays, if it does
STAY_STEPS = 24  # Number of steps between the knots of such a path
DEGREE = 5  # Degree of the splines of offsets
PIECES = 14  # Number of pieces of these splines
BEND_WEIGHT = 1e-3  # Weight of squared second derivatives of offsets by s relative to first ones


class Translatable(FlatPath, Protocol):
    """A path of which the whole hitch can be translated."""

    def translated(self, by: PiecewisePolynomial) -> Self:
        """Return the path with a translation (3,) over s [m]."""


class Obstacle(NamedTuple):
    """A prism or a slab of an object, with the bodies of a team that keep a distance from it."""

    slab: Slab  # Its shape
    pose: Array  # (5,): place [m], cosine and sine of its yaw
    # Nodes (bodies, k) whose convex hulls are bodies, and the distance [m] that they keep
    bodies: list[tuple[Indices, float]]


AT_ORIGIN = np.array([0.0, 0.0, 0.0, 1.0, 0.0])  # Pose of prisms


def obstacles_of(
    layout: Layout, requirements: Requirements, carried: Sequence[tuple[Indices, float]] = ()
) -> Iterator[Obstacle]:
    """Yield the obstacles of a team; nodes are those of ``Layout.routes``.

    ``carried`` are bodies of an object that it carries, with their distance from others.
    """
    drones = layout.points + np.arange(2 * layout.robots)
    drone_nodes = np.column_stack([drones, drones])
    separation = requirements.separation
    drones_only = [(drone_nodes, separation.radius)]
    for prism in requirements.keep_out:
        yield Obstacle(prism.slab, AT_ORIGIN, drones_only)
    bodies = [*drones_only, (layout.part_nodes, separation.object), *carried]
    for body in requirements.objects.values():
        for slab in body.slabs:
            yield Obstacle(slab, body.pose, bodies)


def detours(path: Translatable, requirements: Requirements) -> list[PiecewisePolynomial]:
    """Return translations (3,) over s [m] around all obstacles, those on shorter paths first.

    If there are none, the hitch first moves aside or up where it is, and last to where it ends.
    """
    search = DetourSearch.of(path, requirements)
    found = search.all()
    if not found:
        stays = search.staying()
        staying = DetourSearch.of(path.translated(stays), requirements)
        found = [summed(shift, stays) for shift in staying.all()]
    return sorted(found, key=search.travel_with)


class Gaps(NamedTuple):
    """Offsets along a line that are not free, at the samples of a path."""

    # (J, intervals) [m]: lower ends; infinite where a body is off its obstacle on all offsets
    lower: Array
    upper: Array  # (J, intervals) [m]: upper ends
    least: Array  # (J,) [m]: smallest offset within the walls and above the ground
    largest: Array  # (J,) [m]: largest offset within the walls

    def free(self, offsets: Array) -> NDArray[np.bool_]:
        """Return which offsets (G,) are free at each sample, as (J, G)."""
        inside = (self.lower[..., None] < offsets) & (offsets < self.upper[..., None])
        within = (self.least[:, None] <= offsets) & (offsets <= self.largest[:, None])
        free: NDArray[np.bool_] = within & ~np.any(inside, axis=1)
        return free

    def are_free(self, offsets: Array) -> NDArray[np.bool_]:
        """Return which rows of offsets (W, J) are free at all samples within the path."""
        inner = offsets[:, 1:-1]
        each = inner[..., None]
        inside = np.any((self.lower[1:-1] < each) & (each < self.upper[1:-1]), axis=-1)
        within = (self.least[1:-1] <= inner) & (inner <= self.largest[1:-1])
        free: NDArray[np.bool_] = np.all(within & ~inside, axis=1)
        return free

    def around(self, offsets: Array) -> tuple[Array, Array]:
        """Return the ends (J,) of the free intervals that contain free offsets (J,)."""
        is_below = self.upper <= offsets[:, None]
        below = np.max(np.where(is_below, self.upper, -np.inf), axis=1, initial=-np.inf)
        is_above = self.lower >= offsets[:, None]
        above = np.min(np.where(is_above, self.lower, np.inf), axis=1, initial=np.inf)
        return np.maximum(below, self.least), np.minimum(above, self.largest)


@dataclass(frozen=True, eq=False)
class DetourSearch:
    """The search for translations of a path around obstacles."""

    layout: Layout  # Layout of the team
    # (J, nodes, 3) [m]: vertices, then drones, then points of a carried object, at the samples
    nodes: Array
    obstacles: Sequence[Obstacle]  # Obstacles, with the bodies that keep a distance from them
    requirements: Requirements  # Arena and floor
    clearance: float = CLEARANCE  # [m] Distance in addition to the limits

    @classmethod
    def of(cls, path: FlatPath, requirements: Requirements) -> Self:
        """Return the search along a path whose shapes are feasible."""
        s = np.linspace(0.0, 1.0, SAMPLES)
        vertices = path.flat(s, 1).vertices[..., 0]
        drones = drones_along(path, s).positions[..., 0]
        layout = path.team.layout
        obstacles = tuple(obstacles_of(layout, requirements))
        return cls(layout, np.concatenate([vertices, drones], axis=1), obstacles, requirements)

    @cached_property
    def s(self) -> Array:
        """(J,): the samples."""
        return np.linspace(0.0, 1.0, SAMPLES)

    @property
    def vertices(self) -> Array:
        """(J, points, 3) [m]: vertices at the samples."""
        return self.nodes[:, : self.layout.points]

    def all(self) -> list[PiecewisePolynomial]:
        """Return the translations along all lines of offsets."""
        return [shift for tilt in TILTS for shift in self.along(self.direction(tilt))]

    def staying(self) -> PiecewisePolynomial:
        """Return the translation that keeps the hitch's middle where it is near both ends."""
        every = (SAMPLES - 1) // STAY_STEPS
        middles = self.vertices.mean(axis=1)[::every]
        share = np.clip((self.s[::every] - STAY) / (1.0 - 2.0 * STAY), 0.0, 1.0)[:, None]
        progress = share * share * (3.0 - 2.0 * share)
        return evenly_interpolated(middles[0] + progress * (middles[-1] - middles[0]) - middles)

    def direction(self, tilt: float) -> Array:
        """Return the unit vector (3,) across the path, at an angle [rad] from its left upwards."""
        middles = self.vertices.mean(axis=1)[:, :2]
        left = left_of(unit(middles[-1] - middles[0], EAST[:2], MIN_TRAVEL))
        return np.append(math.cos(tilt) * left, math.sin(tilt))

    def travel_with(self, shift: PiecewisePolynomial) -> float:
        """Return the longest way of a vertex on a translated path [m]."""
        return self._travel(self.vertices + shift.at(self.s)[:, None])

    @staticmethod
    def _travel(vertices: Array) -> float:
        """Return the longest way [m] of vertices (J, points, 3) [m]: of the farthest one each."""
        return float(np.sum(np.max(length(np.diff(vertices, axis=0)), axis=1)))

    def along(self, direction: Array) -> Iterator[PiecewisePolynomial]:
        """Yield the translations along a line: the shortest one, and that to the other side."""
        gaps = self.gaps(direction)
        reach = np.array([np.min(gaps.lower, initial=0.0), np.max(gaps.upper, initial=0.0)])
        reach = np.clip(np.nan_to_num(reach, posinf=0.0, neginf=0.0), -MAX_OFFSET, MAX_OFFSET)
        step = max(float(np.ptp(reach)) / (2 * OFFSETS), MAX_STEP / OFFSETS)
        grid = step * np.arange(math.floor(reach[0] / step) - 1, math.ceil(reach[1] / step) + 2)
        found = list[Array]()
        for side in (grid >= 0.0, grid <= 0.0, np.ones(len(grid), dtype=np.bool_)):
            offsets = self.shortest(grid[side], gaps.free(grid[side]))
            if offsets is None or any(np.array_equal(offsets, other) for other in found):
                continue
            found.append(offsets)
            taut = self.pulled_taut(*gaps.around(offsets))
            if taut is not None:
                yield taut.replaced(taut.coefficients * direction[:, None])

    def gaps(self, direction: Array) -> Gaps:
        """Return the offsets along a direction (3,) that are not free."""
        ends = np.minimum(self.s, 1.0 - self.s)
        margins = self.clearance * np.minimum(ends / CLEARANCE_RAMP, 1.0)
        lower = [np.empty((SAMPLES, 0))]
        upper = [np.empty((SAMPLES, 0))]
        for obstacle in self.obstacles:
            for nodes, distance in obstacle.bodies:
                interval = self._blocked(obstacle, nodes, distance + margins, direction)
                lower.append(interval[0])
                upper.append(interval[1])
        least, largest = self._within_walls(direction)
        return Gaps(np.concatenate(lower, axis=1), np.concatenate(upper, axis=1), least, largest)

    def _blocked(
        self, obstacle: Obstacle, ends: Indices, distances: Array, direction: Array
    ) -> tuple[Array, Array]:
        """Return the offsets (J, bodies) [m] between which bodies are near an obstacle.

        Parameters
        ----------
        ends: (bodies, k), nodes whose convex hulls are bodies.
        distances: (J,) [m], kept at the samples.
        """
        angles = 2.0 * math.pi / HEADINGS * np.arange(HEADINGS)
        level = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(HEADINGS)])
        normals = np.concatenate([level, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])
        place, (cosine, sine) = obstacle.pose[:3], obstacle.pose[3:]
        from_slab = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        support = obstacle.slab.support(normals @ from_slab) + normals @ place
        height_ratios = 1.0 + (self.requirements.height_ratio - 1.0) * np.abs(normals[:, 2])
        nearest = np.min((self.nodes @ normals.T)[:, ends], axis=2)  # (J, bodies, normals)
        missing = support + distances[:, None, None] * height_ratios - nearest
        rates = normals @ direction
        with np.errstate(divide="ignore", invalid="ignore"):
            offsets = missing / rates
        lower = np.max(np.where(rates < -EPS, offsets, -np.inf), axis=-1)
        upper = np.min(np.where(rates > EPS, offsets, np.inf), axis=-1)
        is_off = np.any((np.abs(rates) <= EPS) & (missing <= 0.0), axis=-1) | (lower >= upper)
        return np.where(is_off, np.inf, lower), np.where(is_off, -np.inf, upper)

    def _within_walls(self, direction: Array) -> tuple[Array, Array]:
        """Return the smallest and the largest offset (J,) along a direction within the walls.

        The ground counts as a wall, also without an arena.
        """
        requirements = self.requirements
        first, count = self.layout.points, 2 * self.layout.robots
        drones = self.nodes[:, first : first + count]
        lower = np.full(3, -np.inf)
        upper = np.full(3, np.inf)
        if requirements.arena is not None:
            lower, upper = requirements.arena.lower.copy(), requirements.arena.upper.copy()
        # Detours keep an ellipsoid's height above the ground, more than the arena's floor requires.
        # An end of the path that is lower lowers this bound: near it the path itself stays free
        lowest_end = np.min(drones[[0, -1], :, 2])
        ground = requirements.ground_or(-math.inf)
        lower[2] = min(lowest_end, ground + requirements.separation.height)
        least = np.full(SAMPLES, -np.inf)
        largest = np.full(SAMPLES, np.inf)
        for axis in np.flatnonzero(np.abs(direction) > EPS):
            to_walls = np.stack(
                [
                    lower[axis] - np.min(drones[..., axis], axis=1),
                    upper[axis] - np.max(drones[..., axis], axis=1),
                ]
            )
            # A negative direction exchanges the walls
            offsets_at_walls = np.sort(to_walls / direction[axis], axis=0)
            least = np.maximum(least, offsets_at_walls[0])
            largest = np.minimum(largest, offsets_at_walls[1])
        return least, largest

    def shortest(self, grid: Array, free: NDArray[np.bool_]) -> Array | None:
        """Return the offsets (J,) of the shortest free way from 0 to 0, or None without one.

        Parameters
        ----------
        grid: (G,) [m], offsets with 0 among them.
        free: (J, G), whether they are free.
        """
        origin = int(np.argmin(np.abs(grid)))
        along = self._travel(self.vertices) / (SAMPLES - 1)
        changes = np.abs(grid[:, None] - grid)
        steps = np.where(changes <= MAX_STEP, np.hypot(along, changes), np.inf)
        ways = np.full(len(grid), np.inf)
        ways[origin] = 0.0
        before = np.zeros((SAMPLES, len(grid)), dtype=np.intp)
        for j in range(1, SAMPLES):
            through = ways + steps  # (to, from)
            before[j] = np.argmin(through, axis=1)
            ways = np.min(through, axis=1)
            if j < SAMPLES - 1:
                ways[~free[j]] = np.inf
        if not math.isfinite(ways[origin]):
            return None
        indices = np.full(SAMPLES, origin)
        for j in range(SAMPLES - 1, 0, -1):
            indices[j - 1] = before[j, indices[j]]
        offsets: Array = grid[indices]
        return offsets

    def pulled_taut(self, lower: Array, upper: Array) -> PiecewisePolynomial | None:
        """Return the tautest spline of offsets over s between bounds (J,) [m], or None.

        It is zero at both ends.
        """
        from scipy.sparse import csc_array

        knots = np.concatenate(
            [np.zeros(DEGREE), np.linspace(0.0, 1.0, PIECES + 1), np.ones(DEGREE)]
        )
        count = PIECES + DEGREE
        basis = bspline(knots, np.eye(count), DEGREE)
        jets = basis.jet(self.s, 3)  # (J, count, 3)
        slopes, bends = jets[..., 1], jets[..., 2]
        hessian = (slopes.T @ slopes + BEND_WEIGHT * bends.T @ bends) / SAMPLES
        hessian += REGULARISATION * np.eye(count)
        bounds = np.full(count, FAR)
        bounds[[0, -1]] = 0.0
        program = QuadraticProgram(
            P=csc_array(hessian),
            q=np.zeros(count),
            A=csc_array(jets[1:-1, :, 0]),
            lower=np.maximum(lower[1:-1], -FAR),
            upper=np.minimum(upper[1:-1], FAR),
            x_min=-bounds,
            x_max=bounds,
        )
        coefficients = solve_qp(program)
        return None if coefficients is None else bspline(knots, coefficients[:, None], DEGREE)


FAR = 100.0  # [m] Bound of offsets that are not bounded, as the solver expects
EPS = 1e-9  # Smallest rate of a coordinate along a line that is not parallel to a plane
REGULARISATION = 1e-9  # Added to the Hessian's diagonal
