"""Check ``acceleration`` of the drones."""

from __future__ import annotations

from hitchopt.checks.bounds.rates import largest_rate
from hitchopt.checks.certificate import Check
from hitchopt.motion.motion import Motion


def check(motion: Motion) -> Check:
    """Return the largest acceleration of any drone, which ``where`` names."""
    limit = motion.requirements.limits.acceleration
    found = largest_rate(motion.drones, 2, limit)
    where = (motion.team.drone_names[found.item],)
    return Check.of("acceleration", found.worst, limit, "max", "m/s²", found.time, where, 0.0)
