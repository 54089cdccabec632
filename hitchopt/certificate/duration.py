"""Check ``duration`` of the whole plan."""

from __future__ import annotations

from hitchopt.certificate.report import Check
from hitchopt.model.motion import Motion

RESOLUTION = 1e-12
"""Relative: what the sum of a thousand steps' durations may be off by rounding."""


def check(motion: Motion) -> Check | None:
    """Return the plan's duration; None where no limit is set.

    No margin: it is one difference of two stored numbers. A sum of steps that exceeds the limit by
    rounding only is the limit.
    """
    if motion.requirements.limits.duration is None:
        return None
    end = float(motion.drones.breaks[-1])
    limit = motion.requirements.limits.duration
    worst = limit if abs(motion.duration - limit) < RESOLUTION * limit else motion.duration
    return Check.of("duration", worst, limit, "max", "s", end, ())
