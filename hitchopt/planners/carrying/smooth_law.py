"""A law of motion from rest to rest whose first four derivatives are continuous.

Legs lean with the acceleration of what they carry, so drones accelerate with its fourth derivative.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hitchopt.values import Array

STEP = np.array([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])
"""Coefficients, in rising powers, of a step from 0 to 1 with three zero derivatives at its ends."""

STEEPEST, BENDING = 2.1875, 7.52
"""Largest first and second derivative of that step."""


@dataclass(frozen=True)
class SmoothLaw:
    """A share from 0 to 1: its speed rises, is constant, and falls.

    Attributes
    ----------
    ramp, cruise: how long the speed changes, each time, and is constant [s].
    """

    ramp: float
    cruise: float = 0.0

    @classmethod
    def fastest(cls, speed: float, acceleration: float, jerk: float) -> SmoothLaw:
        """Return the fastest law within limits of the share's derivatives [1/s], [1/s²], [1/s³]."""

        def ramp(top: float) -> float:
            return max(STEEPEST * top / acceleration, math.sqrt(BENDING * top / jerk))

        lower, upper = 0.0, speed
        if upper * ramp(upper) <= 1.0:
            return cls(ramp(upper), 1.0 / upper - ramp(upper))
        for _ in range(60):
            middle = 0.5 * (lower + upper)
            lower, upper = (middle, upper) if middle * ramp(middle) <= 1.0 else (lower, middle)
        return cls(1.0 / upper)

    @property
    def duration(self) -> float:
        """Duration from rest to rest [s]."""
        return 2.0 * self.ramp + self.cruise

    def slowed(self, factor: float) -> SmoothLaw:
        """Return the same law, ``factor`` times as slow."""
        return SmoothLaw(factor * self.ramp, factor * self.cruise)

    def breaks(self, longest: float) -> Array:
        """Return times (pieces + 1,) [s] from 0 on: ramps in pieces, and the cruise in others.

        Parameters
        ----------
        longest: of the cruise's pieces [s].
        """
        ramp = np.linspace(0.0, self.ramp, RAMP_PIECES + 1)
        cruise = self.ramp + self.cruise * np.linspace(
            0.0, 1.0, max(1, math.ceil(self.cruise / longest)) + 1
        )
        times = np.concatenate([ramp, cruise[1:], self.ramp + self.cruise + ramp[1:]])
        kept: Array = times[np.append(True, np.diff(times) > 1e-9)]
        kept[-1] = self.duration
        return kept

    def jet(self, t: Array) -> Array:
        """Return the share and its first two derivatives at times t (…) [s], as (…, 3)."""
        top = 1.0 / (self.ramp + self.cruise)
        begun = np.clip(t / self.ramp, 0.0, 1.0)
        ended = np.clip((t - self.ramp - self.cruise) / self.ramp, 0.0, 1.0)
        there = np.clip(t - self.ramp, 0.0, self.cruise)
        rising, falling = _powers(begun), _powers(ended)
        share = top * (self.ramp * (rising[0] + ended - falling[0]) + there)
        speed = top * (rising[1] - falling[1])
        change = top * (rising[2] - falling[2]) / self.ramp
        return np.stack([share, speed, change], axis=-1)


RAMP_PIECES = 10
"""Pieces of a ramp: legs follow their clasps' balance between them within 1e-4 of the tension."""


def _powers(x: Array) -> tuple[Array, Array, Array]:
    """Return the step's integral, the step, and its derivative at x (…)."""
    step = np.polynomial.Polynomial(STEP)
    return step.integ()(x), step(x), step.deriv()(x)
