"""Check ``jerk`` of the drones."""

from __future__ import annotations

from hitchopt.checks.bounds.rates import largest_rate
from hitchopt.checks.certificate import Check
from hitchopt.motion.motion import Motion


def check(motion: Motion) -> Check:
    """Return the largest jerk of any drone, which ``where`` names."""
    limit = motion.requirements.limits.jerk
    found = largest_rate(motion.drones, 3, limit)
    where = (motion.team.drone_names[found.item],)
    return Check.of("jerk", found.worst, limit, "max", "m/s³", found.time, where, 0.0)
