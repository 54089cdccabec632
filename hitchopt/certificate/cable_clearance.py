"""Check ``cable_clearance``: drones stay off cables."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.certificate.bodies import cable_parts, drone_points
from hitchopt.certificate.broadphase import Indices
from hitchopt.certificate.proximity import smallest_distance
from hitchopt.certificate.report import Check
from hitchopt.certificate.rounding import position_margin
from hitchopt.model.motion import Motion


def check(motion: Motion) -> Check:
    """Return the smallest distance of a drone to any part of a foreign cable, or to its own edge.

    ``where`` names the drone and the cable.
    """
    parts = cable_parts(motion)
    found = smallest_distance(
        motion.drones.breaks, drone_points(motion), parts, _foreign, position_margin(motion)
    )
    drone, part = divmod(found.item, len(parts))
    where = (motion.team.drone_names[drone], f"cable {part // 3}")
    limit = motion.separation.cable
    return Check.of("cable_clearance", found.worst, limit, "min", "m", found.time, where)


def _foreign(drones: Indices, parts: Indices) -> NDArray[np.bool_]:
    foreign: NDArray[np.bool_] = (drones // 2 != parts // 3) | (parts % 3 == 1)
    return foreign
