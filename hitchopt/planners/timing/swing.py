"""Stretches in time with which a hitch keeps ``limits.swing``.

Unlike rates, a swing need not decrease as a motion becomes slower: it is small where the response
to the motion's profile has a zero. Factors are tried upward in small steps, and the first one that
holds is refined. All of them have the same rests, so that each only takes a response.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hitchopt.checks.swing import (
    LEFT_SHARE,
    SwingingHitch,
    has_inertia,
    swinging_hitches,
    worst_swing,
)
from hitchopt.errors import InfeasibleError, StepPlace, Violation, rounded_up
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion
from hitchopt.values.fields import with_fields

RATIO = 1.04  # Ratio of consecutive stretches that are tried
BISECTIONS = 6  # Bisections between the first one that holds and the one before
MAX_STRETCH = 100.0  # Largest stretch that is tried

SHARE = 0.99  # Share of the limit that planners use
LEFT_STEPS = 10  # Number of steps of the limit, in which later motions allow for the swing left


def calm_stretch(motion: Motion, smallest: float = 1.0, left_share: float = LEFT_SHARE) -> float:
    """Return the stretch in time, at least ``smallest``, with which a motion keeps its swing.

    It leaves at most ``left_share`` of the limit at its end.
    """
    limit = motion.requirements.limits.swing
    if limit is None or not has_inertia(motion) or not math.isfinite(smallest):
        return smallest
    search = CalmSearch(swinging_hitches(motion.slowed(smallest)), SHARE * limit, left_share)
    if search.is_calm(1.0):
        return smallest
    # The samples of a slower motion are farther apart: it is sampled anew
    near = smallest * search.first() / RATIO
    hitches = swinging_hitches(motion.slowed(near))
    return near * replace(search, hitches=hitches).smallest()


@dataclass(frozen=True, eq=False)
class CalmSearch:
    """The search of a stretch in time with which a swing keeps its limit."""

    hitches: Sequence[SwingingHitch]  # In each part of the motion
    largest: float  # [m] Largest distance of a vertex
    left_share: float  # Largest share of it after the motion

    def is_calm(self, stretch: float) -> bool:
        """Return whether the swing keeps its limit, and after the end leaves room for others."""
        for hitch in self.hitches:
            distances = hitch.distances(stretch)
            left = np.max(distances[hitch.moving :])
            if np.max(distances) > self.largest or left > self.left_share * self.largest:
                return False
        return True

    def first(self) -> float:
        """Return the first stretch that holds, from 1 on in steps."""
        stretch = 1.0
        while not self.is_calm(stretch) and stretch < MAX_STRETCH:
            stretch *= RATIO
        return stretch

    def smallest(self) -> float:
        """Return the first stretch that holds, refined by bisection."""
        stretch = self.first()
        too_fast = stretch / RATIO
        for _ in range(BISECTIONS if stretch > 1.0 else 0):
            middle = math.sqrt(too_fast * stretch)
            if self.is_calm(middle):
                stretch = middle
            else:
                too_fast = middle
        return stretch


def check_swing(motion: Motion, *steps: StepPlace) -> None:
    """Raise InfeasibleError if a motion with a prescribed duration breaks ``limits.swing``.

    The remedy is the shortest longer duration that keeps it.
    """
    limit = motion.requirements.limits.swing
    worst = worst_swing(motion)
    if limit is None or worst is None or worst.worst <= limit:
        return
    shortest = rounded_up(calm_stretch(motion, left_share=1.0) * motion.duration, 4)
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
