"""Jerk-limited timing of a path, starting from its time-optimal profile.

The smoothed profile defines a first clock τ of the path. With another clock t and
``dτ/dt = √x(τ)`` every derivative with respect to t is linear in ``(x, x', x'')`` up to powers of
√x:

    q̇ = √x Q',   q̈ = x Q'' + ½ x' Q',   q⃛ = √x (x Q''' + 3/2 x' Q'' + ½ x'' Q'),

where Q is the path by τ. Debrouwere et al., "Time-optimal path following for robots with
convex-concave constraints using sequential convex programming", IEEE T-RO 29, 2013, use s for τ; a
clock that is at rest at both ends keeps x finite and positive there. The fastest x, a cubic spline,
solves a small nonlinear program whose size does not depend on n: its rows are those of the drones
nearest to their limits at each sample, and of drones that violate limits in earlier rounds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import ArrayLike

from hitchopt.errors import check_time
from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch.series import chained, chained_rates
from hitchopt.planners.timing.profile import LIMIT_SHARE, Demands, SpeedProfile, TimingError
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.splines import bspline, extraction, interpolated, knots_through
from hitchopt.values import Array, Indices

DemandsAt = Callable[[Array], Demands]
"""Function of path parameters s (J,), with the demands of the path there."""

SAMPLES = 5  # Number of samples per piece at which limits are evaluated
INITIAL_ROWS = 2  # Number of drones per sample and limit that have rows in the first round
MAX_ROW_ROUNDS = 6  # Maximum number of rounds of adding violated rows

LIMIT_TOLERANCE = 0.2 * (1.0 - LIMIT_SHARE)
"""Relative tolerance of the limits, within the reserve of LIMIT_SHARE."""

SQUARED_SHARE = LIMIT_SHARE**2  # Enforced fraction of squared limits

MIN_PROGRESS_RATE = 1e-12
"""[1/s] Smallest rate of the first clock by which bounds of speed are divided."""

MAX_RATE_STEPS = 200  # Maximum number of constant rates that are tried
RATE_FACTOR = 0.8  # Factor of a constant rate over the last one that was tried

INTERIOR_SHARE = 0.97
"""Squared rate of the initial guess over a feasible one, so that it is strictly feasible."""

NODES, WEIGHTS = leggauss(SAMPLES)
"""Gauss nodes in [-1, 1] of the samples in a piece, and their weights."""

INVERSION_SAMPLES = 1001  # Number of times between which those at path parameters are sought
INVERSION_STEPS = 2  # Number of Newton's steps to these times

TIME_SAMPLES = 8  # Number of samples per piece at which time is integrated

TIME_NODES, TIME_WEIGHTS = leggauss(TIME_SAMPLES)
"""Gauss nodes in [-1, 1] of these samples, and their weights."""


@dataclass(frozen=True, eq=False)
class Clock:
    """The path parameter s as a function of time t, through τ."""

    knots: Array  # (K + 1,) [s]: values of τ that bound the trajectory's pieces
    progress: PiecewisePolynomial  # s(τ), a quintic spline at rest at both ends
    squared_rate: PiecewisePolynomial  # x(τ), a cubic spline

    @property
    def breaks(self) -> Array:
        """(K + 1,) [s]: t at the knots."""
        tau = inside(self.knots, TIME_NODES)
        squared_rates = self.squared_rate.at(tau).reshape(-1, TIME_SAMPLES)
        half_steps = 0.5 * (self.knots[1:] - self.knots[:-1])
        durations = half_steps * (squared_rates**-0.5 @ TIME_WEIGHTS)
        return np.append(0.0, durations.cumsum())

    def jets(self) -> Array:
        """Return (K + 1, 4): s and its derivatives with respect to t at the knots."""
        x, x1, x2 = self.squared_rate.jet(self.knots, 3).T
        root = np.sqrt(x)
        by_t = np.stack([np.zeros_like(x), root, 0.5 * x1, 0.5 * x2 * root], axis=-1)  # of τ
        return chained(self.progress.jet(self.knots, 4), by_t)

    def times_at(self, s: Array) -> Array:
        """Return the times t (J,) [s] at which the path is at s (J,), all between 0 and 1."""
        progress = PiecewisePolynomial.through_jets(self.breaks, self.jets())
        t = np.linspace(0.0, progress.duration, INVERSION_SAMPLES)
        times = np.interp(s, progress.at(t), t)
        for _ in range(INVERSION_STEPS):
            times = times - (progress.at(times) - s) / progress.at(times, 1)
        return times


def inside(knots: Array, nodes: Array) -> Array:
    """Return the places (K · m,) of nodes (m,) in [-1, 1] within all pieces between knots."""
    half = 0.5 * (knots[1:] - knots[:-1])[:, None]
    return (knots[:-1, None] + half * (1.0 + nodes)).ravel()


def first_clock(profile: SpeedProfile, ramp: float, knots: Array) -> Clock:
    """Return the profile's moving average over ``ramp`` [s], with x = 1.

    The average turns jumps of the acceleration into ramps.
    """
    at_knots = profile.mean(knots, ramp)
    at_knots[0] = 0.0
    at_knots[-1] = 1.0
    progress = interpolated(knots, at_knots, zero_orders=(1, 2))
    return Clock(knots, progress, PiecewisePolynomial.constant(knots, 1.0))


def even_clock(duration: float, breaks: Array) -> Clock:
    """Return the clock of a path whose s is time: s = t / duration, with ``breaks`` of s."""
    whole = np.array([0.0, duration])
    progress = PiecewisePolynomial(whole, np.array([[0.0, 1.0]]))
    return Clock(duration * breaks, progress, PiecewisePolynomial.constant(whole, 1.0))


def jerk_limited(clock: Clock, demands_at: DemandsAt, jerk_shares: Array | None = None) -> Clock:
    """Return the fastest clock within all limits at the samples.

    ``jerk_shares`` (K,) are the shares of the limit of jerk that each piece may use; None for all
    of it.

    Raises
    ------
    TimingError: no constant rate satisfies the limits at the samples.
    """
    tau = inside(clock.knots, NODES)
    weights = (0.5 * (clock.knots[1:] - clock.knots[:-1])[:, None] * WEIGHTS).ravel()
    progress = clock.progress.jet(tau, 4)
    basis = SplineBasis.of(clock.knots, tau)
    shares = None if jerk_shares is None else np.repeat(jerk_shares, SAMPLES)
    path = ClockedPath.of(demands_at(progress[:, 0].clip(0.0, 1.0)), progress, shares)
    guess = np.full(basis.count, _feasible_rate(path))
    initial_ratios = path.ratios(basis.at(np.ones(basis.count)))
    count = min(INITIAL_ROWS, initial_ratios.shape[-1])
    drones = (-initial_ratios).argpartition(count - 1, axis=-1)[..., :count]
    for _ in range(MAX_ROW_ROUNDS):
        program = RateProgram(basis, RateRows.of(path, drones), weights)
        rate = fastest_rate(program, guess)
        ratios = path.ratios(basis.at(rate))
        if ratios.max() <= LIMIT_SHARE + LIMIT_TOLERANCE:
            break
        drones = np.concatenate([drones, ratios.argmax(axis=-1)[..., None]], axis=-1)
    # The caller stretches the flight to limits that are still violated.
    return Clock(clock.knots, clock.progress, bspline(basis.knots, rate, DEGREE))


def _feasible_rate(path: ClockedPath) -> float:
    """Return a constant, strictly feasible x; smaller values are feasible as well."""
    rate = min(1.0, float(np.min(path.rate_bound)))
    constant = np.zeros((3, len(path.rate_bound)))
    for _ in range(MAX_RATE_STEPS):
        constant[0] = rate
        if np.all(path.ratios(constant) <= LIMIT_SHARE):
            return INTERIOR_SHARE * rate
        rate *= RATE_FACTOR
    raise TimingError("no constant speed along the path keeps the limits")


@dataclass(frozen=True, eq=False)
class ClockedPath:
    """A path by a first clock τ, at M samples."""

    demands: Demands  # Demands of the path, by its own parameter
    first: Array  # (M, 2n, 3): the drones' first derivative with respect to τ
    second: Array  # (M, 2n, 3): the second one
    third: Array  # (M, 2n, 3): the third one
    rate_bound: Array  # (M,): upper bound of x by the speed limits
    largest_jerks: Array  # (M,) [m/s³]: limit of jerk

    @classmethod
    def of(cls, demands: Demands, progress: Array, jerk_shares: Array | None = None) -> ClockedPath:
        """Return a path at samples with demands, and jets of s by τ (M, 4).

        ``jerk_shares`` (M,) are the shares of the limit of jerk that may be used; None for all.
        """
        first, second, third = chained_rates(demands.drones, progress[:, None, None, :])
        bound = demands.speed_bound / np.maximum(progress[:, 1], MIN_PROGRESS_RATE) ** 2
        shares = np.ones(len(progress)) if jerk_shares is None else jerk_shares
        return cls(demands, first, second, third, bound, shares * demands.limits.jerk)

    def accelerations(self, drones: Indices) -> Array:
        """Return the accelerations (M, R', 3, 3) of drones (M, R'), by p = (x, x', x'')."""
        samples = np.arange(len(drones))[:, None]
        first = self.first[samples, drones]
        second = self.second[samples, drones]
        return np.stack([second, 0.5 * first, 0.0 * first], axis=-1)

    def jerks(self, drones: Indices) -> Array:
        """Return the jerks over √x (M, R', 3, 3) of drones (M, R'), by p = (x, x', x'')."""
        samples = np.arange(len(drones))[:, None]
        first = self.first[samples, drones]
        second = self.second[samples, drones]
        third = self.third[samples, drones]
        return np.stack([third, 1.5 * second, 0.5 * first], axis=-1)

    def loads(self, drones: Indices) -> Array:
        """Return the thrusts at rest (M, R', 3) [N] of drones (M, R')."""
        samples = np.arange(len(drones))[:, None]
        loads: Array = self.demands.loads[samples, drones]
        return loads

    def ratios(self, p: Array) -> Array:
        """Return (4, M, 2n): acceleration, jerk, thrust and tilt over their limits.

        Without loads these are the first two alone.

        Parameters
        ----------
        p: (3, M): x, x', x''.
        """
        limits = self.demands.limits
        team = self.demands.team
        x, x1, x2 = p[..., None, None]
        acceleration = x * self.second + 0.5 * x1 * self.first
        jerk_over_root = x * self.third + 1.5 * x1 * self.second + 0.5 * x2 * self.first
        jerk = np.sqrt(x) * jerk_over_root
        ratios = [
            length(acceleration) / limits.acceleration,
            length(jerk) / self.largest_jerks[:, None],
        ]
        if not self.demands.has_loads:
            return np.stack(ratios)
        thrust = team.mass[:, None] * acceleration + self.demands.loads
        tilt = np.arctan2(np.hypot(thrust[..., 0], thrust[..., 1]), thrust[..., 2])
        return np.stack([*ratios, length(thrust) / team.max_thrust, tilt / limits.tilt])


@dataclass(frozen=True, eq=False)
class RateRows:
    """R limits of motion as rows at each of M samples, the last index.

    Acceleration and jerk / √x are linear in p = (x, x', x''). Every limit is quadratic in p and,
    for the jerk, linear in 1/x:

        pᵀ (Q - C) p + bᵀ p + c - e / x ≤ 0,   Q and C positive semidefinite, e ≥ 0.

    Rows are convex except those of tilt, with C, and of jerk, with e.
    """

    forms: Array  # (3, 3, R, M): Q - C, the quadratic parts
    C: Array  # (3, 3, R, M): their concave parts
    b: Array  # (3, R, M): the linear parts
    c: Array  # (R, M): the constant parts
    e: Array  # (R, M): the factors of 1 / x

    @classmethod
    def of(cls, path: ClockedPath, drones: Indices) -> RateRows:
        """Return the rows of the speed and of some drones.

        Parameters
        ----------
        drones: (4, M, R'), those with rows of acceleration, jerk, thrust and tilt; without loads
            (2, M, R').
        """
        rows_of = (_acceleration_rows, _jerk_rows, _thrust_rows, _tilt_rows)[: len(drones)]
        of_drones = [rows(path, nearest) for rows, nearest in zip(rows_of, drones, strict=True)]
        limits = [_speed_rows(path), *of_drones]
        all_parts = (np.concatenate(parts, axis=1) for parts in zip(*limits, strict=True))
        Q, C, b, c, e = (np.ascontiguousarray(part.T) for part in all_parts)
        return cls(Q - C, C, b, c, e)

    def at(self, p: Array) -> tuple[Array, Array]:
        """Return the rows' left sides (R, M) and their derivatives by p (3, R, M) for p (3, M)."""
        form_times_p = np.sum(self.forms * p[:, None], axis=1)
        inverse = self.e / p[0]
        values = np.sum((form_times_p + self.b) * p[:, None], axis=0) + self.c - inverse
        gradients = 2.0 * form_times_p + self.b
        gradients[0] += inverse / p[0]
        return values, gradients

    def curvature(self, p: Array, weights: Array, *, convex: bool = False) -> Array:
        """Return the weighted sum (3, 3, M) of second derivatives, weights (R, M).

        Parameters
        ----------
        convex: whether to omit the concave parts.
        """
        forms = self.forms + self.C if convex else self.forms
        total: Array = 2.0 * np.sum(forms * weights, axis=2)
        if not convex:
            total[0, 0] -= 2.0 * np.sum(weights * self.e, axis=0) / p[0] ** 3
        return total


class LimitRows(NamedTuple):
    """Rows of one limit, of R' drones at each of M samples, in the form of ``RateRows``."""

    Q: Array  # (M, R', 3, 3): the convex quadratic parts
    C: Array  # (M, R', 3, 3): the concave quadratic parts
    b: Array  # (M, R', 3): the linear parts
    c: Array  # (M, R'): the constant parts
    e: Array  # (M, R'): the factors of 1 / x

    @classmethod
    def of(
        cls,
        shape: tuple[int, int],
        Q: ArrayLike = 0.0,
        C: ArrayLike = 0.0,
        b: ArrayLike = 0.0,
        c: ArrayLike = 0.0,
        e: ArrayLike = 0.0,
    ) -> LimitRows:
        """Return rows of a shape (M, R'), whose parts are zero if they are omitted."""
        return cls(
            np.broadcast_to(Q, (*shape, 3, 3)),
            np.broadcast_to(C, (*shape, 3, 3)),
            np.broadcast_to(b, (*shape, 3)),
            np.broadcast_to(c, shape),
            np.broadcast_to(e, shape),
        )


def _speed_rows(path: ClockedPath) -> LimitRows:
    """Return the row of x at each sample, over its bound by the speed limits."""
    linear = np.zeros((len(path.rate_bound), 1, 3))
    linear[:, 0, 0] = 1.0 / path.rate_bound
    return LimitRows.of((len(path.rate_bound), 1), b=linear, c=-1.0)


def _acceleration_rows(path: ClockedPath, drones: Indices) -> LimitRows:
    """Return the rows of squared accelerations of drones (M, R') over their limit."""
    ratios = path.accelerations(drones) / path.demands.limits.acceleration
    return LimitRows.of(drones.shape, Q=_square(ratios), c=-SQUARED_SHARE)


def _jerk_rows(path: ClockedPath, drones: Indices) -> LimitRows:
    """Return the rows of squared jerks over x of drones (M, R') over their limit."""
    ratios = path.jerks(drones) / path.largest_jerks[:, None, None, None]
    return LimitRows.of(drones.shape, Q=_square(ratios), e=SQUARED_SHARE)


def _thrust_rows(path: ClockedPath, drones: Indices) -> LimitRows:
    """Return the rows of squared thrusts of drones (M, R') over their limits."""
    team = path.demands.team
    max_thrust = team.max_thrust[drones][..., None]
    mass = team.mass[drones][..., None]
    ratios = (mass / max_thrust)[..., None] * path.accelerations(drones)
    ratios_at_rest = path.loads(drones) / max_thrust
    return LimitRows.of(
        drones.shape,
        Q=_square(ratios),
        b=_double(ratios, ratios_at_rest),
        c=dot(ratios_at_rest, ratios_at_rest) - SQUARED_SHARE,
    )


def _tilt_rows(path: ClockedPath, drones: Indices) -> LimitRows:
    """Return the rows of the tilt of drones (M, R').

    The level part of the thrust is at most the tangent of the tilt times the upward part. Thrusts
    are over those at rest.
    """
    demands = path.demands
    loads = path.loads(drones)
    scale = length(loads)[..., None]
    mass = demands.team.mass[drones][..., None]
    thrust = (mass / scale)[..., None] * path.accelerations(drones)
    thrust_at_rest = loads / scale
    tangent = np.tan(LIMIT_SHARE * demands.limits.tilt)
    level = thrust[..., :2, :]
    level_at_rest = thrust_at_rest[..., :2]
    upward = tangent * thrust[..., 2:, :]
    upward_at_rest = tangent * thrust_at_rest[..., 2:]
    return LimitRows.of(
        drones.shape,
        Q=_square(level),
        C=_square(upward),
        b=_double(level, level_at_rest) - _double(upward, upward_at_rest),
        c=dot(level_at_rest, level_at_rest) - dot(upward_at_rest, upward_at_rest),
    )


def _square(A: Array) -> Array:
    """Return AᵀA for A (…, d, 3)."""
    return np.swapaxes(A, -1, -2) @ A


def _double(A: Array, load: Array) -> Array:
    """Return 2 Aᵀ load for A (…, d, 3) and loads (…, d)."""
    double: Array = 2.0 * (load[..., None, :] @ A)[..., 0, :]
    return double


DEGREE = 3  # Degree of the spline x
MAX_NEWTON_STEPS = 60  # Maximum number of Newton steps; 15 are typical
GAP_TOLERANCE = 1e-5  # Duality gap at which the search ends, over the duration

MIN_COEFFICIENT = 1e-4
"""Lower bound of coefficients, which keeps the rate positive between the samples."""

BOUNDARY_SHARE = 0.99  # Largest step over the distance to the nearest bound
MIN_SLACK_SHARE = 1e-3  # Smallest slack after a step, over that before
BACKTRACK_FACTOR = 0.7  # Factor that shortens steps that violate a row
MIN_STEP_SHARE = 1e-8  # Fraction of a step at which the search ends
CENTRING = 0.1  # Target of the duality gap in a step, over the current gap


@dataclass(frozen=True, eq=False)
class SplineBasis:
    """A cubic spline and its first two derivatives at M samples; each has four coefficients."""

    knots: Array  # (count + DEGREE + 1,): knots of the spline
    columns: Indices  # (4, M): coefficients at each sample
    local: Array  # (3, 4, M): value and derivatives of their B-splines
    pairs: Array  # (9, 10, M): products of these, of the lower triangle of pairs of coefficients
    band: Indices  # (10, M): index of such pairs in a lower band (4, count)

    @classmethod
    def of(cls, places: Array, at: Array) -> SplineBasis:
        """Return the basis of a spline through values at parameters (K + 1,), at samples (M,)."""
        knots = knots_through(places, DEGREE)
        breaks, columns_of_piece, maps = extraction(knots, DEGREE)
        piece = breaks[1:-1].searchsorted(at, side="right")
        durations = breaks[piece + 1] - breaks[piece]
        jets = bernstein.jet_basis((at - breaks[piece]) / durations, DEGREE, 3)
        jets /= durations[:, None, None] ** np.arange(3)
        local = np.ascontiguousarray((jets.swapaxes(1, 2) @ maps[piece]).transpose(1, 2, 0))
        columns = np.ascontiguousarray(columns_of_piece[piece].T)
        # Pairs of coefficients i ≥ j are in row i - j and column j of the band
        i, j = np.tril_indices(DEGREE + 1)
        pairs = (local[:, None, i] * local[None, :, j]).reshape(9, len(i), -1)
        count = len(knots) - DEGREE - 1
        band = (i - j)[:, None] * count + columns[j]
        return cls(knots, columns, local, pairs, band)

    @property
    def count(self) -> int:
        """Number of coefficients."""
        return len(self.knots) - DEGREE - 1

    def at(self, coefficients: Array) -> Array:
        """Return value and derivatives (3, M)."""
        values: Array = np.sum(self.local * coefficients[self.columns], axis=1)
        return values

    def transposed(self, gradient: Array) -> Array:
        """Return the gradient by coefficients (count,) from that by the values (3, M)."""
        shares = np.sum(self.local * gradient[:, None], axis=0)
        total = np.bincount(self.columns.ravel(), shares.ravel(), self.count)
        return np.asarray(total, dtype=np.float64)

    def banded(self, forms: Array) -> Array:
        """Return the lower band (4, count) of the sum of quadratic forms (3, 3, M) of values."""
        shares = np.sum(self.pairs * forms.reshape(9, 1, -1), axis=0)
        band = np.bincount(self.band.ravel(), shares.ravel(), (DEGREE + 1) * self.count)
        return np.asarray(band, dtype=np.float64).reshape(DEGREE + 1, -1)


class RatePoint(NamedTuple):
    """A strictly feasible point of a ``RateProgram``."""

    p: Array  # (3, M): x and its derivatives at the samples
    gradients: Array  # (3, R, M): derivatives of the rows by p
    slack: Array  # (R · M + count,): slacks of rows, then of coefficients


@dataclass(frozen=True, eq=False)
class RateProgram:
    """The program ``min Σ w / √x`` over coefficients of a cubic spline x, all rows below zero."""

    basis: SplineBasis  # The spline at the samples
    rows: RateRows  # The rows at the samples
    weights: Array  # (M,) [s]: weights of the duration's quadrature

    def duration(self, p: Array) -> float:
        """Return Σ w / √x [s] for x and its derivatives p (3, M) at the samples."""
        return float(self.weights @ (1.0 / np.sqrt(p[0])))

    def at(self, coefficients: Array) -> RatePoint | None:
        """Return the point of coefficients (count,), or None if it is not strictly feasible."""
        p = self.basis.at(coefficients)
        coefficient_slack = coefficients - MIN_COEFFICIENT
        if np.min(coefficient_slack) <= 0.0 or np.min(p[0]) <= 0.0:
            return None
        values, gradients = self.rows.at(p)
        slack = np.concatenate([-values.ravel(), coefficient_slack])
        return RatePoint(p, gradients, slack) if np.min(slack) > 0.0 else None


def fastest_rate(program: RateProgram, guess: Array) -> Array:
    """Return the coefficients of the fastest rate, by a primal-dual interior-point method.

    Rows have four neighbouring coefficients, so that Newton's matrix has seven diagonals and a step
    is linear in the number of rows. All iterates are strictly feasible, and the last one is
    returned. A guess that is not strictly feasible is returned unchanged.
    """
    from scipy.linalg.lapack import dpbtrs

    point = program.at(guess)
    if point is None:
        return guess
    coefficients = guess
    basis = program.basis
    shape = program.rows.c.shape
    size = program.rows.c.size
    dual = CENTRING * program.duration(point.p) / len(point.slack) / point.slack
    for _ in range(MAX_NEWTON_STEPS):
        check_time()
        slack = point.slack
        gap = float(dual @ slack)
        tolerance = GAP_TOLERANCE * program.duration(point.p)
        newton = _newton_system(program, point, dual)
        is_optimal = gap < tolerance and np.max(np.abs(newton.residual)) < tolerance
        if newton.factor is None or is_optimal:
            break
        # Toward equal products of slacks and duals
        dual_change = max(CENTRING * gap, 0.1 * tolerance) / len(slack) / slack - dual
        of_rows = np.sum(dual_change[:size].reshape(shape) * point.gradients, axis=1)
        right_side = dual_change[size:] - newton.residual - basis.transposed(of_rows)
        step: Array = dpbtrs(newton.factor, right_side, lower=True)[0]
        row_step = np.sum(point.gradients * basis.at(step)[:, None], axis=0)
        slack_step = np.concatenate([-row_step.ravel(), step])
        dual_step = dual_change - dual / slack * slack_step
        share = _step_share(slack, slack_step)
        moved = _feasible_step(program, coefficients, step, share, MIN_SLACK_SHARE * slack)
        if moved is None:
            break
        coefficients, point = moved
        dual = dual + _step_share(dual, dual_step) * dual_step
    return coefficients


def _feasible_step(
    program: RateProgram, coefficients: Array, step: Array, share: float, min_slack: Array
) -> tuple[Array, RatePoint] | None:
    """Return the coefficients after a feasible part of a step, and their point; None if it is tiny.

    The part is at most ``share``, and leaves every slack at least ``min_slack``.
    """
    while True:
        moved = coefficients + share * step
        point = program.at(moved)
        if point is not None and not np.any(point.slack < min_slack):
            return moved, point
        share *= BACKTRACK_FACTOR
        if share < MIN_STEP_SHARE:
            return None


class NewtonSystem(NamedTuple):
    """Newton's equations of a ``RateProgram`` at a point."""

    residual: Array  # (count,): gradient of the Lagrangian by the coefficients
    # (4, count): Cholesky factor of the matrix, a lower band; None if it is not definite
    factor: Array | None


def _newton_system(program: RateProgram, point: RatePoint, dual: Array) -> NewtonSystem:
    """Return Newton's equations; an indefinite matrix is replaced by that of convex parts."""
    from scipy.linalg.lapack import dpbtrf

    rows = program.rows
    shape = rows.c.shape
    size = rows.c.size
    p = point.p
    row_dual = dual[:size].reshape(shape)
    stiffness = (dual[:size] / point.slack[:size]).reshape(shape)
    gradient = np.sum(row_dual * point.gradients, axis=1)
    gradient[0] -= 0.5 * program.weights * p[0] ** -1.5
    residual = program.basis.transposed(gradient) - dual[size:]
    forms = np.sum((stiffness * point.gradients)[:, None] * point.gradients, axis=2)
    forms[0, 0] += 0.75 * program.weights * p[0] ** -2.5
    for convex in (False, True):
        band = program.basis.banded(forms + rows.curvature(p, row_dual, convex=convex))
        band[0] += dual[size:] / point.slack[size:]
        factor, failed = dpbtrf(band, lower=True)
        if not failed:
            return NewtonSystem(residual, factor)
    return NewtonSystem(residual, None)


def _step_share(values: Array, steps: Array) -> float:
    """Return the fraction of steps, at most 1, that keeps positive values positive."""
    fastest_decrease = float(np.min(steps / values))
    if fastest_decrease >= 0.0:
        return 1.0
    return min(1.0, BOUNDARY_SHARE / -fastest_decrease)
