"""Morph: one hitch to another along straight vertex paths."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hitchopt.hitch import Hitch
from hitchopt.planners.path.leg_law import with_legs_clear
from hitchopt.planners.path.path_feasibility import check_loads, check_shapes
from hitchopt.planners.path.shape_path import ShapePath
from hitchopt.planners.timing.flight_curves import Flight
from hitchopt.planners.timing.fly_path import fly
from hitchopt.requirements import Requirements

STILL = 1e-9
"""[m] Distance within which a morph moves nothing."""


@dataclass(frozen=True, eq=False)
class StraightMorph:
    """The planner of a morph on which vertices go straight.

    Legs change so that distances hold on the path. Whether all limits hold for all t is for the
    certificate to say.

    Attributes
    ----------
    start, end: the hitches before and after.
    requirements: limits and distances.
    duration: exactly that long [s]; None for as fast as the limits allow.
    """

    start: Hitch
    end: Hitch
    requirements: Requirements
    duration: float | None = None

    @cached_property
    def path(self) -> ShapePath:
        """The straight path, fractions changing evenly; raises InfeasibleError where it is shut."""
        path = ShapePath.straight(self.start, self.end)
        check_shapes(path)
        return path

    @cached_property
    def problem(self) -> ShapePath:
        """The path that is timed.

        Raises InfeasibleError where the polygon loses its convexity, or a leg or the thrust at rest
        gives out.
        """
        path = with_legs_clear(self.path, self.requirements)
        check_loads(path, self.requirements.limits)
        return path

    def solve(self) -> Flight | None:
        """Return the flight from one hitch to the other, or None where they are the same.

        Raises
        ------
        InfeasibleError: as ``problem``, or ``duration`` is too short.
        TimingError, WarpError: no timing was found.
        """
        if np.max(np.abs(self.end.drones - self.start.drones)) < STILL:
            return None
        return fly(self.problem, self.requirements.limits, self.duration)
