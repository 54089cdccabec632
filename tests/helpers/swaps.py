"""Swaps that tie hitches, stage by stage, and the clasps that are wrong in a motion."""

from __future__ import annotations

from functools import cache

import numpy as np

import hitchopt as ho
from hitchopt.forming.prehitch import find_prehitch
from hitchopt.forming.swap_settings import SwapSettings
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.motion import Motion, concatenated
from hitchopt.planners.stages import stage
from hitchopt.trajectory import PiecewisePolynomial
from tests.helpers.motions import row

SPEC = Requirements()
POLYGONS = {
    3: (2.4, [[0.1, 0.6], [0.5, -0.3], [-0.55, -0.25]]),
    4: (2.0, [[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]]),
    5: (2.2, [[0, 1.0], [1.1, 0.5], [0.8, -0.6], [-0.4, -0.8], [-0.9, 0.3]]),
    12: (2.3, ho.regular_polygon(12, 1.3, angle=0.1).vertices),
}


def hitch_of(n: int) -> Hitch:
    length, polygon = POLYGONS[n]
    return Hitch.balanced(Team(n, length), np.array(polygon) + [4.0, -3.0], 1.8)


@cache
def stages_of(n: int, sense: int = 1) -> tuple[Hitch, list[Motion]]:
    """Return two swaps, tightening, and the held hitch."""
    hitch, settings = hitch_of(n), SwapSettings(sense=sense)
    return hitch, find_prehitch(hitch, SPEC, settings).stages(SPEC)


def stage_of(hitch: Hitch, name: str, drones: PiecewisePolynomial, state: CableState) -> Motion:
    """Return a stage with the hitch's vertices."""
    vertices = PiecewisePolynomial.constant(drones.breaks, hitch.vertices)
    return stage(name, drones, hitch.team, SPEC, 0, state, vertices=vertices)


def wrong(*motions: Motion) -> set[str]:
    result = row(concatenated(motions), "interlacing")
    assert (result.worst == 0.0) is result.holds is (not result.where)
    return {name for name in result.where if not name.startswith("phase ")}
