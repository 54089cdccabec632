"""Initial guesses: nominal curves pushed apart, or around a crowd, at altitudes, on a schedule.

They are deterministic and insensitive to rounding of the input.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import interp1d
from scipy.spatial import cKDTree

from hitchopt.errors import check_time
from hitchopt.geometry.vectors import EAST, TIE, left_of, length, unit
from hitchopt.hitch.requirements import Prism
from hitchopt.swarms.nominal import fit_samples, fitted_curves, setting_of
from hitchopt.swarms.prioritized import Schedule
from hitchopt.swarms.task import Grid, SeparationTask, Setting, inside
from hitchopt.values import Array


@dataclass(frozen=True)
class GuessTuning:
    """Numbers of the guesses; ``python -m benchmarks separation`` shows their effect."""

    samples: int = 3  # Number of samples of every piece at which guesses are pushed
    target_separation: float = 1.15  # Target of pushes; above 1, since drones move between samples
    max_push_iterations: int = 120  # Maximum number of iterations of pushing
    momentum: float = 0.8  # Fraction of an iteration's pushes that is added to the next
    smoothing_time: float = 0.08  # Time constant of the smoothing filter, over the duration
    # Fraction of the iterations over which the common side fades out of the pushes
    side_fade_share: float = 0.5
    # Share of the distance to a prism below which a drone counts as stuck in it after pushes
    pushed_share: float = 0.8
    # Number of pieces of a grid for a schedule, over that of a grid for flights as long
    schedule_pieces: float = 4.0
    # Time constant of the filter of a schedule, over its duration
    schedule_smoothing_time: float = 0.005
    # Smallest number of drones meeting at the same time for which a roundabout is used
    min_crowd: int = 32
    layers: int = 2
    """Number of altitudes of a roundabout, which drones take in turn; it divides the rings' radius.
    """

    # Radius of a ring over that at which its drones have the ``target_separation``
    ring_factor: float = 1.06
    detour_factor: float = 1.3
    """Distance from the centre at which drones leave their straight routes, over the radius of a
    ring of all drones."""

    climb_power: int = 6
    """Power of the distance in the vertical offset, so that layers are separated before drones
    enter a ring of all of them."""

    min_layered: int = 16  # Smallest number of drones that are spread over altitudes among prisms


TUNING = GuessTuning()


MIN_OFFSET = 1e-9  # Offset of two drones, in separations, below which they are pushed to the right

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
    smoothing = grid.fitting(s, TUNING.smoothing_time)
    coefficients = setting.nominal.copy()
    step = np.zeros_like(coefficients[:, grid.free])
    for iteration in range(TUNING.max_push_iterations):
        check_time()
        points = np.swapaxes(values @ coefficients, 0, 1)
        velocities = np.swapaxes(rates @ coefficients, 0, 1)
        fade = max(0.0, 1.0 - iteration / (TUNING.side_fade_share * TUNING.max_push_iterations))
        pushes = _pair_pushes(setting, points, velocities, fade * side)
        pushes += _other_pushes(setting, points)
        if not np.any(pushes):
            break
        step = TUNING.momentum * step + smoothing @ np.swapaxes(pushes, 0, 1)
        moved = coefficients[:, grid.free] + step
        coefficients[:, grid.free] = inside(setting.task.requirements.arena, moved)
    return on_routes(setting, coefficients, stuck_in_prisms(setting, coefficients))


def on_routes(setting: Setting, coefficients: Array, drones: NDArray[np.bool_]) -> Array:
    """Return the coefficients (N, count, 3) [m] with some drones, a mask (N,), on their routes."""
    return np.where(drones[:, None, None], setting.nominal, coefficients)


def stuck_in_prisms(
    setting: Setting, coefficients: Array, share: float = TUNING.pushed_share
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
    """Return the times (samples · pieces,) at which guesses are pushed."""
    count = TUNING.samples * grid.pieces
    return (np.arange(count) + 0.5) / count


def _pair_pushes(setting: Setting, points: Array, velocities: Array, side: float) -> Array:
    """Return the pushes (samples, drones, 3) [m] by other drones."""
    samples, drones, _ = points.shape
    scale = setting.task.requirements.separation.scale
    scaled = (points * scale).reshape(-1, 3)
    # Time is a fourth coordinate, scaled so that only simultaneous samples are close.
    time = np.repeat(2.0 * TUNING.target_separation * np.arange(samples), drones)
    tree = cKDTree(np.column_stack([scaled, time]))
    first, second = tree.query_pairs(TUNING.target_separation, output_type="ndarray").T
    offset = scaled[first] - scaled[second]
    velocity = velocities.reshape(-1, 3)
    min_speed = TIE * float(np.max(np.abs(velocity)))
    right = rightward(velocity[first] - velocity[second], min_speed)
    direction = unit(offset + side * right, right, MIN_OFFSET)
    deficit = np.maximum(TUNING.target_separation - np.sum(direction * offset, axis=1), 0.0)
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
    target = TUNING.target_separation * task.requirements.separation.radius
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


def scheduled(task: SeparationTask, schedule: Schedule) -> Setting:
    """Return the task with nominal curves along a schedule, on a grid that resolves them."""
    setting = setting_of(task, TUNING.schedule_pieces * schedule.duration_ratio)
    grid = setting.grid
    times = np.linspace(0.0, 1.0, schedule.points.shape[1])
    points_at = interp1d(times, schedule.points, axis=1)
    targets = np.asarray(points_at(fit_samples(grid)), dtype=np.float64)
    nominal = fitted_curves(task, grid, targets, TUNING.schedule_smoothing_time)
    nominal[:, grid.free] = inside(task.requirements.arena, nominal[:, grid.free])
    return replace(setting, nominal=nominal)


def roundabout(setting: Setting) -> Array | None:
    """Return the coefficients (N, count, 3) [m] of curves around a crowd, or None without one.

    A crowd meets halfway at one point, where pushes between pairs would amplify rounding. With
    ``x`` the distance from there over ``detour_factor`` radii of a ring of all its drones, the
    offset to the right is ``(1 - x²)²`` times the radius of a layer's ring, and the vertical offset
    is ``(1 - x⁶)²`` times the layer's altitude.
    """
    task = setting.task
    grid = setting.grid
    separation = task.requirements.separation
    halfway = grid.sampled(np.asarray(0.5)) @ setting.nominal
    centre = np.median(halfway, axis=0)
    distance_halfway = np.linalg.norm((halfway - centre) * separation.scale, axis=-1)
    in_crowd = distance_halfway < TUNING.target_separation
    crowd = np.sum(in_crowd)
    if crowd < TUNING.min_crowd:
        return None
    # Radius (N, 1) [m] of a ring of the whole crowd, whose circumference seats all its drones
    spacing = 2.0 * TUNING.target_separation * separation.radius
    ring = np.where(in_crowd, TUNING.ring_factor * spacing * crowd / (2.0 * math.pi), 0.0)[:, None]
    s = _push_samples(grid)
    points = grid.sampled(s) @ setting.nominal
    velocities = grid.sampled(s, 1) @ setting.nominal
    distance = np.linalg.norm((points - centre)[..., :2], axis=-1)
    detour = TUNING.detour_factor * ring
    x = np.divide(distance, detour, out=np.ones_like(distance), where=ring > 0.0)
    lateral = np.maximum(1.0 - x**2, 0.0) ** 2
    vertical = np.maximum(1.0 - x**TUNING.climb_power, 0.0) ** 2
    right = rightward(velocities.reshape(-1, 3), 0.0).reshape(velocities.shape)
    offset = (ring / TUNING.layers * lateral)[..., None] * right
    layer = np.arange(task.drones)[:, None] % TUNING.layers - 0.5 * (TUNING.layers - 1)
    offset[..., 2] += 2.0 * TUNING.target_separation * separation.height * layer * vertical
    coefficients = setting.nominal.copy()
    moved = coefficients[:, grid.free] + grid.fitting(s) @ offset
    coefficients[:, grid.free] = inside(task.requirements.arena, moved)
    return coefficients


LAYER_SPACING = 2.0 * TUNING.target_separation
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
    if arena is None or task.drones < TUNING.min_layered:
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
    share = (1.0 - np.abs(2.0 * s - 1.0) ** TUNING.climb_power) ** 2
    offset = np.zeros_like(points)
    offset[..., 2] = share * (altitude[:, None] - points[..., 2])
    nominal = setting.nominal.copy()
    moved = nominal[:, grid.free] + grid.fitting(s) @ offset
    nominal[:, grid.free] = inside(arena, moved)
    return replace(setting, nominal=nominal)
