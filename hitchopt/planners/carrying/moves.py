"""Moves of a hitch with an object, and their curves as polynomials: at rest, pulling, or flying.

They follow a law of motion whose first four derivatives are continuous: legs tilt with the
acceleration of the load, so drones accelerate with its fourth derivative.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hitchopt.objects.placing import in_world
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

STEP = np.polynomial.Polynomial([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])
"""A step from 0 to 1 with three zero derivatives at its ends."""

STEEPEST, BENDING = 2.1875, 7.52
"""Largest first and second derivative of that step."""

RAMP_PIECES = 10
"""Pieces of a ramp: between them legs follow their clasps' balance within 1e-4 of the tension."""


@dataclass(frozen=True)
class SmoothLaw:
    """A share from 0 to 1: its speed rises, is constant, and falls.

    Attributes
    ----------
    ramp, cruise: durations of each change of the speed, and of the constant speed [s].
    """

    ramp: float
    cruise: float = 0.0

    @classmethod
    def fastest(cls, speed: float, acceleration: float, jerk: float) -> SmoothLaw:
        """Return the fastest law within limits of the share's derivatives [1/s], [1/s²], [1/s³]."""
        top = min(speed, math.sqrt(acceleration / STEEPEST), (jerk / BENDING) ** (1.0 / 3.0))
        ramp = max(STEEPEST * top / acceleration, math.sqrt(BENDING * top / jerk))
        return cls(ramp, max(1.0 / top - ramp, 0.0))

    @property
    def duration(self) -> float:
        """Duration from rest to rest [s]."""
        return 2.0 * self.ramp + self.cruise

    def slowed(self, factor: float) -> SmoothLaw:
        """Return the law stretched in time by a factor."""
        return SmoothLaw(factor * self.ramp, factor * self.cruise)

    def breaks(self, longest: float) -> Array:
        """Return times (pieces + 1,) [s] from 0 on: pieces of the ramps and of the cruise.

        Parameters
        ----------
        longest: duration of a piece of the cruise [s].
        """
        ramp = np.linspace(0.0, self.ramp, RAMP_PIECES + 1)
        pieces = max(1, math.ceil(self.cruise / longest))
        cruise = self.ramp + np.linspace(0.0, self.cruise, pieces + 1)
        times = np.concatenate([ramp, cruise[1:], self.ramp + self.cruise + ramp[1:]])
        breaks: Array = times[np.append(True, np.diff(times) > 1e-9)]
        breaks[-1] = self.duration
        return breaks

    def jet(self, t: Array) -> Array:
        """Return the share and its first two derivatives at times t (…) [s], as (…, 3)."""
        top = 1.0 / (self.ramp + self.cruise)
        rise = np.clip(t / self.ramp, 0.0, 1.0)
        fall = np.clip((t - self.ramp - self.cruise) / self.ramp, 0.0, 1.0)
        cruise = np.clip(t - self.ramp, 0.0, self.cruise)
        area, slope = STEP.integ(), STEP.deriv()
        share = self.ramp * (area(rise) + fall - area(fall)) + cruise
        speed = STEP(rise) - STEP(fall)
        acceleration = (slope(rise) - slope(fall)) / self.ramp
        return top * np.stack([share, speed, acceleration], axis=-1)


@dataclass(frozen=True, eq=False)
class Move:
    """All that changes in a span of time, by one share from 0 to 1.

    Attributes
    ----------
    start, end: (4,) x, y, z [m] of the object's base and its yaw [rad], which the clasps follow.
    tension: (2, n) [N], before and after.
    borne: share of the object's weight on clasps before and after.
    below: depth of the clasps below the rim before and after [m]; 0 if they touch it.
    law: of the share.
    closed: closure of a hitch that grips before and after: 0 around the object, 1 in its grip.
    lead: share of clasp friction that legs overcome before and after by pulling harder than edges,
        so that clasps close; negative while they open.
    """

    start: Array
    end: Array
    tension: Array
    borne: tuple[float, float]
    law: SmoothLaw
    below: tuple[float, float] = (0.0, 0.0)
    closed: tuple[float, float] = (1.0, 1.0)
    lead: tuple[float, float] = (0.0, 0.0)

    @property
    def lifted(self) -> bool:
        """Whether the object is off its support all the time."""
        return self.borne == (1.0, 1.0)

    @property
    def steady(self) -> bool:
        """Whether the object or the clasps go straight on while all loads and shapes remain."""
        pairs = (self.tension, self.borne, self.closed, self.lead, (self.start[3], self.end[3]))
        travels = bool(np.any(self.start != self.end)) or self.below[0] != self.below[1]
        return travels and all(np.array_equal(before, after) for before, after in pairs)

    def course(self, t: Array) -> Course:
        """Return the course of the move at times t (…) [s]."""
        return Course(self, *np.moveaxis(self.law.jet(t), -1, 0))


@dataclass(frozen=True, eq=False)
class Course:
    """The state of an object in the course of a move, at times (…).

    Attributes
    ----------
    move: what changes.
    share, speed, acceleration: (…), of the move, and its derivatives [1/s], [1/s²].
    """

    move: Move
    share: Array
    speed: Array
    acceleration: Array

    def between(self, before: Array | float, after: Array | float) -> Array:
        """Return (…) or (…, k) the value of what changes from one value or (k,) to another."""
        share = self.share if np.ndim(after) == 0 else self.share[..., None]
        return np.asarray(before + share * (np.asarray(after) - before))

    @property
    def pose(self) -> Array:
        """(…, 5): of the object."""
        place = self.between(self.move.start, self.move.end)
        yaw = place[..., 3:]
        return np.concatenate([place[..., :3], np.cos(yaw), np.sin(yaw)], axis=-1)

    @property
    def borne(self) -> Array:
        """(…): share of the object's weight on clasps."""
        return self.between(*self.move.borne)

    @property
    def tension(self) -> Array:
        """(…, n) [N]: of cables."""
        return self.between(*self.move.tension)

    def accelerations(self, points: Array) -> Array:
        """Return accelerations (…, k, 3) [m/s²] of points (k, 3) of the object, in its frame."""
        x, y, offset = points[:, 0], points[:, 1], self.move.end - self.move.start
        back = self.pose * [0.0, 0.0, 0.0, 1.0, -1.0]
        linear = in_world(back, self.acceleration[..., None] * offset[:3])
        inward = (self.speed * offset[3])[..., None] ** 2
        sideways = (self.acceleration * offset[3])[..., None]
        spin = [-inward * x - sideways * y, sideways * x - inward * y, 0.0 * inward * x]
        return np.asarray(linear[..., None, :] + np.stack(spin, axis=-1))


PROBE = 2e-3
"""[s] Step of finite differences of the fourth order: they err by 1e-9 m/s² in such motions."""

STENCIL = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
FIRST = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0
SECOND = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0

LONGEST = 0.5
"""[s] Longest piece while the load turns or tensions change."""

STEADY = 2.5
"""[s] Longest piece of steady moves. Second derivatives at its ends err by some 0.01 of the rate at
which loads change before it, which moves clasps by that times the square of its duration."""


def polynomials(
    move: Move, curves: Callable[[Array], dict[str, Array]]
) -> dict[str, PiecewisePolynomial]:
    """Return a move's curves, given by name at times (…) [s], as polynomials.

    Pieces are shorter while loads change. They begin and end at rest.
    """
    breaks, parts = move.law.breaks(STEADY if move.steady else LONGEST), {}
    t = np.clip(breaks[:, None] + PROBE * STENCIL, 0.0, move.law.duration)
    for name, each in curves(t).items():
        if np.all(each == each[:1, :1]):
            parts[name] = PiecewisePolynomial.constant(breaks, each[0, 0])
            continue
        first = np.tensordot(FIRST / PROBE, each, (0, 1))
        second = np.tensordot(SECOND / PROBE**2, each, (0, 1))
        first[[0, -1]] = second[[0, -1]] = 0.0
        jets = np.stack([each[:, len(STENCIL) // 2], first, second])
        parts[name] = PiecewisePolynomial.hermite(breaks, jets[:, :-1], jets[:, 1:])
    return parts
