"""Where a mission stands between two steps: a hitch, or drones on free cables."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks import Certificate
from hitchopt.hitch import Hitch, Team
from hitchopt.motion.motion import Motion
from hitchopt.planners.forming.swap_settings import SwapSettings

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Situation:
    """A moment of rest.

    Attributes
    ----------
    team: who flies.
    drones: (2n, 3) [m], in the order q0, r0, q1, r1, ….
    hitch: what they hold, or None where cables are free.
    senses: (clasps,), which way pairs have turned to form it, 1 where q went up first; a hitch that
        was there at first is taken to have been formed so.
    swap: how they did.
    """

    team: Team
    drones: Array
    hitch: Hitch | None = None
    senses: Array | None = None
    swap: SwapSettings = field(default_factory=SwapSettings)

    @classmethod
    def holding(cls, hitch: Hitch) -> Situation:
        """Return the situation of a hitch that is there at first."""
        return cls(hitch.team, hitch.drones, hitch)


@dataclass(frozen=True, eq=False)
class Tied:
    """The motion of a step, and where it ends.

    Attributes
    ----------
    motion: from rest to rest.
    after: where it ends.
    certificate: of the step alone, its duration left open; None where nobody has asked for it yet.
    """

    motion: Motion
    after: Situation
    certificate: Certificate | None = None
