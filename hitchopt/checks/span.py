"""Check ``span``: the drones of a free cable stay closer together than it is long."""

from __future__ import annotations

import numpy as np

from hitchopt.checks.bounds.rates import norm_bound
from hitchopt.checks.bounds.rounding_margins import magnitude, position_margin
from hitchopt.checks.certificate import within
from hitchopt.checks.rule import CheckRule, Ease, Finder, Finding
from hitchopt.motion.motion import Motion
from hitchopt.motion.phases import FREE_STATES
from hitchopt.trajectory.extremum import Cells, largest

LIMIT = 1.0
"""A cable that is longer than this hangs; a shorter one would be torn."""


def _find(motion: Motion, limit: float) -> Finding:
    """Return the largest distance of a cable's drones over its length; ``where`` names it."""
    drones, length = motion.drones.coefficients, motion.team.cable_length
    chords = (drones[:, 1::2] - drones[:, 0::2]) / length[:, None, None]
    margin = 2.0 * position_margin(motion) / float(np.min(length))
    size = magnitude(motion) / float(np.min(length))
    aim = within(limit, "max", size, 0.5)
    found = largest(Cells.over(motion.drones.breaks, [chords], margin), norm_bound, aim)
    return Finding(found.worst, found.time, (f"cable {found.item}",), size)


RULE = CheckRule(
    "span",
    "1",
    "max",
    LIMIT,
    (Finder(_find, FREE_STATES, exported=True),),
    "use a longer cable, a smaller polygon, or place the drones closer together",
    ease=Ease.LENGTH,
)
