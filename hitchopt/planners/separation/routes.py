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

    corners: list[Array]
    lengths: Array

    def points(self, shares: Array) -> Array:
        """Return the points (N, m, 3) [m] of all routes at shares (N, m) of their lengths."""
        first, last = (np.stack([route[end] for route in self.corners]) for end in (0, -1))
        points: Array = first[:, None] + shares[..., None] * (last - first)[:, None]
        for i in (i for i, route in enumerate(self.corners) if len(route) > 2):
            steps = np.linalg.norm(np.diff(self.corners[i], axis=0), axis=1)
            along = np.append(0.0, np.cumsum(steps) / np.sum(steps))
            for axis in range(3):
                points[i, :, axis] = np.interp(shares[i], along, self.corners[i][:, axis])
        return points


def routes_around(task: SeparationTask) -> Routes:
    """Return the shortest routes: straight lines where no prism is in between.

    Raises
    ------
    InfeasibleError: every route that was found is too narrow.
    """
    radius = task.requirements.separation.radius
    corners = list(np.stack([task.start, task.goal], axis=1))
    lengths = np.linalg.norm(task.goal - task.start, axis=1)
    for i in np.flatnonzero(_blocked(task, task.start, task.goal)).tolist():
        check_time()
        route = _route(task, corners[i], STAND_OFF * radius)
        if route is None:
            route = _route(task, corners[i], radius * (1.0 + TIGHT))
        if route is None:
            remedy = "widen the gap between the prisms, or between them and the arena"
            when, where = "on every route found from its start to its goal", (task.names[i],)
            shut = Violation("keep_out", 0.0, radius, "min", "m", where, when, remedy)
            raise InfeasibleError([shut])
        corners[i] = route
        lengths[i] = np.sum(np.linalg.norm(np.diff(route, axis=0), axis=1))
    return Routes(corners, lengths)


def _blocked(task: SeparationTask, first: Array, last: Array) -> NDArray[np.bool_]:
    """Return whether segments between points (m, 3) come too close to a prism, (m,)."""
    blocked = np.zeros(len(first), dtype=np.bool_)
    for prism in task.requirements.keep_out:
        reach = task.requirements.separation.radius * (1.0 - TIGHT)
        into, out = _crossed(prism, reach, first, last)
        blocked |= into < out
    return blocked


def _route(task: SeparationTask, ends: Array, distance: float) -> Array | None:
    """Return the shortest route whose corners keep a distance [m] from all prisms, or None."""
    prisms, arena = task.requirements.keep_out, task.requirements.arena
    flat = np.vstack([_widened(prism.polygon.vertices, distance) for prism in prisms])
    levels = [[prism.lower - distance, prism.upper + distance] for prism in prisms]
    heights = np.unique([ends[:, 2], *levels])
    nodes = np.column_stack([np.tile(flat, (len(heights), 1)), np.repeat(heights, len(flat))])
    nodes = np.vstack([nodes, *(_over(prism, ends, distance) for prism in prisms)])
    if arena is not None:
        nodes = nodes[np.all((nodes >= arena.lower) & (nodes <= arena.upper), axis=1)]
    nodes = np.vstack([ends, nodes[~_blocked(task, nodes, nodes)]])
    i, j = np.triu_indices(len(nodes), 1)
    seen = ~_blocked(task, nodes[i], nodes[j])
    i, j = i[seen], j[seen]
    length = np.linalg.norm(nodes[i] - nodes[j], axis=1)
    # Of routes that are equally long, one is preferred by its places.
    places = nodes @ np.array([1.0, GOLDEN, GOLDEN**2])
    places = (places - np.min(places)) / max(float(np.ptp(places)), 1e-9)
    preferred = length + TIE * float(np.max(length, initial=0.0)) * (places[i] + places[j])
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


def _over(prism: Prism, ends: Array, distance: float) -> Array:
    """Return points (m, 3) over and under a prism where the straight route enters and leaves."""
    tower = Prism(prism.polygon, -HIGH, HIGH)
    (into,), (out,) = _crossed(tower, distance, ends[:1], ends[1:])
    if into >= out:
        return np.zeros((0, 3))
    flat = ends[0, :2] + np.array([[into], [out]]) * (ends[1] - ends[0])[:2]
    levels = np.repeat([prism.lower - distance, prism.upper + distance], 2)
    return np.column_stack([np.vstack([flat, flat]), levels])


def _crossed(prism: Prism, distance: float, first: Array, last: Array) -> tuple[Array, Array]:
    """Return the shares (m,) where segments enter a widened prism and leave it.

    They miss it where they leave before they enter.
    """
    edges = prism.polygon.edge_vectors
    sides = unit(np.column_stack([-edges[:, 1], edges[:, 0], np.zeros(len(edges))]))
    reach = np.sum(sides[:, :2] * prism.polygon.vertices, axis=1)
    normals = np.vstack([sides, [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]])
    offsets = np.concatenate([reach, [-prism.lower, prism.upper]]) + distance
    before, after = (points @ normals.T - offsets for points in (first, last))
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
