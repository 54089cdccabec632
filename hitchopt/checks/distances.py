"""Minimum distances of moving bodies, for all t; checks ``separation`` and ``crossing``.

``closeness`` lists the closest pairs of drones of a plan.

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
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bodies import Bodies, clasped_cables, taut_parts
from hitchopt.checks.certificate import Check, with_tolerance
from hitchopt.checks.rule import (
    Approach,
    CheckRule,
    Evaluator,
    WorstCase,
    largest_error,
)
from hitchopt.checks.spans import (
    ROUNDING,
    UPWARD,
    cable_names,
    clasped_pairs,
    flight_magnitude,
    magnitude,
    pair_of,
    phase_parts,
    position_margin,
)
from hitchopt.errors import InputError, OneLine
from hitchopt.geometry import differences, hull_offset, shortest_offset
from hitchopt.geometry.broadphase import Boxes, Pairs, few_close_pairs
from hitchopt.geometry.vectors import unit
from hitchopt.hitch.pairs import CROSSING as CROSSING_PAIR
from hitchopt.hitch.pairs import DISTANCES, TautBodies
from hitchopt.hitch.requirements import Separation
from hitchopt.hitch.team import Layout
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import CLASPED_STATES, FREE_STATES, TAUT_STATES, CableState, Motion
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.bernstein import same_degree
from hitchopt.trajectory.enclosed import Bound, Enclosed, largest_of
from hitchopt.trajectory.piecewise import merged_breaks, on_breaks
from hitchopt.trajectory.search import BranchAndBound, Extremum, TimeSpans
from hitchopt.values import Array, Indices, known, lazy

# Maximum number of pairs that are listed without an index, which then costs more than it saves
MAX_LISTED = 8000
MAX_COMPARED = 32_768  # Maximum number of pairs times pieces that are compared at a time
# Number of pairs with the nearest boxes, whose distances at mid span exclude others
MAX_SEEDS = 256
NEIGHBOURS = 8  # Number of neighbours of each of many bodies among which these pairs are searched
ROUGH_SEEDS = 32  # the same where bounds suffice
MAX_PER_BODY = 12  # Number of pairs per body above which a span with moving bodies is halved
MAX_DEPTH = 8  # Maximum number of halvings
TIE = 1e-6  # Largest relative difference of distances that tie
SLACK = 1e-9  # Relative margin of comparisons of boxes
GROUND = "ground"  # Name of the ground
UNBOUNDED = 1e3  # Half size of bodies that model unbounded ones [m]
Flags = NDArray[np.bool_]


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
        down, up = np.maximum(-z, 0.0), np.maximum(z, 0.0)
        return np.asarray(UNBOUNDED * (np.abs(x) + np.abs(y) + down) + self.height * up)

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
PLAN_AXES = np.array([1.0, 1.0, 0.0])[:, None]  # Factors of coordinates, seen from above


def distance(a: Array, b: Array, shape: Shape = ORIGIN) -> Bound:
    """Return the distances of bodies with corners (spans, k, 3, degree + 1) [m], at least 0.

    They are bounded along n, the quadratic through the directions of the shortest connections at
    three points. As ``|n| ≤ (1 + |n|²) / 2``, the smallest ratio of coefficients is a lower bound.
    """
    nodes = 2 if a.shape[-1] + b.shape[-1] > 2 else 0  # a single one at a point
    samples = [
        bernstein.transform(c, bernstein.at_nodes(nodes, c.shape[-1] - 1)).transpose(3, 0, 1, 2)
        for c in (a, b)
    ]
    normals = shape.normals(differences(*samples))
    n = bernstein.interpolate(normals.transpose(1, 2, 0))
    along, farthest, sizes, reach = bernstein.same_degree(
        np.minimum.reduce(bernstein.dot(n[:, None], a), axis=1),
        np.maximum.reduce(bernstein.dot(n[:, None], b), axis=1),
        bernstein.dot(n, n),
        shape.support(n.mT),
    )
    ratios = np.maximum((along - farthest - reach) / (0.5 + 0.5 * np.maximum(sizes, 0.0)), 0.0)
    lower = np.minimum.reduce(ratios, axis=-1)
    # If locations tie, as for bodies that come to rest, an end is reported.
    at_start, at_end = ((ratios <= (1.0 + TIE) * lower[:, None])[:, i] for i in (0, -1))
    interior = ratios.argmin(axis=-1) / (ratios.shape[-1] - 1 or 1)
    return Bound(lower, np.where(at_start, 0.0, np.where(at_end, 1.0, interior)))


def gap(spans: PairSpans) -> Bound:
    """Return the distances of the bodies [m], zero if they touch."""
    distances = distance(*spans.ends, spans.source.shape)
    return Bound(np.maximum(distances.value - spans.source.margin, 0.0), distances.x)


def upright_distance(spans: PairSpans, outlines: tuple[int, int] = (2, 2)) -> Bound:
    """Return the horizontal distance of bodies, or the difference of their heights if larger.

    In plan view, each body is in the hull of its first ``outlines`` corners.
    """
    a, b = spans.ends
    first, second = (c[:, :count] * PLAN_AXES for c, count in zip((a, b), outlines, strict=True))
    counts = first.shape[1], second.shape[1]
    plan_distance = distance(first, second, Hulls(counts) if max(counts) > 2 else ORIGIN)
    margin = spans.source.margin
    horizontal = Bound(np.maximum(plan_distance.value - margin, 0.0), plan_distance.x)
    heights = a[:, :, None, 2] - b[:, None, :, 2]  # (spans, k, l, degree + 1)
    heights = heights.reshape(len(heights), -1, heights.shape[-1])
    over, under = (np.min(sign * heights, axis=1, keepdims=True) for sign in (1.0, -1.0))
    return largest_of([horizontal, *(Enclosed(each, margin).lower for each in (over, under))])


@dataclass(frozen=True, eq=False)
class Moving:
    """Moving bodies, as hulls of corners, and the pairs of them that are checked."""

    breaks: Array  # (pieces + 1,) [s]
    first: Array  # (pieces, bodies, corners, 3, degree + 1) [m]
    # corners of the other group; None for pairs i < j within the first group
    second: Array | None = None
    margin: float = 0.0  # rounding error, subtracted from distances [m]
    # predicate of pairs (first, second) that count; None for all
    allowed: Callable[[Indices, Indices], Flags] | None = None
    matched: bool = False  # whether only pairs of bodies with the same number count
    shape: Shape = ORIGIN  # body from which differences of two positions keep a distance
    # (pieces, bodies), pieces on which the first group counts; None for all
    active: Flags | None = None
    # (bodies,) [m], lengths of cables that hang between both corners of the first group
    lengths: Array | None = None
    # names of the bodies of both groups, or empty; hanging cables are named last
    names: tuple[Sequence[str], Sequence[str]] = ((), ())
    formula: Callable[[PairSpans], Bound] = gap  # bound of the distance of pairs
    # tightness of bounds of distances [m]; None if the limit determines it
    tolerance: float | None = None
    # by which the formula divides heights of hanging cables and their shape; see ``flattened``
    height_ratio: float = 1.0

    @classmethod
    def of(
        cls, motion: Motion, first: Array, second: Array | None = None, **options: Any
    ) -> Moving:
        """Return bodies on the pieces of a motion, with its rounding error."""
        return cls(motion.drones.breaks, first, second, position_margin(motion), **options)

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

        Upright regions are compared by ``upright_distance``. The default rounding error is that of
        the motion.
        """
        corners = [each.corners for each in (first, second) if each is not None]
        a, *b = same_degree(*corners)
        other = second or first
        if "shape" not in options and "formula" not in options and first.outline + other.outline:
            counts = (first.outline or a.shape[2], other.outline or corners[-1].shape[2])
            options["formula"] = partial(upright_distance, outlines=counts)
            options.setdefault("tolerance", UPRIGHT_TOLERANCE)
        masks = [each.pieces for each in (first, other) if each.pieces is not None]
        if masks and "active" not in options:
            options["active"] = np.repeat(np.all(masks, axis=0)[:, None], a.shape[1], axis=1)
        values = {"names": (first.names, other.names)} | options
        off = position_margin(motion) if margin is None else margin
        return cls(motion.drones.breaks, a, b[0] if b else None, off, **values)

    def flattened(self, ratio: float) -> Moving:
        """Return the bodies with heights divided by a ratio.

        Corners of hanging cables are not changed: their shape follows from these and their lengths.
        """
        if ratio == 1.0 or self.lengths is not None:
            return self if ratio == 1.0 else replace(self, height_ratio=ratio)
        scale = np.array([1.0, 1.0, 1.0 / ratio])[:, None]
        second = None if self.second is None else self.second * scale
        shape = self.shape.flattened(ratio)
        return replace(self, first=self.first * scale, second=second, shape=shape)

    def pair_names(self, item: int) -> tuple[str, ...]:
        """Return the names of a pair."""
        i, j = divmod(item, self.count)
        pair = self.names[0][i], self.names[1][j]
        return tuple(filter(None, pair if self.lengths is None else pair[::-1]))

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
        """All pairs that count; None if there are too many to list."""
        if self.matched:
            return self.select(*np.tile(np.arange(self.count), (2, 1)))
        total = self.first.shape[1] * self.count
        return None if total > MAX_LISTED else self.select(*np.divmod(np.arange(total), self.count))

    def select(self, first: Indices, second: Indices) -> Pairs:
        """Return the pairs that count."""
        on = first < second if self.second is None else np.ones(len(first), dtype=np.bool_)
        if self.allowed is not None:
            on &= self.allowed(first, second)
        return Pairs(first[on], second[on])

    @lazy
    def boxes(self) -> tuple[Array, Array]:
        """Bounding boxes (2, 3, pieces, bodies) of the bodies of each group.

        They are relative to the mean position: common motion changes no distance.
        """
        count = self.first.shape[1] * self.first.shape[2]
        drift = np.add.reduce(self.first, axis=(1, 2), keepdims=True) / count
        first = _boxes(self.first - drift)
        if self.lengths is not None:
            # No cable hangs deeper than one that leads straight down and up again.
            ends = np.sum(np.min((self.first - drift)[:, :, :, 2], axis=-1), axis=-1)
            first[0, 2] = np.minimum(first[0, 2], 0.5 * (ends - self.lengths))
        second = first if self.second is None else _boxes(self.second - drift)
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
        lower, upper = boxes.take(pairs.first, axis=3)
        other_lower, other_upper = other_boxes.take(pairs.second, axis=3)
        shape_lower, shape_upper = self.extent[..., None, None]
        offsets = np.maximum(lower - other_upper - shape_upper, other_lower - upper + shape_lower)
        np.maximum(offsets, 0.0, out=offsets)
        gaps: Array = np.sqrt(np.add.reduce(offsets * offsets))
        if self.active is not None:
            gaps[~self.active[:, pairs.first]] = np.inf
        return gaps

    def part(self, start: int, stop: int) -> Moving:
        """Return the bodies on a run of pieces."""
        breaks, cut = self.breaks[start : stop + 1], slice(start, stop)
        second = None if self.second is None else self.second[cut]
        active = None if self.active is None else self.active[cut]
        return replace(self, breaks=breaks, first=self.first[cut], second=second, active=active)

    def halves(self) -> tuple[Moving, Moving]:
        """Return both halves of the pieces, or of a single piece."""
        pieces = len(self.first)
        if pieces > 1:
            return self.part(0, pieces // 2), self.part(pieces // 2, pieces)
        start, end = self.breaks
        times = np.array([start, 0.5 * (start + end), end])
        seconds = (None, None) if self.second is None else bernstein.halve(self.second)
        firsts = bernstein.halve(self.first)
        one, other = (
            replace(self, breaks=times[i : i + 2], first=firsts[i], second=seconds[i])
            for i in (0, 1)
        )
        return one, other


def _boxes(corners: Array) -> Array:
    """Return boxes (2, 3, pieces, bodies) of corners (pieces, bodies, k, 3, degree + 1) [m]."""
    each = corners.transpose(2, 4, 3, 0, 1).reshape(-1, 3, *corners.shape[:2])  # of points
    return np.array([np.minimum.reduce(each), np.maximum.reduce(each)])


class PairSpans(TimeSpans):
    """Spans of pairs of moving bodies."""

    source: Moving

    @lazy
    def ends(self) -> tuple[Array, Array]:
        """Corners (spans, corners, 3, degree + 1) [m] of both bodies."""
        i, j = divmod(self.item, self.source.count)
        return self.read(self.source.first, i), self.read(self.source.others, j)

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
    pairs, pieces = moving.pairs, len(moving.first)
    bodies = moving.first.shape[1] + moving.count
    split = pieces > 1 and pieces * (bodies if pairs is None else len(pairs)) > MAX_COMPARED
    if pairs is None and not split:
        is_moving = False
        if attained() < np.inf:  # what is near for the distance attained so far is often little
            pairs, is_moving = _listed(moving, attained())
        if pairs is None and not (is_moving and depth < MAX_DEPTH):
            yield from _nearest_neighbours(moving, attained)
            pairs, _ = _listed(moving, attained(), depth)
    if split or pairs is None:
        for half in moving.halves():
            yield from near_pairs(half, attained, depth + (pieces == 1), rough=rough)
    else:
        yield from _compared(moving, attained, pairs, rough=rough)


def _listed(moving: Moving, reach: float, depth: int | None = None) -> tuple[Pairs | None, bool]:
    """Return the pairs of boxes within a reach [m], and whether bodies move far in comparison.

    Pairs are None if there are too many, unless a single piece at a ``depth`` is not halved again.
    """
    first, others = (Boxes(b[0].min(axis=1).T, b[1].max(axis=1).T) for b in moving.boxes)
    reach = (reach + moving.margin) * (1.0 + SLACK)
    reach += float(np.max(np.linalg.norm(moving.extent, axis=-1)))
    is_moving = bool(np.median(first.sizes) > 0.25 * reach)
    final = depth is not None and len(moving.first) == 1 and (depth == MAX_DEPTH or not is_moving)
    limit = np.inf if final else MAX_PER_BODY * (len(first) + len(others))
    second = None if moving.second is None else others
    close = few_close_pairs(first, second, reach * (1.0 + SLACK), limit)
    return None if close is None else moving.select(close.first, close.second), is_moving


def _compared(
    moving: Moving, attained: Callable[[], float], pairs: Pairs, *, rough: bool = False
) -> Iterator[PairSpans]:
    """Yield the spans of pairs whose boxes are near, the nearest ones at mid span first."""
    gaps, item = moving.gaps(pairs), pairs.first * moving.count + pairs.second
    count = ROUGH_SEEDS if rough else MAX_SEEDS
    if gaps.size > count:
        flat = gaps.ravel()
        seeds = flat.argpartition(count)[:count]
        seeds.sort()
        seeds = seeds[flat[seeds] < np.inf]
        piece, pair = divmod(seeds, gaps.shape[1])
        spans = PairSpans(moving, moving.breaks, piece, item[pair])
        yield spans if rough else spans.at(0.5)
        flat[seeds if rough else []] = np.inf
    cutoff = min((attained() + moving.margin) * (1.0 + SLACK), sys.float_info.max)
    piece, pair = (~(gaps > cutoff)).nonzero()  # nan excludes nothing
    yield PairSpans(moving, moving.breaks, piece, item[pair])


def _nearest_neighbours(moving: Moving, attained: Callable[[], float]) -> Iterator[PairSpans]:
    """Yield some of the nearest pairs of many bodies on the middle piece."""
    from scipy.spatial import cKDTree

    middle = len(moving.first) // 2
    part = moving.part(middle, middle + 1)
    centres, other_centres = (boxes[:, :, 0].mean(axis=0).T for boxes in part.boxes)
    _, neighbours = cKDTree(other_centres).query(centres, k=min(NEIGHBOURS, moving.count))
    second = neighbours.reshape(len(centres), -1)
    first = np.repeat(np.arange(len(centres)), second.shape[1])
    yield from _compared(part, attained, moving.select(first, second.ravel()))


def smallest(moving: Moving, **options: float) -> Extremum:
    """Return the minimum distance of all pairs that count, with options of ``BranchAndBound``.

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
    target, best = with_tolerance(limit, "min", size, 0.5), WorstCase(math.inf, 0.0, size=size)
    for moving in cases:
        tolerance = moving.tolerance
        if tolerance is None:
            pair = smallest(moving, target=target, incumbent=best.worst)
        else:  # the answer only depends on the time span
            pair = smallest(moving, relative=tolerance, absolute=tolerance)
        value = max(pair.worst, 0.0)
        if value < best.worst and pair.item < 0:  # no attained distance is smaller
            best = replace(best, worst=value)
        elif value < best.worst:
            best = WorstCase(value, pair.time, moving.pair_names(pair.item), size)
    return best


# Changes that separate a drone from another one, or from a cable, of one hitch
LONGER_LEGS = "use a longer cable or a smaller polygon"
LARGER_POLYGON = "a larger polygon"
OTHER_LEGS = "change leg lengths by another cable length or polygon size"

PARALLEL = 0.02
"""Largest component along an edge, of the difference of unit vectors along the legs beyond it, up
to which both legs are parallel: lengths of cables then have no effect on their distance."""


def leg_remedy(motion: Motion, check: Check, distance: str) -> str:
    """Return what separates two drones, or a drone and a cable, of one hitch; empty for others.

    ``distance`` is the key of the limit. A leg continues the next edge of the polygon. With
    exterior angle τ at both ends of an edge e and a cable of length L, the drones of that cable are
    ``e (1 + cos τ) - L cos τ`` apart: always farther on a larger polygon; on a shorter cable where
    their legs converge (τ < 90°: polygons of five vertices or more), on a longer one where they
    diverge (triangles). From the edges that meet at its vertex, and from the other drone there, a
    drone is the farther the longer the legs are.
    """
    change = _leg_change(motion, check)
    return change and f"{change}, or allow a smaller {distance}"


def _leg_change(motion: Motion, check: Check) -> str:
    """Return the change of a cable's length, or of the polygon, that increases a distance."""
    layout = motion.team.layout
    drone_names, cables_of_motion = motion.team.drone_names, cable_names(motion)
    drones = [drone_names.index(name) for name in check.where if name in drone_names]
    cables = [cables_of_motion.index(name) for name in check.where if name in cables_of_motion]
    if len(check.where) != 2 or len(drones) + len(cables) != 2 or not drones:
        return ""
    drone = drones[0]
    cable = drone // 2
    other_cable = cables[0] if cables else drones[1] // 2
    if other_cable != cable:
        ends = layout.starts[other_cable], layout.ends[other_cable]
        vertices_of_other = ends if cables else (layout.anchors[drones[1]],)
        return LONGER_LEGS if layout.anchors[drone] in vertices_of_other else OTHER_LEGS
    if not np.all(layout.has_leg[cable]):
        return OTHER_LEGS
    time = float(np.clip(check.time, *motion.drones.breaks[[0, -1]]))
    places, vertices = motion.drones.at(time), motion.vertices.at(time)
    q, r = places[2 * cable], places[2 * cable + 1]
    start, end = vertices[layout.starts[cable]], vertices[layout.ends[cable]]
    if cables:
        far_leg = [end, r] if drone % 2 == 0 else [start, q]
        to_edge = shortest_offset(places[drone] - [start, end])
        to_leg = shortest_offset(places[drone] - far_leg)
        if np.linalg.norm(to_edge) <= np.linalg.norm(to_leg):
            return LONGER_LEGS
    spread = float((unit(r - end) - unit(q - start)) @ unit(end - start))
    if abs(spread) <= PARALLEL:
        return f"use {LARGER_POLYGON}"
    return f"use a {'shorter' if spread < 0.0 else 'longer'} cable or {LARGER_POLYGON}"


def _scaled_drones(
    drones: PiecewisePolynomial, names: Sequence[str], separation: Separation, size: float
) -> Moving:
    """Return all pairs of drones, scaled by ``Separation.scale``: ratios are distances.

    ``size`` is the largest coordinate [m].
    """
    scale = separation.scale
    margin = ROUNDING * size * float(np.max(scale))
    points = (drones.coefficients * scale[:, None])[:, :, None]
    return Moving(drones.breaks, points, margin=margin, names=(names, names))


def _pairs_of_drones(motion: Motion) -> tuple[Moving]:
    """Return all pairs of drones of a team, scaled by ``Separation.scale``."""
    names, separation = motion.team.drone_names, motion.requirements.separation
    return (_scaled_drones(motion.drones, names, separation, magnitude(motion)),)


_DRONE_DISTANCE = nearest(_pairs_of_drones, scaled=True)

SEPARATION = CheckRule(
    "separation",
    "ratio",
    "min",
    lambda motion: 1.0 if motion.team.drones > 1 else None,
    (Evaluator(_DRONE_DISTANCE, exported=True, formulas=(gap, distance)),),
    f"{OTHER_LEGS}, or allow a smaller separation.radius",
    "place the drones farther apart, use longer cables or a larger polygon, "
    "or allow a smaller separation.radius",
    "length",
    remedy_at=partial(leg_remedy, distance="separation.radius"),
)
"""The ellipsoids of drones do not intersect."""


def plan_points(motion: Motion) -> Array:
    """Return drones (pieces, 2n, 1, 3, degree + 1) [m], projected to height 0."""
    flat: Array = motion.drones.coefficients * PLAN_AXES
    return flat[:, :, None]


def cable_ends(drones: Array) -> Array:
    """Return the ends (pieces, n, 2, 3, degree + 1) of cables between drones (pieces, 2n, …)."""
    return drones.reshape(len(drones), -1, 2, *drones.shape[-2:])


def _taut_parts(motion: Motion) -> Iterator[Moving]:
    """Yield the pairs of parts that share no clasp.

    These include the two legs of one cable, which may cross. Bent cables share no clasp; an object
    that they hold keeps them apart, as the check ``interlacing`` verifies.
    """
    parts, table = taut_parts(motion), TautBodies.of(motion.team.layout)
    part, body = parts.part, table.of_parts(parts.part)

    def crossing(i: Indices, j: Indices) -> Flags:
        flags: Flags = table.kind(body[i], body[j]) == CROSSING_PAIR
        return flags

    yield Moving.between(motion, parts, allowed=crossing)
    if motion.has_bent_cables:
        held = np.array([phase.hold is not None for phase in motion.phases])[motion.phase_of_piece]
        bodies = replace(parts, pieces=motion.in_states(frozenset({CableState.BENT})) & ~held)
        yield Moving.between(motion, bodies, allowed=lambda i, j: part[i] // 3 != part[j] // 3)


def _hanging_cables(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of cables, projected from above onto their chords.

    Neighbours may touch while they are being clasped or unclasped.
    """
    for part in phase_parts(motion):
        linked = part.phase.state not in (CableState.GROUND, CableState.FREE, CableState.DRAWN)
        chords = Bodies(cable_ends(plan_points(part.motion)), cable_names(motion))
        allowed = partial(_unclasped, motion.team.layout) if linked else None
        yield Moving.between(part.motion, chords, allowed=allowed)
        if part.phase.state is CableState.LAYING:
            yield _laid_neighbours(part.motion)


def _unclasped(layout: Layout, i: Indices, j: Indices) -> Flags:
    """Return whether pairs of cables share no clasp."""
    return ~np.isin(pair_of(layout, i, j), clasped_pairs(layout))


UPRIGHT_TOLERANCE = 1e-3
"""[m] Tightness of bounds of horizontal distances, or of heights."""

MAX_SIDEWAYS = 1e-6
"""[m] Largest horizontal motion of drones that move vertically."""


def upright_pieces(motion: Motion) -> Flags:
    """Return on which pieces (pieces,) all drones move vertically, or rest."""
    level = motion.drones.coefficients[:, :, :2]
    return np.asarray(np.max(np.ptp(level, axis=-1), axis=(1, 2)) <= MAX_SIDEWAYS)


def _clasped_cables(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of cables that share no clasp while cables are clasped or tightened."""
    if not motion.cable_states & CLASPED_STATES:
        return
    regions = clasped_cables(motion)
    count, allowed = regions.outline, partial(_unclasped, motion.team.layout)
    flat = replace(regions, corners=regions.corners[:, :, :count] * PLAN_AXES)
    yield Moving.between(motion, flat, allowed=allowed, shape=Hulls((count, count)))


def _laid_neighbours(motion: Motion) -> Moving:
    """Return the pairs of neighbours, on pieces on which drones move horizontally."""
    layout = motion.team.layout

    def neighbours(i: Indices, j: Indices) -> Flags:
        return ~_unclasped(layout, i, j)

    strips = replace(clasped_cables(motion), pieces=~upright_pieces(motion))
    return Moving.between(motion, strips, allowed=neighbours)


CROSSING = CheckRule(
    "crossing",
    "m",
    "min",
    lambda motion: DISTANCES["crossing"].limit(motion.requirements.separation),
    (
        Evaluator(nearest(_taut_parts), TAUT_STATES, formulas=(gap,)),
        Evaluator(nearest(_hanging_cables), FREE_STATES, exported=True),
        Evaluator(nearest(_clasped_cables), FREE_STATES | TAUT_STATES),
    ),
    "shorten the legs that meet (a shorter cable or a larger polygon), "
    "choose other leg lengths, or lower separation.crossing",
    "place the robots farther apart, or lower separation.crossing",
    approach=Approach(lambda gamma: 2.0 * largest_error(gamma), lambda _: 2.0),
)
"""Cable parts that share no clasp keep a distance.

For hanging cables, it is the distance of their chords seen from above: in space they are no closer.
While cables are clasped or tightened, it is the distance of the regions that contain them.
Laid neighbours may be above each other; as they come down on each other, the check ``interlacing``
compares them.
"""


CLOSENESS_SPANS = 48  # Default number of time spans
MAX_PAIRS = 12  # Maximum number of closest pairs


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


def closeness(flight: Flight, spans: int = CLOSENESS_SPANS) -> Closeness:
    """Return the closest pairs of drones, for all t.

    Every bound holds on all of its span, rounding included, within 1e-4 of an attained value,
    relative.

    Parameters
    ----------
    flight: a flight of at least two drones.
    spans: number of equal time spans.

    Raises
    ------
    InputError: a single drone, or no span.
    """
    names = flight.team.drone_names
    if len(names) < 2:
        raise InputError("drones", len(names), "at least 2", "one drone has no neighbour")
    if spans < 1:
        raise InputError("spans", spans, "at least 1", "48 are usual")
    edges = np.linspace(flight.breaks[0], flight.breaks[-1], spans + 1).tolist()
    drones = on_breaks(flight.drones, merged_breaks([np.array(edges), flight.breaks]))
    separation = flight.requirements.separation
    every = _scaled_drones(drones, names, separation, flight_magnitude(flight))

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
