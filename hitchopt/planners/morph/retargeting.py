"""Paths between nearly the same hitches as those of an earlier motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.geometry.vectors import length
from hitchopt.hitch import Hitch
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import fitted_hitch
from hitchopt.planners.path import EvenSamples, LegLaw, Path
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

KNOTS = 33
"""Number of shapes of the earlier motion through which a path passes."""

TIMES = 513
"""Number of times at which the earlier motion is sampled to space its shapes evenly."""


@dataclass(frozen=True, eq=False)
class EarlierRoute:
    """Shapes of an earlier motion, evenly spaced along the way of its drones."""

    vertices: Array
    """(J, points, 3) [m]"""

    fractions: Array
    """(J, n), slack splits of the cables"""

    roll: Array
    """(J, clasps) [rad]"""

    @classmethod
    def of(cls, motion: Motion) -> EarlierRoute:
        """Return the shapes of the motion of a hitch."""
        breaks = motion.drones.breaks
        t = np.linspace(breaks[0], breaks[-1], TIMES)
        steps = np.max(length(np.diff(motion.drones.at(t), axis=0)), axis=-1)
        way = np.concatenate([[0.0], np.cumsum(steps)])
        t = np.interp(np.linspace(0.0, way[-1], KNOTS), way, t)
        curves = motion.drones.at(t), motion.vertices.at(t), motion.legs.at(t)
        hitches = [fitted_hitch(motion.team, *each) for each in zip(*curves, strict=True)]
        return cls(
            curves[1],
            np.array([hitch.fractions for hitch in hitches]),
            np.array([hitch.roll for hitch in hitches]),
        )

    def path(self, start: Hitch, end: Hitch) -> Path:
        """Return the path of these shapes, moved to other ends by what changes evenly."""

        def moved(values: Array, first: Array, last: Array) -> PiecewisePolynomial:
            """Return the spline through values (J, …) with other ends."""
            share = np.linspace(0.0, 1.0, KNOTS).reshape(-1, *(1,) * first.ndim)
            changed = values + (1.0 - share) * (first - values[0]) + share * (last - values[-1])
            return EvenSamples(changed, smooth=False, at_rest=False).spline

        fractions = moved(self.fractions, start.fractions, end.fractions)
        has_roll = np.any(self.roll) or np.any(start.roll) or np.any(end.roll)
        return Path(
            start.team,
            moved(self.vertices, start.vertices, end.vertices),
            LegLaw.of_fractions(fractions),
            roll=moved(self.roll, start.roll, end.roll) if has_roll else None,
        )
