"""The spans of time without a hitch, phase by phase: what is asked of cables depends on them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hitchopt.model.motion import Motion, Phase

GROUNDED = frozenset({"parked", "take-off", "land"})
"""Phases in which cables lie on the ground, at least at one end: they are looked at from above."""

CLASPING = frozenset({"swap 1", "swap 2", "tighten", "loosen", "unswap 1", "unswap 2"})
"""Phases in which neighbouring cables lie against each other, or are about to."""


@dataclass(frozen=True, eq=False)
class FreePhase:
    """A phase without a hitch, and the motion in it."""

    phase: Phase
    motion: Motion

    @property
    def grounded(self) -> bool:
        """Whether cables may lie on the ground."""
        return self.phase.name in GROUNDED

    @property
    def clasping(self) -> bool:
        """Whether neighbouring cables may touch."""
        return self.phase.name in CLASPING


def free_phases(motion: Motion) -> Iterator[FreePhase]:
    """Yield the phases without a hitch of a motion, each piece in the phase of its middle."""
    ends = np.array([phase.end for phase in motion.phases[:-1]])
    middles = 0.5 * (motion.drones.breaks[1:] + motion.drones.breaks[:-1])
    index = np.searchsorted(ends, middles)
    for i, phase in enumerate(motion.phases):
        pieces = np.flatnonzero(index == i)
        if phase.formed or len(pieces) == 0:
            continue
        run = slice(int(pieces[0]), int(pieces[-1]) + 1)
        yield FreePhase(phase, motion.taken(run, (phase,)))
