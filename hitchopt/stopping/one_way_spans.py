"""Where legs lean against the friction of cables that slide, so that a plan flies forward only."""

from __future__ import annotations

import numpy as np

from hitchopt.errors import InfeasibleError
from hitchopt.motion.motion import Motion
from hitchopt.values import Array

ALIKE = 1e-9
"""[N] Legs that pull with tensions of a smaller difference do not lean."""


def leaning_pieces(motion: Motion) -> Array:
    """Return the begins and ends (m, 2) [s] of the pieces on which a leg leans."""
    if motion.leg_tensions is None:
        return np.zeros((0, 2))
    pulls = motion.pulls.coefficients
    apart = np.ptp(pulls.reshape(len(pulls), motion.team.robots, -1), axis=-1)
    leaning = np.max(apart, axis=-1) > ALIKE
    breaks = motion.drones.breaks
    found: Array = np.stack([breaks[:-1], breaks[1:]], axis=-1)[leaning]
    return found


def earliest_return(motion: Motion, time: float) -> float:
    """Return the earliest plan time [s] from which the plan may be flown backward to.

    Raises
    ------
    InfeasibleError: legs lean at ``time`` itself.
    """
    pieces = leaning_pieces(motion)
    before = pieces[pieces[:, 0] < time]
    if not len(before):
        return float(motion.drones.breaks[0])
    if before[-1, 1] > time:
        words = "legs lean against friction as cables slide, which they would the other way"
        remedy = "let the plan run on until they do not, or plan without team.cable_friction"
        raise InfeasibleError([], f"going back at t = {time:.4g} s: {words}; {remedy}")
    return float(before[-1, 1])
