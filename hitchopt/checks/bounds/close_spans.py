"""Spans of time and the pairs of bodies that may be closest on them.

A span is searched for an attained distance first; only pairs whose boxes over it come at least as
close are listed, all others being farther apart for certain. Spans are several pieces where little
moves, and are halved where much does.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from hitchopt.checks.bounds.moving_bodies import SLACK, Allowed, Bodies, Metric, body_boxes
from hitchopt.geometry import differences, shortest_offset
from hitchopt.geometry.broadphase import Boxes, Pairs, close_pairs, few_close_pairs
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.extremum import Search
from hitchopt.values import Array

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


@dataclass(frozen=True, eq=False)
class Span:
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


def close_spans(
    breaks: Array,
    first: Bodies,
    second: Bodies | None,
    search: Search,
    allowed: Allowed,
    margin: float,
    metric: Metric,
) -> Iterator[Span]:
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
                yield Span(times, a, b, pairs.take(allowed(pairs.first, pairs.second)))
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


def _whole_boxes(corners: Array) -> Boxes:
    """Return the boxes over all of the pieces of bodies (pieces, bodies, …)."""
    lower, upper = body_boxes(corners)
    return Boxes(lower.min(axis=1).T, upper.max(axis=1).T)
