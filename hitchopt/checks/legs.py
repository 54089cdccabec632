"""Check ``legs``: every drone stays off its vertex."""

from __future__ import annotations

from hitchopt.checks.bounds.bodies import PART_NAMES, leg_vectors
from hitchopt.checks.bounds.rounding_margins import magnitude, position_margin
from hitchopt.checks.certificate import within
from hitchopt.checks.rule import CheckRule, Ease, Finder, Finding
from hitchopt.motion.motion import Motion
from hitchopt.motion.phases import HITCHED_STATE
from hitchopt.trajectory.distance import distance_bound
from hitchopt.trajectory.extremum import Cells, smallest


def _find(motion: Motion, limit: float) -> Finding:
    """Return the shortest leg ``|q_k - p_k|`` or ``|r_k - p_{k+1}|``; ``where`` is ``q-leg k``."""
    drones = motion.team.layout.drones_with_legs
    size = magnitude(motion)
    cells = Cells.over(
        motion.drones.breaks, [leg_vectors(motion)[:, drones]], position_margin(motion)
    )
    aim = within(limit, "min", size, 0.5)
    found = smallest(cells, distance_bound, aim)
    cable, end = divmod(int(drones[found.item]), 2)
    where = (f"{PART_NAMES[2 * end]} {cable}",)
    return Finding(max(found.worst, 0.0), found.time, where, size)


RULE = CheckRule(
    "legs",
    "m",
    "min",
    lambda motion: motion.requirements.limits.leg,
    (Finder(_find, HITCHED_STATE),),
    "use a longer cable, a smaller polygon, or a smaller limits.leg",
    ease=Ease.LENGTH,
)
