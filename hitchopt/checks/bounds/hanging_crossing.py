"""Check ``crossing`` while there is no hitch: hanging cables keep off each other.

As seen from above, where cables are straight lines: in space they are no closer. Neighbours that
are being clasped, or let go, are free to touch.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.free_phases import PhasePart, free_phases
from hitchopt.checks.bounds.hanging_links import plan_chords
from hitchopt.checks.bounds.proximity import smallest_distance
from hitchopt.checks.bounds.rounding_margins import magnitude, position_margin
from hitchopt.checks.certificate import Check, most_pressing, within
from hitchopt.geometry.broadphase import Indices
from hitchopt.hitch.layout import Layout
from hitchopt.motion.motion import Motion


def check(motion: Motion) -> Check | None:
    """Return the smallest distance of two hanging cables from above; ``where`` names both.

    Parameters
    ----------
    motion: a span of time without a hitch.
    """
    return most_pressing([_of_phase(part) for part in free_phases(motion)])


def neighbours(layout: Layout, i: Indices, j: Indices) -> NDArray[np.bool_]:
    """Return which cables share a clasp."""
    n = layout.robots
    apart = (j - i) % n
    ring: NDArray[np.bool_] = (apart == 1) | (apart == n - 1)
    return ring if layout.closed else np.abs(j - i) == 1


def _of_phase(part: PhasePart) -> Check:
    motion = part.motion
    n, layout = motion.team.robots, motion.team.layout

    def counted(i: Indices, j: Indices) -> NDArray[np.bool_]:
        if not part.clasping:
            return np.ones(np.shape(i), dtype=np.bool_)
        return ~neighbours(layout, i, j)

    limit, size = motion.requirements.separation.crossing, magnitude(motion)
    found = smallest_distance(
        motion.drones.breaks,
        plan_chords(motion),
        None,
        counted,
        position_margin(motion),
        within(limit, "min", size, 0.5),
    )
    pair = sorted(divmod(found.item, n)) if found.item >= 0 else []
    where = tuple(f"cable {k}" for k in pair)
    return Check.of("crossing", found.worst, limit, "min", "m", found.time, where, size)
