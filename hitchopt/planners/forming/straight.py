"""All drones straight from one place to another, on one clock."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import Team
from hitchopt.planners.forming.clock import fastest_clock
from hitchopt.planners.forming.reserve import SHARE, accelerations
from hitchopt.requirements import Limits
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

STILL = 1e-9
"""[m] Shorter ways are none."""

PAUSE = 0.01
"""[s] What a way takes that moves nothing."""

PROBES = 9
"""Of the way, where the drones' reserves are looked at."""


def straight(
    team: Team, limits: Limits, start: Array, end: Array, least: float = 0.0
) -> PiecewisePolynomial:
    """Return the drones (2n, 3) [m] on straight lines, from rest to rest at the same times.

    Parameters
    ----------
    start, end: (2n, 3) [m]
    least: timed as if the farthest drone went at least this far [m].
    """
    way = float(np.max(np.linalg.norm(end - start, axis=1)))
    if way < STILL:
        return PiecewisePolynomial.constant([0.0, PAUSE], end)
    share = np.linspace(0.0, 1.0, PROBES)[:, None, None]
    reserve = float(np.min(accelerations(team, limits, start + share * (end - start))))
    clock = fastest_clock(max(way, least), SHARE * limits.speed, reserve, SHARE * limits.jerk)
    s = clock.coefficients[:, None, None, :] / clock.coefficients[-1, -1]
    s = np.clip(s, 0.0, 1.0)  # the last digit must not lead through the floor
    curves = start[..., None] * (1.0 - s) + end[..., None] * s
    return PiecewisePolynomial(clock.breaks, curves)
