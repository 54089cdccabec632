"""A jerk limit on top of a time-optimal profile: slow time down and speed it up along the way.

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

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

from hitchopt.errors import HitchoptError
from hitchopt.planners.demands import LIMIT_SHARE, Demands
from hitchopt.planners.jets import chained
from hitchopt.planners.timing import SpeedProfile

Array = NDArray[np.float64]
DemandsAt = Callable[[Array], Demands]
"""Demands of the path at given s."""

SAMPLES = 5
"""Per piece, where limits are looked at."""

NEAREST = 2
"""Drones per sample and limit that are rows from the start."""

ROUNDS = 6
"""Of adding drones that were found to break a limit."""

TOLERANCE = 2e-4
"""Relative; limits are planned at LIMIT_SHARE, which leaves more than this."""


class WarpError(HitchoptError):
    """The jerk-limited timing could not be found."""


@dataclass(frozen=True, eq=False)
class Clock:
    """s as a function of time, by way of τ.

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
        nodes, weights = np.polynomial.legendre.leggauss(8)
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
    WarpError: the solver finds no rate that keeps the limits at the samples.
    """
    tau = _samples(clock.knots)
    progress = _spline_jet(clock.progress, tau)
    demands = demands_at(np.clip(progress[:, 0], 0.0, 1.0))
    path = _Path(demands, chained(demands.drones, progress[:, None, None, :]), progress)
    spline = clock.squared_rate
    count = len(spline.c)
    steady = np.full(len(tau), path.steady_rate())
    flat = np.zeros_like(steady)
    rows = path.nearest(steady, flat, flat)
    rate = np.full(count, steady[0])
    for _ in range(ROUNDS):
        try:
            rate = _solve(clock, tau, path, rows, rate)
        except WarpError:  # a steady clock keeps the limits as well, and is only slower
            even = np.full(count, steady[0])
            return Clock(clock.knots, clock.progress, BSpline(spline.t, even, 3))
        squared = BSpline(spline.t, rate, 3)
        x = [squared(tau, order) for order in range(3)]
        broken = path.broken(*x)
        if not np.any(broken):
            return Clock(clock.knots, clock.progress, squared)
        rows = rows | broken
    return Clock(clock.knots, clock.progress, squared)  # the stretch that follows mends the rest


ACCELERATION, JERK, THRUST, TILT = range(4)


class _Path:
    """The path by τ at the samples, and how near each drone comes to each limit for given x."""

    def __init__(self, demands: Demands, jets: Array, progress: Array) -> None:
        self.demands = demands
        self.first, self.second, self.third = jets[..., 1], jets[..., 2], jets[..., 3]
        speed = np.maximum(progress[:, 1], 1e-12)
        self.most = demands.speed_bound / speed**2  # of x

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
                np.linalg.norm(a, axis=-1) / limits.acceleration,
                np.linalg.norm(j, axis=-1) / limits.jerk,
                np.linalg.norm(f, axis=-1) / self.demands.max_thrust,
                np.arctan2(level, f[..., 2]) / limits.tilt,
            ]
        )

    def steady_rate(self) -> float:
        """Return a constant x that keeps all limits."""
        rate = min(1.0, float(np.min(self.most)))
        ones = np.ones(len(self.most))
        for _ in range(200):
            if np.all(self.ratios(rate * ones, 0 * ones, 0 * ones) <= LIMIT_SHARE):
                return rate
            rate *= 0.8
        raise WarpError("no constant speed along the path keeps the limits")

    def nearest(self, x: Array, x1: Array, x2: Array) -> NDArray[np.bool_]:
        """Return (4, M, 2n): the drones that come nearest to each limit at each sample."""
        ratios = self.ratios(x, x1, x2)
        count = min(NEAREST, ratios.shape[-1])
        top = np.argpartition(-ratios, count - 1, axis=-1)[..., :count]
        rows = np.zeros(ratios.shape, dtype=np.bool_)
        np.put_along_axis(rows, top, True, axis=-1)
        return rows

    def broken(self, x: Array, x1: Array, x2: Array) -> NDArray[np.bool_]:
        """Return (4, M, 2n): the worst drone of each sample and limit where it breaks it."""
        ratios = self.ratios(x, x1, x2)
        worst = ratios == np.max(ratios, axis=-1, keepdims=True)
        broken: NDArray[np.bool_] = worst & (ratios > LIMIT_SHARE + TOLERANCE)
        return broken


def _solve(clock: Clock, tau: Array, path: _Path, rows: NDArray[np.bool_], start: Array) -> Array:
    """Return the coefficients of x that minimise the duration with the given rows."""
    spline = clock.squared_rate
    c = ca.MX.sym("c", len(start))
    values = [
        ca.DM(BSpline.design_matrix(tau, spline.t, 3)) @ c,
        *(_derivative_matrix(spline, tau, order) @ c for order in (1, 2)),
    ]
    constraints, upper = _constraints(path, rows, values)
    h = np.repeat(np.diff(clock.knots), SAMPLES)
    _, weights = np.polynomial.legendre.leggauss(SAMPLES)
    weight = 0.5 * h * np.tile(weights, len(clock.knots) - 1)
    duration = ca.dot(ca.DM(weight), 1.0 / ca.sqrt(values[0]))
    program = {"x": c, "f": duration, "g": ca.vertcat(values[0], *constraints)}
    solver = ca.nlpsol(
        "warp",
        "ipopt",
        program,
        {
            "print_time": False,
            "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 200, "tol": 1e-7},
        },
    )
    try:
        solution = solver(
            x0=start,
            lbx=1e-4,
            ubx=1e4,
            lbg=np.append(np.full(len(tau), 1e-4), np.full(len(upper), -np.inf)),
            ubg=np.append(path.most, upper),
        )
    except RuntimeError as error:  # casadi's word for numbers that are none
        raise WarpError("the jerk-limited timing met numbers out of range") from error
    rate = np.asarray(solution["x"], dtype=np.float64).reshape(-1)
    if not np.all(np.isfinite(rate)):
        raise WarpError(f"the jerk-limited timing failed: {solver.stats()['return_status']}")
    return np.clip(rate, 1e-4, 1e4)


def _constraints(
    path: _Path, rows: NDArray[np.bool_], values: list[ca.MX]
) -> tuple[list[ca.MX], Array]:
    """Return the rows' quantities, each over its limit, and their bounds."""
    demands, limits = path.demands, path.demands.limits
    constraints: list[ca.MX] = []
    bounds: list[Array] = []
    for kind in range(4):
        sample, drone = np.nonzero(rows[kind])
        if len(sample) == 0:
            continue
        x, x1, x2 = (v[sample.tolist()] for v in values)
        first, second, third = (d[sample, drone] for d in (path.first, path.second, path.third))
        load, m = demands.loads[sample, drone], demands.mass[drone]
        if kind == JERK:
            jerk = [
                (x * third[:, i] + 1.5 * x1 * second[:, i] + 0.5 * x2 * first[:, i]) / limits.jerk
                for i in range(3)
            ]
            constraints.append(x * _squared(jerk))
            bounds.append(np.full(len(sample), LIMIT_SHARE**2))
            continue
        a = [x * second[:, i] + 0.5 * x1 * first[:, i] for i in range(3)]
        if kind == ACCELERATION:
            constraints.append(_squared([v / limits.acceleration for v in a]))
            bounds.append(np.full(len(sample), LIMIT_SHARE**2))
            continue
        force = [ca.times(m, a[i]) + load[:, i] for i in range(3)]
        if kind == THRUST:
            most = demands.max_thrust[drone]
            constraints.append(_squared([v / most for v in force]))
            bounds.append(np.full(len(sample), LIMIT_SHARE**2))
        else:
            weight = np.linalg.norm(load, axis=1)
            slope = np.tan(LIMIT_SHARE * limits.tilt)
            level = ca.sqrt((force[0] ** 2 + force[1] ** 2) / weight**2 + 1e-12)
            constraints.append(level - slope * force[2] / weight)
            bounds.append(np.zeros(len(sample)))
    return constraints, np.concatenate(bounds)


def _squared(vector: list[ca.MX]) -> ca.MX:
    x, y, z = vector
    return x * x + y * y + z * z


def _samples(knots: Array) -> Array:
    """Return SAMPLES Gauss points of each piece, (K · SAMPLES,)."""
    nodes, _ = np.polynomial.legendre.leggauss(SAMPLES)
    tau: Array = knots[:-1, None] + 0.5 * np.diff(knots)[:, None] * (1.0 + nodes)
    return tau.reshape(-1)


def _derivative_matrix(spline: BSpline, tau: Array, order: int) -> ca.DM:
    """Return the matrix from a cubic spline's coefficients to a derivative at tau."""
    count = len(spline.c)
    rows = BSpline(spline.t, np.eye(count), 3)(tau, order)
    return ca.DM(ca.sparsify(ca.DM(rows)))


def _spline_jet(spline: BSpline, tau: Array) -> Array:
    return np.stack([spline(tau, order) for order in range(4)], axis=-1)


def _rate_jet(spline: BSpline, tau: Array) -> Array:
    """Return the jet of τ(t): 0 (unused), √x, x'/2, x''√x/2."""
    x, x1, x2 = (spline(tau, order) for order in range(3))
    root = np.sqrt(x)
    return np.stack([np.zeros_like(x), root, 0.5 * x1, 0.5 * x2 * root], axis=-1)
