"""Check ``separation``: no two drones' ellipsoids meet."""

from __future__ import annotations

import numpy as np

from hitchopt.checks.bounds.bodies import drone_points
from hitchopt.checks.bounds.moving_bodies import Bodies, every_pair
from hitchopt.checks.bounds.proximity import smallest_distance
from hitchopt.checks.bounds.rounding_margins import ROUNDING, magnitude
from hitchopt.checks.certificate import within
from hitchopt.checks.rule import CheckRule, Ease, Finder, Finding
from hitchopt.motion.motion import Motion


def _find(motion: Motion, limit: float) -> Finding:
    """Return the smallest ratio over all pairs of drones; ``where`` names the two.

    Where every axis is scaled by ``Separation.scale`` the ratio is a distance.
    """
    names, scale = motion.team.drone_names, motion.requirements.separation.scale
    drones = Bodies(drone_points(motion).corners * scale[:, None])
    size = magnitude(motion) * float(np.max(scale))
    found = smallest_distance(
        motion.drones.breaks,
        drones,
        None,
        every_pair,
        ROUNDING * size,
        within(limit, "min", size, 0.5),
    )
    where = tuple(names[i] for i in sorted(divmod(found.item, len(names))))
    return Finding(found.worst, found.time, where, size)


RULE = CheckRule(
    "separation",
    "ratio",
    "min",
    lambda motion: 1.0 if motion.team.drones > 1 else None,
    (Finder(_find, exported=True),),
    "give the drones longer legs (a longer cable or a smaller polygon), "
    "other leg lengths, or a smaller separation.radius",
    "place the drones farther apart, use longer cables or a larger polygon, "
    "or allow a smaller separation.radius",
    Ease.LENGTH,
    far_remedy="use other leg lengths, another cable length or polygon, "
    "or a smaller separation.radius",
)
