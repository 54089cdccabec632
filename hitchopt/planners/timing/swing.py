"""Stretches in time with which a hitch keeps ``limits.swing``.

Unlike rates, a swing need not decrease as a motion becomes slower: it is small where the response
to the motion's profile has a zero. Factors are tried upward in small steps, and the first one that
holds is refined. All of them have the same rests, so that each only takes a response.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hitchopt.checks.swing import LEFT_SHARE, swinging_hitches, worst_swing
from hitchopt.errors import InfeasibleError, StepPlace, Violation, rounded_up
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion
from hitchopt.values.fields import with_fields

RATIO = 1.04  # Ratio of consecutive stretches that are tried
BISECTIONS = 3  # Bisections between the first one that holds and the one before
MAX_STRETCH = 100.0  # Largest stretch that is tried

SHARE = 0.99  # Share of the limit that planners use
LEFT_STEPS = 10  # Number of steps of the limit, in which later motions allow for the swing left


def calm_stretch(motion: Motion, smallest: float = 1.0) -> float:
    """Return the stretch in time, at least ``smallest``, with which a motion keeps its swing."""
    limit = motion.requirements.limits.swing
    hitches = [] if limit is None else swinging_hitches(motion)
    if limit is None or not hitches or not math.isfinite(smallest):
        return smallest
    largest = SHARE * limit

    def is_calm(stretch: float) -> bool:
        """Return whether the swing keeps its limit, and after the end leaves room for others."""
        for hitch in hitches:
            distances = hitch.distances(stretch)
            left = np.max(distances[hitch.moving :])
            if np.max(distances) > largest or left > LEFT_SHARE * largest:
                return False
        return True

    stretch = smallest
    while not is_calm(stretch) and stretch < MAX_STRETCH * smallest:
        stretch *= RATIO
    if stretch == smallest:
        return smallest
    too_fast = stretch / RATIO
    for _ in range(BISECTIONS):
        middle = math.sqrt(too_fast * stretch)
        if is_calm(middle):
            stretch = middle
        else:
            too_fast = middle
    while _exceeds(motion.slowed(stretch), limit) and stretch < MAX_STRETCH * smallest:
        stretch *= 2.0 - SHARE  # samples of the slow motion are closer
    return stretch


def _exceeds(motion: Motion, limit: float) -> bool:
    """Return whether the certified swing of a motion exceeds a limit [m]."""
    worst = worst_swing(motion)
    return worst is not None and worst.worst > limit


def check_swing(motion: Motion, *steps: StepPlace) -> None:
    """Raise InfeasibleError if a motion with a prescribed duration breaks ``limits.swing``.

    The remedy is the shortest longer duration that keeps it.
    """
    limit = motion.requirements.limits.swing
    worst = worst_swing(motion)
    if limit is None or worst is None or worst.worst <= limit:
        return
    shortest = rounded_up(calm_stretch(motion) * motion.duration, 4)
    remedy = f"allow {shortest:g} s, or raise limits.swing; null allows any"
    values = "swing", worst.worst, limit, "max", "m", worst.where
    when = f"at t = {worst.time - float(motion.drones.breaks[0]):.4g} s of the step"
    raise InfeasibleError([Violation(*values, when, remedy, steps)])


def after_swing(requirements: Requirements, motion: Motion) -> Requirements:
    """Return requirements that leave room for the swing that a motion leaves.

    The limit is lowered in steps, so that plans of steps hardly depend on those before.
    """
    limit = requirements.limits.swing
    hitches = [] if limit is None else swinging_hitches(motion)
    if limit is None or not hitches:
        return requirements
    left = float(np.max(hitches[-1].distances()[hitches[-1].moving :]))
    steps = min(math.ceil(LEFT_STEPS * left / limit), LEFT_STEPS - 1)
    if steps == 0:
        return requirements
    lower = with_fields(requirements.limits, swing=limit * (1.0 - steps / LEFT_STEPS))
    return replace(requirements, limits=lower)
