"""Compensation of friction at the clasps: legs that lean against it, and swings that remove it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

from hitchopt.checks.violations import infeasible_error
from hitchopt.motion.motion import Phase
from hitchopt.planners.rests import IDLE, rest_motion
from hitchopt.planners.task import StepPlan, StepTask

FRICTION_SHARES = (1.0, 0.8, 0.65, 0.5, 0.4, 0.3, 0.25)
"""Fractions of the friction that feed-forward compensates; the first certified one is used."""

FULL_SHARE = 0.99
"""Fraction of the friction that counts as all of it."""

MAX_SLOWDOWN = 1.5
"""Maximum ratio of a step's duration with friction feed-forward to that without."""

NOT_COMPENSATED = "clasp friction is not compensated: limits bind"


class Compensated(NamedTuple):
    """A plan in which legs lean against friction."""

    plan: StepPlan
    """The plan."""

    share: float
    """Fraction of the friction that is compensated."""


def with_friction_feedforward(plan: StepPlan, *, timed: bool) -> StepPlan:
    """Return the plan in which legs lean against friction, as far as limits allow.

    Unless its duration is prescribed (``timed``) or limited, MAX_SLOWDOWN bounds the slowdown.
    """
    return compensated(plan, timed=timed).plan


def compensated(plan: StepPlan, *, timed: bool) -> Compensated:
    """Return the plan of ``with_friction_feedforward`` and how much of the friction it covers."""
    motion = plan.motion
    if motion.team.cable_friction == 0.0:
        return Compensated(plan, 1.0)
    from hitchopt.planners.morph.friction import feedforward_matters, friction_feedforward

    if not feedforward_matters(motion):
        return Compensated(plan, 1.0)
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
            return Compensated(leaning, share)
    return Compensated(plan.with_remark(NOT_COMPENSATED), 0.0)


def settling_plan(
    task: StepTask, duration: float | None, phase: Phase, *, required: bool = True
) -> StepPlan:
    """Return the plan in which drones swing to remove friction hysteresis at the clasps.

    They swing as far as limits allow for a duration [s], by default SWINGS of SWING, or longer if
    limits need that. Raises InfeasibleError if limits bind and the swing is ``required``.
    """
    from hitchopt.planners.morph.friction import SWING, SWINGS, settling_swings
    from hitchopt.planners.timing.timed_motion import needed_stretch

    hitch = task.hitch
    requirements = task.requirements
    plan: StepPlan | None = None
    rest_duration = SWINGS * SWING if duration is None else duration
    rest = rest_motion(hitch, requirements, rest_duration, phase)
    for share in FRICTION_SHARES:
        settling = settling_swings(rest, share)
        if settling is None:
            break
        swings, swing_share = settling
        motion = swings.motion
        remark = f"drones swing by up to {math.degrees(swings.lean):.2g}°"
        factor = needed_stretch(motion)
        if factor > 1.0 and duration is None and factor <= MAX_SLOWDOWN:
            motion = motion.slowed(factor)
        if swing_share < FULL_SHARE:
            remark += f" (at least {swing_share:.0%} of the swing that suffices: legs bind)"
        plan = task.plan_ending(motion, hitch).with_remark(remark)
        if plan.certificate.certified:
            return plan
    if plan is None:
        return task.plan_ending(rest, hitch).with_remark("no leg can lean against friction")
    if required:
        raise infeasible_error(plan.certificate, plan.motion)
    unsettled = task.plan_ending(rest_motion(hitch, requirements, IDLE, phase), hitch)
    return unsettled.with_remark("friction hysteresis is not removed: limits bind")
