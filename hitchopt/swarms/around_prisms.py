"""Shortest routes around prisms: paths in a graph of the corners that see each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra

from hitchopt.errors import InfeasibleError, Violation, check_time
from hitchopt.geometry.vectors import GOLDEN, TIE, left_of, length, unit
from hitchopt.hitch.requirements import Arena, Prism
from hitchopt.swarms.task import SeparationTask
from hitchopt.values import Array, Indices

CORNER_DISTANCE = 1.25
"""Distance of a route's corners to prisms, in radii; 1 if there is no such route."""

TOWER_HEIGHT = 1e6  # [m] Altitude above, and depth below, all flights
GAP_BISECTIONS = 12  # Number of bisections of the radius that locate the widest gap

GAP_SAMPLES = 2001
"""Number of samples of a route that tell which prisms are beside its narrowest part."""

BESIDE_GAP = 1.1  # Distance to a prism beside the widest gap, over that gap's
RADIUS_TOLERANCE = 1e-6  # Tolerance of distances to prisms, relative to the radius


def points_along(route: Array, shares: Array) -> Array:
    """Return the points (m, 3) [m] of a route (corners, 3) at shares (m,) of its length."""
    at_corners = np.append(0.0, np.cumsum(length(np.diff(route, axis=0))))
    distances = shares * at_corners[-1]
    coordinates = [np.interp(distances, at_corners, corners) for corners in route.T]
    return np.stack(coordinates, axis=-1)


def routes_around(task: SeparationTask) -> list[Array]:
    """Return shortest routes, N lists of corners (m, 3) [m]; straight without a prism between.

    Corners have slightly more than the required distance to prisms. Their altitudes are those of
    start and goal, and just above and below the prisms.

    Raises
    ------
    InfeasibleError: no route with the required distance was found; the violation gives the widest
        gap, and names the drone and the prisms beside the gap.
    """
    routes = list(np.stack([task.start, task.goal], axis=1))
    prisms = task.requirements.keep_out
    radius = task.requirements.separation.radius
    blocked = _blocked(prisms, radius, task.start, task.goal)
    for drone in np.flatnonzero(blocked).tolist():
        check_time()
        route = _route(task, routes[drone], radius, CORNER_DISTANCE * radius)
        if route is None:
            route = _route(task, routes[drone], radius, (1.0 + RADIUS_TOLERANCE) * radius)
        if route is None:
            raise InfeasibleError([_narrowness(task, routes[drone], task.names[drone])])
        routes[drone] = route
    return routes


def _narrowness(task: SeparationTask, ends: Array, name: str) -> Violation:
    """Return the violation of a drone for whom all gaps between its ends (2, 3) [m] are too narrow.

    The widest gap is found by bisection of the distance to prisms.
    """
    radius = task.requirements.separation.radius
    too_wide = radius
    widest = 0.0
    widest_route: Array | None = None
    for _ in range(GAP_BISECTIONS):
        distance = 0.5 * (widest + too_wide)
        route = _route(task, ends, distance, (1.0 + RADIUS_TOLERANCE) * distance)
        if route is None:
            too_wide = distance
        else:
            widest, widest_route = distance, route
    beside = list[str]()
    if widest_route is not None:
        points = points_along(widest_route, np.linspace(0.0, 1.0, GAP_SAMPLES))
        distances = np.array(
            [np.min(prism.clearance(points).distance) for prism in task.requirements.keep_out]
        )
        nearest = np.argsort(distances, kind="stable")[:2].tolist()
        beside = [task.prisms[k] for k in nearest if distances[k] < BESIDE_GAP * widest]
    return Violation(
        "keep_out",
        value=widest,
        limit=radius,
        sense="min",
        unit="m",
        where=(name, *beside),
        when="on every route found from its start to its goal",
        remedy="widen the gap between the prisms, or between them and the arena",
    )


def _blocked(
    prisms: Sequence[Prism], radius: float, first: Array, last: Array
) -> NDArray[np.bool_]:
    """Return the mask (m,) of segments between points (m, 3) closer to a prism than a radius [m].

    A segment is cut to its part inside of the prism with all faces moved outward. That part may
    still pass a corner, where these faces meet farther away than the distance.
    """
    blocked = np.zeros(len(first), dtype=np.bool_)
    distance = radius * (1.0 - RADIUS_TOLERANCE)
    for prism in prisms:
        entry, exit_ = _crossings(prism, distance, first, last)
        near = np.flatnonzero((entry < exit_) & ~blocked)
        start = first[near, :2]
        along = last[near, :2] - start
        entering = start + entry[near, None] * along
        leaving = start + exit_[near, None] * along
        distances = prism.slab.section.segment_distance(entering, leaving)
        blocked[near[distances < distance]] = True
    return blocked


def _route(task: SeparationTask, ends: Array, radius: float, distance: float) -> Array | None:
    """Return the shortest route (corners, 3) between ends (2, 3) [m], or None.

    It keeps the radius [m] to all prisms, and its corners a distance [m]. A route past some prisms
    that no other one blocks is the shortest past all of them: others are added until then.
    """
    blocking = list[Prism]()
    others = list(task.requirements.keep_out)
    route = ends
    while True:
        in_the_way = [bool(np.any(_blocked([p], radius, route[:-1], route[1:]))) for p in others]
        if not any(in_the_way):
            return route
        blocking += [prism for prism, blocks in zip(others, in_the_way, strict=True) if blocks]
        others = [prism for prism, blocks in zip(others, in_the_way, strict=True) if not blocks]
        corners = _corners(task.requirements.arena, blocking, ends, distance)
        nodes = np.vstack([ends, corners[~_blocked(blocking, radius, corners, corners)]])
        first, second = np.triu_indices(len(nodes), 1)
        visible = ~_blocked(blocking, radius, nodes[first], nodes[second])
        path = _shortest_path(nodes, first[visible], second[visible])
        if path is None:
            return None
        route = nodes[path]


def _corners(arena: Arena | None, prisms: Sequence[Prism], ends: Array, distance: float) -> Array:
    """Return the possible corners (m, 3) [m] of a route past prisms between ends (2, 3) [m].

    They are inside the arena, beside, above and below the prisms, and keep a distance [m] to them.
    """
    outlines = np.vstack([_widened(prism.polygon.vertices, distance) for prism in prisms])
    levels = [[prism.lower - distance, prism.upper + distance] for prism in prisms]
    heights = np.unique([*ends[:, 2], *np.ravel(levels)])
    if arena is not None:
        heights = heights[(heights >= arena.lower[2]) & (heights <= arena.upper[2])]
    beside = np.column_stack(
        [np.tile(outlines, (len(heights), 1)), np.repeat(heights, len(outlines))]
    )
    over = [_points_over(prism, ends, distance) for prism in prisms]
    corners = np.vstack([beside, *over])
    if arena is not None:
        corners = corners[np.all((corners >= arena.lower) & (corners <= arena.upper), axis=1)]
    return corners


def _shortest_path(nodes: Array, first: Indices, second: Indices) -> list[int] | None:
    """Return the shortest path of nodes (m, 3) [m] from the first to the second one, or None.

    Parameters
    ----------
    first, second: (edges,), nodes that are joined.
    """
    edge_lengths = length(nodes[first] - nodes[second])
    # Coordinates resolve ties between routes of equal length.
    preference = nodes @ np.array([1.0, GOLDEN, GOLDEN**2])
    preference = (preference - np.min(preference)) / max(float(np.ptp(preference)), 1e-9)
    tie = TIE * float(np.max(edge_lengths, initial=0.0))
    costs = edge_lengths + tie * (preference[first] + preference[second])
    graph = sp.csr_matrix((costs, (first, second)), shape=(len(nodes), len(nodes)))
    distances, previous = dijkstra(
        graph, directed=False, indices=np.array([0]), return_predecessors=True
    )
    if not np.isfinite(distances[0, 1]):
        return None
    path = [1]
    while path[-1] != 0:
        path.append(int(previous[0, path[-1]]))
    return path[::-1]


def _points_over(prism: Prism, ends: Array, distance: float) -> Array:
    """Return points (m, 3) over and under a prism at both crossings with the straight route."""
    tower = Prism(prism.polygon, -TOWER_HEIGHT, TOWER_HEIGHT)
    (entry,), (exit_,) = _crossings(tower, distance, ends[:1], ends[1:])
    if entry >= exit_:
        return np.zeros((0, 3))
    start = ends[0, :2]
    along = (ends[1] - ends[0])[:2]
    crossings = start + np.array([[entry], [exit_]]) * along
    heights = np.repeat([prism.lower - distance, prism.upper + distance], 2)
    return np.column_stack([np.vstack([crossings, crossings]), heights])


def _crossings(prism: Prism, distance: float, first: Array, last: Array) -> tuple[Array, Array]:
    """Return the shares (m,) of segments at which they enter and exit a prism.

    Segments between points (m, 3) cross the prism widened by a distance [m]; those that miss it
    exit before they enter.
    """
    sides = unit(np.insert(left_of(prism.polygon.edge_vectors), 2, 0.0, axis=1))
    supports = np.sum(sides[:, :2] * prism.polygon.vertices, axis=1)
    normals = np.vstack([sides, [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]])
    offsets = np.concatenate([supports, [-prism.lower, prism.upper]]) + distance
    # Signed distances (m, faces) of the segments' ends to the faces, positive outside
    first_height = first @ normals.T - offsets
    last_height = last @ normals.T - offsets
    change = last_height - first_height
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = -first_height / change
    entry = np.max(np.where(change < 0.0, crossing, 0.0), axis=1, initial=0.0)
    exit_ = np.min(np.where(change > 0.0, crossing, 1.0), axis=1, initial=1.0)
    is_parallel_outside = np.any((change == 0.0) & (first_height >= 0.0), axis=1)
    return np.where(is_parallel_outside, 1.0, entry), exit_


def _widened(outline: Array, distance: float) -> Array:
    """Return the corners of a clockwise outline offset outward by a distance [m]."""
    edges = np.roll(outline, -1, axis=0) - outline
    outward = unit(left_of(edges))
    bisector = np.roll(outward, 1, axis=0) + outward
    squared = np.sum(bisector**2, axis=1, keepdims=True)
    widened: Array = outline + 2.0 * distance * bisector / squared
    return widened
