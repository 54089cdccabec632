"""The smallest distance between any two of many moving points and segments.

A span of time is searched for an attained distance first; only pairs whose boxes over that span
come at least as close are looked at, all others being farther apart for certain. Few bodies are all
paired, and all of the time is one span; of many the close pairs are listed span by span: several
pieces where little moves, and spans in which much moves are halved before.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from hitchopt.checks.bounds.close_spans import GROUP, NEIGHBOURS, Span, close_spans
from hitchopt.checks.bounds.moving_bodies import (
    DISTANCE,
    SLACK,
    Allowed,
    Bodies,
    Metric,
    body_boxes,
)
from hitchopt.geometry import differences, shortest_offset
from hitchopt.geometry.broadphase import Indices, Pairs, all_pairs
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.extremum import Cells, Extremum, Search, smallest
from hitchopt.values import Array

FEW = 6000
"""Pairs in all, up to which an index costs more than it saves."""


def smallest_distance(
    breaks: Array,
    first: Bodies,
    second: Bodies | None,
    allowed: Allowed,
    margin: float,
    target: float = -np.inf,
    metric: Metric = DISTANCE,
    known: float = np.inf,
) -> Extremum:
    """Return the smallest distance, or other measure, of allowed pairs over all of the time.

    Parameters
    ----------
    breaks: (pieces + 1,) [s]
    first, second: two groups of bodies, or one whose pairs among themselves are meant.
    allowed: which pairs count; symmetric where there is one group.
    margin: taken off to cover rounding [m].
    target, known: as of a Search [m].
    metric: by which pairs are near.

    Returns
    -------
    Its ``item`` is ``i * len(second) + j`` (or ``len(first)``, where there is one group).
    """
    search = Search(metric.bound, target=target, known=known)
    count = len(first) if second is None else len(second)
    pairs = len(first) * (len(first) - 1) // 2 if second is None else len(first) * count
    if pairs <= FEW:
        every = _few_pairs(len(first), None if second is None else count, allowed)
        whole = Span(breaks, first.corners, None if second is None else second.corners, every)
        alone = len(breaks) - 1 <= _group(every) and metric is DISTANCE and math.isinf(known)
        for cells in _near_cells(whole, count, margin, metric):
            if alone:
                return _not_negative(smallest(cells, metric.bound, target))
            search.add(cells)
        return _not_negative(search.finish())
    for span in close_spans(breaks, first, second, search, allowed, margin, metric):
        for cells in _near_cells(span, count, margin, metric):
            search.add(cells)
        if search.value <= search.absolute:  # they touch: no other pair can do worse
            return Extremum(0.0, search.value, search.item, search.time)
    return _not_negative(search.finish())


@lru_cache(maxsize=64)
def _few_pairs(first: int, second: int | None, allowed: Allowed) -> Pairs:
    """Return all allowed pairs of two groups of that many, or within the first one."""
    every = all_pairs(first, second)
    return every.take(allowed(every.first, every.second))


def _group(pairs: Pairs) -> int:
    """Return how many pieces of pairs are looked at in one go."""
    return max(1, GROUP // max(1, len(pairs)))


def _near_cells(span: Span, count: int, margin: float, metric: Metric) -> Iterator[Cells]:
    """Give the cells of the pairs that may be closest, on some pieces of a span at a time."""
    group, pieces = _group(span.pairs), len(span.first)
    for start in range(0, pieces if len(span.pairs) else 0, group):
        a = span.first[start : start + group]
        b = a if span.second is None else span.second[start : start + group]
        times = span.times[start : start + group + 1]
        piece, pair = _near(a, b, span.pairs, margin, metric)
        for i in range(0, len(piece), GROUP):
            part = slice(i, i + GROUP)
            yield _cells(times, a, b, piece[part], span.pairs.take(pair[part]), count, margin)


def _near(
    a: Array, b: Array, pairs: Pairs, margin: float, metric: Metric
) -> tuple[Indices, Indices]:
    """Return (piece, pair) of those that some other one's distance does not rule out.

    By the boxes over each piece of (pieces, bodies, 1 or 2, 3, degree + 1), held against what the
    few pairs are apart in a piece's middle whose boxes come closest.
    """
    with np.errstate(all="ignore"):  # what is no number rules nothing out
        drift = np.mean(a, axis=(1, 2), keepdims=True)  # what all do together changes no distance
        own = body_boxes(a - drift)
        others = own if b is a else body_boxes(b - drift)
        i, j = pairs.first, pairs.second
        (a_lower, a_upper), (b_lower, b_upper) = own.take(i, axis=3), others.take(j, axis=3)
        apart = np.maximum(a_lower - b_upper, b_lower - a_upper)
        np.maximum(apart, 0.0, out=apart)
        apart *= apart
        gaps = np.sqrt(apart.sum(axis=0))
        count = min(NEIGHBOURS, gaps.shape[1])
        closest = np.argpartition(gaps, count - 1, axis=1)[:, :count]
        half = bernstein.basis(np.array(0.5), a.shape[-1] - 1)
        each = np.arange(len(a))[:, None]
        offsets = shortest_offset(
            differences((a @ half)[each, i[closest]], (b @ half)[each, j[closest]])
        )
        cutoff = metric.reach(np.min(metric.measured(offsets)) + margin) * (1.0 + SLACK)
        piece, pair = np.nonzero(~(gaps > cutoff))
    return piece, pair


def _cells(
    times: Array, a: Array, b: Array, piece: Indices, pairs: Pairs, count: int, margin: float
) -> Cells:
    """Return one cell per piece (cells,) and pair, holding the differences of their ends."""
    ends_a = a[piece, pairs.first][:, :, None]
    ends_b = b[piece, pairs.second][:, None]
    each = ends_a - ends_b  # (cells, ends, ends, 3, degree + 1), of no pairs perhaps
    rows = each.reshape(len(each), math.prod(each.shape[1:4]), each.shape[-1])
    return Cells(
        (rows,),
        pairs.first * count + pairs.second,
        times[piece],
        times[piece + 1],
        np.full(len(each), margin),
    )


def _not_negative(found: Extremum) -> Extremum:
    """Return the same, bodies that touch being at distance zero, whatever the margin."""
    return Extremum(max(found.worst, 0.0), found.value, found.item, found.time)
