"""Paths and clocks between nearly the same hitches as those of an earlier motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.geometry.vectors import length
from hitchopt.hitch import Hitch
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import fitted_hitch
from hitchopt.planners.path import LegLaw, Path
from hitchopt.planners.sampling import EvenSamples
from hitchopt.planners.timing.clock import Clock
from hitchopt.planners.timing.stretch import needed_stretch
from hitchopt.planners.timing.swing import calm_stretch
from hitchopt.planners.timing.timed_motion import (
    MAX_CABLE_ERROR,
    MIN_DURATION,
    cable_error,
    in_duration,
    motion_by,
)
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

KNOTS = 33  # Number of shapes of the earlier motion through which a path passes
TIMES = 513  # Number of times at which the earlier motion is sampled to space its shapes evenly

STRAIGHT_TOLERANCE = 1e-9
"""Largest distance of vertices from straight lines, flown together, over the longest of them."""

MAX_STRETCH = 1.25
"""Largest factor by which the clock of an earlier motion is stretched or shortened."""


def straight_progress(motion: Motion) -> PiecewisePolynomial | None:
    """Return the share of the way over time if all vertices fly straight in one phase, else None.

    It is a scalar, the same for all vertices.
    """
    places = motion.vertices.reshaped(-1).coefficients
    first = places[0, :, 0]
    way = places[-1, :, -1] - first
    longest = float(np.max(np.abs(way)))
    if len(motion.phases) != 1 or longest == 0.0:
        return None
    moved = places - first[:, None]
    share = way @ moved / (way @ way)
    aside = moved - way[:, None] * share[:, None]
    if np.max(np.abs(aside)) > STRAIGHT_TOLERANCE * longest:
        return None
    breaks = motion.vertices.breaks
    return motion.vertices.replaced(share, breaks - breaks[0])


def motion_by_earlier_clock(
    path: Path, progress: PiecewisePolynomial, requirements: Requirements
) -> Motion | None:
    """Return the motion along a path by an earlier clock, stretched or shortened to its limits.

    ``progress`` is s over time. None if the clock does not suit the path.
    """
    evenly = PiecewisePolynomial.constant(progress.breaks, 1.0)
    motion = motion_by(path, requirements, Clock(progress.breaks, progress, evenly))
    stretch = calm_stretch(motion, needed_stretch(motion))
    is_near = MAX_STRETCH * min(stretch, 1.0 / stretch) >= 1.0
    if not is_near or cable_error(motion) > MAX_CABLE_ERROR:
        return None
    return in_duration(motion, max(stretch * motion.duration, MIN_DURATION))


@dataclass(frozen=True, eq=False)
class EarlierRoute:
    """Shapes of an earlier motion, evenly spaced along the way of its drones."""

    vertices: Array  # (J, points, 3) [m]
    fractions: Array  # (J, n), slack splits of the cables
    roll: Array  # (J, clasps) [rad]

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
