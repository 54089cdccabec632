"""Setpoints of a plan at one plan time, at a rate of its clock: fast enough for a control loop."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from math import comb, perm

import numpy as np

from hitchopt.one_line import OneLine
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array


@dataclass(frozen=True, eq=False)
class Setpoints(OneLine):
    """Where a player has its drones be now.

    Attributes
    ----------
    time: plan time [s].
    rate: of the clock, 1 where the plan is flown as it is.
    positions, velocities, accelerations, jerks: (drones, 3) [m], [m/s], [m/s²], [m/s³], of real
        time.
    """

    time: float
    rate: float
    positions: Array
    velocities: Array
    accelerations: Array
    jerks: Array


class Sampler:
    """The polynomials of a plan's drones, or of its vertices, laid out for one time at a time.

    Parameters
    ----------
    part: of shape (drones, 3) [m].
    """

    def __init__(self, part: PiecewisePolynomial) -> None:
        c = part.coefficients
        pieces, self._drones, _, count = c.shape
        order = count - 1
        to_powers = np.array(
            [
                [
                    comb(order, k) * comb(k, i) * (-1.0) ** (k - i) if i <= k else 0.0
                    for i in range(count)
                ]
                for k in range(count)
            ]
        )
        powers = np.einsum("ki,pdci->pkdc", to_powers, c).reshape(pieces, count, -1)
        rows = np.zeros((pieces, count, 4, powers.shape[-1]))
        h = part.durations[:, None]
        for derivative in range(4):
            for k in range(derivative, count):
                factor = perm(k, derivative)
                rows[:, k - derivative, derivative] = factor * powers[:, k] / h**derivative
        self._rows = rows.reshape(pieces, count, -1)
        self._breaks = part.breaks.tolist()
        self._order = order

    def at(self, time: float, rate: float, slope: float, jerk: float) -> Setpoints:
        """Return the setpoints at a plan time, the clock having these derivatives."""
        return Setpoints(time, rate, *self.values(time, rate, slope, jerk))

    def values(
        self, time: float, rate: float = 1.0, slope: float = 0.0, jerk: float = 0.0
    ) -> Array:
        """Return positions and three derivatives by real time (4, drones, 3)."""
        piece = min(max(bisect_right(self._breaks, time) - 1, 0), len(self._breaks) - 2)
        start = self._breaks[piece]
        x = min(max((time - start) / (self._breaks[piece + 1] - start), 0.0), 1.0)
        powers = [1.0]
        for _ in range(self._order):  # plain numbers are faster than an array of eight
            powers.append(powers[-1] * x)
        values: Array = np.dot(powers, self._rows[piece]).reshape(4, -1)
        if (rate, slope, jerk) != (1.0, 0.0, 0.0):  # else the clock is the plan's
            chain = (
                (1.0, 0.0, 0.0, 0.0, 0.0, rate, 0.0, 0.0)
                + (0.0, slope, rate * rate, 0.0)
                + (0.0, jerk, 3.0 * rate * slope, rate * rate * rate)
            )
            values = np.dot(np.array(chain).reshape(4, 4), values)
        return values.reshape(4, self._drones, 3)
