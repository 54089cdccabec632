"""Closest pairs of drones over time: bounds for every span of time and for the closest pairs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from hitchopt.checks.distances import Moving, scaled_drones, smallest
from hitchopt.errors import InputError, OneLine
from hitchopt.motion.motion import Motion
from hitchopt.trajectory.piecewise import merged_breaks, on_breaks

# Default number of spans of time, and maximum number of pairs followed over all of it
SPANS, MAX_PAIRS = 48, 12


@dataclass(frozen=True)
class Closest(OneLine):
    """No separation (ratio) is smaller than ``bound`` from ``start`` to ``end`` [s].

    ``bound`` holds for any pair, or for ``pair`` over the whole plan; the separation of ``pair`` is
    about ``value`` at ``time``.
    """

    start: float
    end: float
    bound: float
    value: float
    pair: tuple[str, str]
    time: float


@dataclass(frozen=True)
class Closeness(OneLine):
    """Spans that cover all of the time, and at most MAX_PAIRS closest pairs, closest first."""

    spans: tuple[Closest, ...]
    pairs: tuple[Closest, ...]

    def __str__(self) -> str:
        heads = f"{'pair':16}  separation       when"
        rows = (f"{', '.join(p.pair):16}  {p.bound:10.5f}  {p.time:7.3f} s" for p in self.pairs)
        return "\n".join([heads, *rows])


def closeness(motion: Motion, spans: int = SPANS) -> Closeness:
    """Return the closest pairs of drones, for all t.

    Every bound holds on all of its span, rounding included, and comes within 1e-4 of an attained
    value, relative.

    Parameters
    ----------
    motion: of at least two drones.
    spans: number of equal parts of its time.

    Raises
    ------
    InputError: a single drone, or no span.
    """
    names = motion.team.drone_names
    if len(names) < 2:
        raise InputError("drones", len(names), "at least 2", "one drone has no neighbour")
    if spans < 1:
        raise InputError("spans", spans, "at least 1", "48 are usual")
    edges = np.linspace(motion.drones.breaks[0], motion.drones.breaks[-1], spans + 1).tolist()
    drones = on_breaks(motion.drones, merged_breaks([np.array(edges), motion.drones.breaks]))
    every = scaled_drones(motion, drones)

    def closest(moving: Moving, start: float, end: float) -> Closest:
        least = smallest(moving)
        first, second = moving.named(least.item)
        return Closest(start, end, least.worst, least.value, (first, second), least.time)

    by_span = [
        closest(every.part(*np.searchsorted(drones.breaks, (start, end)).tolist()), start, end)
        for start, end in pairwise(edges)
    ]
    pairs = []
    for pair in list(dict.fromkeys(span.pair for span in sorted(by_span, key=_bound)))[:MAX_PAIRS]:
        both = every.first[:, [names.index(name) for name in pair]]
        pairs.append(closest(replace(every, first=both, names=(pair, pair)), edges[0], edges[-1]))
    return Closeness(tuple(by_span), tuple(sorted(pairs, key=_bound)))


def _bound(closest: Closest) -> float:
    return closest.bound
