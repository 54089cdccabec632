"""A plan up to where a stop of its clock ends."""

from __future__ import annotations

import numpy as np

from hitchopt.checks.stops import stop_phases
from hitchopt.motion.motion import Motion
from hitchopt.motion.phases import JOINT
from hitchopt.motion.retiming import before, followed, resting, retimed


def until_stop(motion: Motion, start: float, duration: float, hold: float) -> tuple[Motion, float]:
    """Return the motion until its clock has stopped, and the plan time of its rest [s].

    Parameters
    ----------
    start, duration: of the stop [s]; no duration where the motion is at rest.
    hold: how long it stays where it would not move at all [s].
    """
    parts, rest = [before(motion, start)] if start > JOINT else [], start
    if duration > 0.0:
        clock = stop_phases(np.array([start]), np.array([duration]))
        parts.append(retimed(motion, clock))
        rest = float(clock.ends[-1, 0])
    if not parts:
        parts = [resting(motion, hold, first=True)]
    return parts[0] if len(parts) == 1 else followed(*parts), rest
