"""Check ``body_rate``: no drone has to turn its thrust faster than allowed.

It is the angular velocity of the body about its axes x and y that the plan asks for; turning about
the thrust itself is left to the yaw.
"""

from __future__ import annotations

import math

from hitchopt.checks.bounds.thrust_turning import turning_bound, turning_cells
from hitchopt.checks.certificate import within
from hitchopt.checks.rule import CheckRule, Ease, Finder, Finding
from hitchopt.motion.motion import Motion
from hitchopt.trajectory.extremum import largest


def _find(motion: Motion, limit: float) -> Finding:
    """Return the largest turning rate of any drone's thrust vector, in degrees per second."""
    aim = within(math.radians(limit), "max", 0.0, 0.5)
    found = largest(turning_cells(motion), turning_bound(motion), aim)
    return Finding(math.degrees(found.worst), found.time, (motion.team.drone_names[found.item],))


def _limit(motion: Motion) -> float | None:
    rate = motion.requirements.limits.body_rate
    return None if rate is None else math.degrees(rate)


RULE = CheckRule(
    "body_rate",
    "deg/s",
    "max",
    _limit,
    (Finder(_find),),
    "raise limits.body_rate_deg",
    ease=Ease.TIME,
    derivative=3,
)
