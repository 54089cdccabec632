"""Check ``crossing``: taut cable parts that share no clasp stay apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.bodies import cable_parts, part_name, part_points
from hitchopt.checks.bounds.proximity import smallest_distance
from hitchopt.checks.bounds.rounding_margins import magnitude, position_margin
from hitchopt.checks.certificate import Check, within
from hitchopt.geometry.broadphase import Indices
from hitchopt.motion.motion import Motion


def check(motion: Motion) -> Check:
    """Return the smallest distance of two parts that share no clasp; ``where`` names both.

    The two legs of one cable count among them: they cross where both pass a star tip. All parts of
    a chain of two cables share its one clasp: ``where`` is empty then.
    """
    parts, layout = cable_parts(motion), motion.team.layout

    def apart(i: Indices, j: Indices) -> NDArray[np.bool_]:
        first_i, last_i = part_points(layout.parts[i], layout)
        first_j, last_j = part_points(layout.parts[j], layout)
        shared: NDArray[np.bool_] = (
            (first_i == first_j) | (first_i == last_j) | (last_i == first_j) | (last_i == last_j)
        )
        return ~shared

    limit, size = motion.requirements.separation.crossing, magnitude(motion)
    aim = within(limit, "min", size, 0.5)
    margin = position_margin(motion)
    found = smallest_distance(motion.drones.breaks, parts, None, apart, margin, aim)
    pair = sorted(divmod(found.item, len(parts))) if found.item >= 0 else []
    where = tuple(part_name(int(layout.parts[i])) for i in pair)
    return Check.of("crossing", found.worst, limit, "min", "m", found.time, where, size)
