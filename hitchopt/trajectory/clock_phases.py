"""Clocks: plan time τ as a piecewise cubic function of time, in phases of constant jerk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.values import Array, Indices

SLIVER = 1e-8
"""[s] Shorter parts of a phase are merged into their neighbour: beyond its break, a piece is off by
its jump in jerk times 1e-25 s³."""

BISECTIONS = 52  # Number of bisection steps for the time at which a phase passes a break


def advance(jets: Array, dt: Array | float) -> Array:
    """Return the jets (…, 4) of cubics a time ``dt`` (…) [s] after their jets (…, 4)."""
    p, v, a, j = (jets[..., k] for k in range(4))
    jump = dt * j
    position = p + dt * (v + dt * (a / 2.0 + jump / 6.0))
    result = np.empty((*position.shape, 4))
    for k, value in enumerate((position, v + dt * (a + jump / 2.0), a + jump, j)):
        result[..., k] = value
    return result


@dataclass(frozen=True, eq=False)
class ClockPhases:
    """Phases in which a clock has constant jerk and a rate of constant sign."""

    owner: Indices  # (phases,), index of each phase's clock
    jets: Array  # (phases, 4), plan time τ [s] and its time derivatives at the start of each
    duration: Array  # (phases,) [s]

    def __len__(self) -> int:
        return len(self.duration)

    @property
    def ends(self) -> Array:
        """(phases, 4): jets at the end of each."""
        return advance(self.jets, self.duration)

    def select(self, index: NDArray[np.bool_] | Indices | slice) -> ClockPhases:
        """Return the chosen phases."""
        return ClockPhases(self.owner[index], self.jets[index], self.duration[index])

    def cut(self, breaks: Array, sliver: float = SLIVER) -> tuple[ClockPhases, Indices]:
        """Return the phases split at the breaks they pass, and the pieces (cells,) of these cells.

        A cell before the first break or after the last one has the piece -1 or len(breaks) - 1.
        Parts no longer than ``sliver`` [s] are merged into their neighbour.
        """
        if not len(self):
            return self, np.zeros(0, dtype=np.intp)
        first, last = self.jets[:, 0], self.ends[:, 0]
        low, high = np.minimum(first, last), np.maximum(first, last)
        begin = np.searchsorted(breaks, low, side="right")
        count = np.maximum(np.searchsorted(breaks, high, side="left") - begin, 0)
        phase = np.repeat(np.arange(len(self)), count)
        offset = np.arange(len(phase)) - np.repeat(np.cumsum(count) - count, count)
        target = breaks[begin[phase] + offset]
        times = self._passing_times(phase, target)
        inside = (times > sliver) & (times < self.duration[phase] - sliver)
        phase = np.concatenate([np.arange(len(self)), phase[inside]])
        times = np.concatenate([np.zeros(len(self)), times[inside]])
        order = np.lexsort((times, phase))
        phase, times = phase[order], times[order]
        follows = np.append(phase[1:] == phase[:-1], False)
        distinct = np.append(times[1:] - times[:-1] > sliver, True) | ~follows
        phase, times = phase[distinct], times[distinct]
        follows = np.append(phase[1:] == phase[:-1], False)
        ends = np.where(follows, np.append(times[1:], 0.0), self.duration[phase])
        cells = ClockPhases(self.owner[phase], advance(self.jets[phase], times), ends - times)
        middle = advance(cells.jets, 0.5 * cells.duration)[:, 0]
        return cells, np.searchsorted(breaks, middle, side="right") - 1

    def _passing_times(self, phase: Indices, target: Array) -> Array:
        """Return the times (m,) [s], from their starts, at which phases pass plan times [s]."""
        p, v, a, j = self.jets[phase].T
        lower, upper = np.zeros(len(phase)), self.duration[phase].copy()
        forward = self.ends[phase, 0] >= p
        for _ in range(BISECTIONS):
            middle = 0.5 * (lower + upper)
            position = p + middle * (v + middle * (a / 2.0 + middle * j / 6.0))  # as in ``advance``
            early = (position < target) == forward
            lower, upper = np.where(early, middle, lower), np.where(early, upper, middle)
        return 0.5 * (lower + upper)


def concatenate_clocks(clocks: Sequence[ClockPhases]) -> ClockPhases:
    """Return the phases of several clocks, with their indices as owners."""
    return ClockPhases(
        np.repeat(np.arange(len(clocks)), [len(clock) for clock in clocks]),
        np.concatenate([clock.jets for clock in clocks]),
        np.concatenate([clock.duration for clock in clocks]),
    )
