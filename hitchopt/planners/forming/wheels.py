"""Robots whose two drones are gathered across a small circle, carried and turned as one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hitchopt.hitch import Team
from hitchopt.planners.forming.clock import accelerations, flown
from hitchopt.planners.forming.straight import PAUSE
from hitchopt.planners.timing.ramps import fastest_clock
from hitchopt.requirements import Limits
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

LEAST_TURN = 1e-6
"""[rad] Smallest angle that is turned."""

PIECE = 0.3
"""[rad] Largest angle on one polynomial."""


@dataclass(frozen=True, eq=False)
class Wheels:
    """Pairs of drones across circles.

    Attributes
    ----------
    centres, goals: (n, 3) [m]: the middles of the pairs at the start and at the end.
    radius: of all circles [m].
    headings: (n,) [rad]: from q to r seen from above, at the start.
    angles: (n,) [rad]: angle by which each turns until the end, in the shorter direction.
    """

    centres: Array
    goals: Array
    radius: float
    headings: Array
    angles: Array

    @classmethod
    def between(cls, start: Array, goal: Array, radius: float) -> Wheels:
        """Return the wheels that pairs (2n, 3) [m] become between two places."""
        first, last = (places[1::2] - places[0::2] for places in (start, goal))
        headings = np.arctan2(first[:, 1], first[:, 0])
        angles = np.arctan2(last[:, 1], last[:, 0]) - headings
        angles = (angles + math.pi) % (2.0 * math.pi) - math.pi
        middles = [0.5 * (places[1::2] + places[0::2]) for places in (start, goal)]
        return cls(middles[0], middles[1], radius, headings, angles)

    def arms(self, turned_by: Array, order: int = 0) -> Array:
        """Return the vector from the centre to r (…, n, 3) [m], or its derivative by the angle."""
        angle = self.headings + turned_by + 0.5 * math.pi * order
        zero = np.zeros_like(angle)
        return self.radius * np.stack([np.cos(angle), np.sin(angle), zero], axis=-1)

    def drones(self, centres: Array, turned_by: Array) -> Array:
        """Return the drones (2n, 3) [m] about ``centres`` (n, 3), turned by (n,) [rad]."""
        return _pairs(centres, self.arms(turned_by))

    def carried(self, centres: PiecewisePolynomial) -> PiecewisePolynomial:
        """Return the drones (2n, 3) [m] about moving centres (n, 3), turned to the end."""
        c = np.moveaxis(centres.coefficients, -1, 1)
        pairs = np.moveaxis(_pairs(c, self.arms(self.angles)), 1, -1)
        return PiecewisePolynomial(centres.breaks, pairs)


def turned(team: Team, wheels: Wheels, limits: Limits) -> PiecewisePolynomial:
    """Return the drones (2n, 3) [m] of wheels that turn in place, all on one clock."""
    largest = float(np.max(np.abs(wheels.angles)))
    start = wheels.drones(wheels.centres, np.zeros(team.robots))
    if largest < LEAST_TURN:
        return PiecewisePolynomial.constant([0.0, PAUSE], start)
    share = wheels.angles / largest
    reserve = float(np.min(accelerations(team, limits, start[None])))
    size = wheels.radius

    def curve(angle: Array, order: int) -> Array:
        arms = wheels.arms(angle[:, None] * share, order) * (share**order)[:, None]
        middle = wheels.centres if order == 0 else np.zeros_like(wheels.centres)
        return _pairs(middle, arms)

    speed = min(limits.speed / size, math.sqrt(0.5 * reserve / size))
    clock = fastest_clock(largest, speed, 0.8 * reserve / size, 0.7 * limits.jerk / size)
    return flown(curve, clock, PIECE, limits, reserve)


def _pairs(centres: Array, arms: Array) -> Array:
    """Return the drones (…, 2n, 3) on both sides of centres (…, n, 3), r along the arms."""
    pairs = np.stack([centres - arms, centres + arms], axis=-2)
    return pairs.reshape(*pairs.shape[:-3], -1, 3)
