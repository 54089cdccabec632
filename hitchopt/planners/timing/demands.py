"""What motion along a path demands of the drones, in the quantities of their limits."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch import GRAVITY, Team
from hitchopt.model.evaluation import drone_jets
from hitchopt.planners.path.shape_path import Path
from hitchopt.requirements import Limits
from hitchopt.values import Array

LIMIT_SHARE = 0.999
"""Share of the limits that is planned at samples; the rest is for what happens between them."""

FINAL_SHARE = 1.0 - 0.5 * (1.0 - LIMIT_SHARE)
"""Share of the limits that the polynomials' enclosures may use: half of the rest remains to the
certificate, which bounds them by other means."""

CHUNK = 32_000
"""Number of rays of drones that are cast at a time: temporary arrays fit in a core's cache, and are
small enough for memory that is used again."""


@dataclass(frozen=True, eq=False)
class Demands:
    """Jets along a path and the loads at rest, at J points.

    Attributes
    ----------
    drones: (J, 2n, 3, 4) [m], positions and derivatives by the path's parameter.
    vertex_speed: (J,) [m], largest first derivative of a vertex.
    loads: (J, 2n, 3) [N], thrust at rest: weight and the cable's pull held against.
    mass, max_thrust: (2n,) [kg], [N]
    limits: of which ``share`` is used.
    """

    drones: Array
    vertex_speed: Array
    loads: Array
    mass: Array
    max_thrust: Array
    limits: Limits
    share: float = LIMIT_SHARE

    @classmethod
    def along(cls, path: Path, limits: Limits, s: Array) -> Demands:
        """Return the demands of a path at its points s (J,)."""
        flat = path.flat(s)
        drones = drone_jets(path.team, flat)
        vertex_speed = np.max(length(flat.vertices[..., 1]), axis=1)
        loads = loads_at_rest(path.team, drones.cable_forces)
        return cls(
            drones.positions, vertex_speed, loads, path.team.mass, path.team.max_thrust, limits
        )

    @property
    def speed_bound(self) -> Array:
        """(J,): largest ṡ² within the speed limits of drones and vertices."""
        fastest = np.max(length(self.drones[..., 1]), axis=1)
        own = np.maximum(fastest / self.limits.speed, self.vertex_speed / self.limits.vertex_speed)
        bound: Array = (self.share / np.maximum(own, 1e-12)) ** 2
        return bound

    def reach(self, u: Array, x: Array) -> Array:
        """Return how far along rays (u, x) in the plane of s̈ and ṡ² every drone's limits hold.

        The set that they allow is convex (norms and a cone of an affine function), so the ends of
        rays span an inner approximation of it.

        Parameters
        ----------
        u, x: (J, m), ray directions.

        Returns
        -------
        (J, m), the largest factor on each ray, 0 where rest itself breaks a limit.
        """
        many = max(1, CHUNK // self.drones.shape[1])
        parts = [slice(first, first + many) for first in range(0, len(u), many)]
        return np.concatenate([self._cast(at, u[at], x[at]) for at in parts])

    def _cast(self, at: slice, u: Array, x: Array) -> Array:
        """Return ``reach`` at some points, in turn for as many rays of drones as CHUNK allows."""
        forms, slopes, shut = self._slowness(at)
        linear, quadratic = np.stack([u, x], axis=1), np.stack([u * u, 2.0 * u * x, x * x], axis=1)
        slowest, drones = np.zeros(u.shape), forms.shape[2]
        size = max(1, CHUNK // u.shape[1])  # of drones, then of points with all of their drones
        points = max(1, size // drones)
        with np.errstate(invalid="ignore"):  # a negative discriminant: that limit ends no ray
            for first in range(0, len(u), points):
                span, found = slice(first, first + points), slowest[first : first + points]
                for drone in range(0, drones, size):
                    some = slice(drone, drone + size)
                    squared = forms[0, span, some] @ quadratic[span]
                    np.maximum(found, np.sqrt(np.max(squared, axis=1)), out=found)
                    for form, slope in zip(forms[1:], slopes, strict=True):
                        root = form[span, some] @ quadratic[span]
                        np.sqrt(root, out=root)
                        root += slope[span, some] @ linear[span]
                        np.fmax(found, np.fmax.reduce(root, axis=1), out=found)
        factor: Array = 1.0 / np.maximum(slowest, 1e-150)
        factor[shut] = 0.0
        return factor

    def _slowness(self, at: slice) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return by what the inverse of a ray's factor is computed, limit by limit, at some points.

        With ``a ρ² + 2 b ρ + c = 0`` where a limit is reached, and c < 0 as at rest it is kept,
        ``1 / ρ = -b / c + √((b / c)² - a / c)``, in which nothing cancels.

        Returns
        -------
        (3, J, 2n, 3), forms of (u², 2 u x, x²): the inverse's square for the acceleration, what is
        under the root for thrust and tilt; (2, J, 2n, 2), forms of (u, x): -b / c for these two;
        (J,), whether rest itself breaks a limit.
        """
        q1, q2, loads = self.drones[at, ..., 1], self.drones[at, ..., 2], self.loads[at]
        squares = np.stack([dot(q1, q1), dot(q1, q2), dot(q2, q2)], axis=-1)
        along = np.stack([dot(q1, loads), dot(q2, loads)], axis=-1)
        upward = np.stack([q1[..., 2], q2[..., 2]], axis=-1)
        lift, upwards = loads[..., 2, None], _products(upward)
        forms = [squares / (self.share * self.limits.acceleration) ** 2]
        slopes, shut = [], np.zeros(len(q1), dtype=np.bool_)
        for c, slope2 in self._rest(loads):
            shut |= np.any(c >= 0.0, axis=1)
            inverse = (self.mass / np.where(c < 0.0, -c, 1.0))[..., None]
            slopes.append(inverse * (along - slope2 * lift * upward))
            form = self.mass[:, None] * inverse * (squares - slope2 * upwards)
            forms.append(form + _products(slopes[-1]))
        return np.stack(forms), np.stack(slopes), shut

    def _rest(self, loads: Array) -> tuple[tuple[Array, float], tuple[Array, float]]:
        """Return c (J, 2n) of thrust and tilt, and what squares of heights count for in them.

        Parameters
        ----------
        loads: (J, 2n, 3) [N]
        """
        squares = dot(loads, loads)
        slope2 = 1.0 + math.tan(self.share * self.limits.tilt) ** 2
        most = self.share * self.max_thrust
        return (squares - most * most, 0.0), (squares - slope2 * loads[..., 2] ** 2, slope2)

    def stretch(self) -> float:
        """Return how many times slower a flight must be to keep its limits, the parameter its time.

        Below 1 where it could be faster, infinite where not even the forces at rest are within the
        limits. Slowed by κ, velocities fall with κ, accelerations with κ² and jerks with κ³.
        """
        q2 = self.drones[..., 2]
        squares, along, upward = dot(q2, q2), dot(q2, self.loads), q2[..., 2]
        slowest = [np.sqrt(squares) / (self.share * self.limits.acceleration)]
        for c, slope2 in self._rest(self.loads):
            if np.any(c >= 0.0):
                return math.inf
            inverse = self.mass / -c
            b = inverse * (along - slope2 * self.loads[..., 2] * upward)
            root = b * b + self.mass * inverse * (squares - slope2 * upward * upward)
            slowest.append(np.where(root >= 0.0, b + np.sqrt(np.maximum(root, 0.0)), 0.0))
        by_forces = math.sqrt(max(0.0, *(float(np.max(each)) for each in slowest)))
        by_speed = 1.0 / np.sqrt(np.min(self.speed_bound))
        by_jerk = np.cbrt(np.max(length(self.drones[..., 3])) / (self.share * self.limits.jerk))
        return float(max(by_speed, by_forces, by_jerk))

    def at_rest(self) -> tuple[Array, Array]:
        """Return (J, 2n) each: thrust at rest over its limit, tilt at rest over its limit."""
        thrust = length(self.loads) / self.max_thrust
        level = np.hypot(self.loads[..., 0], self.loads[..., 1])
        return thrust, np.arctan2(level, self.loads[..., 2]) / self.limits.tilt


def loads_at_rest(team: Team, cable_forces: Array) -> Array:
    """Return the thrust (…, 2n, 3) [N] of drones at rest: ``m g ẑ - cable force``."""
    loads: Array = team.mass[:, None] * np.array([0.0, 0.0, GRAVITY]) - cable_forces
    return loads


def _products(pair: Array) -> Array:
    """Return the products (…, 3) of both numbers (…, 2): first², first · second, second²."""
    return pair[..., [0, 0, 1]] * pair[..., [0, 1, 1]]
