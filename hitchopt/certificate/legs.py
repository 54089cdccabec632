"""Check ``legs``: every drone keeps off its vertex."""

from __future__ import annotations

from hitchopt.certificate.bodies import PART_NAMES, leg_vectors
from hitchopt.certificate.report import Check
from hitchopt.certificate.rounding import position_margin
from hitchopt.model.motion import Motion
from hitchopt.trajectory.distance import distance_bound
from hitchopt.trajectory.extremum import Cells, smallest


def check(motion: Motion) -> Check:
    """Return the shortest leg ``|q_k - p_k|`` or ``|r_k - p_{k+1}|``; ``where`` is ``q-leg k``."""
    cells = Cells.over(motion.drones.breaks, [leg_vectors(motion)], position_margin(motion))
    found = smallest(cells, distance_bound)
    where = (f"{PART_NAMES[2 * (found.item % 2)]} {found.item // 2}",)
    worst = max(found.worst, 0.0)
    return Check.of("legs", worst, motion.limits.leg, "min", "m", found.time, where)
