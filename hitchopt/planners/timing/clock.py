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
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline
from scipy.linalg.lapack import dpbtrf, dpbtrs

from hitchopt.errors import HitchoptError, check_time
from hitchopt.geometry.vectors import dot, length
from hitchopt.planners.morph.jets import chained, chained_rates, quintic_spline
from hitchopt.planners.timing.demands import LIMIT_SHARE, Demands
from hitchopt.planners.timing.profile import SpeedProfile
from hitchopt.values import Array, Indices

DemandsAt = Callable[[Array], Demands]
"""Demands of the path at given s."""

SAMPLES = 5
"""Number of samples per piece at which limits are evaluated."""

NEAREST = 2
"""Number of drones per sample and limit that are rows from the start."""

ROUNDS = 6
"""Maximum rounds of adding drones that break a limit."""

TOLERANCE = 0.2 * (1.0 - LIMIT_SHARE)
"""Relative tolerance of the limits; LIMIT_SHARE leaves more than this."""

STEADY = 0.97
"""Share of a squared rate at which limits bind from which the search starts: inside of them."""


class WarpError(HitchoptError):
    """The jerk-limited timing could not be found."""


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
        nodes, weights = gauss_points(8)
        h = np.diff(self.knots)
        tau = self.knots[:-1, None] + 0.5 * h[:, None] * (1.0 + nodes)
        steps = 0.5 * h * (1.0 / np.sqrt(self.squared_rate(tau)) @ weights)
        return np.append(0.0, np.cumsum(steps))

    def jets(self) -> Array:
        """Return (K + 1, 4): s and its derivatives by t at the knots."""
        return chained(
            _spline_jet(self.progress, self.knots), _rate_jet(self.squared_rate, self.knots)
        )


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
    WarpError: no rate, however slow, keeps the limits at the samples.
    """
    tau, weights = _samples(clock.knots)
    progress = _spline_jet(clock.progress, tau)
    path = _clocked(demands_at(np.clip(progress[:, 0], 0.0, 1.0)), progress)
    spline = clock.squared_rate
    basis = spline_basis(spline, tau)
    steady = np.full(len(spline.c), _steady_rate(path))
    drones = _nearest(path.ratios(*(spline(tau, order) for order in range(3))))
    for _ in range(ROUNDS):
        program = RateProgram(*basis, RateRows.of(path, drones), weights)
        rate = fastest_rate(program, steady)
        ratios = path.ratios(*program.at(rate).T)
        if np.max(ratios) <= LIMIT_SHARE + TOLERANCE:
            break
        worst = np.argmax(ratios, axis=-1)[..., None]
        drones = np.concatenate([drones, worst], axis=-1)
    # What is still broken is slowed by the stretch that follows.
    return Clock(clock.knots, clock.progress, BSpline(spline.t, rate, DEGREE))


def _clocked(demands: Demands, progress: Array) -> ClockedPath:
    """Return the path by τ at the samples, for the jets (M, 4) of s by τ there."""
    rates = chained_rates(demands.drones, progress[:, None, None, :])
    speed = np.maximum(progress[:, 1], 1e-12)
    most = demands.speed_bound / speed**2
    return ClockedPath(demands, *rates, most)


def _steady_rate(path: ClockedPath) -> float:
    """Return a constant x inside of all limits.

    Along constant x every limit allows a stretch from rest on, so less than allowed is inside.
    """
    rate = min(1.0, float(np.min(path.most)))
    ones = np.ones(len(path.most))
    for _ in range(200):
        if np.all(path.ratios(rate * ones, 0.0 * ones, 0.0 * ones) <= LIMIT_SHARE):
            return STEADY * rate
        rate *= 0.8
    raise WarpError("no constant speed along the path keeps the limits")


def _nearest(ratios: Array) -> NDArray[np.intp]:
    """Return (4, M, NEAREST): the drones that come nearest to each limit at each sample."""
    count = min(NEAREST, ratios.shape[-1])
    return np.argpartition(-ratios, count - 1, axis=-1)[..., :count]


def _samples(knots: Array) -> tuple[Array, Array]:
    """Return SAMPLES Gauss points of each piece, and their weights, (K · SAMPLES,) each."""
    nodes, weights = gauss_points(SAMPLES)
    half = 0.5 * np.diff(knots)[:, None]
    return (knots[:-1, None] + half * (1.0 + nodes)).ravel(), (half * weights).ravel()


@lru_cache
def gauss_points(count: int) -> tuple[Array, Array]:
    """Return the points (count,) in [-1, 1] of Gauss's quadrature and their weights."""
    points, weights = np.polynomial.legendre.leggauss(count)
    for values in (points, weights):
        values.setflags(write=False)
    return points, weights


def _spline_jet(spline: BSpline, tau: Array) -> Array:
    return np.stack([spline(tau, order) for order in range(4)], axis=-1)


def _rate_jet(spline: BSpline, tau: Array) -> Array:
    """Return the jet of τ(t): 0 (unused), √x, x'/2, x''√x/2."""
    x, x1, x2 = (spline(tau, order) for order in range(3))
    root = np.sqrt(x)
    return np.stack([np.zeros_like(x), root, 0.5 * x1, 0.5 * x2 * root], axis=-1)


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
    """R limits of motion as rows at each of M samples.

    With p = (x, x', x''), acceleration and √x-th part of the jerk are linear in p, so that every
    limit is a quadratic form of p and, for the jerk, of 1/x:

        pᵀ (Q - C) p + bᵀ p + c - e / x ≤ 0,   Q and C positive semidefinite, e ≥ 0.

    Without C and e it would be convex; they are of the tilt and of the jerk only. Arrays over
    samples have these next to one another in memory (Fortran's order): numpy's sums over the few
    other indices are then several times as fast.

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


DEGREE = 3

LOWER = np.tril_indices(DEGREE + 1)
"""Pairs of the coefficients that a sample sees, the first not before the second."""

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

LEAST_LEFT = 0.1
"""Least share of the gap after the predictor's step that sets the centring."""


@dataclass(frozen=True, eq=False)
class RateProgram:
    """``min Σ w / √x`` over the coefficients of a cubic spline x, all rows below zero.

    Attributes
    ----------
    first: (M,), the first of the four coefficients that a sample sees.
    values: (M, 3, 4), the spline's value and two derivatives at samples, by these.
    count: of the coefficients.
    rows: at the samples.
    weights: (M,) [s], of the quadrature that gives the duration.
    """

    first: Indices
    values: Array
    count: int
    rows: RateRows
    weights: Array

    @cached_property
    def seen(self) -> Indices:
        """(4, M): the coefficients that a sample sees."""
        return np.arange(DEGREE + 1)[:, None] + self.first

    @cached_property
    def places(self) -> Indices:
        """(10 M,): places in the flat band of the pairs of coefficients that a sample sees."""
        i, j = (index[:, None] for index in LOWER)
        return (self.count * (i - j) + j + self.first).ravel()

    @cached_property
    def products(self) -> Array:
        """(M, 10, 3, 3): products of values and derivatives of these pairs."""
        first, second = (self.values[..., index] for index in LOWER)
        return np.asfortranarray(np.einsum("mop,mqp->mpoq", first, second))

    def at(self, coefficients: Array) -> Array:
        """Return value and derivatives (M, 3)."""
        values: Array = np.einsum("moj,mj->mo", self.values, coefficients[self.seen].T)
        return values

    def transposed(self, forces: Array) -> Array:
        """Return what (M, 3) by value and derivatives is by coefficients (count,)."""
        local = np.einsum("mo,moj->mj", forces, self.values)
        return _sums(self.seen.ravel(), local.T.ravel(), self.count)

    def banded(self, forms: Array) -> Array:
        """Return the lower band (4, count) of what quadratic forms (M, 3, 3) are together."""
        local = np.einsum("mpoq,moq->mp", self.products, forms)
        band = _sums(self.places, local.T.ravel(), (DEGREE + 1) * self.count)
        return band.reshape(DEGREE + 1, self.count)

    def duration(self, p: Array) -> float:
        """Return Σ w / √x [s] for x and its derivatives p (M, 3) at the samples."""
        return float(self.weights @ (1.0 / np.sqrt(p[:, 0])))

    def slack(self, coefficients: Array) -> Array | None:
        """Return the slack (R · M + count,) of rows and coefficients; None if one is negative."""
        p = self.at(coefficients)
        own = coefficients - LEAST
        if own.min() <= 0.0 or p[:, 0].min() <= 0.0:
            return None
        slack = np.concatenate([-self.rows.values(p).T.ravel(), own])
        return slack if slack.min() > 0.0 else None


def spline_basis(spline: BSpline, at: Array) -> tuple[Indices, Array, int]:
    """Return ``first``, ``values`` and ``count`` of a cubic spline at samples (M,) inside of it."""
    count = len(spline.c)
    first = np.clip(np.searchsorted(spline.t, at, side="right") - 1, DEGREE, count - 1) - DEGREE
    whole, rows = BSpline(spline.t, np.eye(count), DEGREE), np.arange(len(at))[:, None]
    columns = first[:, None] + np.arange(DEGREE + 1)
    values = np.stack([whole(at, order)[rows, columns] for order in range(3)], axis=1)
    return first, np.asfortranarray(values), count


def _sums(places: Indices, values: Array, count: int) -> Array:
    """Return (count,): the sums of the values at each place."""
    return np.bincount(places, weights=values, minlength=count).astype(np.float64, copy=False)


def fastest_rate(program: RateProgram, start: Array) -> Array:
    """Return the coefficients of the fastest rate that is found from a start inside of all rows.

    A primal-dual interior-point method with a predictor, after Mehrotra. Every row sees four
    neighbouring coefficients, so that Newton's matrix has seven diagonals: a step costs as much as
    looking at the rows. Every iterate satisfies all rows strictly, so the last one is a solution
    whatever ended the search. The start itself is returned where it is not inside.
    """
    found = program.slack(start)
    if found is None:
        return start
    c, slack = start, found
    force = 0.1 * program.duration(program.at(c)) / len(slack) / slack
    for _ in range(STEPS):
        check_time()
        p = program.at(c)
        duration, gap = program.duration(p), float(force @ slack)
        gradients = program.rows.gradients(p)
        residual, factor = _newton(program, p, gradients, force, slack)
        if gap < GAP * duration and np.abs(residual).max() < GAP * duration:
            break
        if factor is None:
            break
        system = (program, gradients, residual, factor, force, slack)
        dc, dslack, dforce = _step(*system, aim=0.0)
        left = (slack + _share(slack, dslack) * dslack) @ (force + _share(force, dforce) * dforce)
        aim = max(gap * float(np.clip(left / gap, LEAST_LEFT, 1.0)) ** 3, 0.1 * GAP * duration)
        dc, dslack, dforce = _step(*system, aim=aim / len(slack))
        share = _share(slack, dslack)
        left_over, least = program.slack(c + share * dc), SHRINK * slack
        while left_over is None or (left_over < least).any():
            share *= BACKTRACK
            if share < SMALLEST:
                return c
            left_over = program.slack(c + share * dc)
        c, slack = c + share * dc, left_over
        force = force + _share(force, dforce) * dforce
    return c


def _newton(
    program: RateProgram, p: Array, gradients: Array, force: Array, slack: Array
) -> tuple[Array, Array | None]:
    """Return the residual (count,) of forces at p (M, 3), and the factor of Newton's matrix.

    By the convex part of the rows where the matrix is indefinite; None where there is no factor.

    Parameters
    ----------
    gradients: (M, R, 3), of the rows by value and derivatives of x.
    force, slack: (R · M + count,), of the rows, then of the coefficients.
    """
    rows, shape, inner = program.rows, program.rows.c.T.shape, program.rows.c.size
    own = force[:inner].reshape(shape).T
    stiff = (force[:inner] / slack[:inner]).reshape(shape).T
    pull = np.einsum("mr,mri->mi", own, gradients)
    pull[:, 0] -= 0.5 * program.weights * p[:, 0] ** -1.5
    residual = program.transposed(pull) - force[inner:]
    forms = np.einsum("mri,mrj->mij", stiff[..., None] * gradients, gradients)
    forms[:, 0, 0] += 0.75 * program.weights * p[:, 0] ** -2.5
    for convex in (False, True):
        band = program.banded(forms + rows.curvature(p, own, convex=convex))
        band[0] += force[inner:] / slack[inner:]
        factor, failed = dpbtrf(band, lower=True)
        if not failed:
            return residual, factor
    return residual, None


def _step(
    program: RateProgram,
    gradients: Array,
    residual: Array,
    factor: Array,
    force: Array,
    slack: Array,
    *,
    aim: float,
) -> tuple[Array, Array, Array]:
    """Return the steps of coefficients, slack and forces towards products of ``aim`` each."""
    shape = gradients.shape[1::-1]
    inner = shape[0] * shape[1]
    pull = aim / slack - force
    pushed = np.einsum("mr,mri->mi", pull[:inner].reshape(shape).T, gradients)
    dc: Array = dpbtrs(factor, pull[inner:] - residual - program.transposed(pushed), lower=True)[0]
    along = np.einsum("mri,mi->mr", gradients, program.at(dc))
    dslack = np.concatenate([-along.T.ravel(), dc])
    return dc, dslack, pull - force / slack * dslack


def _share(values: Array, steps: Array) -> float:
    """Return how much of a step keeps the values above zero, at most all of it."""
    fastest = float((steps / values).min())
    return min(1.0, INSIDE / -fastest) if fastest < 0.0 else 1.0
