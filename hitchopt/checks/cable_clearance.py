"""Check ``cable_clearance``: drones, and the ground, stay off cables.

Taut cables are straight. A cable that hangs between its drones is a catenary. Taking off and
landing, cables lie on the ground at least in part, in between their drones: then drones keep off as
seen from above.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.bodies import (
    LAYOUTS,
    cable_parts,
    closest,
    drone_points,
    parts_listed,
)
from hitchopt.checks.bounds.cable_states import phase_parts
from hitchopt.checks.bounds.hanging_clearance import distance_to_drones, height_above_ground
from hitchopt.checks.bounds.hanging_links import foreign, plan_chords, plan_points
from hitchopt.checks.bounds.moving_bodies import Allowed
from hitchopt.checks.bounds.rounding_margins import magnitude
from hitchopt.checks.rule import CheckRule, Ease, Finder, Finding
from hitchopt.geometry.broadphase import Indices
from hitchopt.hitch.layout import Layout
from hitchopt.motion.motion import CableState, Motion
from hitchopt.motion.phases import FREE_STATES, HITCHED_STATE
from hitchopt.trajectory.extremum import Extremum

GROUND = "ground"
"""Stands for the drone in ``where``."""


def _to_taut(motion: Motion, limit: float) -> Finding:
    """Return the smallest distance of a drone to any part of a foreign cable, or to its own edge.

    ``where`` names the drone and the cable. A drone at a chain's end stands on its own edge.
    """
    parts = cable_parts(motion)
    apart = _strange(motion.team.layout, wrapped=motion.contacts is not None)
    found = closest(motion, drone_points(motion), parts, apart, limit)
    drone, body = divmod(found.item, len(parts))
    where = (motion.team.drone_names[drone], f"cable {parts.part[body] // 3}")
    return Finding(found.worst, found.time, where, magnitude(motion))


@lru_cache(maxsize=LAYOUTS)
def _strange(layout: Layout, *, wrapped: bool) -> Allowed:
    """Return which pairs of a drone and a taut cable part count."""
    listed, on_leg = parts_listed(layout, wrapped=wrapped), layout.has_leg.ravel()

    def apart(drones: Indices, bodies: Indices) -> NDArray[np.bool_]:
        part = listed[bodies]
        counted: NDArray[np.bool_] = (drones // 2 != part // 3) | ((part % 3 == 1) & on_leg[drones])
        return counted

    return apart


def _to_hanging(motion: Motion, _: float) -> Finding:
    """Return the smallest distance of a drone, or of the ground, to a hanging cable not its own.

    ``where`` names the drone (or ``ground``) and the cable. Each phase is searched on its own: a
    search stops within millimetres, so that what it finds depends on the span of time.
    """
    found = [
        search(part.motion)
        for part in phase_parts(motion)
        for search in (distance_to_drones, height_above_ground)
    ]
    return _named(motion, min(found, key=lambda extremum: extremum.worst))


def _seen_from_above(motion: Motion, limit: float) -> Finding:
    """Return the smallest level distance of a drone to the chord of a cable not its own."""
    return _named(motion, closest(motion, plan_points(motion), plan_chords(motion), foreign, limit))


def _named(motion: Motion, found: Extremum) -> Finding:
    """Return what has been found with the drone, or the ground, and the cable named."""
    drone, cable = divmod(found.item, motion.team.robots)
    where = ((*motion.team.drone_names, GROUND)[drone], f"cable {cable}")
    return Finding(found.worst, found.time, where, magnitude(motion))


RULE = CheckRule(
    "cable_clearance",
    "m",
    "min",
    lambda motion: motion.requirements.separation.cable,
    (
        Finder(_to_taut, HITCHED_STATE, exported=True),
        Finder(_seen_from_above, frozenset({CableState.GROUND}), exported=True),
        Finder(_to_hanging, FREE_STATES - {CableState.GROUND}, exported=True),
    ),
    "give the drones longer legs (a longer cable or a smaller polygon), "
    "other leg lengths, or a smaller separation.cable",
    "place the robots farther apart, use longer cables or more height, "
    "or allow a smaller separation.cable",
    Ease.LENGTH,
    far_remedy="use other leg lengths, another cable length or polygon, "
    "or a smaller separation.cable",
)
