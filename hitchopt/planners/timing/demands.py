"""What motion along a path demands of the drones, in the quantities of their limits."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

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
        q1, q2 = self.drones[..., 1], self.drones[..., 2]
        aa, ab, bb = (dot(a, b)[:, :, None] for a, b in ((q1, q1), (q1, q2), (q2, q2)))
        zu, zx = q1[..., 2][:, :, None], q2[..., 2][:, :, None]
        lu = dot(q1, self.loads)[:, :, None]
        lx = dot(q2, self.loads)[:, :, None]
        u, x = u[:, None, :], x[:, None, :]
        squared = aa * u**2 + 2.0 * ab * u * x + bb * x**2  # |q' u + q'' x|²
        upward = zu * u + zx * x
        along = lu * u + lx * x
        m = self.mass[None, :, None]
        load2 = dot(self.loads, self.loads)[:, :, None]
        load_z = self.loads[..., 2][:, :, None]
        most = self.share * self.max_thrust[None, :, None]
        slope2 = 1.0 + np.tan(self.share * self.limits.tilt) ** 2
        factor = self.share * self.limits.acceleration / np.sqrt(np.maximum(squared, 1e-300))
        factor = np.minimum(factor, _first_root(m * m * squared, m * along, load2 - most * most))
        factor = np.minimum(
            factor,
            _first_root(
                m * m * (squared - slope2 * upward**2),
                m * (along - slope2 * upward * load_z),
                load2 - slope2 * load_z**2,
            ),
        )
        smallest: Array = np.min(factor, axis=1)
        return smallest

    def stretch(self) -> float:
        """Return how many times slower a flight must be to keep its limits, the parameter its time.

        Below 1 where it could be faster, infinite where not even the forces at rest are within the
        limits. Slowed by κ, velocities fall with κ, accelerations with κ² and jerks with κ³.
        """
        still = np.zeros((len(self.drones), 1))
        jerk = np.max(length(self.drones[..., 3]))
        reach = float(np.min(self.reach(still, still + 1.0)))
        if not reach > 0.0:
            return math.inf
        by_speed = 1.0 / np.sqrt(np.min(self.speed_bound))
        by_jerk = np.cbrt(jerk / (self.share * self.limits.jerk))
        return float(max(by_speed, 1.0 / math.sqrt(reach), by_jerk))

    def at_rest(self) -> tuple[Array, Array]:
        """Return (J, 2n) each: thrust at rest over its limit, tilt at rest over its limit."""
        thrust = length(self.loads) / self.max_thrust
        level = np.hypot(self.loads[..., 0], self.loads[..., 1])
        return thrust, np.arctan2(level, self.loads[..., 2]) / self.limits.tilt


def loads_at_rest(team: Team, cable_forces: Array) -> Array:
    """Return the thrust (…, 2n, 3) [N] of drones at rest: ``m g ẑ - cable force``."""
    loads: Array = team.mass[:, None] * np.array([0.0, 0.0, GRAVITY]) - cable_forces
    return loads


def _first_root(a: Array, b: Array, c: Array) -> Array:
    """Return the smallest positive root of ``a ρ² + 2 b ρ + c``, infinity if none, 0 if c ≥ 0."""
    discriminant = b * b - a * c
    root = np.sqrt(np.maximum(discriminant, 0.0))
    # Written so that nothing cancels: with c < 0 the wanted root is -c / (b + root).
    below = b + root
    found = np.where(
        (discriminant >= 0.0) & (below > 0.0), -c / np.where(below > 0.0, below, 1.0), np.inf
    )
    return np.where(c >= 0.0, 0.0, found)
