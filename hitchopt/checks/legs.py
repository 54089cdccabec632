"""Check ``legs``: every drone keeps off its vertex."""

from __future__ import annotations

from hitchopt.checks.bounds.bodies import PART_NAMES, leg_vectors
from hitchopt.checks.bounds.rounding_margins import magnitude, position_margin
from hitchopt.checks.certificate import Check, within
from hitchopt.motion.motion import Motion
from hitchopt.trajectory.distance import distance_bound
from hitchopt.trajectory.extremum import Cells, smallest


def check(motion: Motion) -> Check:
    """Return the shortest leg ``|q_k - p_k|`` or ``|r_k - p_{k+1}|``; ``where`` is ``q-leg k``."""
    drones = motion.team.layout.drones_with_legs
    legs = leg_vectors(motion)[:, drones]
    limit, size = motion.requirements.limits.leg, magnitude(motion)
    cells = Cells.over(motion.drones.breaks, [legs], position_margin(motion))
    found = smallest(cells, distance_bound, within(limit, "min", size, 0.5))
    cable, end = divmod(int(drones[found.item]), 2)
    where = (f"{PART_NAMES[2 * end]} {cable}",)
    worst = max(found.worst, 0.0)
    return Check.of("legs", worst, limit, "min", "m", found.time, where, size)
