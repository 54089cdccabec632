"""Half a turn of all pairs at once, its angle on one jerk-limited clock."""

from __future__ import annotations

import math

import numpy as np

from hitchopt.planners.forming.clock import fastest_clock
from hitchopt.planners.forming.curve_fitting import flown
from hitchopt.planners.forming.reserve import accelerations
from hitchopt.planners.forming.turns import Turns
from hitchopt.requirements import Limits
from hitchopt.trajectory import PiecewisePolynomial

PIECE = 0.3
"""[rad] Largest angle on one polynomial of degree 7, which is within 1e-9 of the ellipse."""

SHARES = (0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85)
"""Shares of the acceleration that turning takes at full speed; the rest is for speeding up."""

JERK_SHARE = 0.7
"""Share of the jerk that the angle's own rate takes."""

ANGLES = 25
"""Number of angles at which the drones' reserves are computed."""


def swap(turns: Turns, limits: Limits, first: int, seconds: float | None) -> PiecewisePolynomial:
    """Return the drones (2n, 3) [m] on half a turn, from rest to rest.

    As fast as the limits of every drone's speed, acceleration and jerk allow, whatever their
    number: pairs move at the same time.

    Parameters
    ----------
    turns: the ellipses.
    limits: of every drone.
    first: 0 for the turn from θ = 0, 1 for the one from θ = π.
    seconds: no faster than this [s], or None.
    """
    start = first * math.pi
    angles = np.linspace(start, start + math.pi, ANGLES)
    reserve = float(np.min(accelerations(turns.team, limits, turns.drones(angles))))
    candidates = (_half_turn(turns, limits, start, share, reserve) for share in SHARES)
    best = min(candidates, key=lambda drones: drones.duration)
    if seconds is not None and seconds > best.duration:
        best = best.stretched(seconds / best.duration)
    return best


def _half_turn(
    turns: Turns, limits: Limits, start: float, share: float, reserve: float
) -> PiecewisePolynomial:
    """Return a half turn whose angle is limited by the share, slowed to the drones' limits."""
    size = turns.size
    speed = min(limits.speed / size, math.sqrt(share * reserve / size))
    spare = math.sqrt(max(reserve * reserve - (speed * speed * size) ** 2, 1e-12)) / size
    clock = fastest_clock(math.pi, speed, spare, JERK_SHARE * limits.jerk / size)
    return flown(
        lambda angle, order: turns.drones(start + angle, order), clock, PIECE, limits, reserve
    )
