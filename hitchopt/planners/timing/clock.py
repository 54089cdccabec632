"""Jerk-limited timing of a path, starting from its time-optimal profile.

The smoothed profile defines a first clock τ of the path. With another clock t and
``dτ/dt = √x(τ)`` every derivative by t is linear in ``(x, x', x'')`` up to powers of √x:

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

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.linalg.lapack import dpbtrf, dpbtrs

from hitchopt.errors import check_time
from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch.series import chained, chained_rates
from hitchopt.planners.timing.profile import LIMIT_SHARE, Demands, SpeedProfile, TimingError
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.splines import bspline, extraction, interpolated, knots_through
from hitchopt.values import Array, Indices

DemandsAt = Callable[[Array], Demands]  # Function from path parameters s to the path's demands
SAMPLES = 5
"""Number of samples per piece at which limits are evaluated."""

INITIAL_ROWS = 2
"""Number of drones per sample and limit that have rows in the first round."""

MAX_ROW_ROUNDS = 6
"""Maximum number of rounds of adding violated rows."""

LIMIT_TOLERANCE = 0.2 * (1.0 - LIMIT_SHARE)
"""Relative tolerance of the limits, within the reserve of LIMIT_SHARE."""

MIN_PROGRESS_RATE = 1e-12
"""[1/s] Smallest rate of the first clock by which bounds of speed are divided."""

MAX_RATE_STEPS = 200
"""Maximum number of constant rates that are tried."""

RATE_FACTOR = 0.8
"""Factor of a constant rate over the last one that was tried."""

INTERIOR_SHARE = 0.97
"""Squared rate of the initial guess over a feasible one, so that it is strictly feasible."""

NODES, WEIGHTS = leggauss(SAMPLES)
"""Gauss nodes in [-1, 1] of the samples in a piece, and their weights."""

TIME_NODES, TIME_WEIGHTS = leggauss(8)
"""Gauss nodes and weights of the integrals of time over pieces."""


def _inside(knots: Array, nodes: Array) -> Array:
    """Return the places (K · m,) of nodes (m,) in [-1, 1] within all pieces between knots."""
    half = 0.5 * (knots[1:] - knots[:-1])[:, None]
    return (knots[:-1, None] + half * (1.0 + nodes)).ravel()


@dataclass(frozen=True, eq=False)
class Clock:
    """The path parameter s as a function of time t, through τ."""

    knots: Array
    """(K + 1,) [s]: values of τ that bound the trajectory's pieces."""

    progress: PiecewisePolynomial
    """s(τ), a quintic spline at rest at both ends."""

    squared_rate: PiecewisePolynomial
    """x(τ), a cubic spline."""

    @property
    def breaks(self) -> Array:
        """(K + 1,) [s]: t at the knots."""
        rate = self.squared_rate.at(_inside(self.knots, TIME_NODES)).reshape(-1, len(TIME_NODES))
        steps = 0.5 * (self.knots[1:] - self.knots[:-1]) * (rate**-0.5 @ TIME_WEIGHTS)
        return np.append(0.0, steps.cumsum())

    def jets(self) -> Array:
        """Return (K + 1, 4): s and its derivatives by t at the knots."""
        x, x1, x2 = self.squared_rate.jet(self.knots, 3).T
        root = np.sqrt(x)
        by_t = np.stack([np.zeros_like(x), root, 0.5 * x1, 0.5 * x2 * root], axis=-1)  # of τ
        return chained(self.progress.jet(self.knots, 4), by_t)


def first_clock(profile: SpeedProfile, ramp: float, knots: Array) -> Clock:
    """Return the profile's moving average over ``ramp`` [s], with x = 1.

    The average turns jumps of the acceleration into ramps.
    """
    at_knots = profile.mean(knots, ramp)
    at_knots[0], at_knots[-1] = 0.0, 1.0
    progress = interpolated(knots, at_knots, zero_orders=(1, 2))
    return Clock(knots, progress, PiecewisePolynomial.constant(knots, 1.0))


def jerk_limited(clock: Clock, demands_at: DemandsAt) -> Clock:
    """Return the fastest clock within all limits at the samples.

    Raises
    ------
    TimingError: no constant rate satisfies the limits at the samples.
    """
    tau = _inside(clock.knots, NODES)
    weights = (0.5 * (clock.knots[1:] - clock.knots[:-1])[:, None] * WEIGHTS).ravel()
    progress = clock.progress.jet(tau, 4)
    basis = SplineBasis.of(clock.knots, tau)
    demands = demands_at(progress[:, 0].clip(0.0, 1.0))
    first, second, third = chained_rates(demands.drones, progress[:, None, None, :])
    bound = demands.speed_bound / np.maximum(progress[:, 1], MIN_PROGRESS_RATE) ** 2
    path = ClockedPath(demands, first, second, third, bound)
    guess = np.full(basis.count, _feasible_rate(path))
    ratios = -path.ratios(basis.at(np.ones(basis.count)))
    count = min(INITIAL_ROWS, ratios.shape[-1])
    drones = ratios.argpartition(count - 1, axis=-1)[..., :count]
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

    demands: Demands
    """Demands of the path, by its own parameter."""

    first: Array
    """(M, 2n, 3): the drones' first derivative by τ."""

    second: Array
    """(M, 2n, 3): the second one."""

    third: Array
    """(M, 2n, 3): the third one."""

    rate_bound: Array
    """(M,): upper bound of x by the speed limits."""

    def ratios(self, p: Array) -> Array:
        """Return (4, M, 2n): acceleration, jerk, thrust and tilt over their limits.

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
        thrust = team.mass[:, None] * acceleration + self.demands.loads
        tilt = np.arctan2(np.hypot(thrust[..., 0], thrust[..., 1]), thrust[..., 2])
        return np.stack(
            [
                length(acceleration) / limits.acceleration,
                length(jerk) / limits.jerk,
                length(thrust) / team.max_thrust,
                tilt / limits.tilt,
            ]
        )


@dataclass(frozen=True, eq=False)
class RateRows:
    """R limits of motion as rows at each of M samples, the last index.

    Acceleration and jerk / √x are linear in p = (x, x', x''). Every limit is quadratic in p and,
    for the jerk, linear in 1/x:

        pᵀ (Q - C) p + bᵀ p + c - e / x ≤ 0,   Q and C positive semidefinite, e ≥ 0.

    Rows are convex except those of tilt, with C, and of jerk, with e.
    """

    forms: Array
    """(3, 3, R, M): Q - C, the quadratic parts."""

    C: Array
    """(3, 3, R, M): their concave parts."""

    b: Array
    """(3, R, M): the linear parts."""

    c: Array
    """(R, M): the constant parts."""

    e: Array
    """(R, M): the factors of 1 / x."""

    @classmethod
    def of(cls, path: ClockedPath, drones: Indices) -> RateRows:
        """Return the rows of the speed and of some drones.

        Parameters
        ----------
        drones: (4, M, R'), those with rows of acceleration, jerk, thrust and tilt.
        """
        demands = path.demands
        limits = demands.limits
        team = demands.team
        share = LIMIT_SHARE**2
        samples = np.arange(len(path.rate_bound))[:, None]
        # Derivatives of drones by the path parameter (4, M, R', 3)
        first = path.first[samples, drones]
        second = path.second[samples, drones]
        third = path.third[samples, drones]
        # Accelerations and jerks / √x, by p (4, M, R', 3, 3)
        accelerations = np.stack([second, 0.5 * first, 0.0 * first], axis=-1)
        jerks = np.stack([third, 1.5 * second, 0.5 * first], axis=-1)
        acceleration = accelerations[0] / limits.acceleration
        jerk = jerks[1] / limits.jerk
        # Forces by p and at rest: of thrust over its limit, of tilt over the force at rest
        loads = demands.loads[samples, drones]
        mass = team.mass[drones]
        thrust_scale = team.max_thrust[drones[2]][..., None]
        thrust = (mass[2, ..., None] / thrust_scale)[..., None] * accelerations[2]
        thrust_at_rest = loads[2] / thrust_scale
        tilt_scale = length(loads[3])[..., None]
        pull = (mass[3, ..., None] / tilt_scale)[..., None] * accelerations[3]
        pull_at_rest = loads[3] / tilt_scale
        # Tilt: level forces are at most ``slope`` times the upward one
        slope = np.tan(LIMIT_SHARE * limits.tilt)
        level = pull[..., :2, :]
        level_at_rest = pull_at_rest[..., :2]
        upward = slope * pull[..., 2:, :]
        upward_at_rest = slope * pull_at_rest[..., 2:]
        tilt_at_rest = dot(level_at_rest, level_at_rest) - dot(upward_at_rest, upward_at_rest)
        tilt_slope = _double(level, level_at_rest) - _double(upward, upward_at_rest)
        speed = np.zeros((len(samples), 1, 3))
        speed[:, 0, 0] = 1.0 / path.rate_bound

        no_matrix = np.zeros(acceleration.shape)
        no_number = np.zeros(no_matrix.shape[:2])
        no_vector = np.zeros((*no_number.shape, 3))
        shares = no_number + share
        thrust_bound = dot(thrust_at_rest, thrust_at_rest) - share
        rows = (  # Q, C, b, c and e of speed, acceleration, jerk, thrust and tilt
            (no_matrix[:, :1], no_matrix[:, :1], speed, no_number[:, :1] - 1.0, no_number[:, :1]),
            (_square(acceleration), no_matrix, no_vector, -shares, no_number),
            (_square(jerk), no_matrix, no_vector, no_number, shares),
            (_square(thrust), no_matrix, _double(thrust, thrust_at_rest), thrust_bound, no_number),
            (_square(level), _square(upward), tilt_slope, tilt_at_rest, no_number),
        )
        parts = (np.concatenate(part, axis=1).T for part in zip(*rows, strict=True))
        Q, C, b, c, e = (np.ascontiguousarray(part) for part in parts)
        return cls(Q - C, C, b, c, e)

    def at(self, p: Array) -> tuple[Array, Array]:
        """Return the rows' left sides (R, M) and their derivatives by p (3, R, M) for p (3, M)."""
        form_times_p = np.add.reduce(self.forms * p[:, None], axis=1)
        inverse = self.e / p[0]
        values = np.add.reduce((form_times_p + self.b) * p[:, None], axis=0) + self.c - inverse
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
        total: Array = 2.0 * np.add.reduce(forms * weights, axis=2)
        if not convex:
            total[0, 0] -= 2.0 * np.add.reduce(weights * self.e, axis=0) / p[0] ** 3
        return total


def _square(A: Array) -> Array:
    """Return AᵀA for A (…, d, 3)."""
    return np.swapaxes(A, -1, -2) @ A


def _double(A: Array, load: Array) -> Array:
    """Return 2 Aᵀ load for A (…, d, 3) and loads (…, d)."""
    double: Array = 2.0 * (load[..., None, :] @ A)[..., 0, :]
    return double


DEGREE = 3
"""Degree of the spline x."""

MAX_NEWTON_STEPS = 60
"""Maximum number of Newton steps; 15 are typical."""

GAP_TOLERANCE = 1e-5
"""Duality gap at which the search ends, over the duration."""

MIN_COEFFICIENT = 1e-4
"""Lower bound of coefficients, which keeps the rate positive between the samples."""

BOUNDARY_SHARE = 0.99
"""Largest step over the distance to the nearest bound."""

MIN_SLACK_SHARE = 1e-3
"""Smallest slack after a step, over that before."""

BACKTRACK_FACTOR = 0.7
"""Factor that shortens steps that violate a row."""

MIN_STEP_SHARE = 1e-8
"""Fraction of a step at which the search ends."""

CENTRING = 0.1
"""Target of the duality gap in a step, over the current gap."""


@dataclass(frozen=True, eq=False)
class SplineBasis:
    """A cubic spline and its first two derivatives at M samples; each has four coefficients."""

    knots: Array
    """(count + DEGREE + 1,): knots of the spline."""

    columns: Indices
    """(4, M): coefficients at each sample."""

    local: Array
    """(3, 4, M): value and derivatives of their B-splines."""

    pairs: Array
    """(9, 10, M): products of these, of the lower triangle of pairs of coefficients."""

    band: Indices
    """(10, M): index of such pairs in a lower band (4, count)."""

    @classmethod
    def of(cls, places: Array, at: Array) -> SplineBasis:
        """Return the basis of a spline through values at places (K + 1,), at samples (M,)."""
        knots = knots_through(places, DEGREE)
        breaks, columns, maps = extraction(knots, DEGREE)
        piece = breaks[1:-1].searchsorted(at, side="right")
        h = breaks[piece + 1] - breaks[piece]
        jets = bernstein.jet_basis((at - breaks[piece]) / h, DEGREE, 3)
        jets /= h[:, None, None] ** np.arange(3)
        local = np.ascontiguousarray((jets.swapaxes(1, 2) @ maps[piece]).transpose(1, 2, 0))
        index = np.ascontiguousarray(columns[piece].T)
        i, j = np.tril_indices(DEGREE + 1)
        pairs = (local[:, None, i] * local[None, :, j]).reshape(9, len(i), -1)
        count = len(knots) - DEGREE - 1
        return cls(knots, index, local, pairs, (i - j)[:, None] * count + index[j])

    @property
    def count(self) -> int:
        """Number of coefficients."""
        return len(self.knots) - DEGREE - 1

    def at(self, coefficients: Array) -> Array:
        """Return value and derivatives (3, M)."""
        values: Array = np.add.reduce(self.local * coefficients[self.columns], axis=1)
        return values

    def transposed(self, gradient: Array) -> Array:
        """Return the gradient by coefficients (count,) from that by the values (3, M)."""
        shares = np.add.reduce(self.local * gradient[:, None], axis=0)
        total = np.bincount(self.columns.ravel(), shares.ravel(), self.count)
        return np.asarray(total, dtype=np.float64)

    def banded(self, forms: Array) -> Array:
        """Return the lower band (4, count) of the sum of quadratic forms (3, 3, M) of values."""
        shares = np.add.reduce(self.pairs * forms.reshape(9, 1, -1), axis=0)
        band = np.bincount(self.band.ravel(), shares.ravel(), (DEGREE + 1) * self.count)
        return np.asarray(band, dtype=np.float64).reshape(DEGREE + 1, -1)


@dataclass(frozen=True, eq=False)
class RateProgram:
    """The program ``min Σ w / √x`` over coefficients of a cubic spline x, all rows below zero."""

    basis: SplineBasis
    """The spline at the samples."""

    rows: RateRows
    """The rows at the samples."""

    weights: Array
    """(M,) [s]: weights of the duration's quadrature."""

    def duration(self, p: Array) -> float:
        """Return Σ w / √x [s] for x and its derivatives p (3, M) at the samples."""
        return float(self.weights @ (1.0 / np.sqrt(p[0])))

    def at(self, coefficients: Array) -> tuple[Array, Array, Array] | None:
        """Return p (3, M), the rows' derivatives by it, and the slack of rows and coefficients.

        The slack is (R · M + count,); the result is None if one is negative.
        """
        p = self.basis.at(coefficients)
        coefficient_slack = coefficients - MIN_COEFFICIENT
        if np.minimum.reduce(coefficient_slack) <= 0.0 or np.minimum.reduce(p[0]) <= 0.0:
            return None
        values, gradients = self.rows.at(p)
        slack = np.concatenate([-values.ravel(), coefficient_slack])
        return (p, gradients, slack) if np.minimum.reduce(slack) > 0.0 else None


def fastest_rate(program: RateProgram, guess: Array) -> Array:
    """Return the coefficients of the fastest rate, by a primal-dual interior-point method.

    Rows have four neighbouring coefficients, so that Newton's matrix has seven diagonals and a step
    is linear in the number of rows. All iterates are strictly feasible, and the last one is
    returned. A guess that is not strictly feasible is returned unchanged.
    """
    point = program.at(guess)
    if point is None:
        return guess
    coefficients = guess
    basis = program.basis
    shape = program.rows.c.shape
    size = program.rows.c.size
    p, gradients, slack = point
    dual = CENTRING * program.duration(p) / len(slack) / slack
    for _ in range(MAX_NEWTON_STEPS):
        check_time()
        gap = float(dual @ slack)
        tolerance = GAP_TOLERANCE * program.duration(p)
        residual, factor = _newton(program, p, gradients, dual, slack)
        if factor is None or (gap < tolerance and np.maximum.reduce(np.abs(residual)) < tolerance):
            break
        # Toward equal products of slacks and duals.
        change = max(CENTRING * gap, 0.1 * tolerance) / len(slack) / slack - dual
        of_rows = np.add.reduce(change[:size].reshape(shape) * gradients, axis=1)
        right_side = change[size:] - residual - basis.transposed(of_rows)
        step: Array = dpbtrs(factor, right_side, lower=True)[0]
        row_step = np.add.reduce(gradients * basis.at(step)[:, None], axis=0)
        slack_step = np.concatenate([-row_step.ravel(), step])
        dual_step = change - dual / slack * slack_step
        share = _step_share(slack, slack_step)
        smallest_slack = MIN_SLACK_SHARE * slack
        point = program.at(coefficients + share * step)
        while point is None or np.logical_or.reduce(point[2] < smallest_slack):
            share *= BACKTRACK_FACTOR
            if share < MIN_STEP_SHARE:
                return coefficients
            point = program.at(coefficients + share * step)
        coefficients = coefficients + share * step
        p, gradients, slack = point
        dual = dual + _step_share(dual, dual_step) * dual_step
    return coefficients


def _newton(
    program: RateProgram, p: Array, gradients: Array, dual: Array, slack: Array
) -> tuple[Array, Array | None]:
    """Return the dual residual (count,) at p (3, M), and the factor of Newton's matrix.

    An indefinite matrix is replaced by one of the rows' convex parts; the factor may be None.
    """
    rows = program.rows
    shape = rows.c.shape
    size = rows.c.size
    row_dual = dual[:size].reshape(shape)
    stiffness = (dual[:size] / slack[:size]).reshape(shape)
    gradient = np.add.reduce(row_dual * gradients, axis=1)
    gradient[0] -= 0.5 * program.weights * p[0] ** -1.5
    residual = program.basis.transposed(gradient) - dual[size:]
    forms = np.add.reduce((stiffness * gradients)[:, None] * gradients, axis=2)
    forms[0, 0] += 0.75 * program.weights * p[0] ** -2.5
    for convex in (False, True):
        band = program.basis.banded(forms + rows.curvature(p, row_dual, convex=convex))
        band[0] += dual[size:] / slack[size:]
        factor, failed = dpbtrf(band, lower=True)
        if not failed:
            return residual, factor
    return residual, None


def _step_share(values: Array, steps: Array) -> float:
    """Return the fraction of steps, at most 1, that keeps positive values positive."""
    fastest = float(np.minimum.reduce(steps / values))
    return min(1.0, BOUNDARY_SHARE / -fastest) if fastest < 0.0 else 1.0
