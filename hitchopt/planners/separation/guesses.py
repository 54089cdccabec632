"""First curves: along routes around prisms, then pushed apart, or all around a crowd.

Everything is deterministic, and noise on the input of the size of rounding changes nothing.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from hitchopt.errors import InfeasibleError, Violation, check_time
from hitchopt.geometry.vectors import EAST, GOLDEN, TIE, length, unit
from hitchopt.hitch.requirements import Prism
from hitchopt.planners.separation.task import HELD, Grid, SeparationTask, Setting, inside
from hitchopt.planners.timing.ramps import fastest_ramps
from hitchopt.values import Array

RAMP_PIECES = 3
"""Number of pieces of a ramp: the fastest flight is resolved to within 2 %."""

MOST_PIECES = 20
"""Maximum number of pieces between the ramps; with fewer, each is as long as a ramp."""

SHORTEST_RAMP = 1e-5
"""Shortest ramp, as a share of the duration: splines do not resolve shorter ones."""

SHORTEST = 0.2
"""Shortest flight, as a share of the longest one."""


def setting_of(task: SeparationTask, patience: float = 1.0) -> Setting:
    """Return the task on a grid that suits the drone with the longest flight.

    Parameters
    ----------
    patience: duration over that of the slowest flight; above 1, drones leave one after the other,
        and at 1 all leave at once.

    Raises
    ------
    InfeasibleError: the prisms leave no route.
    """
    limits, n = task.requirements.limits, task.drones
    given = limits.acceleration if task.acceleration is None else np.asarray(task.acceleration)
    acceleration = np.minimum(np.broadcast_to(given, n), limits.acceleration)
    caps = np.stack([np.full(n, limits.speed), acceleration, np.full(n, limits.jerk)])
    straight, routes = length(task.goal - task.start), routes_around(task)
    lengths = np.array([np.sum(length(np.diff(route, axis=0))) for route in routes])
    (bound, _), (durations, own_rises) = (
        fastest_ramps(each, limits.speed, acceleration, limits.jerk) for each in (straight, lengths)
    )
    slowest = int(np.argmax(durations))
    alone = float(durations[slowest])
    rise = max(float(own_rises[slowest]), SHORTEST_RAMP * alone)
    size = max(float(np.max(lengths)), 2.0 * task.requirements.separation.radius)
    going = float(lengths[slowest]) > 1e-6 * size  # else nobody goes anywhere
    cruise = max(patience * alone / rise - 2.0, 0.0) if going else 0.0  # as long as how many ramps
    first = np.linspace(0.0, 1.0, RAMP_PIECES + 1)
    middle = min(math.ceil(patience * MOST_PIECES), math.ceil(cruise - 1e-9))
    lasting = 1.0 + np.linspace(0.0, cruise, middle + 1)
    breaks = np.concatenate([first[:-1], lasting, 1.0 + cruise + first[1:]])
    grid = Grid(breaks / breaks[-1])
    s = np.linspace(0.0, 1.0, 12 * grid.pieces + 1)
    if patience > 1.0 and going:
        lasts = np.maximum(durations / alone, SHORTEST) / patience
        rises = np.full(n, 0.5)
        np.divide(own_rises, durations, out=rises, where=lengths > 0.0)
        order = np.argsort(np.round(-lasts / TIE), kind="stable")  # who flies longest leaves first
        rank = np.argsort(order)
        leaving = (1.0 - lasts) * rank / max(1, n - 1)
        each = zip(leaving, lasts, rises, strict=True)
        shares = [_progress((s - leave) / share, float(rise)) for leave, share, rise in each]
    else:
        shares = [_progress(s, 1.0 / breaks[-1])] * n
    nominal = np.zeros((n, grid.count, 3))
    nominal[:, :HELD], nominal[:, -HELD:] = task.start[:, None], task.goal[:, None]
    wanted = np.stack([points_along(*each) for each in zip(routes, shares, strict=True)])
    missing = wanted - grid.sampled(s) @ nominal
    nominal[:, grid.free] = grid.fitting(s) @ missing
    return Setting(task, grid, nominal, caps, float(np.max(bound)), alone, size)


def _progress(s: Array, ramp: float) -> Array:
    """Return the share of a route flown at times ``s``, 0 to 1, with ramps of ``ramp`` ≤ ½."""
    fine = np.linspace(0.0, 1.0, 1001)
    rising, falling = (np.clip(x / ramp, 0.0, 1.0) for x in (fine, 1.0 - fine))
    speed = rising**2 * (3.0 - 2.0 * rising) * falling**2 * (3.0 - 2.0 * falling)
    travelled = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1])))
    share: Array = np.interp(s, fine, travelled / travelled[-1])
    return share


STAND_OFF = 1.25
"""Distance of a route's corners to prisms, in radii; the radius itself where that shuts all."""

HIGH = 1e6
"""[m] Altitude above, and depth below, everything that flies."""

TIGHT = 1e-6
"""Smallest distance of a route's corners to obstacles, relative to the radius."""


def points_along(route: Array, shares: Array) -> Array:
    """Return the points (m, 3) [m] of a route (corners, 3) at shares (m,) of its length."""
    along = np.append(0.0, np.cumsum(length(np.diff(route, axis=0))))
    return np.stack([np.interp(shares * along[-1], along, axis) for axis in route.T], axis=-1)


def routes_around(task: SeparationTask) -> list[Array]:
    """Return shortest routes, N lists of corners (m, 3) [m]: straight where no prism is in between.

    Corners stand off the prisms by a little more than drones must. They are taken at the altitudes
    of a drone's start and goal and just above and below the prisms.

    Raises
    ------
    InfeasibleError: every route that was found is too narrow.
    """
    radius = task.requirements.separation.radius
    routes = list(np.stack([task.start, task.goal], axis=1))
    for i in np.flatnonzero(_blocked(task, task.start, task.goal)).tolist():
        check_time()
        tried = (_route(task, routes[i], off * radius) for off in (STAND_OFF, 1.0 + TIGHT))
        route = next((each for each in tried if each is not None), None)
        if route is None:
            remedy = "widen the gap between the prisms, or between them and the arena"
            when, where = "on every route found from its start to its goal", (task.names[i],)
            blocked = Violation("keep_out", 0.0, radius, "min", "m", where, when, remedy)
            raise InfeasibleError([blocked])
        routes[i] = route
    return routes


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
    lengths = length(nodes[i] - nodes[j])
    # Among routes of equal length, the places decide.
    places = nodes @ np.array([1.0, GOLDEN, GOLDEN**2])
    places = (places - np.min(places)) / max(float(np.ptp(places)), 1e-9)
    preferred = lengths + TIE * float(np.max(lengths, initial=0.0)) * (places[i] + places[j])
    graph = sp.csr_matrix((preferred, (i, j)), shape=(len(nodes), len(nodes)))
    start = np.array([0])
    distances, before = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
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


SAMPLES = 3
"""Number of samples of every piece at which guesses are pushed."""

WANTED = 1.15
"""Separation that pushes aim at, larger than 1 as drones also move between samples."""

PUSH_ROUNDS = 120
"""Maximum rounds of pushing."""

MOMENTUM = 0.8
"""Share of a round's pushes that carries over to the next round."""

STIFFNESS = 0.08
"""Shortest bend that the filter passes, as a share of the duration."""

FADING = 0.5
"""Share of the rounds over which the common side fades out of the pushes."""


def pushed_apart(setting: Setting, side: float) -> Array:
    """Return the coefficients (N, count, 3) [m] of curves that are clear, or nearly so.

    Drones that come too close are pushed apart at samples of time, along their offset; a smoothing
    filter makes curves of the pushes. Where two meet head on there is no offset to speak of: at
    first all give way to the same side.

    Parameters
    ----------
    side: strength of the push to the right (negative: to the left), in separations.
    """
    grid = setting.grid
    s = _samples(grid)
    basis, rates, smoothing = grid.sampled(s), grid.sampled(s, 1), grid.fitting(s, STIFFNESS)
    coefficients = setting.nominal.copy()
    speed = np.zeros_like(coefficients[:, grid.free])
    for round_number in range(PUSH_ROUNDS):
        check_time()
        points, velocities = (np.swapaxes(each @ coefficients, 0, 1) for each in (basis, rates))
        fading = max(0.0, 1.0 - round_number / (FADING * PUSH_ROUNDS))
        pushes = _pushes(setting, points, velocities, fading * side)
        pushes += _other_pushes(setting, points)
        if not np.any(pushes):
            break
        speed = MOMENTUM * speed + smoothing @ np.swapaxes(pushes, 0, 1)
        moved = coefficients[:, grid.free] + speed
        coefficients[:, grid.free] = inside(setting.task.requirements.arena, moved)
    return coefficients


def _samples(grid: Grid) -> Array:
    return (np.arange(SAMPLES * grid.pieces) + 0.5) / (SAMPLES * grid.pieces)


def _pushes(setting: Setting, points: Array, velocities: Array, side: float) -> Array:
    """Return how far each sample (samples, drones, 3) is pushed by other drones [m]."""
    samples, drones, _ = points.shape
    scale = setting.task.requirements.separation.scale
    scaled = (points * scale).reshape(-1, 3)
    # Time as a fourth coordinate, so stretched that only samples of one time are close.
    time = np.repeat(2.0 * WANTED * np.arange(samples), drones)
    tree = cKDTree(np.column_stack([scaled, time]))
    first, second = tree.query_pairs(WANTED, output_type="ndarray").T
    offset, flat = scaled[first] - scaled[second], velocities.reshape(-1, 3)
    right = rightward(flat[first] - flat[second], TIE * float(np.max(np.abs(flat))))
    direction = unit(offset + side * right, right, 1e-9)
    missing = np.maximum(WANTED - np.sum(direction * offset, axis=1), 0.0)
    steepest = direction * scale
    share = 0.5 * missing / np.sum(steepest * steepest, axis=1)
    pushes = np.zeros((samples * drones, 3))
    for axis in range(3):
        push = steepest[:, axis] * share
        pushes[:, axis] = np.bincount(first, push, len(pushes))
        pushes[:, axis] -= np.bincount(second, push, len(pushes))
    count = np.bincount(np.append(first, second), minlength=len(pushes))
    pushes /= np.sqrt(np.maximum(count, 1))[:, None]
    return pushes.reshape(points.shape)


def rightward(velocity: Array, still: float) -> Array:
    """Return unit vectors (pairs, 3) to the right of relative velocities (pairs, 3).

    East where it is upright, or slower than ``still``: rounding has no direction.
    """
    right = np.column_stack([velocity[:, 1], -velocity[:, 0], np.zeros(len(velocity))])
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    return unit(right, EAST, np.maximum(1e-3 * speed, still))


def _other_pushes(setting: Setting, points: Array) -> Array:
    """Return pushes (samples, drones, 3) out of prisms, and together along taut cables [m]."""
    task = setting.task
    pushes = np.zeros_like(points)
    wanted = WANTED * task.requirements.separation.radius
    for prism in task.requirements.keep_out:
        clearance = prism.clearance(points)
        missing = np.maximum(wanted - clearance.distance, 0.0)
        pushes += missing[..., None] * clearance.normals
    first, second, longest = task.tether_arrays
    offset = points[:, first] - points[:, second]
    apart = length(offset)
    excess = np.maximum(apart - longest, 0.0) / np.maximum(apart, longest)
    pull = np.swapaxes(0.5 * excess[..., None] * offset, 0, 1)
    by_drone = np.swapaxes(pushes, 0, 1)
    np.add.at(by_drone, first, -pull)
    np.add.at(by_drone, second, pull)
    return pushes


CROWD = 32
"""Number of drones that meet at once from which on a roundabout is tried."""

LAYERS = 2
"""Number of altitudes at which drones pass, in the order of their numbers: rings are as much
smaller."""

RING = 1.06
"""Radius of a ring over that at which the drones of one layer have the separation WANTED."""

WIDTH = 1.3
"""Distance from the centre at which drones leave their straight routes, over the radius of a ring
of all drones."""

CLIMB = 6
"""Power of the distance in the offset upward: layers are apart before drones are within a ring of
all of them."""


def roundabout(setting: Setting) -> Array | None:
    """Return the coefficients (N, count, 3) [m] of curves around a crowd; None where there is none.

    A crowd meets half way, at one place, where pushes between pairs would amplify rounding. With
    ``x`` the distance from there over WIDTH radii of a ring of all its drones, the offset to the
    right is ``(1 - x²)²`` times the radius of a layer's ring, and that upward ``(1 - x⁶)²`` times
    the layer's altitude.
    """
    task, grid, separation = setting.task, setting.grid, setting.task.requirements.separation
    s = _samples(grid)
    points, steps = (grid.sampled(s, order) @ setting.nominal for order in (0, 1))
    middle = grid.sampled(np.asarray(0.5)) @ setting.nominal
    centre = np.median(middle, axis=0)
    crowd = np.linalg.norm((middle - centre) * separation.scale, axis=-1) < WANTED
    if np.sum(crowd) < CROWD:
        return None
    spacing = 2.0 * WANTED * separation.radius
    ring = np.where(crowd, RING * spacing * np.sum(crowd) / (2.0 * math.pi), 0.0)[:, None]
    distance = np.linalg.norm((points - centre)[..., :2], axis=-1)
    x = np.divide(distance, WIDTH * ring, out=np.ones_like(distance), where=ring > 0.0)
    aside, upward = (np.maximum(1.0 - x**power, 0.0) ** 2 for power in (2, CLIMB))
    right = rightward(steps.reshape(-1, 3), 0.0).reshape(steps.shape)
    offset = (ring / LAYERS * aside)[..., None] * right
    layer = np.arange(task.drones)[:, None] % LAYERS - 0.5 * (LAYERS - 1)
    offset[..., 2] += 2.0 * WANTED * separation.height * layer * upward
    coefficients = setting.nominal.copy()
    moved = coefficients[:, grid.free] + grid.fitting(s) @ offset
    coefficients[:, grid.free] = inside(task.requirements.arena, moved)
    return coefficients
