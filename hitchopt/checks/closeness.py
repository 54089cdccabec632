"""Closest pairs of drones: bounds for every time span, and for the closest pairs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from hitchopt.checks.distances import Moving, scaled_drones, smallest
from hitchopt.errors import InputError, OneLine
from hitchopt.motion.motion import Motion
from hitchopt.trajectory.piecewise import merged_breaks, on_breaks

# Default number of time spans, and maximum number of closest pairs
SPANS, MAX_PAIRS = 48, 12


@dataclass(frozen=True)
class Closest(OneLine):
    """A lower bound of separation (ratio) from ``start`` to ``end`` [s].

    ``bound`` holds for all pairs in a time span, or for ``pair`` over the plan. The separation of
    ``pair`` is close to ``value`` at ``time`` [s].
    """

    start: float
    end: float
    bound: float
    value: float
    pair: tuple[str, str]
    time: float


@dataclass(frozen=True)
class Closeness(OneLine):
    """Time spans that cover the plan, and up to MAX_PAIRS closest pairs, closest first."""

    spans: tuple[Closest, ...]
    pairs: tuple[Closest, ...]

    def __str__(self) -> str:
        heads = f"{'pair':16}  separation       when"
        rows = (f"{', '.join(p.pair):16}  {p.bound:10.5f}  {p.time:7.3f} s" for p in self.pairs)
        return "\n".join([heads, *rows])


def closeness(motion: Motion, spans: int = SPANS) -> Closeness:
    """Return the closest pairs of drones, for all t.

    Every bound holds on all of its span, rounding included, within 1e-4 of an attained value,
    relative.

    Parameters
    ----------
    motion: a motion of at least two drones.
    spans: number of equal time spans.

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
        minimum = smallest(moving)
        first, second = moving.pair_names(minimum.item)
        return Closest(start, end, minimum.worst, minimum.value, (first, second), minimum.time)

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
