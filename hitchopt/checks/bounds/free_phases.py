"""A motion phase by phase: what is asked of cables depends on the state that they are in."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hitchopt.motion.motion import CableState, Motion, Phase


@dataclass(frozen=True, eq=False)
class PhasePart:
    """A phase, its pieces in the whole motion, and the motion on them."""

    phase: Phase
    pieces: slice
    motion: Motion

    @property
    def start(self) -> float:
        """When it begins [s]."""
        return float(self.motion.drones.breaks[0])

    @property
    def end(self) -> float:
        """When it ends [s]."""
        return float(self.motion.drones.breaks[-1])

    @property
    def grounded(self) -> bool:
        """Whether cables may lie on the ground."""
        return self.phase.state is CableState.GROUND

    @property
    def clasping(self) -> bool:
        """Whether neighbouring cables may touch."""
        return self.phase.state in {CableState.CLASPING, CableState.TIGHTENING}

    @property
    def tightening(self) -> bool:
        """Whether clasped cables are drawn out."""
        return self.phase.state is CableState.TIGHTENING


def phase_parts(motion: Motion) -> Iterator[PhasePart]:
    """Yield the phases of a motion, each piece in the phase of its middle."""
    index = motion.phase_of_piece
    for i, phase in enumerate(motion.phases):
        pieces = np.flatnonzero(index == i)
        if len(pieces):
            run = slice(int(pieces[0]), int(pieces[-1]) + 1)
            yield PhasePart(phase, run, motion.taken(run, (phase,)))


def free_phases(motion: Motion) -> Iterator[PhasePart]:
    """Yield the phases without a hitch."""
    return (part for part in phase_parts(motion) if not part.phase.formed)
