"""Check ``jerk`` of the drones."""

from __future__ import annotations

from hitchopt.certificate.rates import largest_rate
from hitchopt.certificate.report import Check
from hitchopt.model.motion import Motion


def check(motion: Motion) -> Check:
    """Return the largest jerk of any drone, which ``where`` names."""
    found = largest_rate(motion.drones, 3)
    where = (motion.team.drone_names[found.item],)
    limit = motion.requirements.limits.jerk
    return Check.of("jerk", found.worst, limit, "max", "m/s³", found.time, where)
