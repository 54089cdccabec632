"""A way from one hitch to another, as knots: what the optimiser moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from hitchopt.hitch import Hitch, Team
from hitchopt.planners.path.shape_path import LegLaw, ShapePath, legs_along, polygons_along
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

SPLINE_DEGREE = 5
"""Smooth up to the snap, so that pieces of a trajectory need not meet the knots."""


@dataclass(frozen=True, eq=False)
class Way:
    """A hitch at J + 1 knots, evenly spaced in the path's parameter.

    Attributes
    ----------
    name: of the guess that it came from.
    team: whose cables.
    altitude: of the hitch's plane [m].
    polygons: (J + 1, n, 2) [m]
    q_legs: (J + 1, n) [m]
    tensions: (J + 1, n) [N]
    """

    name: str
    team: Team
    altitude: float
    polygons: Array
    q_legs: Array
    tensions: Array

    @classmethod
    def through(cls, name: str, start: Hitch, end: Hitch, polygons: Array) -> Way:
        """Return the way through polygons (J + 1, n, 2) on which fractions change evenly."""
        s = np.linspace(0.0, 1.0, len(polygons))[:, None]
        fractions = start.fractions + s * (end.fractions - start.fractions)
        edges = np.linalg.norm(np.roll(polygons, -1, axis=1) - polygons, axis=-1)
        q_legs = fractions * (start.team.cable_length - edges)
        tensions = np.tile(start.team.tension, (len(polygons), 1))
        return cls(name, start.team, start.altitude, polygons, q_legs, tensions)

    @property
    def slack(self) -> Array:
        """(J + 1, n) [m]: what each cable has left for its two legs."""
        edges = np.roll(self.polygons, -1, axis=1) - self.polygons
        slack: Array = self.team.cable_length - np.linalg.norm(edges, axis=-1)
        return slack

    def path(self) -> ShapePath:
        """Return the smooth path through the knots."""
        level = np.full((*self.polygons.shape[:2], 1), self.altitude)
        steady = np.all(self.tensions == self.tensions[0])
        return ShapePath(
            self.team,
            knot_spline(np.concatenate([self.polygons, level], axis=-1)),
            LegLaw.of_fractions(knot_spline(self.q_legs / self.slack)),
            None if steady else knot_spline(self.tensions),
        )

    def resampled(self, count: int) -> Way:
        """Return the same way at ``count`` knots, read off its path."""
        return self.at(np.linspace(0.0, 1.0, count))

    def at(self, s: Array) -> Way:
        """Return the hitches at s (K,) of its path, as if they were knots."""
        path = self.path()
        return Way(
            self.name,
            self.team,
            self.altitude,
            polygons_along(path, s),
            legs_along(path, s)[..., 0],
            path.flat(s).tensions[..., 0],
        )


def knot_spline(values: Array) -> PiecewisePolynomial:
    """Return the spline through values (J + 1, *shape) at evenly spaced s in [0, 1]."""
    s = np.linspace(0.0, 1.0, len(values))
    return PiecewisePolynomial.from_spline(make_interp_spline(s, values, k=SPLINE_DEGREE))
