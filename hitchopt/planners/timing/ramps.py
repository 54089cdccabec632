"""The fastest jerk-limited motions along a line, and curves timed by such a clock."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import HitchoptError
from hitchopt.hitch.requirements import Limits
from hitchopt.hitch.series import chained
from hitchopt.planners.timing.profile import LIMIT_SHARE
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.clock_phases import advance
from hitchopt.trajectory.piecewise import divided
from hitchopt.values import Array

PHASE_TOLERANCE = 1e-9
"""[s] Shorter phases of a profile are dropped."""

MIN_PHASE = 5e-4
"""[s] Shortest phase whose derivatives are accurate."""

LIMIT_FACTORS = (1.0, 0.98, 0.96)
"""Factors of limits that avoid shorter phases, in the order of the search."""


def fastest_ramps(
    distance: ArrayLike, speed: float, acceleration: ArrayLike, jerk: float
) -> tuple[Array, Array]:
    """Return durations and rise times (N,) [s] of the fastest straight flights from rest to rest.

    The durations are lower bounds for all flights between two points at that distance, since the
    component along their line satisfies the same limits.

    Parameters
    ----------
    distance: (N,) [m]
    speed, acceleration, jerk: limits; acceleration may be (N,).
    """
    d = np.asarray(distance, dtype=np.float64)
    a = np.broadcast_to(np.asarray(acceleration, dtype=np.float64), d.shape)
    # Peak speeds without cruise: with and without a plateau of the acceleration.
    corner = a * a / jerk
    with_plateau = 0.5 * (np.sqrt(corner * corner + 4.0 * a * d) - corner)
    without = np.cbrt(0.25 * d * d * jerk)
    peak = np.minimum(np.where(with_plateau >= corner, with_plateau, without), speed)
    rise = np.where(peak >= corner, peak / a + a / jerk, 2.0 * np.sqrt(peak / jerk))
    cruise = np.divide(d, peak, out=np.zeros_like(d), where=peak > 0.0) - rise
    return 2.0 * rise + np.maximum(cruise, 0.0), rise


def fastest_clock(
    goal: float, speed: float, acceleration: float, jerk: float
) -> PiecewisePolynomial:
    """Return the fastest profile from 0 to ``goal``, from rest to rest, a cubic per phase.

    The phases are exact integrals of ruckig's jerks. LIMIT_FACTORS avoid phases that are so short
    that their derivatives suffer from rounding.

    Parameters
    ----------
    goal: positive, in any unit.
    speed, acceleration, jerk: limits, in that unit and seconds.
    """
    from ruckig import InputParameter, Result, Ruckig, Trajectory

    task = InputParameter(1)
    task.current_position, task.target_position = [0.0], [goal]
    for factor in LIMIT_FACTORS:
        limits = factor * speed, factor * acceleration, jerk
        task.max_velocity, task.max_acceleration, task.max_jerk = ([limit] for limit in limits)
        trajectory = Trajectory(1)
        result = Ruckig(1).calculate(task, trajectory)
        if result not in {Result.Working, Result.Finished}:
            raise HitchoptError(f"ruckig: {result} from 0 to {goal:g}; please report it")
        profile = trajectory.profiles[0][0]
        seconds, jerks = np.array([profile.t, profile.j], dtype=np.float64)
        present = seconds > PHASE_TOLERANCE
        if np.min(seconds[present]) >= MIN_PHASE:
            break
    jets = [np.zeros(4)]
    for each, constant in zip(seconds[present], jerks[present], strict=True):
        jets[-1][3] = constant
        jets.append(advance(jets[-1], each))
    x = np.stack(jets, axis=1)[:3]
    x[:, -1] = goal, 0.0, 0.0  # the last phase absorbs rounding
    breaks = np.append(0.0, np.cumsum(seconds[present]))
    return PiecewisePolynomial.hermite(breaks, x[:, :-1], x[:, 1:])


Curve = Callable[[Array, int], Array]
"""Function of parameters (J,) and the order of a derivative, with values (J, drones, 3) [m]."""


def timed_curve(
    curve: Curve,
    clock: PiecewisePolynomial,
    max_advance: float,
    limits: Limits,
    acceleration: float,
) -> PiecewisePolynomial:
    """Return drones on a curve, timed by a clock that is slowed down to their limits.

    Parameters
    ----------
    curve: in the clock's unit.
    clock: cubics from rest to rest.
    max_advance: largest advance of the clock on one piece.
    limits: of speed and jerk.
    acceleration: limit of their acceleration [m/s²].
    """
    advances = np.diff(clock.at(clock.breaks))
    counts = np.maximum(1, np.ceil(advances / max_advance).astype(np.intp))
    breaks = divided(clock.breaks, counts)
    middles = 0.5 * (breaks[1:] + breaks[:-1])
    rates = np.stack([clock.differentiated(k).at(middles) for k in range(4)], axis=-1)
    ends = []
    for times in (breaks[:-1], breaks[1:]):
        # Extrapolated from the middle of the piece, since jerk jumps between phases.
        inner = advance(rates, times - middles)
        outer = np.stack([curve(inner[:, 0], k) for k in range(4)], axis=-1)
        ends.append(np.moveaxis(chained(outer, inner[:, None, None, :]), -1, 0))
    left, right = ends
    left[0, 0], right[0, -1] = curve(clock.at(clock.breaks[[0, -1]]), 0)
    left[1:3, 0] = right[1:3, -1] = 0.0
    left[:3, 1:] = right[:3, :-1]
    drones = PiecewisePolynomial.hermite(breaks, left, right)
    factors = []
    for order, limit in ((1, limits.speed), (2, acceleration), (3, limits.jerk)):
        largest = np.max(np.linalg.norm(drones.differentiated(order).coefficients, axis=-2))
        factors.append((float(largest) / (LIMIT_SHARE * limit)) ** (1.0 / order))
    return drones.stretched(max(factors))
