"""Shortest routes around prisms, for one drone at a time: through corners that see each other.

Corners stand off the prisms by a little more than drones must. They are taken at the altitudes of
a drone's start and goal and just above and below the prisms: routes are shortest among those.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra

from hitchopt.errors import InfeasibleError, Violation, check_time
from hitchopt.geometry.vectors import GOLDEN, TIE, unit
from hitchopt.hitch.requirements import Prism
from hitchopt.planners.separation.task import SeparationTask
from hitchopt.values import Array

STAND_OFF = 1.25
"""Distance of a route's corners to prisms, in radii; the radius itself where that shuts all."""

HIGH = 1e6
"""[m] Altitude above, and depth below, everything that flies."""

TIGHT = 1e-6
"""Smallest distance of a route's corners to what they stay out of, relative to the radius."""


@dataclass(frozen=True, eq=False)
class Routes:
    """Routes of all drones.

    Attributes
    ----------
    corners: (N,) lists of points (m, 3) [m], from start to goal.
    lengths: (N,) [m]
    """

    corners: tuple[Array, ...]
    lengths: Array

    def points(self, shares: Array) -> Array:
        """Return the points (N, m, 3) [m] of all routes at shares (N, m) of their lengths."""
        first = np.stack([route[0] for route in self.corners])
        last = np.stack([route[-1] for route in self.corners])
        points: Array = first[:, None] + shares[..., None] * (last - first)[:, None]
        for i in self.bent:
            points[i] = self.of(i, shares[i])
        return points

    @property
    def bent(self) -> list[int]:
        """The drones whose routes are not straight lines."""
        return [i for i, route in enumerate(self.corners) if len(route) > 2]

    def of(self, drone: int, share: Array) -> Array:
        """Return the points (*share.shape, 3) [m] of one route at shares of its length."""
        corners = self.corners[drone]
        steps = np.linalg.norm(np.diff(corners, axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        along = along / along[-1] if along[-1] > 0.0 else np.linspace(0.0, 1.0, len(corners))
        return np.stack([np.interp(share, along, corners[:, axis]) for axis in range(3)], axis=-1)


def routes_around(task: SeparationTask) -> Routes:
    """Return the shortest routes: straight lines where no prism is in between.

    Blocked ones are searched one by one, each among the corners of all prisms.

    Raises
    ------
    InfeasibleError: every route that was found is too narrow.
    """
    radius = task.requirements.separation.radius
    corners = list(np.stack([task.start, task.goal], axis=1))
    blocked = np.zeros(task.drones, dtype=np.bool_)
    for prism in task.requirements.keep_out:
        blocked |= _Solid.around(prism, radius * (1.0 - TIGHT)).cuts(task.start, task.goal)
    lengths = np.linalg.norm(task.goal - task.start, axis=1)
    for i in np.flatnonzero(blocked).tolist():
        check_time()
        start, goal = task.start[i], task.goal[i]
        route = _route(task, start, goal, STAND_OFF * radius)
        if route is None:
            route = _route(task, start, goal, radius * (1.0 + TIGHT))
        if route is None:
            remedy = "widen the gap between the prisms, or between them and the arena"
            when, where = "on every route found from its start to its goal", (task.names[i],)
            shut = Violation("keep_out", 0.0, radius, "min", "m", where, when, remedy)
            raise InfeasibleError([shut])
        corners[i] = route
        lengths[i] = np.sum(np.linalg.norm(np.diff(route, axis=0), axis=1))
    return Routes(tuple(corners), lengths)


def _route(task: SeparationTask, start: Array, goal: Array, distance: float) -> Array | None:
    """Return the shortest route whose corners keep a distance [m] from all prisms, or None."""
    prisms = task.requirements.keep_out
    solids = [_Solid.around(prism, distance * (1.0 - TIGHT)) for prism in prisms]
    # Ends may stand closer to a prism than corners do: then only what they must keep counts there.
    ends = np.stack([start, goal])
    least_distance = min(distance, task.requirements.separation.radius) * (1.0 - TIGHT)
    least = [_Solid.around(prism, least_distance) for prism in prisms]
    if not any(solid.cuts(start[None], goal[None])[0] for solid in least):
        return ends
    flat = np.vstack([_widened(prism.polygon.vertices, distance) for prism in prisms])
    levels = [[prism.lower - distance, prism.upper + distance] for prism in prisms]
    heights = np.unique([[start[2], goal[2]], *levels])
    nodes = np.column_stack([np.tile(flat, (len(heights), 1)), np.repeat(heights, len(flat))])
    nodes = np.vstack([nodes, *(_over(prism, start, goal, distance) for prism in prisms)])
    arena = task.requirements.arena
    if arena is not None:
        nodes = nodes[np.all((nodes >= arena.lower) & (nodes <= arena.upper), axis=1)]
    for solid in solids:
        nodes = nodes[~solid.holds(nodes)]
    nodes = np.vstack([ends, nodes])
    i, j = np.triu_indices(len(nodes), 1)
    seen = np.ones(len(i), dtype=np.bool_)
    for group, at in ((least, i < 2), (solids, i >= 2)):
        for solid in group:
            seen[at] &= ~solid.cuts(nodes[i[at]], nodes[j[at]])
    i, j = i[seen], j[seen]
    length = np.linalg.norm(nodes[i] - nodes[j], axis=1)
    # Of routes that are equally long, one is preferred by its places.
    places = nodes @ np.array([1.0, GOLDEN, GOLDEN**2])
    places = (places - np.min(places)) / max(float(np.ptp(places)), 1e-9)
    preferred = length + TIE * float(np.max(length)) * (places[i] + places[j])
    graph = sp.csr_matrix((preferred, (i, j)), shape=(len(nodes), len(nodes)))
    distances, before = dijkstra(
        graph, directed=False, indices=np.array([0]), return_predecessors=True
    )
    if not np.isfinite(distances[0, 1]):
        return None
    route = [1]
    while route[-1] != 0:
        route.append(int(before[0, route[-1]]))
    return nodes[route[::-1]]


def _over(prism: Prism, start: Array, goal: Array, distance: float) -> Array:
    """Return points (m, 3) over and under a prism where the straight route enters and leaves."""
    tower = _Solid.around(Prism(prism.polygon, -HIGH, HIGH), distance)
    into, out = tower.crossed(start[None], goal[None])
    if not into[0] < out[0]:
        return np.zeros((0, 3))
    flat = start[:2] + np.array([[into[0]], [out[0]]]) * (goal - start)[:2]
    levels = np.repeat([prism.lower - distance, prism.upper + distance], 2)
    return np.column_stack([np.vstack([flat, flat]), levels])


@dataclass(frozen=True, eq=False)
class _Solid:
    """A prism widened by a distance, as half spaces normals · p < offsets."""

    normals: Array
    offsets: Array

    @classmethod
    def around(cls, prism: Prism, distance: float) -> _Solid:
        edges = prism.polygon.edge_vectors
        sides = unit(np.column_stack([-edges[:, 1], edges[:, 0], np.zeros(len(edges))]))
        reach = np.sum(sides[:, :2] * prism.polygon.vertices, axis=1)
        normals = np.vstack([sides, [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]])
        return cls(normals, np.concatenate([reach, [-prism.lower, prism.upper]]) + distance)

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """Return whether points (m, 3) are within, (m,)."""
        within: NDArray[np.bool_] = np.all(points @ self.normals.T < self.offsets, axis=1)
        return within

    def cuts(self, first: Array, last: Array) -> NDArray[np.bool_]:
        """Return whether segments between points (m, 3) pass through, (m,)."""
        into, out = self.crossed(first, last)
        return into < out

    def crossed(self, first: Array, last: Array) -> tuple[Array, Array]:
        """Return the shares (m,) where segments enter and leave; they miss it if enter ≥ leave."""
        before = first @ self.normals.T - self.offsets
        after = last @ self.normals.T - self.offsets
        change = after - before
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = -before / change
        into = np.max(np.where(change < 0.0, crossing, 0.0), axis=1, initial=0.0)
        out = np.min(np.where(change > 0.0, crossing, 1.0), axis=1, initial=1.0)
        aside = np.any((change == 0.0) & (before >= 0.0), axis=1)  # along a side, outside of it
        return np.where(aside, 1.0, into), out


def _widened(outline: Array, distance: float) -> Array:
    """Return the corners of a clockwise outline whose sides are moved out by a distance [m]."""
    edges = np.roll(outline, -1, axis=0) - outline
    outward = unit(np.column_stack([-edges[:, 1], edges[:, 0]]))
    middle = np.roll(outward, 1, axis=0) + outward
    widened: Array = outline + 2.0 * distance * middle / np.sum(middle**2, axis=1, keepdims=True)
    return widened
