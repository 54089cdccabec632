"""A common clock: phases of constant jerk, and polynomials of plan time flown on it.

A clock gives plan time τ as a piecewise cubic of time. Composed with it, a polynomial of degree N
becomes one of degree 3N.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.values import Array, Indices

SLIVER = 1e-8
"""[s] Parts of a phase that are shorter go to their neighbour: the piece beyond its break is off by
its jump in jerk times 1e-25 s³."""

BISECTIONS = 52
"""Halvings of a phase in search of the time of a break."""


def advanced(jets: Array, dt: Array | float) -> Array:
    """Return the jets (…, 4) of cubics ``dt`` (…) [s] after those given (…, 4)."""
    p, v, a, j = (jets[..., k] for k in range(4))
    change = dt * j
    place = p + dt * (v + dt * (a / 2.0 + change / 6.0))
    moved = np.empty((*place.shape, 4))
    for k, value in enumerate((place, v + dt * (a + change / 2.0), a + change, j)):
        moved[..., k] = value
    return moved


@dataclass(frozen=True, eq=False)
class ClockPhases:
    """Phases in which a clock's jerk is constant and its rate does not change its sign.

    Attributes
    ----------
    owner: (phases,), index of each phase's clock.
    jets: (phases, 4), plan time τ [s] and its derivatives by time where each begins.
    duration: (phases,) [s]
    """

    owner: Indices
    jets: Array
    duration: Array

    def __len__(self) -> int:
        return len(self.duration)

    @property
    def ends(self) -> Array:
        """(phases, 4): jets where each ends."""
        return advanced(self.jets, self.duration)

    def select(self, index: NDArray[np.bool_] | Indices | slice) -> ClockPhases:
        """Return the chosen phases."""
        return ClockPhases(self.owner[index], self.jets[index], self.duration[index])

    def cut(self, breaks: Array, sliver: float = SLIVER) -> tuple[ClockPhases, Indices]:
        """Return the phases cut where they pass a break, and (cells,) the pieces they lie in.

        A cell before the first break or after the last one has the piece -1 or len(breaks) - 1.
        Parts no longer than ``sliver`` [s] go to their neighbour.
        """
        if not len(self):
            return self, np.zeros(0, dtype=np.intp)
        first, last = self.jets[:, 0], self.ends[:, 0]
        low, high = np.minimum(first, last), np.maximum(first, last)
        begin = np.searchsorted(breaks, low, side="right")
        count = np.maximum(np.searchsorted(breaks, high, side="left") - begin, 0)
        phase = np.repeat(np.arange(len(self)), count)
        which = np.arange(len(phase)) - np.repeat(np.cumsum(count) - count, count)
        target = breaks[begin[phase] + which]
        when = self._passing(phase, target)
        whole = self.duration[phase]
        inside = (when > sliver) & (when < whole - sliver)
        phase = np.concatenate([np.arange(len(self)), phase[inside]])
        when = np.concatenate([np.zeros(len(self)), when[inside]])
        order = np.lexsort((when, phase))
        phase, when = phase[order], when[order]
        follows = np.append(phase[1:] == phase[:-1], False)
        wide = np.append(when[1:] - when[:-1] > sliver, True) | ~follows
        phase, when = phase[wide], when[wide]
        follows = np.append(phase[1:] == phase[:-1], False)
        until = np.where(follows, np.append(when[1:], 0.0), self.duration[phase])
        cells = ClockPhases(self.owner[phase], advanced(self.jets[phase], when), until - when)
        middle = advanced(cells.jets, 0.5 * cells.duration)[:, 0]
        return cells, np.searchsorted(breaks, middle, side="right") - 1

    def _passing(self, phase: Indices, target: Array) -> Array:
        """Return the time (m,) [s] at which each phase passes a plan time [s]."""
        p, v, a, j = self.jets[phase].T
        low, high = np.zeros(len(phase)), self.duration[phase].copy()
        forward = self.ends[phase, 0] >= p
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            place = p + middle * (v + middle * (a / 2.0 + middle * j / 6.0))  # as advanced
            early = (place < target) == forward
            low, high = np.where(early, middle, low), np.where(early, high, middle)
        return 0.5 * (low + high)


def concatenated_clocks(clocks: Sequence[ClockPhases]) -> ClockPhases:
    """Return the phases of several clocks, with their indices as owners."""
    return ClockPhases(
        np.repeat(np.arange(len(clocks)), [len(clock) for clock in clocks]),
        np.concatenate([clock.jets for clock in clocks]),
        np.concatenate([clock.duration for clock in clocks]),
    )
