"""Check ``duration`` of the whole plan."""

from __future__ import annotations

from hitchopt.checks.rule import CheckRule, Finder, Finding
from hitchopt.motion.motion import Motion


def _find(motion: Motion, _: float) -> Finding:
    """Return the plan's duration, without a margin: the difference of two stored numbers."""
    return Finding(motion.duration, float(motion.drones.breaks[-1]))


RULE = CheckRule(
    "duration",
    "s",
    "max",
    lambda motion: motion.requirements.limits.duration,
    (Finder(_find),),
    "raise limits.duration, or the limits of motion",
    whole=True,
)
