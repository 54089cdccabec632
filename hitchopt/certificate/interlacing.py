"""Check ``interlacing``: neighbours hold each other once, and nobody else, from paths alone.

The *crossing number* of two cables counts how often their chords have passed through each other,
with signs. Free cables have 0. A hitch is right when neighbours have ±1 (either way of turning
holds) and all others 0; once it has been released all have 0 again. A hitch that is there at first
is taken to have been tied with every q going up first, which is 1. Besides, no drone may fly inside
the hanging cable of another: what it pulls there is caught although no chords have met.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.certificate.chord_crossings import chord_crossings
from hitchopt.certificate.hanging_crossing import neighbours
from hitchopt.certificate.report import Check
from hitchopt.certificate.strands import entered
from hitchopt.geometry.broadphase import Indices
from hitchopt.hitch.layout import Layout
from hitchopt.model.motion import JOINT, Motion

Array = NDArray[np.float64]

MOST_NAMED = 12
"""Pairs that ``where`` names at most."""


@dataclass(frozen=True, eq=False)
class _Wrong:
    """Pairs (k,) of cables, as ``i * n + j`` with i < j, and when it is known [s]."""

    pairs: Indices
    time: Array


def check(motion: Motion) -> Check | None:
    """Return how many pairs of cables are wrongly interlaced at some time.

    Told wherever the hitch is formed or released, and at the plan's end where there is none.
    ``where`` names the vertex of neighbours and both cables of other pairs. None for a plan that
    has its hitch all of the time.
    """
    spans = motion.spans(formed=False)
    if not spans:
        return None
    layout = motion.team.layout
    found = list(_wrong(motion, spans))
    pairs = np.concatenate([each.pairs for each in found])
    times = np.concatenate([each.time for each in found])
    wrong, first = np.unique(pairs, return_index=True)
    order = np.argsort(times[first], kind="stable")
    named = tuple(name for pair in wrong[order][:MOST_NAMED] for name in _names(layout, int(pair)))
    time = float(np.min(times)) if len(times) else float(motion.drones.breaks[-1])
    return Check.of("interlacing", float(len(wrong)), 0.0, "max", "1", time, named)


def _wrong(motion: Motion, spans: tuple[Motion, ...]) -> Iterator[_Wrong]:
    """Yield the pairs that are wrong after each span without a hitch."""
    n, layout = motion.team.robots, motion.team.layout
    beside = _beside(layout)
    # A hitch that is there at first has been tied with every q going up first: 1 for neighbours.
    given = spans[0].drones.breaks[0] > motion.drones.breaks[0] + JOINT
    numbers = np.full(len(beside), int(given), dtype=np.intp)
    for span in spans:
        end = float(span.drones.breaks[-1])
        formed_after = end < motion.drones.breaks[-1] - JOINT
        met = chord_crossings(span.drones)
        pairs = met.first * n + met.second
        yield _Wrong(pairs[~met.certain], met.time[~met.certain])
        strangers = met.certain & ~np.isin(pairs, beside) & (met.count != 0)
        yield _Wrong(pairs[strangers], met.time[strangers])
        counted = np.zeros(len(beside), dtype=np.intp)
        place = np.searchsorted(beside, pairs)
        known = np.isin(pairs, beside)
        counted[place[known]] = met.count[known]
        numbers = numbers + counted
        right = np.abs(numbers) == 1 if formed_after else numbers == 0
        yield _Wrong(beside[~right], np.full(int(np.sum(~right)), end))
        inside = entered(span)
        own = inside.drone // 2
        caught = np.minimum(own, inside.cable) * n + np.maximum(own, inside.cable)
        yield _Wrong(caught, inside.time)


def _beside(layout: Layout) -> Indices:
    """Return the neighbouring pairs, ascending."""
    i = np.minimum(layout.ahead, layout.behind)
    j = np.maximum(layout.ahead, layout.behind)
    return np.sort(i * layout.robots + j)


def _names(layout: Layout, pair: int) -> tuple[str, ...]:
    i, j = divmod(pair, layout.robots)
    if neighbours(layout, np.array([i]), np.array([j]))[0]:
        shared = (layout.ahead == i) & (layout.behind == j)
        shared |= (layout.ahead == j) & (layout.behind == i)
        return (f"p{layout.clasps[int(np.argmax(shared))]}",)
    return (f"cable {i}", f"cable {j}")
