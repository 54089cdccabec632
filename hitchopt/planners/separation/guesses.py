"""Initial guesses: nominal curves, pushed apart where they meet until they are nearly clear.

Drones that come too close are pushed apart at samples of time, along their offset; a smoothing
filter makes curves of the pushes. Where two drones meet head on there is no offset to speak of:
at first all give way to the same side, as in a roundabout. Everything
is deterministic. One round takes O(M log M) for M samples of drones, and what pairs are close.

A crowd that meets in one place goes around it, all on the same side. Pushes between pairs amplify
rounding a million times where tens of drones meet at once; a roundabout is closed form.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from hitchopt.errors import check_time
from hitchopt.geometry.vectors import EAST, TIE, unit
from hitchopt.planners.separation.setting import Grid, Setting, inside
from hitchopt.values import Array

SAMPLES = 3
"""Number of samples of every piece at which guesses are pushed."""

WANTED = 1.15
"""Separation that pushes aim at, larger than 1 as drones also move between samples."""

ROUNDS = 120
"""Maximum rounds of pushing."""

MOMENTUM = 0.8
"""Share of a round's pushes that carries over to the next round."""

STIFFNESS = 0.08
"""Shortest bend that the filter passes, as a share of the duration."""

FADING = 0.5
"""Share of the rounds over which the common side fades out of the pushes."""


def pushed_apart(setting: Setting, side: float) -> Array:
    """Return the coefficients (N, count, 3) [m] of curves that are clear, or nearly so.

    Parameters
    ----------
    side: strength of the push to the right (negative: to the left), in separations.
    """
    grid = setting.grid
    s = _samples(grid)
    basis, rates, smoothing = grid.sampled(s), grid.sampled(s, 1), grid.fitting(s, STIFFNESS)
    coefficients = setting.nominal.copy()
    speed = np.zeros_like(coefficients[:, grid.free])
    for round_number in range(ROUNDS):
        check_time()
        points, velocities = (np.swapaxes(each @ coefficients, 0, 1) for each in (basis, rates))
        fading = max(0.0, 1.0 - round_number / (FADING * ROUNDS))
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
    length = np.linalg.norm(offset, axis=-1)
    excess = np.maximum(length - longest, 0.0) / np.maximum(length, longest)
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

    A crowd meets half way, at one place. With ``x`` the distance from there over WIDTH radii of a
    ring of all its drones, the offset to the right is ``(1 - x²)²`` times the radius of a layer's
    ring, and that upward ``(1 - x⁶)²`` times the layer's altitude.
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
