"""The fastest jerk-limited motions along a line, and curves timed by such a clock."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import HitchoptError
from hitchopt.hitch.requirements import Limits
from hitchopt.hitch.series import chained
from hitchopt.planners.timing.profile import LIMIT_SHARE
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.clock_phases import advance
from hitchopt.trajectory.piecewise import MIN_SPACING, divided
from hitchopt.values import Array

LIMIT_FACTORS = (1.0, 0.98, 0.96)
"""Factors of limits that avoid short phases, in the order of the search."""

MAX_HALVINGS = 100  # Largest number of halvings of the jerk that avoid short phases


class RampTimes(NamedTuple):
    """Times of N straight flights from rest to rest."""

    durations: Array  # (N,) [s]
    rises: Array  # (N,) [s]: times in which the speed rises to its peak, and in which it falls


def fastest_ramps(
    distance: ArrayLike, speed: float, acceleration: ArrayLike, jerk: float
) -> RampTimes:
    """Return the times of the fastest straight flights from rest to rest.

    The durations are lower bounds for all flights between two points at that distance, since the
    component along their line satisfies the same limits. They are in closed form for many lines at
    once, as bounds and assignments need; ``fastest_clock`` has the phases of one, by ruckig.

    Parameters
    ----------
    distance: (N,) [m]
    speed, acceleration, jerk: limits; acceleration may be (N,).
    """
    distances = np.asarray(distance, dtype=np.float64)
    accelerations = np.broadcast_to(np.asarray(acceleration, np.float64), distances.shape)
    # Peak speeds without cruise: with and without a plateau of the acceleration
    plateau_speeds = accelerations * accelerations / jerk  # from which on there is a plateau
    roots = np.sqrt(plateau_speeds * plateau_speeds + 4.0 * accelerations * distances)
    peaks_with_plateau = 0.5 * (roots - plateau_speeds)
    peaks_without = np.cbrt(0.25 * distances * distances * jerk)
    has_plateau = peaks_with_plateau >= plateau_speeds
    peaks = np.minimum(np.where(has_plateau, peaks_with_plateau, peaks_without), speed)
    rises_with_plateau = peaks / accelerations + accelerations / jerk
    rises_without = 2.0 * np.sqrt(peaks / jerk)
    rises = np.where(peaks >= plateau_speeds, rises_with_plateau, rises_without)
    times_at_peaks = np.divide(distances, peaks, out=np.zeros_like(distances), where=peaks > 0.0)
    cruises = times_at_peaks - rises
    return RampTimes(2.0 * rises + np.maximum(cruises, 0.0), rises)


def fastest_clock(
    goal: float, speed: float, acceleration: float, jerk: float
) -> PiecewisePolynomial:
    """Return the fastest profile from 0 to ``goal``, from rest to rest, a cubic per phase.

    The phases are exact integrals of ruckig's jerks. LIMIT_FACTORS, and then halves of the jerk,
    avoid phases shorter than MIN_SPACING.

    Parameters
    ----------
    goal: positive, in any unit.
    speed, acceleration, jerk: limits, in that unit and seconds.
    """
    from ruckig import InputParameter, Result, Ruckig, Trajectory

    task = InputParameter(1)
    task.current_position = [0.0]
    task.target_position = [goal]
    for halving, factor in product(range(MAX_HALVINGS), LIMIT_FACTORS):
        task.max_velocity = [factor * speed]
        task.max_acceleration = [factor * acceleration]
        task.max_jerk = [0.5**halving * jerk]
        trajectory = Trajectory(1)
        result = Ruckig(1).calculate(task, trajectory)
        if result not in {Result.Working, Result.Finished}:
            raise HitchoptError(f"ruckig: {result} from 0 to {goal:g}; please report it")
        profile = trajectory.profiles[0][0]
        durations = np.array(profile.t, dtype=np.float64)
        is_phase = durations > 1e-9
        if np.min(durations[is_phase]) >= MIN_SPACING:
            break
    durations = durations[is_phase]
    jerks = np.array(profile.j, dtype=np.float64)[is_phase]
    jets = [np.zeros(4)]
    for duration, constant_jerk in zip(durations, jerks, strict=True):
        jets[-1][3] = constant_jerk
        jets.append(advance(jets[-1], duration))
    orders = np.stack(jets, axis=1)[:3]
    orders[:, -1] = [goal, 0.0, 0.0]  # the last phase absorbs rounding
    breaks = np.append(0.0, np.cumsum(durations))
    return PiecewisePolynomial.hermite(breaks, orders[:, :-1], orders[:, 1:])


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
    # Jets at the ends are extrapolated from the middle of a piece, since jerk jumps between phases
    middle_jets = np.stack([clock.at(middles, order) for order in range(4)], axis=-1)
    left = _orders_on_clock(curve, advance(middle_jets, breaks[:-1] - middles))
    right = _orders_on_clock(curve, advance(middle_jets, breaks[1:] - middles))
    start, end = curve(clock.at(clock.breaks[[0, -1]]), 0)
    left[0, 0] = start
    right[0, -1] = end
    left[1:3, 0] = 0.0
    right[1:3, -1] = 0.0
    left[:3, 1:] = right[:3, :-1]
    drones = PiecewisePolynomial.hermite(breaks, left, right)
    factors = []
    for order, limit in ((1, limits.speed), (2, acceleration), (3, limits.jerk)):
        coefficients = drones.differentiated(order).coefficients
        largest = float(np.max(np.linalg.norm(coefficients, axis=-2)))
        factors.append((largest / (LIMIT_SHARE * limit)) ** (1.0 / order))
    return drones.stretched(max(factors))


def _orders_on_clock(curve: Curve, clock_jets: Array) -> Array:
    """Return derivatives (4, J, drones, 3) of a curve by time, the zeroth first.

    Parameters
    ----------
    clock_jets: (J, 4), parameters of the curve and their derivatives by time.
    """
    by_parameter = np.stack([curve(clock_jets[:, 0], order) for order in range(4)], axis=-1)
    return np.moveaxis(chained(by_parameter, clock_jets[:, None, None, :]), -1, 0)
