"""Check ``span``: the drones of a free cable stay closer together than it is long."""

from __future__ import annotations

import numpy as np

from hitchopt.checks.bounds.rates import norm_bound
from hitchopt.checks.bounds.rounding_margins import magnitude, position_margin
from hitchopt.checks.certificate import Check, within
from hitchopt.motion.motion import Motion
from hitchopt.trajectory.extremum import Cells, largest

LIMIT = 1.0
"""A cable that is longer than this hangs; a shorter one would be torn."""


def check(motion: Motion) -> Check:
    """Return the largest distance of a cable's drones over its length; ``where`` names the cable.

    Parameters
    ----------
    motion: a span of time without a hitch.
    """
    drones, length = motion.drones.coefficients, motion.team.cable_length
    chords = (drones[:, 1::2] - drones[:, 0::2]) / length[:, None, None]
    margin = -2.0 * position_margin(motion) / float(np.min(length))  # upward
    size = magnitude(motion) / float(np.min(length))
    aim = within(LIMIT, "max", size, 0.5)
    found = largest(Cells.over(motion.drones.breaks, [chords], -margin), norm_bound, aim)
    where = (f"cable {found.item}",)
    return Check.of("span", found.worst, LIMIT, "max", "1", found.time, where, size)
