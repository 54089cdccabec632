"""Morph: one hitch to another along straight vertex paths."""

from __future__ import annotations

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


def straight_morph(
    start: Hitch,
    end: Hitch,
    requirements: Requirements,
    duration: float | None = None,
) -> Flight | None:
    """Return the flight from one hitch to another, or None where they are the same.

    Vertices go straight and legs change so that distances hold on the path. Whether all limits
    hold for all t is for the certificate to say.

    Raises
    ------
    InfeasibleError: the polygon loses its convexity, a leg or the thrust at rest gives out on the
        path, or ``duration`` [s] is too short.
    TimingError, WarpError: no timing was found.
    """
    if np.max(np.abs(end.drones - start.drones)) < STILL:
        return None
    path = ShapePath.straight(start, end)
    check_shapes(path)
    path = with_legs_clear(path, requirements)
    check_loads(path, requirements.limits)
    return fly(path, requirements.limits, duration)
