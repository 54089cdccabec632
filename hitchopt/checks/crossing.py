"""Check ``crossing``: cables and parts of cables that share no clasp keep a distance.

For hanging cables, it is the distance of their chords seen from above: in space they are no closer.
While cables are clasped or tightened, it is the distance of the regions that contain them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from hitchopt.checks.bodies import (
    PLAN_AXES,
    Bodies,
    cable_ends,
    clasped_cables,
    plan_points,
    taut_parts,
)
from hitchopt.checks.distances import Flags, Hulls, Moving, gap, nearest
from hitchopt.checks.rule import CheckRule, Evaluator
from hitchopt.checks.spans import cable_names, clasped_pairs, pair_of, phase_parts
from hitchopt.hitch.pairs import CROSSING as CROSSING_PAIR
from hitchopt.hitch.pairs import DISTANCES, TautBodies
from hitchopt.hitch.team import Layout
from hitchopt.motion.motion import Motion
from hitchopt.values import Indices


def _taut_parts(motion: Motion) -> Iterator[Moving]:
    """Yield the pairs of parts that share no clasp.

    These include the two legs of one cable, which may cross.
    """
    parts = taut_parts(motion)
    table = TautBodies.of(motion.team.layout)
    body = table.of_parts(parts.part)

    def share_no_clasp(first: Indices, second: Indices) -> Flags:
        flags: Flags = table.kind(body[first], body[second]) == CROSSING_PAIR
        return flags

    yield Moving.between(motion, parts, allowed=share_no_clasp)


def _hanging_cables(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of cables, projected from above onto their chords.

    Neighbours may touch while they are being clasped or unclasped.
    """
    for part in phase_parts(motion):
        chords = Bodies(cable_ends(plan_points(part.motion)), cable_names(motion))
        is_linked = part.phase.state.linked
        allowed = partial(_unclasped, motion.team.layout) if is_linked else None
        yield Moving.between(part.motion, chords, allowed=allowed)


def _unclasped(layout: Layout, first: Indices, second: Indices) -> Flags:
    """Return whether pairs of cables share no clasp."""
    return ~np.isin(pair_of(layout, first, second), clasped_pairs(layout))


def _clasped_cables(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of cables that share no clasp while cables are clasped or tightened."""
    if not any(state.clasped for state in motion.cable_states):
        return
    regions = clasped_cables(motion)
    corners = regions.outline
    outlines = replace(regions, corners=regions.corners[:, :, :corners] * PLAN_AXES)
    yield Moving.between(
        motion,
        outlines,
        allowed=partial(_unclasped, motion.team.layout),
        shape=Hulls((corners, corners)),
    )


CROSSING = CheckRule(
    "crossing",
    "m",
    "min",
    lambda motion: DISTANCES["crossing"].limit(motion.requirements.separation),
    (
        Evaluator(nearest(_taut_parts), lambda state: state.hitched, formulas=(gap,)),
        Evaluator(nearest(_hanging_cables), lambda state: state.slack, exported=True),
        Evaluator(nearest(_clasped_cables), lambda state: state.has_cables),
    ),
    "use a shorter cable or a larger polygon, or lower separation.crossing",
    "place the robots farther apart, or lower separation.crossing",
    group="distances",
    key="separation.crossing",
    bodies=(("cables", "cables"),),
    proves="the minimum distance [m] between taut parts that share no clasp; of hanging cables as "
    "seen from above",
    unproven="neighbours that are being clasped or released, which may touch",
)
"""Cable parts that share no clasp keep a distance."""
