"""Steps whose cables slide against friction: the planned motion with legs that lean."""

from __future__ import annotations

import math
from dataclasses import replace

from hitchopt.motion.motion import Motion
from hitchopt.steps.certified_motions import certified
from hitchopt.steps.situation import StepPlan

SHARES = (1.0, 0.8, 0.65, 0.5, 0.4, 0.3, 0.25)
"""Shares of the friction to lean against, tried in turn until every limit is satisfied."""

REFUSED = 0.5
"""Factor of a share that breaks a limit to the next one tried: certificates take time."""

NO_ROOM = "legs do not lean against friction: limits leave no room for it"

LONGER = 1.5
"""Most times as long as without friction that a step may last for legs to lean so far."""


def against_friction(planned: StepPlan, *, timed: bool) -> StepPlan:
    """Return the plan with legs that lean against friction as far as limits allow.

    It is the given one where the team's cables have no friction or none of them slides, and where
    limits leave no room for leaning, which its remarks then say. The motion may take up to LONGER
    times as long for it, unless its time is given or the whole plan's is limited.

    Parameters
    ----------
    planned: from rest to rest, of a hitch.
    timed: whether the step's own time is given.
    """
    motion, limits = planned.motion, planned.motion.requirements.limits
    if motion.team.cable_friction == 0.0:
        return planned
    from hitchopt.planners.friction.leaning import leaning, worth_leaning

    if not worth_leaning(motion):
        return planned
    slower = not timed and limits.duration is None
    most = 1.0
    for share in SHARES:
        if share > most:
            continue
        found = leaning(motion, limits, share, slower=slower)
        if found is None or found.motion.duration > LONGER * motion.duration:
            continue
        words = f"legs lean against friction, by up to {math.degrees(found.turned):.2g}°"
        if share < 1.0:
            words += f" ({share:.0%} of what would do: limits leave room for no more)"
        judged = certified(remarked(found.motion, words))
        if judged.certificate.certified:
            return replace(planned, motion=judged.motion, certificate=judged.certificate)
        most = REFUSED * share
    return replace(planned, motion=remarked(motion, NO_ROOM))


def remarked(motion: Motion, words: str) -> Motion:
    """Return the same motion, the remarks of its phases with these words at their end."""
    phases = tuple(
        replace(phase, remark=f"{phase.remark}; {words}" if phase.remark else words)
        for phase in motion.phases
    )
    return replace(motion, phases=phases)
