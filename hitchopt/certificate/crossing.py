"""Check ``crossing``: taut cable parts that share no clasp stay apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.certificate.bodies import cable_parts, part_clasps, part_name
from hitchopt.certificate.broadphase import Indices
from hitchopt.certificate.proximity import smallest_distance
from hitchopt.certificate.report import Check
from hitchopt.certificate.rounding import position_margin
from hitchopt.model.motion import Motion


def check(motion: Motion) -> Check:
    """Return the smallest distance of two parts that share no clasp; ``where`` names both.

    The two legs of one cable count among them: they cross where both pass a star tip.
    """
    parts = cable_parts(motion)
    n = motion.team.robots

    def apart(i: Indices, j: Indices) -> NDArray[np.bool_]:
        first_i, last_i = part_clasps(i, n)
        first_j, last_j = part_clasps(j, n)
        shared: NDArray[np.bool_] = (
            (first_i == first_j) | (first_i == last_j) | (last_i == first_j) | (last_i == last_j)
        )
        return ~shared

    found = smallest_distance(motion.drones.breaks, parts, None, apart, position_margin(motion))
    where = tuple(part_name(part) for part in sorted(divmod(found.item, len(parts))))
    limit = motion.separation.crossing
    return Check.of("crossing", found.worst, limit, "min", "m", found.time, where)
