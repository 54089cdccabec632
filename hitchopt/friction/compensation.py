"""Compensation of friction at the clasps: legs that lean against it."""

from __future__ import annotations

import math
from dataclasses import replace

from hitchopt.friction.leaning import feedforward_matters, friction_feedforward
from hitchopt.planners.finishing import Finished
from hitchopt.planners.task import StepPlan

FRICTION_SHARES = (1.0, 0.8, 0.65, 0.5, 0.4, 0.3, 0.25)
"""Fractions of the friction that feed-forward compensates; the first certified one is used."""

MAX_SLOWDOWN = 1.5  # Maximum ratio of a step's duration with friction feed-forward to that without

NOT_COMPENSATED = "clasp friction is not compensated: limits bind"


def compensated(plan: StepPlan, *, timed: bool) -> Finished:
    """Return the plan in which legs lean against friction, as far as limits allow.

    Its share is the fraction of the friction that is compensated. Unless its duration is prescribed
    (``timed``) or limited, MAX_SLOWDOWN bounds the slowdown.
    """
    motion = plan.motion
    if motion.team.friction == 0.0:
        return Finished(plan, 1.0)
    if not feedforward_matters(motion):
        return Finished(plan, 1.0)
    slower = not timed and motion.requirements.limits.duration is None
    for share in FRICTION_SHARES:
        feedforward = friction_feedforward(motion, share, slower=slower)
        if feedforward is None or feedforward.motion.duration > MAX_SLOWDOWN * motion.duration:
            continue
        remark = f"legs lean against friction, by up to {math.degrees(feedforward.lean):.2g}°"
        if share < 1.0:
            remark += f" ({share:.0%} of the friction: limits bind)"
        leaning = replace(plan, motion=feedforward.motion).with_remark(remark)
        if leaning.certificate.certified:
            return Finished(leaning, share)
    return Finished(plan.with_remark(NOT_COMPENSATED), 0.0)
