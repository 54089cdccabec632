"""Initial guesses: along routes around prisms, then pushed apart, or around a crowd.

They are deterministic and insensitive to rounding of the input.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.interpolate import interp1d
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from hitchopt.errors import InfeasibleError, Violation, check_time
from hitchopt.geometry.vectors import EAST, GOLDEN, TIE, left_of, length, unit
from hitchopt.hitch.requirements import Prism
from hitchopt.planners.separation.prioritized import Schedule
from hitchopt.planners.separation.task import END_COUNT, Grid, SeparationTask, Setting, inside
from hitchopt.planners.timing.ramps import fastest_ramps
from hitchopt.values import Array

RAMP_PIECES = 3
"""Number of pieces of a ramp, which resolve the fastest flight to within 2 %."""

MAX_CRUISE_PIECES = 20
"""Maximum number of pieces between the ramps; if there are fewer, each is as long as a ramp."""

MIN_RAMP_SHARE = 1e-5
"""Shortest ramp over the duration; splines do not resolve shorter ones."""


def setting_of(task: SeparationTask, duration_ratio: float = 1.0) -> Setting:
    """Return the task on a grid for the drone with the longest flight; all leave at once.

    Parameters
    ----------
    duration_ratio: duration over that of the slowest flight, by which the grid has more pieces.

    Raises
    ------
    InfeasibleError: no route around the prisms was found.
    """
    limits, n = task.requirements.limits, task.drones
    usable = limits.acceleration if task.acceleration is None else np.asarray(task.acceleration)
    acceleration = np.minimum(np.broadcast_to(usable, n), limits.acceleration)
    caps = np.stack([np.full(n, limits.speed), acceleration, np.full(n, limits.jerk)])
    routes = routes_around(task)
    lengths = np.array([np.sum(length(np.diff(route, axis=0))) for route in routes])
    straight = length(task.goal - task.start)
    bound, _ = fastest_ramps(straight, limits.speed, acceleration, limits.jerk)
    durations, ramps = fastest_ramps(lengths, limits.speed, acceleration, limits.jerk)
    slowest = int(np.argmax(durations))
    duration = float(durations[slowest])
    ramp = max(float(ramps[slowest]), MIN_RAMP_SHARE * duration)
    size = max(float(np.max(lengths)), 2.0 * task.requirements.separation.radius)
    moving = float(lengths[slowest]) > 1e-6 * size
    cruise = max(duration_ratio * duration / ramp - 2.0, 0.0) if moving else 0.0  # in ramps
    # Breaks in ramps: of the first ramp, of the cruise, and of the last ramp
    ramp_breaks = np.linspace(0.0, 1.0, RAMP_PIECES + 1)
    cruise_pieces = min(math.ceil(duration_ratio * MAX_CRUISE_PIECES), math.ceil(cruise - 1e-9))
    cruise_breaks = 1.0 + np.linspace(0.0, cruise, cruise_pieces + 1)
    breaks = np.concatenate([ramp_breaks[:-1], cruise_breaks, 1.0 + cruise + ramp_breaks[1:]])
    grid = Grid(breaks / breaks[-1])
    s = np.linspace(0.0, 1.0, 12 * grid.pieces + 1)
    progress = _progress(s, 1.0 / breaks[-1])
    nominal = np.zeros((n, grid.count, 3))
    nominal[:, :END_COUNT] = task.start[:, None]
    nominal[:, -END_COUNT:] = task.goal[:, None]
    targets = np.stack([points_along(route, progress) for route in routes])
    nominal[:, grid.free] = grid.fitting(s) @ (targets - grid.sampled(s) @ nominal)
    return Setting(task, grid, nominal, caps, float(np.max(bound)), duration, size)


def _progress(s: Array, ramp: float) -> Array:
    """Return the progress along a route at times s, from 0 to 1, with ramps of ``ramp`` ≤ ½."""
    fine = np.linspace(0.0, 1.0, 1001)
    rising, falling = (np.clip(x / ramp, 0.0, 1.0) for x in (fine, 1.0 - fine))
    speed = rising**2 * (3.0 - 2.0 * rising) * falling**2 * (3.0 - 2.0 * falling)
    distance = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1])))
    progress: Array = np.interp(s, fine, distance / distance[-1])
    return progress


CORNER_DISTANCE = 1.25
"""Distance of a route's corners to prisms, in radii; 1 if there is no such route."""

TOWER_HEIGHT = 1e6
"""[m] Altitude above, and depth below, all flights."""

RADIUS_TOLERANCE = 1e-6
"""Tolerance of distances to prisms, relative to the radius."""


def points_along(route: Array, shares: Array) -> Array:
    """Return the points (m, 3) [m] of a route (corners, 3) at shares (m,) of its length."""
    along = np.append(0.0, np.cumsum(length(np.diff(route, axis=0))))
    return np.stack([np.interp(shares * along[-1], along, axis) for axis in route.T], axis=-1)


def routes_around(task: SeparationTask) -> list[Array]:
    """Return shortest routes, N lists of corners (m, 3) [m]; straight without a prism between.

    Corners have slightly more than the required distance to prisms. Their altitudes are those of
    start and goal, and just above and below the prisms.

    Raises
    ------
    InfeasibleError: no route with the required distance was found.
    """
    radius = task.requirements.separation.radius
    routes = list(np.stack([task.start, task.goal], axis=1))
    for i in np.flatnonzero(_blocked(task, task.start, task.goal)).tolist():
        check_time()
        factors = CORNER_DISTANCE, 1.0 + RADIUS_TOLERANCE
        candidates = (_route(task, routes[i], factor * radius) for factor in factors)
        route = next((each for each in candidates if each is not None), None)
        if route is None:
            remedy = "widen the gap between the prisms, or between them and the arena"
            when, where = "on every route found from its start to its goal", (task.names[i],)
            raise InfeasibleError(
                [Violation("keep_out", 0.0, radius, "min", "m", where, when, remedy)]
            )
        routes[i] = route
    return routes


def _blocked(task: SeparationTask, first: Array, last: Array) -> NDArray[np.bool_]:
    """Return the mask (m,) of segments between points (m, 3) that come too close to a prism.

    A segment is cut to its part inside of the prism with all faces moved outward. That part may
    still pass a corner, where these faces meet farther away than the distance.
    """
    blocked = np.zeros(len(first), dtype=np.bool_)
    distance = task.requirements.separation.radius * (1.0 - RADIUS_TOLERANCE)
    for prism in task.requirements.keep_out:
        entry, exit_ = _crossings(prism, distance, first, last)
        near = np.flatnonzero((entry < exit_) & ~blocked)
        start = first[near, :2]
        along = last[near, :2] - start
        entering = start + entry[near, None] * along
        leaving = start + exit_[near, None] * along
        distances = prism.slab.section.segment_distance(entering, leaving)
        blocked[near[distances < distance]] = True
    return blocked


def _route(task: SeparationTask, ends: Array, distance: float) -> Array | None:
    """Return the shortest route whose corners keep a distance [m] to all prisms, or None."""
    prisms, arena = task.requirements.keep_out, task.requirements.arena
    corners = np.vstack([_widened(prism.polygon.vertices, distance) for prism in prisms])
    levels = [[prism.lower - distance, prism.upper + distance] for prism in prisms]
    heights = np.unique([ends[:, 2], *levels])
    nodes = np.column_stack([np.tile(corners, (len(heights), 1)), np.repeat(heights, len(corners))])
    nodes = np.vstack([nodes, *(_points_over(prism, ends, distance) for prism in prisms)])
    if arena is not None:
        nodes = nodes[np.all((nodes >= arena.lower) & (nodes <= arena.upper), axis=1)]
    nodes = np.vstack([ends, nodes[~_blocked(task, nodes, nodes)]])
    i, j = np.triu_indices(len(nodes), 1)
    visible = ~_blocked(task, nodes[i], nodes[j])
    i, j = i[visible], j[visible]
    lengths = length(nodes[i] - nodes[j])
    # Coordinates resolve ties between routes of equal length.
    preference = nodes @ np.array([1.0, GOLDEN, GOLDEN**2])
    preference = (preference - np.min(preference)) / max(float(np.ptp(preference)), 1e-9)
    costs = lengths + TIE * float(np.max(lengths, initial=0.0)) * (preference[i] + preference[j])
    graph = sp.csr_matrix((costs, (i, j)), shape=(len(nodes), len(nodes)))
    start = np.array([0])
    distances, before = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
    if not np.isfinite(distances[0, 1]):
        return None
    route = [1]
    while route[-1] != 0:
        route.append(int(before[0, route[-1]]))
    return nodes[route[::-1]]


def _points_over(prism: Prism, ends: Array, distance: float) -> Array:
    """Return points (m, 3) over and under a prism at both crossings with the straight route."""
    tower = Prism(prism.polygon, -TOWER_HEIGHT, TOWER_HEIGHT)
    (entry,), (exit_,) = _crossings(tower, distance, ends[:1], ends[1:])
    if entry >= exit_:
        return np.zeros((0, 3))
    points = ends[0, :2] + np.array([[entry], [exit_]]) * (ends[1] - ends[0])[:2]
    levels = np.repeat([prism.lower - distance, prism.upper + distance], 2)
    return np.column_stack([np.vstack([points, points]), levels])


def _crossings(prism: Prism, distance: float, first: Array, last: Array) -> tuple[Array, Array]:
    """Return the shares (m,) at which segments enter and exit a prism widened by a distance [m].

    Segments that miss the prism exit before they enter.
    """
    edges = prism.polygon.edge_vectors
    sides = unit(np.insert(left_of(edges), 2, 0.0, axis=1))
    supports = np.sum(sides[:, :2] * prism.polygon.vertices, axis=1)
    normals = np.vstack([sides, [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]])
    offsets = np.concatenate([supports, [-prism.lower, prism.upper]]) + distance
    before, after = (points @ normals.T - offsets for points in (first, last))
    change = after - before
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = -before / change
    entry = np.max(np.where(change < 0.0, crossing, 0.0), axis=1, initial=0.0)
    exit_ = np.min(np.where(change > 0.0, crossing, 1.0), axis=1, initial=1.0)
    outside = np.any((change == 0.0) & (before >= 0.0), axis=1)  # parallel to a side
    return np.where(outside, 1.0, entry), exit_


def _widened(outline: Array, distance: float) -> Array:
    """Return the corners of a clockwise outline offset outward by a distance [m]."""
    edges = np.roll(outline, -1, axis=0) - outline
    outward = unit(left_of(edges))
    middle = np.roll(outward, 1, axis=0) + outward
    widened: Array = outline + 2.0 * distance * middle / np.sum(middle**2, axis=1, keepdims=True)
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
    s = _samples(grid)
    basis, rates, smoothing = grid.sampled(s), grid.sampled(s, 1), grid.fitting(s, SMOOTHING_TIME)
    coefficients = setting.nominal.copy()
    velocity = np.zeros_like(coefficients[:, grid.free])
    for iteration in range(MAX_PUSH_ITERATIONS):
        check_time()
        points, velocities = (np.swapaxes(each @ coefficients, 0, 1) for each in (basis, rates))
        fade = max(0.0, 1.0 - iteration / (SIDE_FADE_SHARE * MAX_PUSH_ITERATIONS))
        pushes = _pair_pushes(setting, points, velocities, fade * side)
        pushes += _other_pushes(setting, points)
        if not np.any(pushes):
            break
        velocity = MOMENTUM * velocity + smoothing @ np.swapaxes(pushes, 0, 1)
        moved = coefficients[:, grid.free] + velocity
        coefficients[:, grid.free] = inside(setting.task.requirements.arena, moved)
    return coefficients


def _samples(grid: Grid) -> Array:
    return (np.arange(SAMPLES * grid.pieces) + 0.5) / (SAMPLES * grid.pieces)


def _pair_pushes(setting: Setting, points: Array, velocities: Array, side: float) -> Array:
    """Return the pushes (samples, drones, 3) [m] by other drones."""
    samples, drones, _ = points.shape
    scale = setting.task.requirements.separation.scale
    scaled = (points * scale).reshape(-1, 3)
    # Time is a fourth coordinate, scaled so that only simultaneous samples are close.
    time = np.repeat(2.0 * TARGET_SEPARATION * np.arange(samples), drones)
    tree = cKDTree(np.column_stack([scaled, time]))
    first, second = tree.query_pairs(TARGET_SEPARATION, output_type="ndarray").T
    offset, flat = scaled[first] - scaled[second], velocities.reshape(-1, 3)
    right = rightward(flat[first] - flat[second], TIE * float(np.max(np.abs(flat))))
    direction = unit(offset + side * right, right, 1e-9)
    deficit = np.maximum(TARGET_SEPARATION - np.sum(direction * offset, axis=1), 0.0)
    gradient = direction * scale
    share = 0.5 * deficit / np.sum(gradient * gradient, axis=1)
    pushes = np.zeros((samples * drones, 3))
    for axis in range(3):
        push = gradient[:, axis] * share
        pushes[:, axis] = np.bincount(first, push, len(pushes))
        pushes[:, axis] -= np.bincount(second, push, len(pushes))
    count = np.bincount(np.append(first, second), minlength=len(pushes))
    pushes /= np.sqrt(np.maximum(count, 1))[:, None]
    return pushes.reshape(points.shape)


def rightward(velocity: Array, min_speed: float) -> Array:
    """Return unit vectors (pairs, 3) to the right of relative velocities (pairs, 3).

    East for vertical velocities, and below ``min_speed``, where rounding dominates.
    """
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    return unit(left_of(-velocity), EAST, np.maximum(1e-3 * speed, min_speed))


def _other_pushes(setting: Setting, points: Array) -> Array:
    """Return pushes (samples, drones, 3) [m] out of prisms, and together along taut tethers."""
    task = setting.task
    pushes = np.zeros_like(points)
    target = TARGET_SEPARATION * task.requirements.separation.radius
    for prism in task.requirements.keep_out:
        clearance = prism.clearance(points)
        deficit = np.maximum(target - clearance.distance, 0.0)
        pushes += deficit[..., None] * clearance.normals
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
    grid, nominal = setting.grid, np.zeros_like(setting.nominal)
    nominal[:, :END_COUNT] = task.start[:, None]
    nominal[:, -END_COUNT:] = task.goal[:, None]
    s = np.linspace(0.0, 1.0, 12 * grid.pieces + 1)
    times = np.linspace(0.0, 1.0, schedule.points.shape[1])
    targets = interp1d(times, schedule.points, axis=1)(s)
    fit = grid.fitting(s, SCHEDULE_SMOOTHING_TIME) @ (targets - grid.sampled(s) @ nominal)
    nominal[:, grid.free] = inside(task.requirements.arena, fit)
    return replace(setting, nominal=nominal)


MIN_CROWD = 32
"""Number of drones meeting at the same time above which a roundabout is used."""

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
    task, grid, separation = setting.task, setting.grid, setting.task.requirements.separation
    s = _samples(grid)
    points, steps = (grid.sampled(s, order) @ setting.nominal for order in (0, 1))
    middle = grid.sampled(np.asarray(0.5)) @ setting.nominal
    centre = np.median(middle, axis=0)
    crowd = np.linalg.norm((middle - centre) * separation.scale, axis=-1) < TARGET_SEPARATION
    if np.sum(crowd) < MIN_CROWD:
        return None
    spacing = 2.0 * TARGET_SEPARATION * separation.radius
    ring = np.where(crowd, RING_FACTOR * spacing * np.sum(crowd) / (2.0 * math.pi), 0.0)[:, None]
    distance = np.linalg.norm((points - centre)[..., :2], axis=-1)
    x = np.divide(distance, DETOUR_FACTOR * ring, out=np.ones_like(distance), where=ring > 0.0)
    lateral, vertical = (np.maximum(1.0 - x**power, 0.0) ** 2 for power in (2, CLIMB_POWER))
    right = rightward(steps.reshape(-1, 3), 0.0).reshape(steps.shape)
    offset = (ring / LAYERS * lateral)[..., None] * right
    layer = np.arange(task.drones)[:, None] % LAYERS - 0.5 * (LAYERS - 1)
    offset[..., 2] += 2.0 * TARGET_SEPARATION * separation.height * layer * vertical
    coefficients = setting.nominal.copy()
    moved = coefficients[:, grid.free] + grid.fitting(s) @ offset
    coefficients[:, grid.free] = inside(task.requirements.arena, moved)
    return coefficients
