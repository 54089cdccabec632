"""Departure times: drones that would meet leave one after the other."""

from __future__ import annotations

import numpy as np

from hitchopt.geometry.vectors import tied_order
from hitchopt.planners.separation.routes import Routes
from hitchopt.time_limit import check_time
from hitchopt.values import Array

CHOICES = 24
"""Number of departure times that a drone can choose from."""

SAMPLES = 96
"""Number of samples over the whole time at which meetings are counted."""

WANTED = 1.15
"""Separation that samples aim at, larger than 1 as drones also move between samples."""


def progress_along(s: Array, ramp: float) -> Array:
    """Return the share of a route flown at times ``s`` (from 0 to 1), with ramps of ``ramp``.

    Parameters
    ----------
    s: (…), below 0 at the start and above 1 at the goal.
    ramp: up to one half.
    """
    fine = np.linspace(0.0, 1.0, 1001)
    speed = _smooth(fine / ramp) * _smooth((1.0 - fine) / ramp)
    gone = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))])
    share: Array = np.interp(s, fine, gone / gone[-1])
    return share


def departures(routes: Routes, shares: Array, ramps: Array, scale: Array) -> Array:
    """Return when each drone leaves (N,), as a share of the whole time: the earliest free choice.

    Drones with the longest flights choose first; one that meets others at every choice takes the
    one with the fewest meetings. Quadratic in N, as all pairs are looked at.

    Parameters
    ----------
    routes: one per drone.
    shares: (N,) of the whole time that each one's flight takes.
    ramps: (N,) of its flight that each one takes to get up to speed.
    scale: (3,) [1/m], the norm of an offset times this is a separation.
    """
    n = len(shares)
    time = np.linspace(0.0, 1.0, SAMPLES)
    chosen = np.zeros(n)
    flown = np.zeros((n, SAMPLES, 3))
    done: list[int] = []
    for i in tied_order(-shares, 1.0):
        check_time()
        delays = np.linspace(0.0, 1.0 - shares[i], CHOICES if shares[i] < 1.0 else 1)
        s = (time - delays[:, None]) / shares[i]
        points = routes.of(int(i), progress_along(s, float(ramps[i]))) * scale
        if done:
            offset = points[:, None] - flown[done]  # (choices, drones, samples, 3)
            meetings = np.sum(np.sum(offset * offset, axis=-1) < WANTED * WANTED, axis=(1, 2))
        else:
            meetings = np.zeros(len(delays), dtype=np.intp)
        best = int(np.argmin(meetings))
        chosen[i] = delays[best]
        flown[i] = points[best]
        done.append(int(i))
    return chosen


def _smooth(x: Array) -> Array:
    """Return a step from 0 to 1 that starts and ends level."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)
