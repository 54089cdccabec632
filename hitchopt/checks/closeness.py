"""Who is closest to whom, over time: bounds for every span of time and for the closest pairs."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from hitchopt.checks.distances import scaled_drones, smallest
from hitchopt.errors import InputError, OneLine
from hitchopt.motion.motion import Motion
from hitchopt.trajectory.piecewise import merged_breaks, on_breaks

SPANS = 48
"""Spans of time that a plan is looked at in."""

MOST_PAIRS = 12
"""Pairs that are followed over the whole plan."""


@dataclass(frozen=True)
class ClosestSpan(OneLine):
    """No pair's separation is smaller than ``bound`` (ratio) from ``start`` to ``end`` [s].

    That of ``pair`` has about that ``value`` at ``time`` [s].
    """

    start: float
    end: float
    bound: float
    value: float
    pair: tuple[str, str]
    time: float


@dataclass(frozen=True)
class ClosestPair(OneLine):
    """A pair whose separation is never smaller than ``bound`` (ratio), over the whole plan.

    At ``time`` [s] it is about that small, and their distance ``apart`` [m]. They are the closest
    pair on so many of the ``spans``.
    """

    pair: tuple[str, str]
    bound: float
    time: float
    apart: float
    spans: int


@dataclass(frozen=True)
class Closeness(OneLine):
    """Spans that cover all of the time, and at most MOST_PAIRS closest pairs, closest first."""

    spans: tuple[ClosestSpan, ...]
    pairs: tuple[ClosestPair, ...]

    def __str__(self) -> str:
        lines = ["pair              separation      apart       when  closest for"]
        total = self.spans[-1].end - self.spans[0].start
        for p in self.pairs:
            share = p.spans / len(self.spans) * total
            name = f"{p.pair[0]}, {p.pair[1]}"
            lines.append(
                f"{name:16}  {p.bound:10.5f}  {p.apart:7.4f} m  {p.time:7.3f} s  {share:7.2f} s"
            )
        return "\n".join(lines)


def closeness(motion: Motion, spans: int = SPANS) -> Closeness:
    """Return who is closest to whom, for all of the time.

    Every bound holds on all of its span, rounding included, and comes within 1e-4 of an attained
    value, relative.

    Parameters
    ----------
    motion: what flies; at least two drones.
    spans: equal parts that its time is cut into.

    Raises
    ------
    InputError: a single drone, or no span.
    """
    names = list(motion.team.drone_names)
    if len(names) < 2:
        raise InputError("drones", len(names), "at least 2", "one drone has no neighbour")
    if spans < 1:
        raise InputError("spans", spans, "at least 1", "48 are usual")
    breaks = motion.drones.breaks
    edges = np.linspace(breaks[0], breaks[-1], spans + 1)
    drones = on_breaks(motion.drones, merged_breaks([edges, breaks]))
    every = scaled_drones(motion, drones)
    found, pairs = [], []
    for start, end in pairwise(edges.tolist()):
        least = smallest(every.part(*np.searchsorted(drones.breaks, [start, end]).tolist()))
        i, j = divmod(least.item, len(names))
        pair = (names[i], names[j])
        found.append(ClosestSpan(start, end, least.worst, least.value, pair, least.time))
    counts = Counter(span.pair for span in sorted(found, key=lambda span: span.bound))
    for pair, count in list(counts.items())[:MOST_PAIRS]:
        i, j = (names.index(name) for name in pair)
        least = smallest(replace(every, first=every.first[:, [i, j]]))
        here = motion.drones.at(least.time)
        apart = float(np.linalg.norm(here[i] - here[j]))
        pairs.append(ClosestPair(pair, least.worst, least.time, apart, count))
    return Closeness(tuple(found), tuple(sorted(pairs, key=lambda pair: pair.bound)))
