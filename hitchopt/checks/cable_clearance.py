"""Check ``cable_clearance``: drones stay off cables."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.bodies import cable_parts, drone_points
from hitchopt.checks.bounds.proximity import smallest_distance
from hitchopt.checks.bounds.rounding_margins import magnitude, position_margin
from hitchopt.checks.certificate import Check, within
from hitchopt.geometry.broadphase import Indices
from hitchopt.motion.motion import Motion


def check(motion: Motion) -> Check:
    """Return the smallest distance of a drone to any part of a foreign cable, or to its own edge.

    ``where`` names the drone and the cable. A drone at a chain's end stands on its own edge.
    """
    parts, layout = cable_parts(motion), motion.team.layout
    on_leg = layout.has_leg.ravel()

    def foreign(drones: Indices, bodies: Indices) -> NDArray[np.bool_]:
        part = layout.parts[bodies]
        apart: NDArray[np.bool_] = (drones // 2 != part // 3) | ((part % 3 == 1) & on_leg[drones])
        return apart

    limit, size = motion.requirements.separation.cable, magnitude(motion)
    found = smallest_distance(
        motion.drones.breaks,
        drone_points(motion),
        parts,
        foreign,
        position_margin(motion),
        within(limit, "min", size, 0.5),
    )
    drone, body = divmod(found.item, len(parts))
    where = (motion.team.drone_names[drone], f"cable {layout.parts[body] // 3}")
    return Check.of("cable_clearance", found.worst, limit, "min", "m", found.time, where, size)
