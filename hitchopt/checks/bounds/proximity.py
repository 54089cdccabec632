"""The smallest distance between any two of many moving points and segments.

A span of time is searched for an attained distance first; only pairs whose boxes over that span
come at least as close are looked at, all others being farther apart for certain. Few bodies are all
paired, and all of the time is one span; of many the close pairs are listed span by span: several
pieces where little moves, and spans in which much moves are halved before.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hitchopt.compiled.kernel_switch import kernels_on
from hitchopt.geometry import differences, shortest_offset
from hitchopt.geometry.broadphase import (
    Boxes,
    Indices,
    Pairs,
    all_pairs,
    close_pairs,
    few_close_pairs,
)
from hitchopt.geometry.vectors import length
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.compiled_search import KnownBound, smallest
from hitchopt.trajectory.distance import distance_bound
from hitchopt.trajectory.extremum import Bound, Cells, Extremum, Search
from hitchopt.values import Array

Allowed = Callable[[Indices, Indices], NDArray[np.bool_]]
"""Which pairs (first, second) count."""

FEW = 6000
"""Pairs in all, up to which an index costs more than it saves."""

GROUP = 32_768
"""Pairs, or bodies, times pieces whose boxes are compared at a time."""

NEIGHBOURS = 8
"""How many of a body's neighbours are tried for an attained distance."""

CROWD = 12
"""Pairs per body above which a span is halved, if motion is to blame."""

QUIET = 30
"""Pairs per body above which a span of several pieces is cut: each pair is looked at on each."""

MAX_DEPTH = 8
"""Spans are halved this often at most."""

SLACK = 1e-9
"""Relative: boxes are rounded, and so is the distance that they are compared with."""


@dataclass(frozen=True, eq=False)
class Bodies:
    """Points or segments.

    Attributes
    ----------
    corners: (pieces, bodies, 1 or 2, 3, degree + 1) [m]: their ends.
    """

    corners: Array

    def __len__(self) -> int:
        return int(self.corners.shape[1])


@dataclass(frozen=True, eq=False)
class Metric:
    """A measure of how near bodies are that grows with their distance.

    Attributes
    ----------
    bound: lower bounds on cells, as ``distance_bound`` gives them.
    measured: returns the measure (…) of shortest offsets (…, 3).
    reach: returns the distance from which on the measure is at least the given one.
    """

    bound: Bound
    measured: Callable[[Array], Array]
    reach: Callable[[float], float]


DISTANCE = Metric(distance_bound, length, lambda measure: measure)


def every_pair(first: Indices, _: Indices) -> NDArray[np.bool_]:
    """Allow all pairs."""
    return np.ones(len(first), dtype=np.bool_)


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
        every = all_pairs(len(first), None if second is None else count)
        every = every.take(allowed(every.first, every.second))
        whole = _Span(breaks, first.corners, None if second is None else second.corners, every)
        alone = len(breaks) - 1 <= _group(every) and metric is DISTANCE and math.isinf(known)
        for cells in _near_cells(whole, count, margin, metric):
            if alone:
                return _not_negative(smallest(cells, metric.bound, KnownBound("distance"), target))
            search.add(cells)
        return _not_negative(search.finish())
    for span in _spans(breaks, first, second, search, allowed, margin, metric):
        for cells in _near_cells(span, count, margin, metric):
            search.add(cells)
        if search.value <= search.absolute:  # they touch: no other pair can do worse
            return Extremum(0.0, search.value, search.item, search.time)
    return _not_negative(search.finish())


@dataclass(frozen=True, eq=False)
class _Span:
    """A span of time and the pairs that matter on it.

    Attributes
    ----------
    times: (pieces + 1,) [s]
    first, second: (pieces, bodies, 1 or 2, 3, degree + 1) [m], ends of two groups, or of one.
    pairs: of bodies.
    """

    times: Array
    first: Array
    second: Array | None
    pairs: Pairs


def _group(pairs: Pairs) -> int:
    """Return how many pieces of pairs are looked at in one go."""
    return max(1, GROUP // max(1, len(pairs)))


def _near_cells(span: _Span, count: int, margin: float, metric: Metric) -> Iterator[Cells]:
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


def _spans(
    breaks: Array,
    first: Bodies,
    second: Bodies | None,
    search: Search,
    allowed: Allowed,
    margin: float,
    metric: Metric,
) -> Iterator[_Span]:
    """Give spans that cover all of the time; the cutoff falls as the search goes on.

    The next span has twice as many pieces until one has to be cut, and then as many as its parts.
    """
    bodies = len(first) + (0 if second is None else len(second))
    piece, size, growth = 0, 1, 2
    while piece < len(breaks) - 1:
        part = slice(piece, piece + min(size, max(1, GROUP // bodies)))
        others = None if second is None else second.corners[part]
        stack = [(breaks[part.start : part.stop + 1], first.corners[part], others, 0)]
        piece += len(first.corners[part])
        while stack:
            times, a, b, depth = stack.pop()
            pairs = _close(a, b, search.value, allowed, margin, metric, depth, bodies)
            if pairs is not None:
                yield _Span(times, a, b, pairs.take(allowed(pairs.first, pairs.second)))
            elif len(a) > 1:
                middle = len(a) // 2
                size, growth = min(size, middle), 1
                here, there = slice(middle), slice(middle, None)
                cut = (None, None) if b is None else (b[here], b[there])
                stack.append((times[middle:], a[there], cut[1], 0))
                stack.append((times[: middle + 1], a[here], cut[0], 0))
            else:
                moment = 0.5 * (times[0] + times[1])
                a_halves, b_halves = _halves(a), (None, None) if b is None else _halves(b)
                stack.append((np.array([moment, times[1]]), a_halves[1], b_halves[1], depth + 1))
                stack.append((np.array([times[0], moment]), a_halves[0], b_halves[0], depth + 1))
        size *= growth


def _close(
    a: Array,
    b: Array | None,
    known: float,
    allowed: Allowed,
    margin: float,
    metric: Metric,
    depth: int,
    bodies: int,
) -> Pairs | None:
    """Return the pairs whose boxes over a span may be closest, or None where it is to be cut."""
    middle = len(a) // 2
    there = None if b is None else b[middle]
    attained = min(known, _attained(a[middle], there, allowed, metric))
    cutoff = metric.reach(attained + margin) * (1.0 + SLACK)
    drift = np.mean(a, axis=(1, 2), keepdims=True)  # what all do together changes no distance
    boxes = _whole_boxes(a - drift)
    others = None if b is None else _whole_boxes(b - drift)
    if len(a) > 1:
        return few_close_pairs(boxes, others, cutoff, QUIET * bodies)
    moving = np.median(0.5 * np.max(np.ptp(a[0] - drift[0], axis=-1), axis=(1, 2)))
    if depth < MAX_DEPTH and moving > 0.25 * cutoff:
        return few_close_pairs(boxes, others, cutoff, CROWD * bodies)
    return close_pairs(boxes, others, cutoff)


def _near(
    a: Array, b: Array, pairs: Pairs, margin: float, metric: Metric
) -> tuple[Indices, Indices]:
    """Return (piece, pair) of those that some other one's distance does not rule out.

    By the boxes over each piece of (pieces, bodies, 1 or 2, 3, degree + 1), held against what the
    few pairs are apart in a piece's middle whose boxes come closest.
    """
    if kernels_on() and metric is DISTANCE and pairs:
        from hitchopt.compiled.near_kernel import near_pairs

        here, there, most = a.copy(), b.copy(), min(NEIGHBOURS, len(pairs))
        kept = near_pairs(here, there, pairs.first, pairs.second, margin, most, SLACK)
        piece, pair = np.nonzero(kept)
        return piece, pair
    with np.errstate(all="ignore"):  # what is no number rules nothing out
        drift = np.mean(a, axis=(1, 2), keepdims=True)  # what all do together changes no distance
        own = _boxes(a - drift)
        others = own if b is a else _boxes(b - drift)
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


def _boxes(corners: Array) -> Array:
    """Return the boxes (2, 3, pieces, bodies), lower and upper, of bodies (pieces, bodies, …)."""
    each = corners.transpose(2, 4, 3, 0, 1).reshape(-1, 3, *corners.shape[:2])  # of points
    return np.stack([each.min(axis=0), each.max(axis=0)])


def _whole_boxes(corners: Array) -> Boxes:
    """Return the boxes over all of the pieces of bodies (pieces, bodies, …)."""
    lower, upper = _boxes(corners)
    return Boxes(lower.min(axis=1).T, upper.max(axis=1).T)


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


def _attained(a: Array, b: Array | None, allowed: Allowed, metric: Metric) -> float:
    """Return a measure that some pair has in the middle of the span; near the smallest then."""
    half = bernstein.basis(np.array(0.5), a.shape[-1] - 1)
    here = a @ half
    there = here if b is None else b @ half
    nearest = min(NEIGHBOURS, len(there))
    _, j = cKDTree(np.mean(there, axis=1)).query(np.mean(here, axis=1), k=nearest)
    j = np.asarray(j, dtype=np.intp).ravel()
    i = np.repeat(np.arange(len(here)), nearest)
    counted = allowed(i, j) & ((i != j) if b is None else True)
    i, j = i[counted], j[counted]
    if len(i) == 0:
        return np.inf
    offsets = shortest_offset(differences(here[i], there[j]))
    return float(np.min(metric.measured(offsets)))


def _halves(corners: Array) -> tuple[Array, Array]:
    left, right = bernstein.halve(corners.reshape(-1, corners.shape[-1]))
    return left.reshape(corners.shape), right.reshape(corners.shape)


def _not_negative(found: Extremum) -> Extremum:
    """Return the same, bodies that touch being at distance zero, whatever the margin."""
    return Extremum(max(found.worst, 0.0), found.value, found.item, found.time)
