"""Minimum distances of moving bodies, for all t.

For a vector u of at most unit length, ``|a - b| ≥ u · (a - b)``, a polynomial. With u along the
shortest connection, turning with it, its smallest coefficient over the corners of both bodies is a
lower bound of their distance, tight to the third order of a span's length; at a point it is the
distance. For a body with a shape, its support function along u is subtracted.

For few bodies, bounding boxes of all pairs are compared, piece by piece: pairs farther apart than
an attained distance are excluded. For many bodies, a spatial index lists the close pairs of several
pieces at a time, and spans with too many of them are halved.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bodies import PLAN_AXES, Bodies
from hitchopt.checks.certificate import with_tolerance
from hitchopt.checks.rule import WorstCase
from hitchopt.checks.spans import UPWARD, magnitude, position_margin
from hitchopt.geometry import differences, hull_offset, shortest_offset
from hitchopt.geometry.broadphase import Boxes, Pairs, few_close_pairs
from hitchopt.geometry.vectors import unit
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.bernstein import same_degree
from hitchopt.trajectory.enclosed import Bound, Enclosed, largest_of
from hitchopt.trajectory.search import BranchAndBound, Extremum, TimeSpans
from hitchopt.values import Array, Indices, known, lazy

MAX_LISTED = 8000
"""Maximum number of pairs that are listed without an index, which then costs more than it saves."""

MAX_COMPARED = 32_768  # Maximum number of pairs times pieces that are compared at a time

MAX_SEEDS = 256
"""Number of pairs with the nearest boxes, whose distances at mid span exclude others."""

ROUGH_SEEDS = 32  # Number of these pairs where bounds suffice
NEIGHBOURS = 8  # Number of neighbours of each of many bodies among which these pairs are searched
MAX_PER_BODY = 12  # Number of pairs per body above which a span with moving bodies is halved
FAR = 0.25  # Bodies move far if they sweep boxes larger than this share of the reach of a search
MAX_DEPTH = 8  # Maximum number of halvings
TIE = 1e-6  # Largest relative difference of distances that tie
SLACK = 1e-9  # Relative margin of comparisons of boxes
GROUND = "ground"  # Name of the ground
UNBOUNDED = 1e3  # [m] Half size of bodies that model unbounded ones

Flags = NDArray[np.bool_]

UPRIGHT_TOLERANCE = 1e-3  # [m] Tightness of bounds of horizontal distances, or of heights


class Shape(Protocol):
    """A convex body at rest; by default the origin."""

    def normals(self, corners: Array) -> Array:
        """Return unit vectors (…, 3) from it to the nearest points of hulls (…, corners, 3)."""
        return unit(shortest_offset(corners))

    def support(self, directions: Array) -> Array:
        """Return the support function (…) [m] along directions (…, 3)."""
        return np.zeros(directions.shape[:-1])

    def flattened(self, ratio: float) -> Shape:  # noqa: ARG002
        """Return the body with heights divided by a ratio; by default, no height matters."""
        return self


class Origin(Shape):
    """The origin: distances of bodies are those of their Minkowski difference from it."""


@dataclass(frozen=True)
class Ground(Shape):
    """The half-space below a height [m]."""

    height: float

    def normals(self, corners: Array) -> Array:
        """Return the upward direction (…, 3)."""
        return np.broadcast_to(UPWARD, (*corners.shape[:-2], 3))

    def support(self, directions: Array) -> Array:
        """Return the support function (…) [m] along directions (…, 3)."""
        x, y, z = np.moveaxis(directions, -1, 0)
        upward = np.maximum(z, 0.0)
        downward = np.maximum(-z, 0.0)
        return np.asarray(UNBOUNDED * (np.abs(x) + np.abs(y) + downward) + self.height * upward)

    def flattened(self, ratio: float) -> Ground:
        """Return the half-space with heights divided by a ratio."""
        return Ground(self.height / ratio)


@dataclass(frozen=True)
class Hulls(Origin):
    """The origin, for differences in plan view of two hulls with numbers of corners."""

    corners: tuple[int, int]

    def normals(self, corners: Array) -> Array:
        """Return unit vectors (…, 3) between hulls with differences (…, k · m, 3) [m]."""
        level = corners[..., :2].reshape(*corners.shape[:-2], *self.corners, 2)
        offsets = hull_offset(level)
        return unit(np.concatenate([offsets, np.zeros_like(offsets[..., :1])], axis=-1))


ORIGIN = Origin()

AXES = np.eye(3)  # Directions of the axes


def distance(a: Array, b: Array, shape: Shape = ORIGIN) -> Bound:
    """Return the distances of bodies with corners (spans, k, 3, degree + 1) [m], at least 0.

    They are bounded along n, the quadratic through the directions of the shortest connections at
    three points. As ``|n| ≤ (1 + |n|²) / 2``, the smallest ratio of coefficients is a lower bound.
    """
    order = 2 if a.shape[-1] + b.shape[-1] > 2 else 0  # constants have one node
    normals = shape.normals(differences(_at_nodes(a, order), _at_nodes(b, order)))
    n = bernstein.interpolate(normals.transpose(1, 2, 0))
    nearest_of_a = np.minimum.reduce(bernstein.dot(n[:, None], a), axis=1)
    farthest_of_b = np.maximum.reduce(bernstein.dot(n[:, None], b), axis=1)
    squared_size = bernstein.dot(n, n)
    near, far, squares, reach = same_degree(
        nearest_of_a, farthest_of_b, squared_size, shape.support(n.mT)
    )
    largest_sizes = 0.5 + 0.5 * np.maximum(squares, 0.0)
    ratios = np.maximum((near - far - reach) / largest_sizes, 0.0)
    lower = np.minimum.reduce(ratios, axis=-1)
    # If locations tie, as for bodies that come to rest, an end is reported.
    ties = ratios <= (1.0 + TIE) * lower[:, None]
    degree = ratios.shape[-1] - 1
    inner = ratios.argmin(axis=-1) / max(degree, 1)
    return Bound(lower, np.where(ties[:, 0], 0.0, np.where(ties[:, -1], 1.0, inner)))


def _at_nodes(corners: Array, order: int) -> Array:
    """Return corners (spans, k, 3, degree + 1) at the nodes of an order (nodes, spans, k, 3)."""
    nodes = bernstein.at_nodes(order, bernstein.degree(corners))
    return np.asarray(bernstein.transform(corners, nodes).transpose(3, 0, 1, 2))


def gap(spans: PairSpans) -> Bound:
    """Return the distances of the bodies [m], zero if they touch."""
    distances = distance(*spans.ends, spans.source.shape)
    return Bound(np.maximum(distances.value - spans.source.margin, 0.0), distances.x)


def upright_distance(spans: PairSpans, outlines: tuple[int, int] = (2, 2)) -> Bound:
    """Return the horizontal distance of bodies, or the difference of their heights if larger.

    In plan view, each body is in the hull of its first ``outlines`` corners.
    """
    first, second = spans.ends
    first_outline = first[:, : outlines[0]] * PLAN_AXES
    second_outline = second[:, : outlines[1]] * PLAN_AXES
    corners = first_outline.shape[1], second_outline.shape[1]
    shape = Hulls(corners) if max(corners) > 2 else ORIGIN
    plan_distance = distance(first_outline, second_outline, shape)
    margin = spans.source.margin
    horizontal = Bound(np.maximum(plan_distance.value - margin, 0.0), plan_distance.x)
    heights = first[:, :, None, 2] - second[:, None, :, 2]  # (spans, k, l, degree + 1)
    heights = heights.reshape(len(heights), -1, heights.shape[-1])
    above = Enclosed(np.min(heights, axis=1, keepdims=True), margin)
    below = Enclosed(np.min(-heights, axis=1, keepdims=True), margin)
    return largest_of([horizontal, above.lower, below.lower])


@dataclass(frozen=True, eq=False)
class Moving:
    """Moving bodies, as hulls of corners, and the pairs of them that are checked."""

    breaks: Array  # (pieces + 1,) [s], ends of pieces
    # (pieces, bodies, corners, 3, degree + 1) [m], corners of the first group of bodies
    first: Array
    # Corners of the second group, in the same shape; None for pairs i < j within the first one
    second: Array | None = None
    margin: float = 0.0  # [m] Rounding error, which is subtracted from distances
    # Predicate of pairs (first, second) that are compared; None for all
    allowed: Callable[[Indices, Indices], Flags] | None = None
    matched: bool = False  # True if only pairs of bodies with the same number are compared
    shape: Shape = ORIGIN  # The body from which differences of two positions keep a distance
    # (pieces, bodies), whether bodies of the first group are compared on a piece; None for all
    active: Flags | None = None
    # (bodies,) [m], lengths of cables that hang between both corners of the first group
    lengths: Array | None = None
    # Names of the bodies of both groups, or empty; hanging cables are named last
    names: tuple[Sequence[str], Sequence[str]] = ((), ())
    formula: Callable[[PairSpans], Bound] = gap  # Bound of the distance of pairs
    # [m] Tightness of bounds of distances; None if the limit determines it
    tolerance: float | None = None
    # Divisor of heights of hanging cables and their shape in the formula; see ``flattened``
    height_ratio: float = 1.0

    @classmethod
    def between(
        cls,
        motion: Motion,
        first: Bodies,
        second: Bodies | None = None,
        *,
        margin: float | None = None,
        **options: Any,
    ) -> Moving:
        """Return the pairs of bodies of two kinds on the pieces of a motion, or of one kind.

        Vertical regions are compared by ``upright_distance``. The default rounding error is that of
        the motion.
        """
        other = second or first
        first_corners, other_corners = same_degree(first.corners, other.corners)
        second_corners = None if second is None else other_corners
        is_upright = bool(first.outline or other.outline)
        if is_upright and "shape" not in options and "formula" not in options:
            outlines = (
                first.outline or first.corners.shape[2],
                other.outline or other.corners.shape[2],
            )
            options["formula"] = partial(upright_distance, outlines=outlines)
            options.setdefault("tolerance", UPRIGHT_TOLERANCE)
        masks = [bodies.pieces for bodies in (first, other) if bodies.pieces is not None]
        if masks and "active" not in options:
            counts = np.all(masks, axis=0)
            options["active"] = np.repeat(counts[:, None], first_corners.shape[1], axis=1)
        options.setdefault("names", (first.names, other.names))
        if margin is None:
            margin = position_margin(motion)
        return cls(motion.drones.breaks, first_corners, second_corners, margin, **options)

    def flattened(self, ratio: float) -> Moving:
        """Return the bodies with heights divided by a ratio.

        Corners of hanging cables are not changed: their shape follows from these and their lengths.
        """
        if ratio == 1.0:
            return self
        if self.lengths is not None:
            return replace(self, height_ratio=ratio)
        scale = np.array([1.0, 1.0, 1.0 / ratio])[:, None]
        second = None if self.second is None else self.second * scale
        shape = self.shape.flattened(ratio)
        return replace(self, first=self.first * scale, second=second, shape=shape)

    def pair_names(self, item: int) -> tuple[str, ...]:
        """Return the names of a pair."""
        first, second = divmod(item, self.count)
        pair = self.names[0][first], self.names[1][second]
        in_order = pair if self.lengths is None else pair[::-1]
        return tuple(filter(None, in_order))

    @lazy
    def others(self) -> Array:
        """The second group."""
        return self.first if self.second is None else self.second

    @lazy
    def count(self) -> int:
        """Size of the second group: item ``i * count + j`` is a pair."""
        return int(self.others.shape[1])

    @property
    def pairs(self) -> Pairs | None:
        """All pairs to compare; None if there are too many to list."""
        if self.matched:
            bodies = np.arange(self.count)
            return self.select(bodies, bodies)
        total = self.first.shape[1] * self.count
        if total > MAX_LISTED:
            return None
        first, second = np.divmod(np.arange(total), self.count)
        return self.select(first, second)

    def select(self, first: Indices, second: Indices) -> Pairs:
        """Return the pairs to compare."""
        counts = np.ones(len(first), dtype=np.bool_)
        if self.second is None:
            counts = first < second
        if self.allowed is not None:
            counts &= self.allowed(first, second)
        return Pairs(first[counts], second[counts])

    @lazy
    def boxes(self) -> tuple[Array, Array]:
        """Bounding boxes (2, 3, bodies, pieces) of the bodies of each group.

        They are relative to the mean position: common motion changes no distance.
        """
        corners = self.first.shape[1] * self.first.shape[2]
        mean_position = np.add.reduce(self.first, axis=(1, 2), keepdims=True) / corners
        first = _boxes(self.first - mean_position)
        if self.lengths is not None:
            # No cable hangs deeper than one that leads straight down and up again.
            heights = (self.first - mean_position)[:, :, :, 2]
            height_sum = np.sum(np.min(heights, axis=-1), axis=-1)
            first[0, 2] = np.minimum(first[0, 2], 0.5 * (height_sum - self.lengths).T)
        second = first if self.second is None else _boxes(self.second - mean_position)
        if self.height_ratio != 1.0:
            first[:, 2] /= self.height_ratio
            if second is not first:
                second[:, 2] /= self.height_ratio
        return first, second

    @property
    def extent(self) -> Array:
        """Lower and upper corner (2, 3) [m] of the shape's bounding box."""
        shape = self.shape.flattened(self.height_ratio)
        return np.array([-shape.support(-AXES), shape.support(AXES)])

    def gaps(self, pairs: Pairs) -> Array:
        """Return lower bounds (pieces, pairs) [m] of distances, from the boxes of pairs."""
        boxes, other_boxes = self.boxes
        lower, upper = boxes
        shape_lower, shape_upper = self.extent[..., None, None]
        grown_lower = lower - shape_upper
        grown_upper = upper - shape_lower
        other_lower, other_upper = other_boxes
        squares = np.zeros((len(pairs), lower.shape[-1]))
        for axis in range(3):  # arrays of all three would not fit into the caches
            offsets = grown_lower[axis].take(pairs.first, axis=0)
            offsets -= other_upper[axis].take(pairs.second, axis=0)
            opposite = other_lower[axis].take(pairs.second, axis=0)
            opposite -= grown_upper[axis].take(pairs.first, axis=0)
            np.maximum(offsets, opposite, out=offsets)
            np.maximum(offsets, 0.0, out=offsets)
            offsets *= offsets
            squares += offsets
        gaps = np.ascontiguousarray(np.sqrt(squares).T)
        if self.active is not None:
            gaps[~self.active[:, pairs.first]] = np.inf
        return gaps

    def part(self, start: int, stop: int) -> Moving:
        """Return the bodies on a run of pieces."""
        run = slice(start, stop)
        return replace(
            self,
            breaks=self.breaks[start : stop + 1],
            first=self.first[run],
            second=None if self.second is None else self.second[run],
            active=None if self.active is None else self.active[run],
        )

    def halves(self) -> tuple[Moving, Moving]:
        """Return both halves of the pieces, or of a single piece."""
        pieces = len(self.first)
        if pieces > 1:
            return self.part(0, pieces // 2), self.part(pieces // 2, pieces)
        start, end = self.breaks
        times = np.array([start, 0.5 * (start + end), end])
        first, later_first = bernstein.halve(self.first)
        second, later_second = None, None
        if self.second is not None:
            second, later_second = bernstein.halve(self.second)
        return (
            replace(self, breaks=times[:2], first=first, second=second),
            replace(self, breaks=times[1:], first=later_first, second=later_second),
        )


def _boxes(corners: Array) -> Array:
    """Return boxes (2, 3, bodies, pieces) of corners (pieces, bodies, k, 3, degree + 1) [m]."""
    points = corners.transpose(2, 4, 3, 1, 0).reshape(-1, 3, *corners.shape[1::-1])
    return np.array([np.minimum.reduce(points), np.maximum.reduce(points)])


class PairSpans(TimeSpans):
    """Spans of pairs of moving bodies."""

    source: Moving

    @lazy
    def ends(self) -> tuple[Array, Array]:
        """Corners (spans, corners, 3, degree + 1) [m] of both bodies."""
        first, second = divmod(self.item, self.source.count)
        return self.read(self.source.first, first), self.read(self.source.others, second)

    @property
    def lengths(self) -> Array:
        """Lengths (spans,) [m] of hanging cables."""
        return known(self.source.lengths)[self.item // self.source.count]


def near_pairs(
    moving: Moving, attained: Callable[[], float], depth: int = 0, *, rough: bool = False
) -> Iterator[PairSpans]:
    """Yield spans of all pairs that may be closer than the smallest attained distance.

    ``attained`` is called again after every yield. Points at which some pairs are near come first;
    if bounds suffice (``rough``), the spans of some near pairs.
    A single piece is halved, up to a ``depth``, if the index lists many pairs of moving bodies.
    """
    pairs = moving.pairs
    pieces = len(moving.first)
    bodies = moving.first.shape[1] + moving.count
    compared = pieces * (bodies if pairs is None else len(pairs))
    is_split = pieces > 1 and compared > MAX_COMPARED
    if pairs is None and not is_split:
        move_far = False
        if attained() < np.inf:  # what is near for the distance attained so far is often little
            pairs, move_far = _listed(moving, attained())
        if pairs is None and not (move_far and depth < MAX_DEPTH):
            yield from _nearest_neighbours(moving, attained)
            pairs, _ = _listed(moving, attained(), depth)
    if is_split or pairs is None:
        for half in moving.halves():
            yield from near_pairs(half, attained, depth + (pieces == 1), rough=rough)
    else:
        yield from _compared(moving, attained, pairs, rough=rough)


class Listed(NamedTuple):
    """Pairs of close boxes from a spatial index."""

    pairs: Pairs | None  # The pairs; None if there are too many
    # True if bodies move far in comparison with the reach, so that halves have fewer pairs
    move_far: bool


def _listed(moving: Moving, reach: float, depth: int | None = None) -> Listed:
    """Return the pairs of boxes within a reach [m].

    There are never too many for a single piece at a ``depth`` that is not halved again.
    """
    first, others = (Boxes(box[0].min(axis=2).T, box[1].max(axis=2).T) for box in moving.boxes)
    reach = (reach + moving.margin) * (1.0 + SLACK)
    reach += float(np.max(np.linalg.norm(moving.extent, axis=-1)))
    move_far = bool(np.median(first.sizes) > FAR * reach)
    is_last = len(moving.first) == 1 and (depth == MAX_DEPTH or not move_far)
    is_limited = depth is None or not is_last
    max_pairs = MAX_PER_BODY * (len(first) + len(others)) if is_limited else np.inf
    second = None if moving.second is None else others
    close = few_close_pairs(first, second, reach * (1.0 + SLACK), max_pairs)
    pairs = None if close is None else moving.select(close.first, close.second)
    return Listed(pairs, move_far)


def _compared(
    moving: Moving, attained: Callable[[], float], pairs: Pairs, *, rough: bool = False
) -> Iterator[PairSpans]:
    """Yield the spans of pairs whose boxes are near, the nearest ones at mid span first."""
    gaps = moving.gaps(pairs)
    item = pairs.first * moving.count + pairs.second
    seeds = ROUGH_SEEDS if rough else MAX_SEEDS
    if gaps.size > seeds:
        flat_gaps = gaps.ravel()
        near = flat_gaps.argpartition(seeds)[:seeds]
        near.sort()
        near = near[flat_gaps[near] < np.inf]
        piece, pair = divmod(near, gaps.shape[1])
        spans = PairSpans(moving, moving.breaks, piece, item[pair])
        if rough:
            yield spans
            flat_gaps[near] = np.inf  # not again
        else:
            yield spans.at(0.5)
    cutoff = min((attained() + moving.margin) * (1.0 + SLACK), sys.float_info.max)
    is_far = gaps > cutoff  # nan excludes nothing
    piece, pair = (~is_far).nonzero()
    yield PairSpans(moving, moving.breaks, piece, item[pair])


def _nearest_neighbours(moving: Moving, attained: Callable[[], float]) -> Iterator[PairSpans]:
    """Yield some of the nearest pairs of many bodies on the middle piece."""
    from scipy.spatial import cKDTree

    middle = len(moving.first) // 2
    part = moving.part(middle, middle + 1)
    centres, other_centres = (boxes[..., 0].mean(axis=0).T for boxes in part.boxes)
    _, neighbours = cKDTree(other_centres).query(centres, k=min(NEIGHBOURS, moving.count))
    second = neighbours.reshape(len(centres), -1)
    first = np.repeat(np.arange(len(centres)), second.shape[1])
    yield from _compared(part, attained, moving.select(first, second.ravel()))


def smallest(moving: Moving, **options: float) -> Extremum:
    """Return the minimum distance of all compared pairs, with options of ``BranchAndBound``.

    Without a pair, it is infinite and the item is -1.
    """
    search: BranchAndBound[PairSpans] = BranchAndBound(moving.formula, "min", **options)
    for spans in near_pairs(moving, lambda: search.attained, rough=search.rough):
        search.add(spans)
        if search.attained <= search.absolute:  # the bodies touch: no pair is worse
            return Extremum(0.0, search.attained, search.item, search.time)
    return search.finish()


def nearest(
    cases: Callable[[Motion], Iterable[Moving]], *, scaled: bool = False
) -> Callable[[Motion, float], WorstCase]:
    """Return a function that evaluates the minimum distance over several cases of bodies.

    Heights are divided by ``Requirements.height_ratio``, except in ``scaled`` coordinates.
    """

    def evaluate(motion: Motion, limit: float) -> WorstCase:
        ratio = 1.0 if scaled else motion.requirements.height_ratio
        flattened = (moving.flattened(ratio) for moving in cases(motion))
        return nearest_of(flattened, limit, magnitude(motion))

    return evaluate


def nearest_of(cases: Iterable[Moving], limit: float, size: float) -> WorstCase:
    """Return the minimum distance over several cases of bodies; infinite without any.

    ``limit`` is that of the distance, ``size`` the largest length that enters [m].
    """
    target = with_tolerance(limit, "min", size, 0.5)
    best = WorstCase(math.inf, 0.0, size=size)
    for moving in cases:
        tolerance = moving.tolerance
        if tolerance is None:
            pair = smallest(moving, target=target, incumbent=best.worst)
        else:  # the answer only depends on the time span
            pair = smallest(moving, relative=tolerance, absolute=tolerance)
        best = smaller_case(best, max(pair.worst, 0.0), moving, pair)
    return best


def smaller_case(case: WorstCase, value: float, moving: Moving, pair: Extremum) -> WorstCase:
    """Return a case, or the smaller value that follows from the smallest distance of pairs.

    If no pair attains a smaller one, a search from the case has still not excluded values down
    to its bound: the case keeps its bodies with that bound.
    """
    if not value < case.worst:
        return case
    if pair.item < 0:
        return replace(case, worst=value)
    return replace(case, worst=value, time=pair.time, where=moving.pair_names(pair.item))
