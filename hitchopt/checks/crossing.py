"""Check ``crossing``: cable parts that share no clasp stay apart.

Hanging cables keep off each other as seen from above, where they are straight lines: in space they
are no closer. Neighbours that are being clasped, or let go, are free to touch.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.bodies import (
    cable_parts,
    clasped_pairs,
    closest,
    pair_of,
    part_name,
    part_points,
)
from hitchopt.checks.bounds.hanging_links import plan_chords
from hitchopt.checks.bounds.moving_bodies import Allowed, Bodies, every_pair
from hitchopt.checks.bounds.rounding_margins import magnitude
from hitchopt.checks.rule import CheckRule, Finder, Finding
from hitchopt.geometry.broadphase import Indices
from hitchopt.motion.motion import CableState, Motion
from hitchopt.motion.phases import HITCHED_STATE


def _taut(motion: Motion, limit: float) -> Finding:
    """Return the smallest distance of two parts that share no clasp; ``where`` names both.

    The two legs of one cable count among them: they cross where both pass a star tip. All parts of
    a chain of two cables share its one clasp: nothing is counted then.
    """
    layout, bodies = motion.team.layout, cable_parts(motion)

    def apart(i: Indices, j: Indices) -> NDArray[np.bool_]:
        first_i, last_i = part_points(bodies.part[i], layout)
        first_j, last_j = part_points(bodies.part[j], layout)
        shared: NDArray[np.bool_] = (
            (first_i == first_j) | (first_i == last_j) | (last_i == first_j) | (last_i == last_j)
        )
        return ~shared

    names = [part_name(int(part)) for part in bodies.part]
    return _closest(motion, bodies, apart, limit, names)


def _hanging(motion: Motion, limit: float) -> Finding:
    """Return the smallest distance of two cables from above; ``where`` names both."""
    return _closest(motion, plan_chords(motion), every_pair, limit, _cable_names(motion))


def _clasped(motion: Motion, limit: float) -> Finding:
    """Return the same of cables that share no clasp."""
    layout = motion.team.layout

    def apart(i: Indices, j: Indices) -> NDArray[np.bool_]:
        return ~np.isin(pair_of(layout, i, j), clasped_pairs(layout))

    return _closest(motion, plan_chords(motion), apart, limit, _cable_names(motion))


def _cable_names(motion: Motion) -> list[str]:
    return [f"cable {k}" for k in range(motion.team.robots)]


def _closest(
    motion: Motion, bodies: Bodies, allowed: Allowed, limit: float, names: Sequence[str]
) -> Finding:
    found = closest(motion, bodies, None, allowed, limit)
    where = tuple(names[i] for i in sorted(divmod(found.item, len(names))))
    return Finding(found.worst, found.time, where, magnitude(motion))


RULE = CheckRule(
    "crossing",
    "m",
    "min",
    lambda motion: motion.requirements.separation.crossing,
    (
        Finder(_taut, HITCHED_STATE),
        Finder(_hanging, frozenset({CableState.GROUND, CableState.FREE}), exported=True),
        Finder(_clasped, frozenset({CableState.CLASPING, CableState.TIGHTENING}), exported=True),
    ),
    "shorten the legs that meet (a shorter cable or a larger polygon), "
    "choose other leg lengths, or lower separation.crossing",
    "place the robots farther apart, or lower separation.crossing",
)
