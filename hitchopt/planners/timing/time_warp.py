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
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

from hitchopt.errors import HitchoptError
from hitchopt.planners.path.jets import chained, chained_rates
from hitchopt.planners.timing.demands import LIMIT_SHARE, Demands
from hitchopt.planners.timing.fastest_rate import DEGREE, RateProgram, SplineBasis, fastest_rate
from hitchopt.planners.timing.rate_rows import ClockedPath, RateRows
from hitchopt.planners.timing.speed_profile import SpeedProfile
from hitchopt.values import Array

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
    rest = [(1, 0.0), (2, 0.0)]  # the stubs know of one condition an end, scipy of any
    progress = make_interp_spline(knots, at_knots, k=5, bc_type=(rest, rest))  # type: ignore[arg-type]
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
    basis = SplineBasis.of(spline, tau)
    steady = np.full(len(spline.c), _steady_rate(path))
    drones = _nearest(path.ratios(*basis.at(steady).T))
    for _ in range(ROUNDS):
        program = RateProgram(basis, RateRows.of(path, drones), weights)
        rate = fastest_rate(program, steady)
        ratios = path.ratios(*basis.at(rate).T)
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
