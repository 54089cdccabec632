"""Check ``duration`` of the whole plan."""

from __future__ import annotations

from hitchopt.checks.certificate import Check
from hitchopt.motion.motion import Motion


def check(motion: Motion) -> Check | None:
    """Return the plan's duration; None where no limit is set.

    No margin: it is one difference of two stored numbers.
    """
    if motion.requirements.limits.duration is None:
        return None
    end = float(motion.drones.breaks[-1])
    limit = motion.requirements.limits.duration
    return Check.of("duration", motion.duration, limit, "max", "s", end, ())
