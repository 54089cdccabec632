"""Curves that are no polynomials, flown on a clock: as polynomials that fit them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hitchopt.planners.forming.clock import timed
from hitchopt.planners.forming.reserve import SHARE
from hitchopt.planners.path.jets import chained
from hitchopt.requirements import Limits
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

Curve = Callable[[Array, int], Array]
"""From parameters (J,) and the order of a derivative by them to places (J, drones, 3) [m]."""


def fitted(curve: Curve, clock: PiecewisePolynomial, most: float) -> PiecewisePolynomial:
    """Return polynomials that meet position, velocity, acceleration and jerk at every break.

    Parameters
    ----------
    curve: in the clock's unit.
    clock: cubics from rest to rest.
    most: of the clock's way on one piece.
    """
    breaks = timed(clock, most)
    middles = 0.5 * (breaks[1:] + breaks[:-1])
    rates = np.stack([clock.differentiated(k).at(middles) for k in range(4)], axis=-1)
    ends = []
    for times in (breaks[:-1], breaks[1:]):
        # Of the phase that the piece lies in: jerk jumps between phases.
        inner = _moved(rates, (times - middles)[:, None])
        outer = np.stack([curve(inner[:, 0], k) for k in range(4)], axis=-1)
        ends.append(np.moveaxis(chained(outer, inner[:, None, None, :]), -1, 0))
    left, right = ends
    first, last = clock.at(clock.breaks[[0, -1]])
    left[:3, 0] = _at_rest(curve, first)
    right[:3, -1] = _at_rest(curve, last)
    left[:3, 1:] = right[:3, :-1]
    return PiecewisePolynomial.hermite(breaks, left, right)


def needed_stretch(drones: PiecewisePolynomial, limits: Limits, reserve: float) -> float:
    """Return how many times slower drones must fly to keep their limits, by the rates' hulls.

    Parameters
    ----------
    reserve: largest acceleration of any of them [m/s²].
    """
    factors = []
    for order, limit in ((1, limits.speed), (2, reserve), (3, limits.jerk)):
        largest = np.max(np.linalg.norm(drones.differentiated(order).coefficients, axis=-2))
        factors.append((float(largest) / (SHARE * limit)) ** (1.0 / order))
    return float(max(factors))


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


def _at_rest(curve: Curve, parameter: float) -> Array:
    """(3, drones, 3): where drones rest, without velocity and acceleration."""
    places = curve(np.array([parameter]), 0)[0]
    return np.stack([places, *np.zeros((2, *places.shape))])
