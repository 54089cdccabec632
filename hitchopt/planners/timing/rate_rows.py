"""Limits of motion as rows over (x, x', x''), x the squared rate of a clock: see ``warp``.

With p = (x, x', x''), acceleration and √x-th part of the jerk are linear in p, so that every limit
is a quadratic form of p and, for the jerk, of 1/x:

    pᵀ (Q - C) p + bᵀ p + c - e / x ≤ 0,   Q and C positive semidefinite, e ≥ 0.

Without C and e it would be convex; they are of the tilt and of the jerk only.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hitchopt.geometry.vectors import dot, length
from hitchopt.planners.timing.demands import LIMIT_SHARE, Demands
from hitchopt.values import Array, Indices

ACCELERATION, JERK, THRUST, TILT = range(4)


@dataclass(frozen=True, eq=False)
class ClockedPath:
    """A path by a first clock τ, at M samples of it.

    Attributes
    ----------
    demands: of the path, by its own parameter.
    first, second, third: (M, 2n, 3), the drones' derivatives by τ.
    most: (M,) of x, by the limits of speed.
    """

    demands: Demands
    first: Array
    second: Array
    third: Array
    most: Array

    def ratios(self, x: Array, x1: Array, x2: Array) -> Array:
        """Return (4, M, 2n): acceleration, jerk, thrust, tilt over their limits."""
        limits, m = self.demands.limits, self.demands.mass[:, None]
        x, x1, x2 = (a[:, None, None] for a in (x, x1, x2))
        a = x * self.second + 0.5 * x1 * self.first
        j = np.sqrt(x) * (x * self.third + 1.5 * x1 * self.second + 0.5 * x2 * self.first)
        f = m * a + self.demands.loads
        level = np.hypot(f[..., 0], f[..., 1])
        return np.stack(
            [
                length(a) / limits.acceleration,
                length(j) / limits.jerk,
                length(f) / self.demands.max_thrust,
                np.arctan2(level, f[..., 2]) / limits.tilt,
            ]
        )


@dataclass(frozen=True, eq=False)
class RateRows:
    """R rows at each of M samples.

    Attributes
    ----------
    Q, C: (M, R, 3, 3)
    b: (M, R, 3)
    c, e: (M, R)
    """

    Q: Array
    C: Array
    b: Array
    c: Array
    e: Array

    @classmethod
    def of(cls, path: ClockedPath, drones: Indices) -> RateRows:
        """Return the rows of the speed and of given drones.

        Parameters
        ----------
        drones: (4, M, R'), whose acceleration, jerk, thrust and tilt are rows.
        """
        demands, limits = path.demands, path.demands.limits
        samples = np.arange(len(path.most))[:, None]
        nothing = np.zeros((*drones.shape[1:], 3))

        def linear(kind: int) -> tuple[Array, Array, Array]:
            """Return a drone's acceleration (…, 3, 3) by p, its load (…, 3) and mass."""
            which = (samples, drones[kind])
            by_p = np.stack([path.second[which], 0.5 * path.first[which], nothing], axis=-1)
            return by_p, demands.loads[which], demands.mass[drones[kind]]

        A, _, _ = linear(ACCELERATION)
        A = A / limits.acceleration
        which = (samples, drones[JERK])
        J = np.stack([path.third[which], 1.5 * path.second[which], 0.5 * path.first[which]], -1)
        J = J / limits.jerk
        F, load, mass = linear(THRUST)
        most = demands.max_thrust[drones[THRUST]]
        F, load = (mass / most)[..., None, None] * F, load / most[..., None]
        G, pull, mass = linear(TILT)
        weight = length(pull)
        G, pull = (mass / weight)[..., None, None] * G, pull / weight[..., None]
        slope = np.tan(LIMIT_SHARE * limits.tilt)
        rise, lift = slope * G[..., 2:, :], slope * pull[..., 2:]
        G, pull = G[..., :2, :], pull[..., :2]
        share = np.full(A.shape[:2], LIMIT_SHARE**2)
        zero, flat = np.zeros((*share.shape, 3, 3)), np.zeros_like(share)
        none, one = zero[:, :1], np.ones((len(samples), 1))
        speed = np.stack([1.0 / path.most, *np.zeros((2, len(samples)))], axis=-1)[:, None]
        thrust, tilt = _double(F, load), _double(G, pull) - _double(rise, lift)
        rows = (
            (none, none, speed, -one, 0.0 * one),
            (_square(A), zero, nothing, -share, flat),
            (_square(J), zero, nothing, flat, share),
            (_square(F), zero, thrust, dot(load, load) - share, flat),
            (_square(G), _square(rise), tilt, dot(pull, pull) - dot(lift, lift), flat),
        )
        parts = (np.concatenate(part, axis=1) for part in zip(*rows, strict=True))
        return cls(*map(np.asfortranarray, parts))

    @cached_property
    def forms(self) -> Array:
        """(M, R, 3, 3): the rows' quadratic forms."""
        return self.Q - self.C

    def values(self, p: Array) -> Array:
        """Return the rows' left sides (M, R) for p (M, 3)."""
        along = np.einsum("mrij,mj->mri", self.forms, p) + self.b
        values: Array = np.einsum("mri,mi->mr", along, p) + self.c - self.e / p[:, :1]
        return values

    def gradients(self, p: Array) -> Array:
        """Return their derivatives by p (M, R, 3)."""
        gradients: Array = 2.0 * np.einsum("mrij,mj->mri", self.forms, p) + self.b
        gradients[..., 0] += self.e / p[:, :1] ** 2
        return gradients

    def curvature(self, p: Array, weights: Array, *, convex: bool = False) -> Array:
        """Return the weighted sum (M, 3, 3) of second derivatives, weights (M, R).

        Parameters
        ----------
        convex: leave out the concave parts.
        """
        forms = self.Q if convex else self.forms
        total: Array = 2.0 * np.einsum("mr,mrij->mij", weights, forms)
        if not convex:
            total[:, 0, 0] -= 2.0 * np.sum(weights * self.e, axis=1) / p[:, 0] ** 3
        return total


def _square(A: Array) -> Array:
    """Return AᵀA for A (…, d, 3)."""
    return np.swapaxes(A, -1, -2) @ A


def _double(A: Array, load: Array) -> Array:
    """Return 2 Aᵀ load for A (…, d, 3) and loads (…, d)."""
    double: Array = 2.0 * np.einsum("...ij,...i->...j", A, load)
    return double
