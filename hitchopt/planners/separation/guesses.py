"""Initial guesses: along routes around prisms, then pushed apart, or around a crowd.

They are deterministic and insensitive to rounding of the input.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.interpolate import interp1d
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from hitchopt.errors import InfeasibleError, Violation, check_time
from hitchopt.geometry.vectors import EAST, GOLDEN, TIE, left_of, length, unit
from hitchopt.hitch.requirements import Arena, Prism
from hitchopt.planners.separation.prioritized import Schedule
from hitchopt.planners.separation.task import END_COUNT, Grid, SeparationTask, Setting, inside
from hitchopt.planners.timing.ramps import fastest_ramps
from hitchopt.values import Array, Indices

RAMP_PIECES = 3
"""Number of pieces of a ramp, which resolve the fastest flight to within 2 %."""

MAX_CRUISE_PIECES = 20
"""Maximum number of pieces between the ramps; if there are fewer, each is as long as a ramp."""

MIN_RAMP_SHARE = 1e-5
"""Shortest ramp over the duration; splines do not resolve shorter ones."""

FIT_SAMPLES = 12
"""Number of samples of every piece through which nominal curves are fitted."""

MIN_ROUTE_RATIO = 1e-6
"""Length of the longest route, over the length scale, below which no drone moves."""

BREAK_ROUNDING = 1e-9
"""Rounding of the duration of the cruise [ramps], which adds no piece."""


def setting_of(task: SeparationTask, duration_ratio: float = 1.0) -> Setting:
    """Return the task on a grid for the drone with the longest flight; all leave at once.

    Parameters
    ----------
    duration_ratio: duration over that of the slowest flight, by which the grid has more pieces.

    Raises
    ------
    InfeasibleError: no route around the prisms was found.
    """
    limits = task.requirements.limits
    n = task.drones
    usable = limits.acceleration if task.acceleration is None else np.asarray(task.acceleration)
    acceleration = np.minimum(np.broadcast_to(usable, n), limits.acceleration)
    caps = np.stack([np.full(n, limits.speed), acceleration, np.full(n, limits.jerk)])
    routes = routes_around(task)
    route_lengths = np.array([np.sum(length(np.diff(route, axis=0))) for route in routes])
    distances = length(task.goal - task.start)
    bounds, _ = fastest_ramps(distances, limits.speed, acceleration, limits.jerk)
    durations, ramps = fastest_ramps(route_lengths, limits.speed, acceleration, limits.jerk)
    slowest = int(np.argmax(durations))
    duration = float(durations[slowest])
    ramp = max(float(ramps[slowest]), MIN_RAMP_SHARE * duration)
    diameter = 2.0 * task.requirements.separation.radius
    length_scale = max(float(np.max(route_lengths)), diameter)
    cruise = 0.0
    if float(route_lengths[slowest]) > MIN_ROUTE_RATIO * length_scale:
        cruise = max(duration_ratio * duration / ramp - 2.0, 0.0)
    breaks = _breaks(cruise, duration_ratio)
    grid = Grid(breaks / breaks[-1])
    s = _fit_samples(grid)
    progress = _progress(s, 1.0 / breaks[-1])
    targets = np.stack([points_along(route, progress) for route in routes])
    return Setting(
        task=task,
        grid=grid,
        nominal=_fitted(task, grid, targets),
        caps=caps,
        bound=float(np.max(bounds)),
        single_duration=duration,
        length_scale=length_scale,
    )


def _breaks(cruise: float, duration_ratio: float) -> Array:
    """Return the breaks (pieces + 1,) of the first ramp, a cruise, and the last ramp.

    The unit of time is a ramp.
    """
    ramp_breaks = np.linspace(0.0, 1.0, RAMP_PIECES + 1)
    max_pieces = math.ceil(duration_ratio * MAX_CRUISE_PIECES)
    cruise_pieces = min(max_pieces, math.ceil(cruise - BREAK_ROUNDING))
    cruise_breaks = 1.0 + np.linspace(0.0, cruise, cruise_pieces + 1)
    return np.concatenate([ramp_breaks[:-1], cruise_breaks, 1.0 + cruise + ramp_breaks[1:]])


def _fit_samples(grid: Grid) -> Array:
    """Return the times (FIT_SAMPLES · pieces + 1,) through which curves are fitted."""
    return np.linspace(0.0, 1.0, FIT_SAMPLES * grid.pieces + 1)


def _fitted(task: SeparationTask, grid: Grid, targets: Array, smoothing_time: float = 0.0) -> Array:
    """Return the coefficients (N, count, 3) [m] of curves from start to goal.

    Parameters
    ----------
    targets: (N, samples, 3) [m], positions at the times ``_fit_samples``.
    smoothing_time: see ``Grid.fitting``.
    """
    coefficients = np.zeros((task.drones, grid.count, 3))
    coefficients[:, :END_COUNT] = task.start[:, None]
    coefficients[:, -END_COUNT:] = task.goal[:, None]
    s = _fit_samples(grid)
    offsets = targets - grid.sampled(s) @ coefficients
    coefficients[:, grid.free] = grid.fitting(s, smoothing_time) @ offsets
    return coefficients


PROGRESS_SAMPLES = 1001
"""Number of times between which the progress along a route is linear."""


def _progress(s: Array, ramp: float) -> Array:
    """Return the progress along a route at times s, from 0 to 1, with ramps of ``ramp`` ≤ ½."""
    times = np.linspace(0.0, 1.0, PROGRESS_SAMPLES)
    rising = np.clip(times / ramp, 0.0, 1.0)
    falling = np.clip((1.0 - times) / ramp, 0.0, 1.0)
    speed = rising**2 * (3.0 - 2.0 * rising) * falling**2 * (3.0 - 2.0 * falling)
    distance = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1])))
    progress: Array = np.interp(s, times, distance / distance[-1])
    return progress


CORNER_DISTANCE = 1.25
"""Distance of a route's corners to prisms, in radii; 1 if there is no such route."""

TOWER_HEIGHT = 1e6
"""[m] Altitude above, and depth below, all flights."""

GAP_BISECTIONS = 12
"""Number of bisections of the radius that locate the widest gap."""

GAP_SAMPLES = 2001
"""Number of samples of a route that tell which prisms are beside its narrowest part."""

BESIDE_GAP = 1.1
"""Distance to a prism beside the widest gap, over that gap's."""

RADIUS_TOLERANCE = 1e-6
"""Tolerance of distances to prisms, relative to the radius."""


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


class Crossings(NamedTuple):
    """Shares (m,) of segments at which they enter and exit a prism.

    Segments that miss the prism exit before they enter.
    """

    entry: Array
    exit: Array


def _crossings(prism: Prism, distance: float, first: Array, last: Array) -> Crossings:
    """Return where segments between points (m, 3) cross a prism widened by a distance [m]."""
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
    return Crossings(np.where(is_parallel_outside, 1.0, entry), exit_)


def _widened(outline: Array, distance: float) -> Array:
    """Return the corners of a clockwise outline offset outward by a distance [m]."""
    edges = np.roll(outline, -1, axis=0) - outline
    outward = unit(left_of(edges))
    bisector = np.roll(outward, 1, axis=0) + outward
    squared = np.sum(bisector**2, axis=1, keepdims=True)
    widened: Array = outline + 2.0 * distance * bisector / squared
    return widened


SAMPLES = 3
"""Number of samples of every piece at which guesses are pushed."""

TARGET_SEPARATION = 1.15
"""Target of pushes; above 1, since drones move between samples."""

MAX_PUSH_ITERATIONS = 120
"""Maximum number of iterations of pushing."""

MOMENTUM = 0.8
"""Fraction of an iteration's pushes that is added to the next."""

SMOOTHING_TIME = 0.08
"""Time constant of the smoothing filter, over the duration."""

SIDE_FADE_SHARE = 0.5
"""Fraction of the iterations over which the common side fades out of the pushes."""

PUSHED_SHARE = 0.8
"""Share of the distance to a prism below which a drone counts as stuck in it after pushes."""

MIN_OFFSET = 1e-9
"""Offset of two drones, in separations, below which they are pushed to the right."""

MIN_LEVEL_SHARE = 1e-3
"""Level part of a velocity, over its length, below which the velocity counts as vertical."""


def pushed_apart(setting: Setting, side: float) -> Array:
    """Return the coefficients (N, count, 3) [m] of curves without, or with few, conflicts.

    Drones that are too close are pushed apart at samples of time, along their offset; a smoothing
    filter fits curves to the pushes. Since the offset vanishes where two meet head-on, all first
    give way to the same side.

    Parameters
    ----------
    side: strength of the push to the right (negative: to the left), in separations.
    """
    grid = setting.grid
    s = _push_samples(grid)
    values = grid.sampled(s)
    rates = grid.sampled(s, 1)
    smoothing = grid.fitting(s, SMOOTHING_TIME)
    coefficients = setting.nominal.copy()
    step = np.zeros_like(coefficients[:, grid.free])
    for iteration in range(MAX_PUSH_ITERATIONS):
        check_time()
        points = np.swapaxes(values @ coefficients, 0, 1)
        velocities = np.swapaxes(rates @ coefficients, 0, 1)
        fade = max(0.0, 1.0 - iteration / (SIDE_FADE_SHARE * MAX_PUSH_ITERATIONS))
        pushes = _pair_pushes(setting, points, velocities, fade * side)
        pushes += _other_pushes(setting, points)
        if not np.any(pushes):
            break
        step = MOMENTUM * step + smoothing @ np.swapaxes(pushes, 0, 1)
        moved = coefficients[:, grid.free] + step
        coefficients[:, grid.free] = inside(setting.task.requirements.arena, moved)
    return on_routes(setting, coefficients, stuck_in_prisms(setting, coefficients))


def on_routes(setting: Setting, coefficients: Array, drones: NDArray[np.bool_]) -> Array:
    """Return the coefficients (N, count, 3) [m] with some drones, a mask (N,), on their routes."""
    return np.where(drones[:, None, None], setting.nominal, coefficients)


def stuck_in_prisms(
    setting: Setting, coefficients: Array, share: float = PUSHED_SHARE
) -> NDArray[np.bool_]:
    """Return the mask (N,) of drones that others have pushed into prisms or gaps too narrow.

    They are closer to a prism than a share of the required distance.
    """
    points = setting.grid.sampled(_push_samples(setting.grid)) @ coefficients
    closest = share * setting.task.requirements.separation.radius
    stuck = np.zeros(len(coefficients), dtype=np.bool_)
    for prism in setting.task.requirements.keep_out:
        drone, sample = np.nonzero(_near(prism, points, closest))
        too_close = prism.clearance(points[drone, sample]).distance < closest
        stuck[drone[too_close]] = True
    return stuck


def _near(prism: Prism, points: Array, distance: float) -> NDArray[np.bool_]:
    """Return the mask (…) of points (…, 3) in the prism's bounding box, widened by a distance."""
    lower = np.min(prism.corners, axis=0) - distance
    upper = np.max(prism.corners, axis=0) + distance
    near: NDArray[np.bool_] = np.all((points > lower) & (points < upper), axis=-1)
    return near


def _push_samples(grid: Grid) -> Array:
    """Return the times (SAMPLES · pieces,) at which guesses are pushed."""
    count = SAMPLES * grid.pieces
    return (np.arange(count) + 0.5) / count


def _pair_pushes(setting: Setting, points: Array, velocities: Array, side: float) -> Array:
    """Return the pushes (samples, drones, 3) [m] by other drones."""
    samples, drones, _ = points.shape
    scale = setting.task.requirements.separation.scale
    scaled = (points * scale).reshape(-1, 3)
    # Time is a fourth coordinate, scaled so that only simultaneous samples are close.
    time = np.repeat(2.0 * TARGET_SEPARATION * np.arange(samples), drones)
    tree = cKDTree(np.column_stack([scaled, time]))
    first, second = tree.query_pairs(TARGET_SEPARATION, output_type="ndarray").T
    offset = scaled[first] - scaled[second]
    velocity = velocities.reshape(-1, 3)
    min_speed = TIE * float(np.max(np.abs(velocity)))
    right = rightward(velocity[first] - velocity[second], min_speed)
    direction = unit(offset + side * right, right, MIN_OFFSET)
    deficit = np.maximum(TARGET_SEPARATION - np.sum(direction * offset, axis=1), 0.0)
    gradient = direction * scale
    factor = 0.5 * deficit / np.sum(gradient * gradient, axis=1)
    pushes = np.zeros((samples * drones, 3))
    for axis in range(3):
        push = gradient[:, axis] * factor
        pushes[:, axis] = np.bincount(first, push, len(pushes))
        pushes[:, axis] -= np.bincount(second, push, len(pushes))
    pairs_of_point = np.bincount(np.append(first, second), minlength=len(pushes))
    pushes /= np.sqrt(np.maximum(pairs_of_point, 1))[:, None]
    return pushes.reshape(points.shape)


def rightward(velocity: Array, min_speed: float) -> Array:
    """Return unit vectors (pairs, 3) to the right of relative velocities (pairs, 3).

    East for vertical velocities, and below ``min_speed``, where rounding dominates.
    """
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    return unit(left_of(-velocity), EAST, np.maximum(MIN_LEVEL_SHARE * speed, min_speed))


def _other_pushes(setting: Setting, points: Array) -> Array:
    """Return pushes (samples, drones, 3) [m] out of prisms, and together along taut tethers."""
    task = setting.task
    pushes = np.zeros_like(points)
    target = TARGET_SEPARATION * task.requirements.separation.radius
    for prism in task.requirements.keep_out:
        near = _near(prism, points, target)
        clearance = prism.clearance(points[near])
        deficit = np.maximum(target - clearance.distance, 0.0)
        pushes[near] += deficit[..., None] * clearance.normals
    first, second, longest = task.tether_arrays
    offset = points[:, first] - points[:, second]
    distance = length(offset)
    excess = np.maximum(distance - longest, 0.0) / np.maximum(distance, longest)
    pull = np.swapaxes(0.5 * excess[..., None] * offset, 0, 1)
    by_drone = np.swapaxes(pushes, 0, 1)
    np.add.at(by_drone, first, -pull)
    np.add.at(by_drone, second, pull)
    return pushes


SCHEDULE_PIECES = 4.0
"""Number of pieces of a grid for a schedule, over that of a grid for flights as long."""

SCHEDULE_SMOOTHING_TIME = 0.005
"""Time constant of the filter of a schedule, over its duration."""


def scheduled(task: SeparationTask, schedule: Schedule) -> Setting:
    """Return the task with nominal curves along a schedule, on a grid that resolves them."""
    setting = setting_of(task, SCHEDULE_PIECES * schedule.duration_ratio)
    grid = setting.grid
    times = np.linspace(0.0, 1.0, schedule.points.shape[1])
    points_at = interp1d(times, schedule.points, axis=1)
    targets = np.asarray(points_at(_fit_samples(grid)), dtype=np.float64)
    nominal = _fitted(task, grid, targets, SCHEDULE_SMOOTHING_TIME)
    nominal[:, grid.free] = inside(task.requirements.arena, nominal[:, grid.free])
    return replace(setting, nominal=nominal)


MIN_CROWD = 32
"""Smallest number of drones meeting at the same time for which a roundabout is used."""

LAYERS = 2
"""Number of altitudes of a roundabout, which drones take in turn; it divides the rings' radius."""

RING_FACTOR = 1.06
"""Radius of a ring over that at which its drones have the TARGET_SEPARATION."""

DETOUR_FACTOR = 1.3
"""Distance from the centre at which drones leave their straight routes, over the radius of a ring
of all drones."""

CLIMB_POWER = 6
"""Power of the distance in the vertical offset, so that layers are separated before drones enter a
ring of all of them."""


def roundabout(setting: Setting) -> Array | None:
    """Return the coefficients (N, count, 3) [m] of curves around a crowd, or None without one.

    A crowd meets halfway at one point, where pushes between pairs would amplify rounding. With
    ``x`` the distance from there over DETOUR_FACTOR radii of a ring of all its drones, the offset
    to the right is ``(1 - x²)²`` times the radius of a layer's ring, and the vertical offset is
    ``(1 - x⁶)²`` times the layer's altitude.
    """
    task = setting.task
    grid = setting.grid
    separation = task.requirements.separation
    halfway = grid.sampled(np.asarray(0.5)) @ setting.nominal
    centre = np.median(halfway, axis=0)
    distance_halfway = np.linalg.norm((halfway - centre) * separation.scale, axis=-1)
    in_crowd = distance_halfway < TARGET_SEPARATION
    crowd = np.sum(in_crowd)
    if crowd < MIN_CROWD:
        return None
    # Radius (N, 1) [m] of a ring of the whole crowd, whose circumference seats all its drones
    spacing = 2.0 * TARGET_SEPARATION * separation.radius
    ring = np.where(in_crowd, RING_FACTOR * spacing * crowd / (2.0 * math.pi), 0.0)[:, None]
    s = _push_samples(grid)
    points = grid.sampled(s) @ setting.nominal
    velocities = grid.sampled(s, 1) @ setting.nominal
    distance = np.linalg.norm((points - centre)[..., :2], axis=-1)
    detour = DETOUR_FACTOR * ring
    x = np.divide(distance, detour, out=np.ones_like(distance), where=ring > 0.0)
    lateral = np.maximum(1.0 - x**2, 0.0) ** 2
    vertical = np.maximum(1.0 - x**CLIMB_POWER, 0.0) ** 2
    right = rightward(velocities.reshape(-1, 3), 0.0).reshape(velocities.shape)
    offset = (ring / LAYERS * lateral)[..., None] * right
    layer = np.arange(task.drones)[:, None] % LAYERS - 0.5 * (LAYERS - 1)
    offset[..., 2] += 2.0 * TARGET_SEPARATION * separation.height * layer * vertical
    coefficients = setting.nominal.copy()
    moved = coefficients[:, grid.free] + grid.fitting(s) @ offset
    coefficients[:, grid.free] = inside(task.requirements.arena, moved)
    return coefficients


MIN_LAYERED = 16
"""Smallest number of drones that are spread over altitudes among prisms."""

LAYER_SPACING = 2.0 * TARGET_SEPARATION
"""Distance of such altitudes, in heights of ellipsoids."""


def on_layers(setting: Setting) -> Setting | None:
    """Return the setting with nominal curves at altitudes by heading, or None without room.

    As in the semicircular rule of aviation, drones at one altitude fly in similar directions, so
    that few of them meet. The altitudes fill the arena; drones reach theirs with the factor
    ``(1 - x⁶)²`` of a roundabout, with ``x`` the time from halfway.
    """
    task = setting.task
    grid = setting.grid
    arena = task.requirements.arena
    spacing = LAYER_SPACING * task.requirements.separation.height
    if arena is None or task.drones < MIN_LAYERED:
        return None
    count = 1 + int((arena.upper[2] - arena.lower[2]) / spacing)
    if count == 1:
        return None
    middle = float(np.median([task.start[:, 2], task.goal[:, 2]]))
    reach = 0.5 * (count - 1) * spacing
    middle = float(np.clip(middle, arena.lower[2] + reach, arena.upper[2] - reach))
    altitudes = middle + np.linspace(-reach, reach, count)
    change = task.goal - task.start
    by_heading = np.argsort(np.arctan2(change[:, 1], change[:, 0]), kind="stable")
    altitude = np.empty(task.drones)
    altitude[by_heading] = altitudes[np.arange(task.drones) * count // task.drones]
    s = _push_samples(grid)
    points = grid.sampled(s) @ setting.nominal
    share = (1.0 - np.abs(2.0 * s - 1.0) ** CLIMB_POWER) ** 2
    offset = np.zeros_like(points)
    offset[..., 2] = share * (altitude[:, None] - points[..., 2])
    nominal = setting.nominal.copy()
    moved = nominal[:, grid.free] + grid.fitting(s) @ offset
    nominal[:, grid.free] = inside(arena, moved)
    return replace(setting, nominal=nominal)
