"""Curves from a moving state to rest at a goal, in closed form.

A curve is the sum of two: a *brake*, the quartic with the least jerk that comes to rest in a given
time wherever that is, and a *shift*, the quintic from rest to rest that leads from there to the
goal. The longer the shift takes the less it adds, so that the sum keeps every limit that the brake
keeps with something to spare.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import perm

import numpy as np

from hitchopt.values import Array

JET = 4
"""Number of derivatives of a jet, the zeroth included."""

STATE = 3
"""Number of derivatives of a state, likewise."""

QUINTIC = np.array([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])
"""Coefficients of the quintic from 0 to 1, by powers of time over duration."""

PEAK_SPEED, PEAK_ACCELERATION, PEAK_JERK = 1.875, 10.0 / np.sqrt(3.0), 60.0
"""Largest derivatives of the quintic, by time over duration."""


@dataclass(frozen=True, eq=False)
class SmoothChange:
    """Curves of values of one shape.

    Attributes
    ----------
    start: (*shape, 3), value, velocity and acceleration at time 0.
    goal: (*shape)
    """

    start: Array
    goal: Array

    def braked(self, brake: float) -> Array:
        """Return where a brake of a duration [s] comes to rest, (*shape)."""
        rest: Array = self.start @ np.array([1.0, 0.5 * brake, brake**2 / 12.0])
        return rest

    def jets(self, t: Array, brake: float, shift: float) -> Array:
        """Return the jets (J, *shape, 4) at times t (J,) [s].

        Parameters
        ----------
        brake, shift: durations [s].
        """
        p, v, a = np.moveaxis(self.start, -1, 0)
        b = brake
        powers = [
            p,
            v,
            0.5 * a,
            -(v / b + 2.0 * a / 3.0) / b,
            (0.5 * v / b + 0.25 * a) / b**2,
        ]
        stop = self.braked(brake)
        slowed = _polynomial(np.stack(powers), np.minimum(t, b))
        slowed[t >= b, ..., 1:] = 0.0
        share = np.minimum(t / shift, 1.0)
        moved = _polynomial(QUINTIC, share) / shift ** np.arange(JET)
        moved[t >= shift, 1:] = 0.0
        axes = (len(t), *(1,) * stop.ndim, JET)
        result: Array = slowed + (self.goal - stop)[..., None] * moved.reshape(axes)
        return result


def _polynomial(powers: Array, t: Array) -> Array:
    """Return the jets (J, *shape, 4) of polynomials with coefficients (N, *shape) by t."""
    count = len(powers)
    table = t[:, None] ** np.arange(count)
    rows = np.zeros((JET, len(t), count))
    for order in range(JET):
        rows[order, :, order:] = _FACTORS[order, order:count] * table[:, : count - order]
    found = rows.reshape(-1, count) @ powers.reshape(count, -1)
    return np.moveaxis(found.reshape(JET, len(t), *powers.shape[1:]), 0, -1)


_FACTORS = np.array([[perm(k, order) for k in range(len(QUINTIC))] for order in range(JET)], float)
"""Factors of the powers' derivatives."""
