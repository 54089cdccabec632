"""Time-optimal speed along a path under limits on vector norms, by toppra."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import toppra
from scipy.interpolate import PPoly
from toppra import algorithm, constraint
from toppra.constraint.linear_constraint import canlinear_colloc_to_interpolate

from hitchopt.errors import HitchoptError
from hitchopt.geometry.vectors import length
from hitchopt.planners.timing.demands import Demands
from hitchopt.values import Array

logging.getLogger("toppra").setLevel(logging.ERROR)  # its complaints become a TimingError

RAYS = 64
"""Directions in the half plane of (s̈, ṡ² ≥ 0): chords cut off 0.03 % of a circle."""

CHUNK = 40_000
"""Number of elements of a temporary array: rays are cast for as many points of the path at a time.
The dozen arrays fit in a core's cache, which makes it four times as fast."""


class TimingError(HitchoptError):
    """The path cannot be timed: toppra found no profile from rest to rest."""


def path_grid(steps: int) -> Array:
    """Return (steps + 1,) from 0 to 1, closer at the ends, where the path is left from rest."""
    return 0.5 - 0.5 * np.cos(np.pi * np.arange(steps + 1) / steps)


@dataclass(frozen=True, eq=False)
class SpeedProfile:
    """The fastest motion along a path without a jerk limit.

    Attributes
    ----------
    s: (J,), the grid from 0 to 1.
    speed: (J,) [1/s], ṡ there; s̈ is constant in between.
    """

    s: Array
    speed: Array

    @property
    def times(self) -> Array:
        """(J,) [s]: when s is reached."""
        steps = 2.0 * np.diff(self.s) / (self.speed[1:] + self.speed[:-1])
        return np.append(0.0, np.cumsum(steps))

    @property
    def duration(self) -> float:
        """Duration from rest to rest [s]."""
        return float(self.times[-1])

    @cached_property
    def progress(self) -> PPoly:
        """Function of time [s]: s, a quadratic on each step."""
        steps = np.diff(self.times)
        quadratics = np.stack([0.5 * np.diff(self.speed) / steps, self.speed[:-1], self.s[:-1]])
        return PPoly(quadratics, self.times)

    def acceleration(self, t: Array) -> Array:
        """Return s̈ at t (…) [s], zero before and after [1/s²]."""
        inside = (t >= 0.0) & (t <= self.duration)
        return np.where(inside, self.progress(np.clip(t, 0.0, self.duration), 2), 0.0)

    def mean(self, t: Array, width: float) -> Array:
        """Return the mean of s over the ``width`` [s] before t (…); at rest before and after."""
        integral, end = self.progress.antiderivative(), self.duration
        until, before = (
            integral(np.clip(x, 0.0, end)) + np.maximum(x - end, 0.0) for x in (t, t - width)
        )
        mean: Array = (until - before) / width
        return mean


def fastest_profile(s: Array, demands: Demands) -> SpeedProfile:
    """Return the time-optimal profile from rest to rest on the grid s (J,), from 0 to 1.

    Raises
    ------
    TimingError: none exists, as where rest itself breaks a limit on the path.
    """
    rows = acceleration_rows(demands)
    # toppra's bounds and tolerances are absolute: its path gets a length, and its time a unit, in
    # which both s̈ and ṡ² are of order 1, be they bound by acceleration or by speed.
    length = float(np.clip(np.median(rows.steepest / rows.fastest), 1e-2, 1e9))
    unit = float(np.median(rows.fastest)) * length
    normals = rows.normals * [1.0, 1.0 / length]
    size = np.linalg.norm(normals, axis=-1)
    rule = _Rule(normals / size[..., None], rows.bounds / unit / size)
    path = toppra.SplineInterpolator([0.0, length], [[0.0], [1.0]])
    solver = algorithm.TOPPRA([rule], path, gridpoints=s * length, solver_wrapper="seidel")
    _, speed, _ = solver.compute_parameterization(0.0, 0.0)
    if speed is None or not np.all(np.isfinite(speed)) or np.any(speed[1:-1] <= 0.0):
        raise TimingError("toppra found no speed profile from rest to rest on this path")
    return SpeedProfile(s, speed * np.sqrt(unit / length))


def acceleration_ramp(profile: SpeedProfile, demands: Demands) -> float:
    """Return how long the acceleration takes from one limit to the other [s].

    Where the jerk never lets it reach its limits: as long as the largest speed that is reached
    takes, or the longest path of a drone.
    """
    rates = length(demands.drones[..., 1])
    speed = float(np.max(rates * profile.speed[:, None]))
    steps = np.diff(profile.s)[:, None]
    longest = float(np.max(np.sum(0.5 * (rates[1:] + rates[:-1]) * steps, axis=0)))
    limits = demands.limits
    return min(
        2.0 * limits.acceleration / limits.jerk,
        2.0 * math.sqrt(speed / limits.jerk),
        math.pow(32.0 * longest / limits.jerk, 1.0 / 3.0),
    )


@dataclass(frozen=True, eq=False)
class AccelerationRows:
    """Half planes ``normals @ (s̈, ṡ²) ≤ bounds``.

    Attributes
    ----------
    normals: (J, m, 2)
    bounds: (J, m)
    steepest, fastest: (J,) [1/s²], sizes of s̈ and ṡ².
    """

    normals: Array
    bounds: Array
    steepest: Array
    fastest: Array


@dataclass(frozen=True, eq=False)
class AllowedCorners:
    """Polygons of (s̈, ṡ²) that all drones allow together, of fixed size in n.

    Attributes
    ----------
    points: (J, RAYS + 1, 2), corners from the largest s̈ at ṡ = 0 to the smallest.
    steepest, fastest: (J,) [1/s²], sizes of s̈ and ṡ².
    """

    points: Array
    steepest: Array
    fastest: Array


def allowed_corners(demands: Demands) -> AllowedCorners:
    """Return an inner approximation of what all drones' limits allow.

    Vector norms are no boxes: rays from rest find the boundary of the convex set that all drones
    allow together, and the polygon through their ends lies inside of it.
    """
    fastest = demands.speed_bound
    steepest = np.min(
        demands.limits.acceleration / np.maximum(length(demands.drones[..., 1]), 1e-12), axis=1
    )
    angles = np.pi * np.arange(RAYS + 1) / RAYS
    u, x = steepest[:, None] * np.cos(angles), fastest[:, None] * np.sin(angles)
    x[:, [0, -1]] = 0.0
    ends = _cast(demands, u, x)
    moving = np.where(x > 0.0, x, 1.0)
    ends = np.minimum(ends, np.where(x > 0.0, fastest[:, None] / moving, np.inf))
    return AllowedCorners(np.stack([ends * u, ends * x], axis=-1), steepest, fastest)


def acceleration_rows(demands: Demands) -> AccelerationRows:
    """Return the half planes of the polygons of ``allowed_corners``."""
    allowed = allowed_corners(demands)
    corners = allowed.points
    along = np.diff(corners, axis=1)
    normals = np.stack([along[..., 1], -along[..., 0]], axis=-1)  # rays run counter-clockwise
    size = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = np.where(size > 0.0, normals / np.where(size > 0.0, size, 1.0), [0.0, 1.0])
    bounds = np.sum(normals * corners[:, :-1], axis=-1)
    return AccelerationRows(normals, bounds, allowed.steepest, allowed.fastest)


def _cast(demands: Demands, u: Array, x: Array) -> Array:
    """Return demands.reach in chunks of the path, to bound the memory."""
    size = max(1, CHUNK // (demands.drones.shape[1] * u.shape[1]))
    parts = []
    for first in range(0, len(u), size):
        span = slice(first, first + size)
        drones, vertex_speed = demands.drones[span], demands.vertex_speed[span]
        part = replace(demands, drones=drones, vertex_speed=vertex_speed, loads=demands.loads[span])
        parts.append(part.reach(u[span], x[span]))
    return np.concatenate(parts)


class _Rule(constraint.LinearConstraint):  # type: ignore[misc]
    """The rows as toppra wants them: ``F (a s̈ + b ṡ² + c) ≤ g`` with a, b the unit vectors."""

    def __init__(self, normals: Array, bounds: Array) -> None:
        super().__init__()
        self.normals, self.bounds = normals, bounds
        self.discretization_type = constraint.DiscretizationType.Interpolation
        self.identical = False

    def compute_constraint_params(
        self, path: object, gridpoints: Array, *_: object
    ) -> tuple[object, ...]:
        """Return toppra's canonical arrays, also enforced at the next grid point."""
        del path
        count = len(gridpoints)
        a = np.tile([1.0, 0.0], (count, 1))
        b = np.tile([0.0, 1.0], (count, 1))
        converted: tuple[object, ...] = canlinear_colloc_to_interpolate(
            a, b, np.zeros((count, 2)), self.normals, self.bounds, None, None, gridpoints
        )
        return converted
