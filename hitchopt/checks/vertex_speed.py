"""Check ``vertex_speed``: the hitch changes slowly enough to stay quasi-static."""

from __future__ import annotations

from hitchopt.checks.bounds.rates import largest_rate
from hitchopt.checks.certificate import Check
from hitchopt.motion.motion import Motion


def check(motion: Motion) -> Check:
    """Return the largest speed of any vertex, which ``where`` names (such as ``p1``)."""
    limit = motion.requirements.limits.vertex_speed
    found = largest_rate(motion.vertices, 1, limit)
    where = (motion.team.point_names[found.item],)
    return Check.of("vertex_speed", found.worst, limit, "max", "m/s", found.time, where, 0.0)
