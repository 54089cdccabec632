"""Moves of a hitch with an object, and their curves as polynomials.

Their law of motion has four continuous derivatives: legs tilt with the acceleration of the load, so
that drones accelerate with its fourth derivative.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hitchopt.objects.placing import in_world
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

STEP = np.polynomial.Polynomial([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])
"""A step from 0 to 1 with three zero derivatives at its ends."""

MAX_STEP_SLOPE = 2.1875  # Largest derivative of that step
MAX_STEP_CURVATURE = 7.52  # Largest second derivative of that step

RAMP_PIECES = 10
"""Number of pieces of a ramp, which approximate the clasps' balance to 1e-4 of the tension."""

MIN_PIECE_SHARE = 0.02  # Duration of the shortest piece of a cruise over that of a piece of a ramp


@dataclass(frozen=True)
class SmoothLaw:
    """A progress from 0 to 1 with a rising, a constant and a falling speed."""

    ramp: float  # [s] Duration of each change of the speed
    cruise: float = 0.0  # [s] Duration of the constant speed

    @classmethod
    def fastest(cls, speed: float, acceleration: float, jerk: float) -> SmoothLaw:
        """Return the fastest law with these limits of derivatives [1/s], [1/s²], [1/s³]."""
        slope = MAX_STEP_SLOPE
        curvature = MAX_STEP_CURVATURE
        top = min(speed, math.sqrt(acceleration / slope), (jerk / curvature) ** (1.0 / 3.0))
        ramp = max(slope * top / acceleration, math.sqrt(curvature * top / jerk))
        return cls(ramp, max(1.0 / top - ramp, 0.0))

    @property
    def duration(self) -> float:
        """Duration from rest to rest [s]."""
        return 2.0 * self.ramp + self.cruise

    def slowed(self, factor: float) -> SmoothLaw:
        """Return the law stretched in time by a factor."""
        return SmoothLaw(factor * self.ramp, factor * self.cruise)

    def breaks(self, longest: float) -> Array:
        """Return the breakpoints (pieces + 1,) [s] of the ramps and of the cruise, starting at 0.

        Parameters
        ----------
        longest: largest duration of a piece of the cruise [s].
        """
        ramp = np.linspace(0.0, self.ramp, RAMP_PIECES + 1)
        pieces = max(1, math.ceil(self.cruise / longest))
        cruise = self.ramp + np.linspace(0.0, self.cruise, pieces + 1)
        times = np.concatenate([ramp, cruise[1:], self.ramp + self.cruise + ramp[1:]])
        # Accelerations of a very short piece are those of rounding
        shortest = MIN_PIECE_SHARE * self.ramp / RAMP_PIECES
        breaks: Array = times[np.append(True, np.diff(times) > shortest)]
        breaks[-1] = self.duration
        return breaks

    def jet(self, t: Array) -> Array:
        """Return the progress and its first two derivatives (…, 3) at times t (…) [s]."""
        top = 1.0 / (self.ramp + self.cruise)
        rise = np.clip(t / self.ramp, 0.0, 1.0)
        fall = np.clip((t - self.ramp - self.cruise) / self.ramp, 0.0, 1.0)
        cruise = np.clip(t - self.ramp, 0.0, self.cruise)
        area = STEP.integ()
        slope = STEP.deriv()
        share = self.ramp * (area(rise) + fall - area(fall)) + cruise
        speed = STEP(rise) - STEP(fall)
        acceleration = (slope(rise) - slope(fall)) / self.ramp
        return top * np.stack([share, speed, acceleration], axis=-1)


@dataclass(frozen=True, eq=False)
class Move:
    """Linear changes of state variables with one progress from 0 to 1.

    Pairs are values before and after.
    """

    start: Array  # (4,) x, y, z [m] of the object's base and its yaw [rad], which the clasps follow
    end: Array  # (4,) Those after the move
    tension: Array  # (2, n) [N]
    load_share: tuple[float, float]  # Fractions of the object's weight on clasps
    law: SmoothLaw  # Law of the progress
    # [m] Depths of the clasps below the rim; 0 if they touch it
    below: tuple[float, float] = (0.0, 0.0)
    # Closures of a gripping hitch: 0 around the object, 1 in its grip
    closure: tuple[float, float] = (1.0, 1.0)
    friction_share: tuple[float, float] = (0.0, 0.0)
    """Friction feed-forwards, as fractions of clasp friction.

    Legs pull harder than edges, so that clasps close; it is negative while they open.
    """

    roll: tuple[float, float] = (0.0, 0.0)  # [rad] Rolls of all clasps
    remark: str = ""  # Why it is slower than its law could be, in words

    @property
    def lifted(self) -> bool:
        """Return whether the object is off its support at all times."""
        return self.load_share == (1.0, 1.0)

    @property
    def steady(self) -> bool:
        """Return whether the object or the clasps move straight, with constant loads and shapes."""
        yaw = (self.start[3], self.end[3])
        pairs = (
            self.tension,
            self.load_share,
            self.closure,
            self.friction_share,
            yaw,
            self.roll,
        )
        are_constant = all(np.array_equal(before, after) for before, after in pairs)
        travels = bool(np.any(self.start != self.end)) or self.below[0] != self.below[1]
        return travels and are_constant

    def state(self, t: Array) -> MoveState:
        """Return the state of the move at times t (…) [s]."""
        progress, speed, acceleration = np.moveaxis(self.law.jet(t), -1, 0)
        return MoveState(self, progress, speed, acceleration)


@dataclass(frozen=True, eq=False)
class MoveState:
    """The state of an object during a move, at times (…)."""

    move: Move  # The move
    progress: Array  # (…), of the move
    speed: Array  # (…) [1/s], of the progress
    acceleration: Array  # (…) [1/s²], of the progress

    def between(self, before: Array | float, after: Array | float) -> Array:
        """Return interpolated values (…) or (…, k) between two values, scalars or (k,)."""
        progress = self.progress if np.ndim(after) == 0 else self.progress[..., None]
        return np.asarray(before + progress * (np.asarray(after) - before))

    @property
    def pose(self) -> Array:
        """(…, 5): pose of the object, x, y, z [m] and cosine and sine of its yaw."""
        place = self.between(self.move.start, self.move.end)
        yaw = place[..., 3:]
        return np.concatenate([place[..., :3], np.cos(yaw), np.sin(yaw)], axis=-1)

    @property
    def load_share(self) -> Array:
        """(…): fraction of the object's weight on clasps."""
        return self.between(*self.move.load_share)

    @property
    def tension(self) -> Array:
        """(…, n) [N]: tensions of cables."""
        return self.between(*self.move.tension)

    def accelerations(self, points: Array) -> Array:
        """Return accelerations (…, k, 3) [m/s²] of points (…, k, 3) of the object, in its frame."""
        x, y = points[..., 0], points[..., 1]
        travel = self.move.end - self.move.start
        to_object = self.pose * [0.0, 0.0, 0.0, 1.0, -1.0]  # rotation by the opposite yaw
        linear = in_world(to_object, self.acceleration[..., None] * travel[:3])
        squared_yaw_rate = (self.speed * travel[3])[..., None] ** 2
        yaw_acceleration = (self.acceleration * travel[3])[..., None]
        along_x = -squared_yaw_rate * x - yaw_acceleration * y
        along_y = yaw_acceleration * x - squared_yaw_rate * y
        of_rotation = np.stack([along_x, along_y, np.zeros_like(along_x)], axis=-1)
        return np.asarray(linear[..., None, :] + of_rotation)


DIFFERENCE_STEP = 2e-3
"""[s] Step of fourth-order finite differences, whose error is 1e-9 m/s² for typical motions."""

STENCIL = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])  # Times at which differences take values, in steps

FIRST = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0
"""Weights of these values in the first derivative."""

SECOND = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0
"""Weights of these values in the second derivative."""

MAX_PIECE = 0.5
"""[s] Longest piece of a cruise. An error of second derivatives at the ends of a piece, some 0.01
of the loads' rate of change before, displaces clasps by that times its squared duration."""

MAX_STEADY_PIECE = 2.5  # [s] Longest piece of the cruise of steady moves


class Timed(Protocol):
    """A move with a law of motion."""

    @property
    def law(self) -> SmoothLaw:
        """Law of its progress."""

    @property
    def steady(self) -> bool:
        """Return whether all points move straight, with constant loads and shapes."""


def polynomials(
    move: Timed, curves: Callable[[Array], dict[str, Array]]
) -> dict[str, PiecewisePolynomial]:
    """Return a move's curves by name, from rest to rest, as polynomials.

    ``curves`` returns their values at times (…) [s].
    """
    breaks = move.law.breaks(MAX_STEADY_PIECE if move.steady else MAX_PIECE)
    times = breaks[:, None] + DIFFERENCE_STEP * STENCIL
    samples = curves(np.clip(times, 0.0, move.law.duration))
    return {name: _fitted(breaks, values) for name, values in samples.items()}


def _fitted(breaks: Array, values: Array) -> PiecewisePolynomial:
    """Return the curve with values (pieces + 1, stencil, …) about breakpoints [s], from rest."""
    if np.all(values == values[:1, :1]):
        return PiecewisePolynomial.constant(breaks, values[0, 0])
    first = np.tensordot(FIRST / DIFFERENCE_STEP, values, (0, 1))
    second = np.tensordot(SECOND / DIFFERENCE_STEP**2, values, (0, 1))
    first[[0, -1]] = 0.0
    second[[0, -1]] = 0.0
    jets = np.stack([values[:, 2], first, second])  # the middle of the stencil
    return PiecewisePolynomial.hermite(breaks, jets[:, :-1], jets[:, 1:])
