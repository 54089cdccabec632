"""Half a turn of all pairs at once, its angle on one jerk-limited clock."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import Limits
from hitchopt.planners.forming.clock import fastest_clock, timed
from hitchopt.planners.forming.reserve import SHARE, accelerations
from hitchopt.planners.forming.turns import Turns
from hitchopt.planners.jets import chained
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

PIECE = 0.3
"""[rad] Of the turn on one polynomial of degree 7: within 1e-9 of the ellipse then."""

SHARES = (0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85)
"""Of the acceleration, what the curve takes at full speed; the rest is left to speed up."""

JERK_SHARE = 0.7
"""Of the jerk, what the angle's own may take."""

ANGLES = 25
"""At which the drones' reserves are looked at."""


def swap(turns: Turns, limits: Limits, first: int, seconds: float | None) -> PiecewisePolynomial:
    """Return the drones (2n, 3) [m] on half a turn, from rest to rest.

    The fastest one that keeps the limits of every drone's speed, acceleration and jerk, whatever
    their number: pairs do not wait for each other.

    Parameters
    ----------
    turns: the ellipses.
    limits: of every drone.
    first: 0 for the turn from θ = 0, 1 for the one from θ = π.
    seconds: no faster than this [s], or None.
    """
    start = first * math.pi
    angles = np.linspace(start, start + math.pi, ANGLES)
    reserve = accelerations(turns.team, limits, turns.drones(angles))
    candidates = (_flown(turns, limits, start, share, float(np.min(reserve))) for share in SHARES)
    best = min(candidates, key=lambda flown: flown.duration)
    if seconds is not None and seconds > best.duration:
        best = best.stretched(seconds / best.duration)
    return best


def _flown(
    turns: Turns, limits: Limits, start: float, share: float, reserve: float
) -> PiecewisePolynomial:
    """Return a half turn whose angle has limits by the share, then slowed to keep the drones'."""
    size = turns.size
    speed = min(limits.speed / size, math.sqrt(share * reserve / size))
    spare = math.sqrt(max(reserve * reserve - (speed * speed * size) ** 2, 1e-12)) / size
    clock = fastest_clock(math.pi, speed, spare, JERK_SHARE * limits.jerk / size)
    breaks = timed(clock, PIECE)
    drones = _fitted(turns, clock, breaks, start)
    return drones.stretched(_needed_stretch(drones, limits, reserve))


def _fitted(
    turns: Turns, clock: PiecewisePolynomial, breaks: Array, start: float
) -> PiecewisePolynomial:
    """Return polynomials that meet position, velocity, acceleration and jerk at every break."""
    middles = 0.5 * (breaks[1:] + breaks[:-1])
    rates = np.stack([clock.differentiated(k).at(middles) for k in range(4)], axis=-1)
    ends = []
    for times in (breaks[:-1], breaks[1:]):
        # Of the phase that the piece lies in: jerk jumps between phases.
        dt = (times - middles)[:, None]
        inner = _moved(rates, dt)
        outer = np.stack([turns.drones(start + inner[:, 0], k) for k in range(4)], axis=-1)
        jets = chained(outer, inner[:, None, None, :])
        ends.append(np.moveaxis(jets, -1, 0))
    left, right = ends
    left[:3, 0] = _at_rest(turns, start)
    right[:3, -1] = _at_rest(turns, start + math.pi)
    return PiecewisePolynomial.hermite(breaks, _joined(left, right), right)


def _moved(rates: Array, dt: Array) -> Array:
    """Return the jets (m, 4) of a cubic at ``dt`` (m, 1) from where it has ``rates``."""
    p, v, a, j = (rates[:, k : k + 1] for k in range(4))
    moved: Array = np.concatenate(
        [
            p + dt * (v + dt * (a / 2.0 + dt * j / 6.0)),
            v + dt * (a + dt * j / 2.0),
            a + dt * j,
            j,
        ],
        axis=1,
    )
    return moved


def _joined(left: Array, right: Array) -> Array:
    """Return the left ends with position, velocity and acceleration of the pieces before."""
    left[:3, 1:] = right[:3, :-1]
    return left


def _at_rest(turns: Turns, angle: float) -> Array:
    """(3, 2n, 3): where the drones rest, without velocity and acceleration."""
    places = turns.drones(np.asarray(angle))
    return np.stack([places, *np.zeros((2, *places.shape))])


def _needed_stretch(drones: PiecewisePolynomial, limits: Limits, reserve: float) -> float:
    """Return how many times slower the drones must be, by the hulls of their rates."""
    factors = []
    for order, limit in ((1, limits.speed), (2, reserve), (3, limits.jerk)):
        largest = np.max(np.linalg.norm(drones.differentiated(order).coefficients, axis=-2))
        factors.append((float(largest) / (SHARE * limit)) ** (1.0 / order))
    return float(max(factors))
