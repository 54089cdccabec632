"""The fastest flights along straight lines from rest to rest, limited in jerk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import HitchoptError
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.clock_phases import advanced
from hitchopt.values import Array

SHORTEST = 1e-9
"""[s] Phases of a profile that are shorter are dropped."""


@dataclass(frozen=True, eq=False)
class Ramp:
    """The fastest straight flights from rest to rest within speed, acceleration and jerk.

    Attributes
    ----------
    peak: (N,) largest speed of each [m/s]
    rise: (N,) time to reach it [s]
    duration: (N,) total time [s]
    """

    peak: Array
    rise: Array
    duration: Array


def fastest_ramps(distance: ArrayLike, speed: float, acceleration: ArrayLike, jerk: float) -> Ramp:
    """Return the fastest straight flights.

    The bound holds for any flight between two points at that distance: its component along the
    line between them is such a flight.

    Parameters
    ----------
    distance: (N,) [m]
    speed, acceleration, jerk: limits; acceleration may be (N,).
    """
    d = np.asarray(distance, dtype=np.float64)
    a = np.broadcast_to(np.asarray(acceleration, dtype=np.float64), d.shape)
    # Peaks of flights that never cruise: with, or without, a time of constant acceleration.
    corner = a * a / jerk
    with_plateau = 0.5 * (np.sqrt(corner * corner + 4.0 * a * d) - corner)
    without = np.cbrt(0.25 * d * d * jerk)
    peak = np.minimum(np.where(with_plateau >= corner, with_plateau, without), speed)
    rise = np.where(peak >= corner, peak / a + a / jerk, 2.0 * np.sqrt(peak / jerk))
    cruise = np.divide(d, peak, out=np.zeros_like(d), where=peak > 0.0) - rise
    return Ramp(peak, rise, 2.0 * rise + np.maximum(cruise, 0.0))


def fastest_clock(
    goal: float, speed: float, acceleration: float, jerk: float
) -> PiecewisePolynomial:
    """Return the fastest profile from 0 to ``goal``, from rest to rest, a cubic per phase.

    The phases are exact: ruckig's jerks and durations, integrated. No waypoints are used.

    Parameters
    ----------
    goal: positive, in any unit.
    speed, acceleration, jerk: limits, in that unit and seconds.
    """
    from ruckig import InputParameter, Result, Ruckig, Trajectory

    task = InputParameter(1)
    task.current_position, task.target_position = [0.0], [goal]
    task.max_velocity, task.max_acceleration, task.max_jerk = [speed], [acceleration], [jerk]
    trajectory = Trajectory(1)
    result = Ruckig(1).calculate(task, trajectory)
    if result not in {Result.Working, Result.Finished}:
        raise HitchoptError(f"ruckig: {result} from 0 to {goal:g}; please report it")
    profile = trajectory.profiles[0][0]
    phases = np.array([profile.t, profile.j], dtype=np.float64)
    seconds, jerks = phases[:, phases[0] > SHORTEST]
    return _integrated(goal, seconds, jerks)


def _integrated(goal: float, seconds: Array, jerks: Array) -> PiecewisePolynomial:
    """Return the cubics of phases of constant jerk; the end is met exactly."""
    jets = [np.zeros(4)]
    for duration, jerk in zip(seconds, jerks, strict=True):
        jets[-1][3] = jerk
        jets.append(advanced(jets[-1], duration))
    x = np.stack(jets, axis=1)[:3]
    x[:, -1] = goal, 0.0, 0.0  # rounding goes into the last phase, where it is all but nothing
    breaks = np.concatenate([[0.0], np.cumsum(seconds)])
    return PiecewisePolynomial.hermite(breaks, x[:, :-1], x[:, 1:])
