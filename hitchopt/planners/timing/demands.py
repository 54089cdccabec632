"""What motion along a path demands of the drones, in the quantities of their limits."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.model import drone_jets
from hitchopt.hitch.requirements import Limits
from hitchopt.planners.morph.path import Path
from hitchopt.values import Array

LIMIT_SHARE = 0.999
"""Share of the limits that is planned at samples; the rest is for what happens between them."""

FINAL_SHARE = 1.0 - 0.5 * (1.0 - LIMIT_SHARE)
"""Share of the limits that the polynomials' enclosures may use: half of the rest remains to the
certificate, which bounds them by other means."""

CHUNK = 64_000
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
        linear, quadratic = np.stack([u, x], axis=1), np.stack([u * u, 2.0 * u * x, x * x], axis=1)
        factors, many = np.empty(u.shape), max(1, CHUNK // (self.drones.shape[1] * u.shape[1]))
        for first in range(0, len(u), many):
            at = slice(first, first + many)
            forms, slopes, shut = self._slowness(at)
            slowest = np.sqrt(np.max(forms[0] @ quadratic[at], axis=1))
            with np.errstate(invalid="ignore"):  # a negative discriminant: that limit ends no ray
                for form, slope in zip(forms[1:], slopes, strict=True):
                    root = np.sqrt(form @ quadratic[at]) + slope @ linear[at]
                    slowest = np.fmax(slowest, np.fmax.reduce(root, axis=1))
            factors[at] = 1.0 / np.maximum(slowest, 1e-150)
            factors[at][np.any(shut, axis=1)] = 0.0
        return factors

    def _slowness(self, at: slice) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return by what the inverse of a ray's factor is computed, limit by limit, at some points.

        With ``a ρ² + 2 b ρ + c = 0`` where a limit is reached, and c < 0 as at rest it is kept,
        ``1 / ρ = -b / c + √((b / c)² - a / c)``, in which nothing cancels.

        Returns
        -------
        (3, J, 2n, 3), forms of (u², 2 u x, x²): the inverse's square for the acceleration, what is
        under the root for thrust and tilt; (2, J, 2n, 2), forms of (u, x): -b / c for these two;
        (J, 2n), whether rest itself breaks a limit.
        """
        q1, q2, loads = self.drones[at, ..., 1], self.drones[at, ..., 2], self.loads[at]
        squares = np.stack([dot(q1, q1), dot(q1, q2), dot(q2, q2)], axis=-1)
        along = np.stack([dot(q1, loads), dot(q2, loads)], axis=-1)
        upward = np.stack([q1[..., 2], q2[..., 2]], axis=-1)
        lift, upwards = loads[..., 2, None], _products(upward)
        forms = [squares / (self.share * self.limits.acceleration) ** 2]
        slopes, shut = [], np.zeros(loads.shape[:-1], dtype=np.bool_)
        rest, cone = dot(loads, loads), 1.0 + math.tan(self.share * self.limits.tilt) ** 2
        thrust = rest - (self.share * self.max_thrust) ** 2
        for c, slope2 in ((thrust, 0.0), (rest - cone * loads[..., 2] ** 2, cone)):
            shut |= c >= 0.0
            inverse = (self.mass / np.where(c < 0.0, -c, 1.0))[..., None]
            slopes.append(inverse * (along - slope2 * lift * upward))
            form = self.mass[:, None] * inverse * (squares - slope2 * upwards)
            forms.append(form + _products(slopes[-1]))
        return np.stack(forms), np.stack(slopes), shut

    def stretches(self) -> Array:
        """Return how many times slower each drone (2n,) must fly to keep its limits.

        The parameter is the flight's time. Below 1 where it could be faster, infinite where not
        even the forces at rest are within the limits. Slowed by κ, velocities fall with κ,
        accelerations with κ² and jerks with κ³.
        """
        forms, slopes, shut = self._slowness(slice(None))
        squares, slope = forms[..., 2], slopes[..., 1]  # along the ray of ṡ²
        forces = np.where(squares[1:] >= 0.0, slope + np.sqrt(np.maximum(squares[1:], 0.0)), 0.0)
        speeds, jerks = length(self.drones[..., 1]), length(self.drones[..., 3])
        slower = np.maximum.reduce(
            [
                speeds / self.limits.speed / self.share,
                np.sqrt(np.maximum(np.sqrt(squares[0]), np.max(forces, axis=0))),
                np.cbrt(jerks / self.limits.jerk / self.share),
            ]
        )
        slowest: Array = np.max(np.where(shut, math.inf, slower), axis=0)
        return slowest

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
