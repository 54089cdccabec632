"""A motion phase by phase."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hitchopt.motion.motion import Motion, Phase


@dataclass(frozen=True, eq=False)
class PhasePart:
    """A phase, its pieces in the whole motion, and the motion on them."""

    phase: Phase
    pieces: slice
    motion: Motion

    @property
    def start(self) -> float:
        """Start time [s]."""
        return float(self.motion.drones.breaks[0])

    @property
    def end(self) -> float:
        """End time [s]."""
        return float(self.motion.drones.breaks[-1])


def phase_parts(motion: Motion) -> Iterator[PhasePart]:
    """Yield the phases of a motion, each piece in the phase of its middle."""
    index = motion.phase_of_piece
    for i, phase in enumerate(motion.phases):
        pieces = np.flatnonzero(index == i)
        if len(pieces):
            run = slice(int(pieces[0]), int(pieces[-1]) + 1)
            yield PhasePart(phase, run, motion.taken(run, (phase,)))
