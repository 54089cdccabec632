"""Who is closest to whom, over time: bounds for every span of time and for the closest pairs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from hitchopt.checks.bounds.moving_bodies import Bodies, every_pair
from hitchopt.checks.bounds.proximity import smallest_distance
from hitchopt.checks.bounds.rounding_margins import position_margin
from hitchopt.errors import InputError
from hitchopt.motion.motion import Motion
from hitchopt.one_line import OneLine
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.distance import distance_bound
from hitchopt.trajectory.extremum import Cells, smallest
from hitchopt.trajectory.splitting import merged_breaks, on_breaks

SPANS = 48
"""Spans of time that a plan is looked at in."""

MOST_PAIRS = 12
"""Pairs that are followed over the whole plan."""


@dataclass(frozen=True)
class ClosestSpan(OneLine):
    """A span of time and the pair that comes closest on it.

    Attributes
    ----------
    start, end: [s]
    bound: no pair's separation is smaller anywhere on the span (ratio).
    value: a separation that ``pair`` has at ``time``, about as small.
    pair: names of the two drones.
    time: [s]
    """

    start: float
    end: float
    bound: float
    value: float
    pair: tuple[str, str]
    time: float


@dataclass(frozen=True)
class ClosestPair(OneLine):
    """A pair of drones over the whole plan.

    Attributes
    ----------
    pair: names of the two drones.
    bound: their separation is never smaller (ratio).
    time: [s], when it is about that small.
    apart: distance between them then [m]
    spans: how many of the spans of time they are the closest pair on.
    """

    pair: tuple[str, str]
    bound: float
    time: float
    apart: float
    spans: int


@dataclass(frozen=True)
class Closeness(OneLine):
    """The closest neighbours over time.

    Attributes
    ----------
    spans: one after the other, covering all of the plan's time.
    pairs: those that are closest on some span, the closest first; at most MOST_PAIRS.
    """

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
    names = motion.team.drone_names
    if len(names) < 2:
        raise InputError("drones", len(names), "at least 2", "one drone has no neighbour")
    if spans < 1:
        raise InputError("spans", spans, "at least 1", "48 are usual")
    scale = motion.requirements.separation.scale
    margin = position_margin(motion) * float(np.max(scale))
    breaks = motion.drones.breaks
    edges = np.linspace(breaks[0], breaks[-1], spans + 1)
    drones = on_breaks(motion.drones, merged_breaks([edges, breaks]))
    scaled = replace(drones, coefficients=drones.coefficients * scale[:, None])
    found = []
    for start, end in pairwise(edges):
        part = scaled.taken(slice(*np.searchsorted(scaled.breaks, [start, end])))
        bodies = Bodies(part.coefficients[:, :, None])
        least = smallest_distance(part.breaks, bodies, None, every_pair, margin)
        i, j = sorted(divmod(least.item, len(names)))
        pair = (names[i], names[j])
        found.append(
            ClosestSpan(float(start), float(end), least.worst, least.value, pair, least.time)
        )
    return Closeness(tuple(found), _pairs(motion, scaled, found, margin))


def _pairs(
    motion: Motion, scaled: PiecewisePolynomial, spans: list[ClosestSpan], margin: float
) -> tuple[ClosestPair, ...]:
    names = motion.team.drone_names
    index = {name: i for i, name in enumerate(names)}
    counts: dict[tuple[str, str], int] = {}
    for span in sorted(spans, key=lambda span: span.bound):
        counts[span.pair] = counts.get(span.pair, 0) + 1
    chosen = list(counts)[:MOST_PAIRS]
    pairs = []
    for pair in chosen:
        i, j = index[pair[0]], index[pair[1]]
        offset = (scaled.coefficients[:, i] - scaled.coefficients[:, j])[:, None]
        least = smallest(Cells.over(scaled.breaks, [offset], margin), distance_bound)
        here = motion.drones.at(least.time)
        apart = float(np.linalg.norm(here[i] - here[j]))
        bound = max(least.worst, 0.0)
        pairs.append(ClosestPair(pair, bound, least.time, apart, counts[pair]))
    return tuple(sorted(pairs, key=lambda p: p.bound))
