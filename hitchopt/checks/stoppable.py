"""Report ``stoppable``: how long it takes until all drones rest, from the command to stop."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from hitchopt.checks.bounds.clock_stops import StopTable, stop_table
from hitchopt.checks.bounds.quick_stops import quick_stop_table
from hitchopt.checks.rule import Finding, Findings, ReportRule
from hitchopt.motion.motion import Motion


def _find(
    motion: Motion, found: Findings, gamma: float, table: Callable[[Motion], StopTable]
) -> Finding:
    """Return the longest time [s] over all times of the command, and about when that is."""
    del found, gamma
    with np.errstate(all="ignore"):  # coefficients may be anything; nan breaks a limit
        longest, begins = table(motion).longest
    worst = int(np.argmax(longest))
    return Finding(float(longest[worst]), float(begins[worst]))


RULE = ReportRule(
    "stoppable", "s", "max", partial(_find, table=partial(stop_table, decisive=True)), whole=True
)

QUICK = ReportRule("stoppable", "s", "max", partial(_find, table=quick_stop_table), whole=True)
"""The same in a small part of the time, longer by a few per cent."""
