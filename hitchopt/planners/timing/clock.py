"""A jerk limit on top of a time-optimal profile: slow time down and speed it up along the path.

The profile, smoothed, gives the path a first clock τ. Flying it by another clock t with
``dτ/dt = √x(τ)`` makes every derivative by t linear in ``(x, x', x'')`` up to powers of √x:

    q̇ = √x Q',   q̈ = x Q'' + ½ x' Q',   q⃛ = √x (x Q''' + 3/2 x' Q'' + ½ x'' Q'),

Q the path by τ (as Debrouwere et al., "Time-optimal path following for robots with convex-concave
constraints using sequential convex programming", IEEE T-RO 29, 2013, do with s for τ; starting
from a clock that is at rest at both ends keeps x finite and away from zero there). The fastest x,
a cubic spline, is a small nonlinear program whose size does not depend on n: at each sample only
the drones that come nearest to their limits are rows, and more join as long as any breaks one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.polynomial.legendre import leggauss
from scipy.interpolate import BSpline, make_interp_spline
from scipy.linalg.lapack import dpbtrf, dpbtrs

from hitchopt.errors import check_time
from hitchopt.geometry.vectors import dot, length
from hitchopt.planners.morph.jets import chained, chained_rates, quintic_spline
from hitchopt.planners.timing.profile import LIMIT_SHARE, Demands, SpeedProfile, TimingError
from hitchopt.values import Array, Indices

DemandsAt = Callable[[Array], Demands]
"""Demands of the path at given s."""

SAMPLES = 5
"""Number of samples per piece at which limits are evaluated."""

NEAREST = 2
"""Number of drones per sample and limit that are rows from the start."""

DRONE_ROUNDS = 6
"""Maximum rounds of adding drones that break a limit."""

TOLERANCE = 0.2 * (1.0 - LIMIT_SHARE)
"""Relative tolerance of the limits; LIMIT_SHARE leaves more than this."""

STEADY = 0.97
"""Share of a squared rate at which limits bind from which the search starts: inside of them."""


@dataclass(frozen=True, eq=False)
class Clock:
    """s as a function of time, through τ.

    Attributes
    ----------
    knots: (K + 1,) [s], of τ; the pieces of the trajectory to be.
    progress: s(τ), a quintic spline at rest at both ends.
    squared_rate: x(τ), a cubic spline.
    """

    knots: Array
    progress: BSpline
    squared_rate: BSpline

    @property
    def breaks(self) -> Array:
        """(K + 1,) [s], t at the knots."""
        nodes, weights = leggauss(8)
        h = np.diff(self.knots)
        tau = self.knots[:-1, None] + 0.5 * h[:, None] * (1.0 + nodes)
        steps = 0.5 * h * (1.0 / np.sqrt(self.squared_rate(tau)) @ weights)
        return np.append(0.0, np.cumsum(steps))

    def jets(self) -> Array:
        """Return (K + 1, 4): s and its derivatives by t at the knots."""
        x, x1, x2 = (self.squared_rate(self.knots, order) for order in range(3))
        root = np.sqrt(x)
        by_t = np.stack([np.zeros_like(x), root, 0.5 * x1, 0.5 * x2 * root], axis=-1)  # of τ
        return chained(_spline_jet(self.progress, self.knots), by_t)


def first_clock(profile: SpeedProfile, ramp: float, knots: Array) -> Clock:
    """Return the profile smoothed over ``ramp`` [s], flown as it is (x = 1).

    A moving average of that width turns jumps of the acceleration into ramps.
    """
    at_knots = profile.mean(knots, ramp)
    at_knots[0], at_knots[-1] = 0.0, 1.0
    progress = quintic_spline(knots, at_knots, (1, 2))
    return Clock(knots, progress, make_interp_spline(knots, np.ones(len(knots)), k=3))


def jerk_limited(clock: Clock, demands_at: DemandsAt) -> Clock:
    """Return the clock sped up and slowed down to be as fast as all limits allow.

    Raises
    ------
    TimingError: no rate, however slow, keeps the limits at the samples.
    """
    nodes, weights = leggauss(SAMPLES)
    half = 0.5 * np.diff(clock.knots)[:, None]
    tau = (clock.knots[:-1, None] + half * (1.0 + nodes)).ravel()
    progress, spline = _spline_jet(clock.progress, tau), clock.squared_rate
    demands = demands_at(np.clip(progress[:, 0], 0.0, 1.0))
    rates = chained_rates(demands.drones, progress[:, None, None, :])
    most = demands.speed_bound / np.maximum(progress[:, 1], 1e-12) ** 2
    path, basis = ClockedPath(demands, *rates, most), SplineBasis.of(spline, tau)
    steady = np.full(basis.count, _steady_rate(path))
    near = -path.ratios(basis.at(spline.c))
    count = min(NEAREST, near.shape[-1])
    drones = np.argpartition(near, count - 1, axis=-1)[..., :count]
    for _ in range(DRONE_ROUNDS):
        program = RateProgram(basis, RateRows.of(path, drones), (half * weights).ravel())
        rate = fastest_rate(program, steady)
        ratios = path.ratios(basis.at(rate))
        if np.max(ratios) <= LIMIT_SHARE + TOLERANCE:
            break
        drones = np.concatenate([drones, np.argmax(ratios, axis=-1)[..., None]], axis=-1)
    # The stretch that follows slows all limits that are still broken.
    return Clock(clock.knots, clock.progress, BSpline(spline.t, rate, DEGREE))


def _steady_rate(path: ClockedPath) -> float:
    """Return a constant x inside of all limits: less than what they allow is inside as well."""
    rate, p = min(1.0, float(np.min(path.most))), np.zeros((3, len(path.most)))
    for _ in range(200):
        p[0] = rate
        if np.all(path.ratios(p) <= LIMIT_SHARE):
            return STEADY * rate
        rate *= 0.8
    raise TimingError("no constant speed along the path keeps the limits")


def _spline_jet(spline: BSpline, tau: Array) -> Array:
    return np.stack([spline(tau, order) for order in range(4)], axis=-1)


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

    def ratios(self, p: Array) -> Array:
        """Return (4, M, 2n): acceleration, jerk, thrust, tilt over their limits.

        Parameters
        ----------
        p: (3, M): x, x', x''.
        """
        limits, m = self.demands.limits, self.demands.team.mass[:, None]
        x, x1, x2 = p[..., None, None]
        a = x * self.second + 0.5 * x1 * self.first
        j = np.sqrt(x) * (x * self.third + 1.5 * x1 * self.second + 0.5 * x2 * self.first)
        f = m * a + self.demands.loads
        return np.stack(
            [
                length(a) / limits.acceleration,
                length(j) / limits.jerk,
                length(f) / self.demands.team.max_thrust,
                np.arctan2(np.hypot(f[..., 0], f[..., 1]), f[..., 2]) / limits.tilt,
            ]
        )


@dataclass(frozen=True, eq=False)
class RateRows:
    """R limits of motion as rows at each of M samples, which are the last index.

    With p = (x, x', x''), acceleration and √x-th part of the jerk are linear in p, so that every
    limit is a quadratic form of p and, for the jerk, of 1/x:

        pᵀ (Q - C) p + bᵀ p + c - e / x ≤ 0,   Q and C positive semidefinite, e ≥ 0.

    Without C and e it would be convex; they are of the tilt and of the jerk only.

    Attributes
    ----------
    Q, C: (3, 3, R, M)
    b: (3, R, M)
    c, e: (R, M)
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
        demands, limits, share = path.demands, path.demands.limits, LIMIT_SHARE**2
        samples = np.arange(len(path.most))[:, None]
        # (4, M, R', 3) each, then by p: (4, M, R', 3, 3)
        q1, q2, q3 = (each[samples, drones] for each in (path.first, path.second, path.third))
        accelerations = np.stack([q2, 0.5 * q1, 0.0 * q1], axis=-1)
        A = accelerations[0] / limits.acceleration
        J = np.stack([q3, 1.5 * q2, 0.5 * q1], axis=-1)[1] / limits.jerk
        loads, mass = demands.loads[samples, drones][2:], demands.team.mass[drones[2:]]
        scales = np.stack([demands.team.max_thrust[drones[2]], length(loads[1])])[..., None]
        F, G = (mass[..., None] / scales)[..., None] * accelerations[2:]
        thrust, pull = loads / scales
        slope = np.tan(LIMIT_SHARE * limits.tilt)
        rise, lift = slope * G[..., 2:, :], slope * pull[..., 2:]
        G, pull = G[..., :2, :], pull[..., :2]
        flat = np.zeros(A.shape[:2])
        none, full, zero = np.zeros((*flat.shape, 3)), flat + share, np.zeros(A.shape)
        speed = np.zeros((len(samples), 1, 3))
        speed[:, 0, 0] = 1.0 / path.most
        tilt = dot(pull, pull) - dot(lift, lift)
        rows = (
            (zero[:, :1], zero[:, :1], speed, flat[:, :1] - 1.0, flat[:, :1]),
            (_square(A), zero, none, -full, flat),
            (_square(J), zero, none, flat, full),
            (_square(F), zero, _double(F, thrust), dot(thrust, thrust) - share, flat),
            (_square(G), _square(rise), _double(G, pull) - _double(rise, lift), tilt, flat),
        )
        parts = (np.concatenate(part, axis=1) for part in zip(*rows, strict=True))
        return cls(*(np.ascontiguousarray(part.T) for part in parts))

    def values(self, p: Array) -> Array:
        """Return the rows' left sides (R, M) for p (3, M)."""
        along = np.einsum("ijrm,jm->irm", self.Q - self.C, p) + self.b
        values: Array = np.einsum("irm,im->rm", along, p) + self.c - self.e / p[0]
        return values

    def gradients(self, p: Array) -> Array:
        """Return their derivatives by p (3, R, M)."""
        gradients: Array = 2.0 * np.einsum("ijrm,jm->irm", self.Q - self.C, p) + self.b
        gradients[0] += self.e / p[0] ** 2
        return gradients

    def curvature(self, p: Array, weights: Array, *, convex: bool = False) -> Array:
        """Return the weighted sum (3, 3, M) of second derivatives, weights (R, M).

        Parameters
        ----------
        convex: leave out the concave parts.
        """
        forms = self.Q if convex else self.Q - self.C
        total: Array = 2.0 * np.einsum("rm,ijrm->ijm", weights, forms)
        if not convex:
            total[0, 0] -= 2.0 * np.sum(weights * self.e, axis=0) / p[0] ** 3
        return total


def _square(A: Array) -> Array:
    """Return AᵀA for A (…, d, 3)."""
    return np.swapaxes(A, -1, -2) @ A


def _double(A: Array, load: Array) -> Array:
    """Return 2 Aᵀ load for A (…, d, 3) and loads (…, d)."""
    double: Array = 2.0 * np.einsum("...ij,...i->...j", A, load)
    return double


DEGREE = 3

STEPS = 60
"""Largest number of Newton steps; some 15 are usual."""

GAP = 1e-5
"""Duality gap at which the search ends, as a share of the duration."""

LEAST = 1e-4
"""Least coefficient: keeps the rate above zero between the samples as well."""

INSIDE = 0.99
"""Largest share of the distance to the nearest bound that a step may take."""

SHRINK = 1e-3
"""Least share of a slack that every step leaves."""

BACKTRACK, SMALLEST = 0.7, 1e-8
"""Factor by which a step is shortened that breaks a row, and the share at which that ends."""

CENTRING = 0.1
"""Share of the gap that a step aims at."""


@dataclass(frozen=True, eq=False)
class SplineBasis:
    """A cubic spline and its first two derivatives at M samples: each sees four coefficients.

    Attributes
    ----------
    values: (3 M, count), from coefficients.
    products: (4 count, 9 M), from quadratic forms (3, 3, M) of the values to the lower band of
        their sum, by coefficients.
    """

    values: sp.csr_array[np.float64]
    products: sp.csr_array[np.float64]

    @classmethod
    def of(cls, spline: BSpline, at: Array) -> SplineBasis:
        """Return the basis of a spline at samples (M,) inside of it."""
        count, m = len(spline.c), np.arange(len(at))
        first = np.clip(np.searchsorted(spline.t, at, side="right") - 1, DEGREE, count - 1) - DEGREE
        columns = first + np.arange(DEGREE + 1)[:, None]  # (4, M)
        whole = BSpline(spline.t, np.eye(count), DEGREE)
        local = np.stack([whole(at, order)[m, columns] for order in range(3)])  # (3, 4, M)
        rows = np.broadcast_to(np.arange(3)[:, None, None] * len(m) + m, local.shape)
        places = rows.ravel(), np.broadcast_to(columns, local.shape).ravel()
        values = sp.csr_array((local.ravel(), places), shape=(3 * len(m), count))
        i, j = np.tril_indices(DEGREE + 1)
        pairs = local[:, None, i] * local[None, :, j]  # (3, 3, 10, M)
        band = np.broadcast_to((i - j)[:, None] * count + columns[j], pairs.shape)
        forms = np.broadcast_to(np.arange(9 * len(m)).reshape(3, 3, 1, -1), pairs.shape)
        places, shape = (band.ravel(), forms.ravel()), ((DEGREE + 1) * count, 9 * len(m))
        return cls(values, sp.csr_array((pairs.ravel(), places), shape=shape))

    @property
    def count(self) -> int:
        """Number of coefficients."""
        return int(self.values.shape[1])

    def at(self, coefficients: Array) -> Array:
        """Return value and derivatives (3, M)."""
        return np.asarray(self.values @ coefficients).reshape(3, -1)

    def transposed(self, forces: Array) -> Array:
        """Return the gradient by coefficients (count,) of that by value and derivatives (3, M)."""
        return np.asarray(self.values.T @ forces.ravel())

    def banded(self, forms: Array) -> Array:
        """Return the lower band (4, count) of what quadratic forms (3, 3, M) are together."""
        return np.asarray(self.products @ forms.ravel()).reshape(DEGREE + 1, self.count)


@dataclass(frozen=True, eq=False)
class RateProgram:
    """``min Σ w / √x`` over the coefficients of a cubic spline x, all rows below zero.

    Attributes
    ----------
    basis: of the spline at the samples.
    rows: at the samples.
    weights: (M,) [s], of the quadrature that gives the duration.
    """

    basis: SplineBasis
    rows: RateRows
    weights: Array

    def duration(self, p: Array) -> float:
        """Return Σ w / √x [s] for x and its derivatives p (3, M) at the samples."""
        return float(self.weights @ (1.0 / np.sqrt(p[0])))

    def slack(self, coefficients: Array) -> Array | None:
        """Return the slack (R · M + count,) of rows and coefficients; None if one is negative."""
        p, own = self.basis.at(coefficients), coefficients - LEAST
        if own.min() <= 0.0 or p[0].min() <= 0.0:
            return None
        slack = np.append(-self.rows.values(p).ravel(), own)
        return slack if slack.min() > 0.0 else None


def fastest_rate(program: RateProgram, start: Array) -> Array:
    """Return the coefficients of the fastest rate that is found from a start inside of all rows.

    A primal-dual interior-point method. Every row sees four neighbouring coefficients, so that
    Newton's matrix has seven diagonals: a step costs as much as looking at the rows. Every iterate
    satisfies all rows strictly, so the last one is a solution whatever ended the search. The start
    itself is returned where it is not inside.
    """
    slack = program.slack(start)
    if slack is None:
        return start
    c, basis, shape = start, program.basis, program.rows.c.shape
    force = CENTRING * program.duration(basis.at(c)) / len(slack) / slack
    for _ in range(STEPS):
        check_time()
        p, gap = basis.at(c), float(force @ slack)
        done = GAP * program.duration(p)
        gradients = program.rows.gradients(p)
        residual, factor = _newton(program, p, gradients, force, slack)
        if factor is None or (gap < done and np.abs(residual).max() < done):
            break
        # Towards products of slacks and forces that are all the same.
        pull = max(CENTRING * gap, 0.1 * done) / len(slack) / slack - force
        inner = pull[: program.rows.c.size].reshape(shape)
        pushed = basis.transposed(np.einsum("rm,irm->im", inner, gradients))
        dc: Array = dpbtrs(factor, pull[program.rows.c.size :] - residual - pushed, lower=True)[0]
        dslack = np.append(-np.einsum("irm,im->rm", gradients, basis.at(dc)).ravel(), dc)
        dforce = pull - force / slack * dslack
        share = _share(slack, dslack)
        left, least = program.slack(c + share * dc), SHRINK * slack
        while left is None or (left < least).any():
            share *= BACKTRACK
            if share < SMALLEST:
                return c
            left = program.slack(c + share * dc)
        c, slack = c + share * dc, left
        force = force + _share(force, dforce) * dforce
    return c


def _newton(
    program: RateProgram, p: Array, gradients: Array, force: Array, slack: Array
) -> tuple[Array, Array | None]:
    """Return the residual (count,) of forces at p (3, M), and the factor of Newton's matrix.

    By the convex part of the rows where the matrix is indefinite; None where there is no factor.
    """
    rows, shape, inner = program.rows, program.rows.c.shape, program.rows.c.size
    own, stiff = (each[:inner].reshape(shape) for each in (force, force / slack))
    pull = np.einsum("rm,irm->im", own, gradients)
    pull[0] -= 0.5 * program.weights * p[0] ** -1.5
    residual = program.basis.transposed(pull) - force[inner:]
    forms = np.einsum("irm,jrm->ijm", stiff * gradients, gradients)
    forms[0, 0] += 0.75 * program.weights * p[0] ** -2.5
    for convex in (False, True):
        band = program.basis.banded(forms + rows.curvature(p, own, convex=convex))
        band[0] += force[inner:] / slack[inner:]
        factor, failed = dpbtrf(band, lower=True)
        if not failed:
            return residual, factor
    return residual, None


def _share(values: Array, steps: Array) -> float:
    """Return how much of a step keeps the values above zero, at most all of it."""
    fastest = float((steps / values).min())
    return min(1.0, INSIDE / -fastest) if fastest < 0.0 else 1.0
