"""Check ``separation``: no two drones' ellipsoids meet."""

from __future__ import annotations

import numpy as np

from hitchopt.checks.bounds.bodies import drone_points
from hitchopt.checks.bounds.proximity import Bodies, smallest_distance
from hitchopt.checks.bounds.rounding_margins import ROUNDING, magnitude
from hitchopt.checks.certificate import Check, within
from hitchopt.motion.motion import Motion


def check(motion: Motion) -> Check | None:
    """Return the smallest ratio over all pairs of drones; ``where`` names the two.

    Where every axis is scaled by ``Separation.scale`` the ratio is a distance. None for one drone.
    """
    names = motion.team.drone_names
    if len(names) < 2:
        return None
    scale = motion.requirements.separation.scale
    drones = Bodies(drone_points(motion).corners * scale[:, None])
    size = magnitude(motion) * float(np.max(scale))
    aim = within(1.0, "min", size, 0.5)
    found = smallest_distance(
        motion.drones.breaks,
        drones,
        None,
        lambda i, _: np.ones(len(i), dtype=np.bool_),
        ROUNDING * size,
        aim,
    )
    where = tuple(names[i] for i in sorted(divmod(found.item, len(names))))
    return Check.of("separation", found.worst, 1.0, "min", "ratio", found.time, where, size)
