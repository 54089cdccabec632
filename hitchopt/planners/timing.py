"""Time-optimal speed along a path under limits on vector norms, by toppra."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import toppra
from numpy.typing import NDArray
from toppra import algorithm, constraint
from toppra.constraint.linear_constraint import canlinear_colloc_to_interpolate

from hitchopt.errors import HitchoptError
from hitchopt.planners.demands import Demands

Array = NDArray[np.float64]

RAYS = 64
"""Directions in the half plane of (s̈, ṡ² ≥ 0): chords cut off 0.03 % of a circle."""

CHUNK = 4_000_000
"""Elements of a temporary array: rays are cast for as many points of the path at a time."""


class TimingError(HitchoptError):
    """The path cannot be timed: toppra found no profile from rest to rest."""


@dataclass(frozen=True, eq=False)
class SpeedProfile:
    """The fastest way along a path without a jerk limit.

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
        """From rest to rest [s]."""
        return float(self.times[-1])

    def at(self, t: Array) -> Array:
        """Return s at t (…) [s]; at rest before and after."""
        times = self.times
        inside = np.clip(t, 0.0, times[-1])
        i = np.clip(np.searchsorted(times, inside, side="right") - 1, 0, len(times) - 2)
        dt = inside - times[i]
        acceleration = np.diff(self.speed)[i] / np.diff(times)[i]
        return np.minimum(self.s[i] + dt * (self.speed[i] + 0.5 * dt * acceleration), 1.0)


def fastest_profile(s: Array, demands: Demands) -> SpeedProfile:
    """Return the time-optimal profile from rest to rest on the grid s (J,), from 0 to 1.

    Raises
    ------
    TimingError: none exists, as where rest itself breaks a limit on the way.
    """
    rows = acceleration_rows(demands)
    unit = float(np.max(rows.scale))  # toppra's tolerances are absolute: make ṡ² of order 1
    rule = _Rule(rows.normals, rows.bounds / unit)
    path = toppra.SplineInterpolator([0.0, 1.0], [[0.0], [1.0]])
    solver = algorithm.TOPPRA([rule], path, gridpoints=s, solver_wrapper="seidel")
    _, speed, _ = solver.compute_parameterization(0.0, 0.0)
    if speed is None or not np.all(np.isfinite(speed)) or np.any(speed[1:-1] <= 0.0):
        raise TimingError("toppra found no speed profile from rest to rest on this path")
    return SpeedProfile(s, speed * np.sqrt(unit))


@dataclass(frozen=True, eq=False)
class AccelerationRows:
    """Half planes ``normals @ (s̈, ṡ²) ≤ bounds``.

    Attributes
    ----------
    normals: (J, m, 2)
    bounds: (J, m)
    scale: (J,) [1/s²], a typical size of ṡ².
    """

    normals: Array
    bounds: Array
    scale: Array


def acceleration_rows(demands: Demands) -> AccelerationRows:
    """Return an inner approximation of what all drones' limits allow, of fixed size in n.

    Vector norms are no boxes: rays from rest find the boundary of the convex set that all drones
    allow together, and the polygon through their ends lies inside of it.
    """
    fastest = demands.speed_bound
    steepest = np.min(
        demands.limits.acceleration
        / np.maximum(np.linalg.norm(demands.drones[..., 1], axis=-1), 1e-12),
        axis=1,
    )
    angles = np.pi * np.arange(RAYS + 1) / RAYS
    u, x = steepest[:, None] * np.cos(angles), fastest[:, None] * np.sin(angles)
    x[:, [0, -1]] = 0.0
    ends = _cast(demands, u, x)
    moving = np.where(x > 0.0, x, 1.0)
    ends = np.minimum(ends, np.where(x > 0.0, fastest[:, None] / moving, np.inf))
    corners = np.stack([ends * u, ends * x], axis=-1)
    along = np.diff(corners, axis=1)
    normals = np.stack([along[..., 1], -along[..., 0]], axis=-1)  # rays run counter-clockwise
    size = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = np.where(size > 0.0, normals / np.where(size > 0.0, size, 1.0), [0.0, 1.0])
    bounds = np.sum(normals * corners[:, :-1], axis=-1)
    return AccelerationRows(normals, bounds, fastest)


def _cast(demands: Demands, u: Array, x: Array) -> Array:
    """Return demands.reach in chunks of the path, to bound the memory."""
    size = max(1, CHUNK // (demands.drones.shape[1] * u.shape[1]))
    parts = []
    for first in range(0, len(u), size):
        span = slice(first, first + size)
        part = Demands(
            demands.drones[span],
            demands.vertex_speed[span],
            demands.loads[span],
            demands.mass,
            demands.max_thrust,
            demands.limits,
        )
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
