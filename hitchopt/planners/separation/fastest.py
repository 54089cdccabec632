"""The shortest time from rest to rest along a straight line, the fastest of all routes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.values import Array


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
