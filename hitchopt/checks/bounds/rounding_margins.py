"""How much is allowed for rounding, in one place. Every ``worst`` is moved outward by this.

Coefficients and breaks are taken as exact: they are the plan. What is computed from them errs by a
few units in the last place of the numbers that enter, say 2**-50 of them after halving forty
times; ``ROUNDING`` leaves a factor of a thousand, also for whoever samples the same polynomials.
"""

from __future__ import annotations

from math import perm
from weakref import WeakKeyDictionary

import numpy as np

from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

ROUNDING = 2.0**-40
"""Relative to the magnitude of the numbers that enter a quantity."""

_KNOWN: WeakKeyDictionary[PiecewisePolynomial, dict[int, Array]] = WeakKeyDictionary()
"""Margins of derivatives, by their order, as long as the polynomials are in use; by 0, the largest
differences of coefficients."""

_MAGNITUDES: WeakKeyDictionary[Motion, float] = WeakKeyDictionary()
"""Largest coordinates of motions in use."""

LAST_PLACE = 2.0**-50
"""What a difference of two numbers errs by at most, relative to it, with room to spare."""


def magnitude(motion: Motion) -> float:
    """Return the largest coordinate of the plan [m]; all checks ask for it."""
    found = _MAGNITUDES.get(motion)
    if found is None:
        parts = (motion.drones, motion.vertices)
        sizes = (np.max(np.abs(part.coefficients), initial=0.0) for part in parts)
        found = _MAGNITUDES[motion] = float(max(sizes))
    return found


def position_margin(motion: Motion) -> float:
    """Return the margin of distances and lengths [m]."""
    return ROUNDING * magnitude(motion)


def derivative_margin(part: PiecewisePolynomial, order: int) -> Array:
    """Return the margin of the norm of a derivative by time.

    The k-th differences of the coefficients amplify what the first ones err by, 2^(k-1) times,
    and N!/(N-k)! / h^k times that is the derivative.

    Parameters
    ----------
    part: of shape (items, d).
    order: of the derivative, k >= 1.

    Returns
    -------
    (pieces, items), read-only: several checks ask for the same ones.
    """
    known = _KNOWN.setdefault(part, {})
    if order not in known:
        known[order] = _derivative_margin(part, order)
        known[order].setflags(write=False)
    return known[order]


def _derivative_margin(part: PiecewisePolynomial, order: int) -> Array:
    c = part.coefficients
    if part.degree == 0:
        return np.zeros(c.shape[:2])
    if 0 not in _KNOWN[part]:  # the same for all orders
        _KNOWN[part][0] = _largest(c[..., 1:] - c[..., :-1])
    differences = _KNOWN[part][0]
    gain = 2.0**order * perm(part.degree, order) / part.durations**order
    size = _largest(part.differentiated(order).coefficients)
    margin: Array = (LAST_PLACE * gain)[:, None] * differences + ROUNDING * size
    return margin


def _largest(coefficients: Array) -> Array:
    """Return the largest magnitudes (pieces, items) of coefficients (pieces, items, d, m)."""
    sizes = np.abs(coefficients)
    largest: Array = sizes.reshape(*sizes.shape[:2], -1).max(axis=-1)
    return largest
