"""Check ``crossing``: cable parts that share no clasp stay apart.

Hanging cables keep off each other as seen from above, where they are straight lines: in space they
are no closer. Neighbours that are being clasped, or let go, are free to touch.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.bodies import (
    LAYOUTS,
    cable_parts,
    clasped_pairs,
    closest,
    pair_of,
    part_name,
    part_points,
    parts_listed,
)
from hitchopt.checks.bounds.hanging_links import plan_chords
from hitchopt.checks.bounds.moving_bodies import Allowed, Bodies, every_pair
from hitchopt.checks.bounds.rounding_margins import magnitude
from hitchopt.checks.rule import CheckRule, Finder, Finding
from hitchopt.geometry.broadphase import Indices
from hitchopt.hitch.layout import Layout
from hitchopt.motion.motion import CableState, Motion
from hitchopt.motion.phases import HITCHED_STATE


def _taut(motion: Motion, limit: float) -> Finding:
    """Return the smallest distance of two parts that share no clasp; ``where`` names both.

    The two legs of one cable count among them: they cross where both pass a star tip. All parts of
    a chain of two cables share its one clasp: nothing is counted then.
    """
    bodies = cable_parts(motion)
    apart = _unclasped(motion.team.layout, wrapped=motion.contacts is not None)
    return _closest(motion, bodies, apart, limit, lambda body: part_name(int(bodies.part[body])))


@lru_cache(maxsize=LAYOUTS)
def _unclasped(layout: Layout, *, wrapped: bool) -> Allowed:
    """Return which pairs of cable parts share no clasp."""
    part = parts_listed(layout, wrapped=wrapped)

    def apart(i: Indices, j: Indices) -> NDArray[np.bool_]:
        first_i, last_i = part_points(part[i], layout)
        first_j, last_j = part_points(part[j], layout)
        shared: NDArray[np.bool_] = (
            (first_i == first_j) | (first_i == last_j) | (last_i == first_j) | (last_i == last_j)
        )
        return ~shared

    return apart


def _hanging(motion: Motion, limit: float) -> Finding:
    """Return the smallest distance of two cables from above; ``where`` names both."""
    return _closest(motion, plan_chords(motion), every_pair, limit, _cable_name)


def _clasped(motion: Motion, limit: float) -> Finding:
    """Return the same of cables that share no clasp."""
    apart = _strangers(motion.team.layout)
    return _closest(motion, plan_chords(motion), apart, limit, _cable_name)


@lru_cache(maxsize=LAYOUTS)
def _strangers(layout: Layout) -> Allowed:
    """Return which pairs of cables share no clasp."""

    def apart(i: Indices, j: Indices) -> NDArray[np.bool_]:
        return ~np.isin(pair_of(layout, i, j), clasped_pairs(layout))

    return apart


def _cable_name(cable: int) -> str:
    return f"cable {cable}"


def _closest(
    motion: Motion, bodies: Bodies, allowed: Allowed, limit: float, name: Callable[[int], str]
) -> Finding:
    found = closest(motion, bodies, None, allowed, limit)
    where = tuple(name(i) for i in sorted(divmod(found.item, len(bodies))))
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
