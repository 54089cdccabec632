"""Smallest distances of moving bodies, for all t; checks ``separation`` and ``crossing``.

For a vector u no longer than one, ``|a - b| ≥ u · (a - b)``, a polynomial. With u along the
shortest connection, turning as that does, its least coefficient over the corners of both bodies
bounds their distance from below, within the third power of a span's length; at a point it is the
distance. The distance from a body of some shape is less by its support function along u.

Of few bodies all pairs are compared, piece by piece, by the boxes that they stay in: those farther
apart than some attained distance are excluded. Of many, a spatial index lists the close pairs of
several pieces at a time, and spans of which it would list too many are halved.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.certificate import within
from hitchopt.checks.clasps import cut_corners
from hitchopt.checks.rule import CheckRule, Evaluator, WorstCase
from hitchopt.checks.spans import (
    UPWARD,
    cable_names,
    cable_parts,
    clasped_pairs,
    magnitude,
    pair_of,
    part_names,
    phase_parts,
    position_margin,
)
from hitchopt.geometry import differences, shortest_offset
from hitchopt.geometry.broadphase import Boxes, Pairs, few_close_pairs
from hitchopt.geometry.vectors import unit
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.pairs import CROSSING as CROSSING_PAIR
from hitchopt.hitch.pairs import PAIRS, Bodies
from hitchopt.motion.motion import FREE_STATES, HITCHED_STATE, CableState, Motion
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.enclosed import Bound, Enclosed, largest_of
from hitchopt.trajectory.search import Extremum, Search, Spans
from hitchopt.values import Array, Indices

# Pairs up to which an index costs more than it saves; pairs times pieces compared at a time
MAX_LISTED, GROUP = 8000, 32_768
# Pairs of the nearest boxes: their distances at mid span exclude others. Of many bodies they are
# searched for among so many neighbours of each
SEEDS, NEIGHBOURS = 256, 8
# Pairs per body above which a span is halved, if bodies move; maximum number of halvings
MAX_PER_BODY, MAX_DEPTH = 12, 8
# Relative: largest difference of distances that tie, and margin of comparisons of boxes
TIE, SLACK = 1e-6, 1e-9
# Name of the ground, and half of the size [m] of its model, and of an object seen from above
GROUND, TALL = "ground", 1e3
# [m] Cables that come closer touch, and may pass through each other, regardless of limits: a
# hundred times the largest jump at a joint
TOUCHING = 1e-4
Flags = NDArray[np.bool_]


class Shape(Protocol):
    """A convex body at rest; by default the origin."""

    def towards(self, corners: Array) -> Array:
        """Return unit vectors (…, 3) out of it to the nearest point of hulls (…, corners, 3)."""
        return unit(shortest_offset(corners))

    def support(self, directions: Array) -> Array:
        """Return how far it reaches (…) [m] along directions (…, 3)."""
        return np.zeros(directions.shape[:-1])


class Origin(Shape):
    """The origin: distances of bodies are those of their Minkowski difference from it."""


@dataclass(frozen=True)
class Ground(Shape):
    """All that is below a height [m]."""

    height: float

    def towards(self, corners: Array) -> Array:
        """Return the directions (…, 3) out of it."""
        return np.broadcast_to(UPWARD, (*corners.shape[:-2], 3))

    def support(self, directions: Array) -> Array:
        """Return how far it reaches (…) [m] along directions (…, 3), TALL except upward."""
        x, y, z = np.moveaxis(directions, -1, 0)
        down, up = np.maximum(-z, 0.0), np.maximum(z, 0.0)
        return np.asarray(TALL * (np.abs(x) + np.abs(y) + down) + self.height * up)


ORIGIN = Origin()
FLAT = np.array([1.0, 1.0, 0.0])[:, None]


def distance(a: Array, b: Array, shape: Shape = ORIGIN) -> Bound:
    """Return the distances of bodies with corners (spans, k, 3, degree + 1) [m], not negative.

    Along n, the quadratic through the directions of the shortest connections at three places. As
    ``|n| ≤ (1 + |n|²) / 2``, no distance is smaller than the least ratio of coefficients.
    """
    order = 2 + max(2, bernstein.degree(a), bernstein.degree(b))
    places = [np.moveaxis(c @ bernstein.at_nodes(2, bernstein.degree(c)).T, -1, 0) for c in (a, b)]
    first, middle, last = shape.towards(differences(*places))
    n = np.stack([first, 2.0 * middle - 0.5 * (first + last), last], axis=-1)
    along = bernstein.elevate(np.min(bernstein.dot(n[:, None], a), axis=1), order)
    along -= bernstein.elevate(np.max(bernstein.dot(n[:, None], b), axis=1), order)
    along -= bernstein.elevate(shape.support(np.moveaxis(n, -1, 1)), order)
    sizes = 0.5 + 0.5 * np.maximum(bernstein.elevate(bernstein.dot(n, n), order), 0.0)
    least = np.maximum(along / sizes, 0.0)
    lower = np.min(least, axis=-1)
    # If places tie, as of bodies that come to rest, an end is reported.
    start, end = (least[:, i] <= lower * (1.0 + TIE) for i in (0, -1))
    inside = np.argmin(least, axis=-1) / order
    return Bound(lower, np.where(start, 0.0, np.where(end, 1.0, inside)))


def gap(spans: PairSpans) -> Bound:
    """Return the distances of the bodies [m], zero where they meet."""
    apart = distance(*spans.ends, spans.source.shape)
    return Bound(np.maximum(apart.value - spans.source.margin, 0.0), apart.x)


def aside(spans: PairSpans) -> Bound:
    """Return the distance of bodies from above, or the difference of their heights if larger."""
    a, b = spans.ends
    from_above_ = distance(*(c[:, : min(2, c.shape[1])] * FLAT for c in (a, b)))
    margin = spans.source.margin
    plan = Bound(np.maximum(from_above_.value - margin, 0.0), from_above_.x)
    apart = a[:, :, None, 2] - b[:, None, :, 2]  # (spans, k, l, degree + 1)
    apart = apart.reshape(len(apart), -1, apart.shape[-1])
    over, under = (np.min(sign * apart, axis=1, keepdims=True) for sign in (1.0, -1.0))
    return largest_of([plan, *(Enclosed(each, margin).below for each in (over, under))])


@dataclass(frozen=True, eq=False)
class Moving:
    """Bodies in motion, as hulls of corners, and the pairs of them that are checked.

    Attributes
    ----------
    breaks: (pieces + 1,) [s]
    first: (pieces, bodies, corners, 3, degree + 1) [m]
    second: corners of the other group; None for pairs i < j within the first group.
    margin: subtracted from distances to cover rounding [m].
    allowed: which pairs (first, second) count; None for all.
    shape: body from which the difference of two positions keeps its distance.
    counted: (pieces, bodies), on which pieces the first group counts; None for all.
    lengths: (bodies,) [m] of cables that hang between both corners of the first group.
    names: of the bodies of both groups; empty ones are not named, hanging cables are named last.
    formula: bounds the distance of pairs.
    tolerance: tightness of bounds of distances [m]; None if the limit determines it.
    """

    breaks: Array
    first: Array
    second: Array | None = None
    margin: float = 0.0
    allowed: Callable[[Indices, Indices], Flags] | None = None
    shape: Shape = ORIGIN
    counted: Flags | None = None
    lengths: Array | None = None
    names: tuple[Sequence[str], Sequence[str]] = ((), ())
    formula: Callable[[PairSpans], Bound] = gap
    tolerance: float | None = None

    @classmethod
    def of(
        cls, motion: Motion, first: Array, second: Array | None = None, **options: Any
    ) -> Moving:
        """Return bodies on the pieces of a motion, whose positions round as it says."""
        return cls(motion.drones.breaks, first, second, position_margin(motion), **options)

    def named(self, item: int) -> tuple[str, ...]:
        """Return the names of a pair."""
        i, j = divmod(item, self.count)
        pair = self.names[0][i], self.names[1][j]
        return tuple(filter(None, pair if self.lengths is None else pair[::-1]))

    @property
    def others(self) -> Array:
        """The second group."""
        return self.first if self.second is None else self.second

    @property
    def count(self) -> int:
        """Number of the second group: item ``i * count + j`` is a pair."""
        return int(self.others.shape[1])

    @property
    def pairs(self) -> Pairs | None:
        """All pairs that count, unless there are too many to list."""
        total = self.first.shape[1] * self.count
        return None if total > MAX_LISTED else self.chosen(*np.divmod(np.arange(total), self.count))

    def chosen(self, first: Indices, second: Indices) -> Pairs:
        """Return the pairs that count."""
        on = first < second if self.second is None else np.ones(len(first), dtype=np.bool_)
        if self.allowed is not None:
            on &= self.allowed(first, second)
        return Pairs(first[on], second[on])

    @cached_property
    def boxes(self) -> tuple[Array, Array]:
        """Boxes (2, 3, pieces, bodies) that the bodies of each group stay in.

        Relative to their mean place: common motion changes no distance.
        """
        drift = np.mean(self.first, axis=(1, 2), keepdims=True)
        own = _boxes(self.first - drift)
        if self.lengths is not None:
            # Down one drone and up to the other one along its length, no cable comes deeper.
            ends = np.sum(np.min((self.first - drift)[:, :, :, 2], axis=-1), axis=-1)
            own[0, 2] = np.minimum(own[0, 2], 0.5 * (ends - self.lengths))
        return own, own if self.second is None else _boxes(self.second - drift)

    @property
    def extent(self) -> Array:
        """The lower and upper corner (2, 3) [m] of a box around the shape."""
        return np.stack([-self.shape.support(-np.eye(3)), self.shape.support(np.eye(3))])

    def gaps(self, pairs: Pairs) -> Array:
        """Return lower bounds (pieces, pairs) [m] of distances, from the boxes of pairs."""
        own, others = self.boxes
        a_lower, a_upper = own.take(pairs.first, axis=3)
        b_lower, b_upper = others.take(pairs.second, axis=3)
        lower, upper = self.extent[..., None, None]
        apart = np.maximum(a_lower - b_upper - upper, b_lower - a_upper + lower)
        np.maximum(apart, 0.0, out=apart)
        gaps: Array = np.sqrt(np.einsum("cpi,cpi->pi", apart, apart))
        if self.counted is not None:
            gaps[~self.counted[:, pairs.first]] = np.inf
        return gaps

    def part(self, start: int, stop: int) -> Moving:
        """Return the bodies on a run of pieces."""
        breaks, cut = self.breaks[start : stop + 1], slice(start, stop)
        second = None if self.second is None else self.second[cut]
        counted = None if self.counted is None else self.counted[cut]
        return replace(self, breaks=breaks, first=self.first[cut], second=second, counted=counted)

    def halves(self) -> tuple[Moving, Moving]:
        """Return both halves of the pieces, or of the only one."""
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
    """Return boxes (2, 3, pieces, bodies) around corners (pieces, bodies, k, 3, degree + 1) [m]."""
    each = corners.transpose(2, 4, 3, 0, 1).reshape(-1, 3, *corners.shape[:2])  # of points
    return np.stack([each.min(axis=0), each.max(axis=0)])


class PairSpans(Spans):
    """Spans of pairs of moving bodies."""

    source: Moving

    @cached_property
    def ends(self) -> tuple[Array, Array]:
        """Corners (spans, corners, 3, degree + 1) [m] of both bodies."""
        i, j = np.divmod(self.item, self.source.count)
        return self.read(self.source.first, i), self.read(self.source.others, j)

    @property
    def lengths(self) -> Array:
        """Lengths (spans,) [m] of hanging cables."""
        assert self.source.lengths is not None
        return self.source.lengths[self.item // self.source.count]


def near(moving: Moving, attained: Callable[[], float], depth: int = 0) -> Iterator[PairSpans]:
    """Yield spans of all pairs that may be closer than the smallest distance attained.

    ``attained`` is called again after every yield. Points at which some pairs are near come first.
    A single piece is halved, to a ``depth``, if the index lists many pairs because bodies move.
    """
    pairs, pieces = moving.pairs, len(moving.first)
    bodies = moving.first.shape[1] + moving.count
    split = pieces > 1 and pieces * (bodies if pairs is None else len(pairs)) > GROUP
    if pairs is None and not split:
        yield from _neighbours(moving, attained)
        reach = (attained() + moving.margin) * (1.0 + SLACK)
        reach += float(np.max(np.linalg.norm(moving.extent, axis=-1)))
        own, others = (Boxes(b[0].min(axis=1).T, b[1].max(axis=1).T) for b in moving.boxes)
        moves = np.median(own.sizes) > 0.25 * reach
        last = pieces == 1 and (depth == MAX_DEPTH or not moves)
        second = None if moving.second is None else others
        close = few_close_pairs(
            own, second, float(reach) * (1.0 + SLACK), np.inf if last else MAX_PER_BODY * bodies
        )
        pairs = None if close is None else moving.chosen(close.first, close.second)
    if split or pairs is None:
        for half in moving.halves():
            yield from near(half, attained, depth + (pieces == 1))
    else:
        yield from _compared(moving, attained, pairs)


def _compared(moving: Moving, attained: Callable[[], float], pairs: Pairs) -> Iterator[PairSpans]:
    """Yield the spans of given pairs whose boxes are near, the nearest ones at mid span first."""
    gaps, item = moving.gaps(pairs), pairs.first * moving.count + pairs.second
    if gaps.size > SEEDS:
        nearest = np.sort(np.argpartition(gaps, SEEDS, axis=None)[:SEEDS])
        piece, pair = np.divmod(nearest[gaps.flat[nearest] < np.inf], len(pairs))
        yield PairSpans(moving, moving.breaks, piece, item[pair]).at(np.array(0.5))
    cutoff = min((attained() + moving.margin) * (1.0 + SLACK), np.finfo(np.float64).max)
    piece, pair = np.nonzero(~(gaps > cutoff))  # nan excludes nothing
    yield PairSpans(moving, moving.breaks, piece, item[pair])


def _neighbours(moving: Moving, attained: Callable[[], float]) -> Iterator[PairSpans]:
    """Yield some of the nearest pairs of many bodies on the middle one of their pieces."""
    from scipy.spatial import cKDTree

    middle = len(moving.first) // 2
    part = moving.part(middle, middle + 1)
    own, others = (boxes[:, :, 0].mean(axis=0).T for boxes in part.boxes)
    second = cKDTree(others).query(own, k=min(NEIGHBOURS, moving.count))[1].reshape(len(own), -1)
    first = np.repeat(np.arange(len(own)), second.shape[1])
    yield from _compared(part, attained, moving.chosen(first, second.ravel()))


def smallest(moving: Moving, **options: float) -> Extremum:
    """Return the smallest distance of all pairs that count; infinite, item -1, if there is none.

    The ``options`` are of ``Search``.
    """
    search: Search[PairSpans] = Search(moving.formula, "min", **options)
    for spans in near(moving, lambda: search.attained):
        search.add(spans)
        if search.attained <= search.absolute:  # they touch: no other pair can do worse
            return Extremum(0.0, search.attained, search.item, search.time)
    return search.finish()


def nearest(cases: Callable[[Motion], Iterable[Moving]]) -> Callable[[Motion, float], WorstCase]:
    """Return a function that finds the smallest distance over all groups of moving bodies."""

    def evaluate(motion: Motion, limit: float) -> WorstCase:
        size = magnitude(motion)
        aim, best = within(limit, "min", size, 0.5), WorstCase(math.inf, 0.0, size=size)
        for moving in cases(motion):
            tolerance = moving.tolerance
            if tolerance is None:
                pair = smallest(moving, target=aim, known=best.worst)
            else:  # the answer depends on the span of time, and on nothing else
                pair = smallest(moving, relative=tolerance, absolute=tolerance)
            least = max(pair.worst, 0.0)
            if least < best.worst and pair.item < 0:  # nothing is known to be nearer
                best = replace(best, worst=least)
            elif least < best.worst:
                best = WorstCase(least, pair.time, moving.named(pair.item), size)
        return best

    return evaluate


def scaled_drones(motion: Motion, drones: PiecewisePolynomial) -> Moving:
    """Return all pairs of drones, every axis times ``Separation.scale``: ratios are distances."""
    scale, names = motion.requirements.separation.scale, motion.team.drone_names
    margin = position_margin(motion) * float(np.max(scale))
    points = (drones.coefficients * scale[:, None])[:, :, None]
    return Moving(drones.breaks, points, margin=margin, names=(names, names))


_SEPARATED = nearest(lambda motion: [scaled_drones(motion, motion.drones)])

SEPARATION = CheckRule(
    "separation",
    "ratio",
    "min",
    lambda motion: 1.0 if motion.team.drones > 1 else None,
    (Evaluator(_SEPARATED, exported=True, shown=(gap, distance)),),
    "give the drones other leg lengths (of a longer cable or a smaller polygon), "
    "or a smaller separation.radius",
    "place the drones farther apart, use longer cables or a larger polygon, "
    "or allow a smaller separation.radius",
    "length",
)
"""No two drones' ellipsoids meet."""


def plan_points(motion: Motion) -> Array:
    """Return the drones (pieces, 2n, 1, 3, degree + 1) as seen from above, at height 0 [m]."""
    flat: Array = motion.drones.coefficients * FLAT
    return flat[:, :, None]


def cable_ends(drones: Array) -> Array:
    """Return the ends (pieces, n, 2, 3, degree + 1) of cables between drones (pieces, 2n, …)."""
    return drones.reshape(len(drones), -1, 2, *drones.shape[-2:])


def _taut(motion: Motion) -> Iterator[Moving]:
    """Yield the pairs of parts that share no clasp.

    The two legs of one cable count among them: they cross where both pass a star tip. Legs that lie
    across each other at a corner which is cut off do not, as long as they may touch.
    """
    corners, part = cable_parts(motion)
    bodies, names = Bodies.of(motion.team.layout), part_names(motion, part)
    body = bodies.of_parts(part)

    def crossing(i: Indices, j: Indices) -> Flags:
        flags: Flags = bodies.kind(body[i], body[j]) == CROSSING_PAIR
        return flags

    corners_cut = cut_corners(motion)
    counted, whole = np.ones((len(corners), len(part)), dtype=np.bool_), (names, names)
    for corner in corners_cut:
        counted[corner.pieces] = False
        meeting = 3 * corner.behind + 2, 3 * corner.ahead

        def others(i: Indices, j: Indices, meeting: tuple[int, int] = meeting) -> Flags:
            both = np.isin(part[i], meeting) & np.isin(part[j], meeting)
            return crossing(i, j) & ~both

        here = np.zeros_like(counted)
        here[corner.pieces] = True
        yield Moving.of(motion, corners, allowed=others, counted=here, names=whole)
    yield Moving.of(
        motion, corners, allowed=crossing, counted=counted if corners_cut else None, names=whole
    )


def _hanging(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of cables from above: there they are on their chords.

    Neighbours that are being clasped, or let go, are free to touch.
    """
    names, layout = cable_names(motion), motion.team.layout

    def unclasped(i: Indices, j: Indices) -> Flags:
        return ~np.isin(pair_of(layout, i, j), clasped_pairs(layout))

    for part in phase_parts(motion):
        clasped = part.phase.state not in (CableState.GROUND, CableState.FREE)
        ends, allowed = cable_ends(plan_points(part.motion)), unclasped if clasped else None
        yield Moving.of(part.motion, ends, allowed=allowed, names=(names, names))
        if part.phase.state is CableState.LAYING:
            yield _over_each_other(part.motion)


UPRIGHT_TOLERANCE = 1e-3
"""[m] Tightness of bounds of distances from above, or of heights."""

SIDEWAYS = 1e-6
"""[m] Largest sideways motion of drones that go straight up or down."""


def upright_pieces(motion: Motion) -> Flags:
    """Return (pieces,) whether all drones go straight up or down, or rest."""
    level = motion.drones.coefficients[:, :, :2]
    upright: Flags = np.max(np.ptp(level, axis=-1), axis=(1, 2)) <= SIDEWAYS
    return upright


def taut_strips(motion: Motion) -> Array:
    """Return the corners (pieces, n, 4, 3, degree + 1) [m] of strips around cables that are laid.

    They keep their shape: each is within the upright strip from its chord to the level of its
    largest sag below that.
    """
    c = motion.drones.coefficients
    first = c[0, ..., 0].reshape(-1, 2, 3)
    cables = Catenary.between(first[:, 0], first[:, 1], motion.team.cable_length)
    deepest = cables.depth(0.0) + 0.25 * cables.sigma**2 * np.abs(cables.rise)
    strips = np.concatenate([cable_ends(c)] * 2, axis=2)
    strips[:, :, 2:, 2] -= deepest[:, None, None]
    return strips


def _over_each_other(motion: Motion) -> Moving:
    """Return the pairs of neighbours that move over each other, while any drone moves sideways."""
    names, layout, strips = cable_names(motion), motion.team.layout, taut_strips(motion)

    def neighbours(i: Indices, j: Indices) -> Flags:
        return np.isin(pair_of(layout, i, j), clasped_pairs(layout))

    counted = np.repeat(~upright_pieces(motion)[:, None], layout.robots, axis=1)
    options: dict[str, Any] = {"formula": aside, "tolerance": UPRIGHT_TOLERANCE}
    options |= {"allowed": neighbours, "counted": counted, "names": (names, names)}
    return Moving.of(motion, strips, **options)


CROSSING = CheckRule(
    "crossing",
    "m",
    "min",
    lambda motion: max(PAIRS[CROSSING_PAIR].limit(motion.requirements.separation), TOUCHING),
    (
        Evaluator(nearest(_taut), HITCHED_STATE, shown=(gap,)),
        Evaluator(nearest(_hanging), FREE_STATES, exported=True),
    ),
    "shorten the legs that meet (a shorter cable or a larger polygon), "
    "choose other leg lengths, or lower separation.crossing",
    "place the robots farther apart, or lower separation.crossing",
)
"""Cable parts that share no clasp stay apart.

Hanging cables keep off each other as seen from above, where they are straight lines: in space they
are no closer. Neighbours that are laid may be over each other; as they come down on one another the
check ``interlacing`` compares them.
"""
