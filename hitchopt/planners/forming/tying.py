"""From the pre-hitch to the tensioned hitch: swap, swap, tighten, pull; and the same backward."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import Hitch, Limits
from hitchopt.planners.forming.prehitch import PreHitch
from hitchopt.planners.forming.settings import SwapSettings
from hitchopt.planners.forming.stage import Stage
from hitchopt.planners.forming.swap import swap
from hitchopt.planners.forming.tightening import tightened
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

PULL_SECONDS = 1.0
"""[s] From no pull to the team's tension: drones that hold against it tilt meanwhile."""

SMOOTH = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])
"""Bernstein coefficients of the rise from 0 to 1 with three derivatives zero at both ends."""

BACKWARD = {"swap 1": "unswap 2", "swap 2": "unswap 1", "tighten": "loosen", "tension": "relax"}
"""What the stages of forming are called when they are undone."""


def tied(pre: PreHitch, hitch: Hitch, limits: Limits, settings: SwapSettings) -> list[Stage]:
    """Return the stages from the pre-hitch to the hitch, pulled by the team's tension."""
    team = hitch.team
    legs = float(np.max(hitch.legs))
    shorter = (1.0 - pre.share) * legs  # at least what any drone goes, whatever the polygon
    ways = tightened(team, limits, pre.separation, pre.drones, hitch.drones, shorter)
    rest = PiecewisePolynomial.constant([0.0, PULL_SECONDS], hitch.drones)
    return [
        Stage("swap 1", swap(pre.turns, limits, 0, settings.seconds)),
        Stage("swap 2", swap(pre.turns, limits, 1, settings.seconds)),
        *(Stage("tighten", way) for way in ways),
        Stage("tension", rest, SMOOTH[None]),
    ]


def undone(stages: Sequence[Stage]) -> list[Stage]:
    """Return the stages of forming backward in time: the hitch is taken apart."""
    return [stage.reversed(BACKWARD[stage.name]) for stage in reversed(stages)]
