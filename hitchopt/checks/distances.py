"""Smallest distances of moving bodies, for all t; checks ``separation`` and ``crossing``.

For a vector u no longer than one, ``|a - b| ≥ u · (a - b)``, a polynomial. With u along the
shortest connection, turning as that does, its least coefficient over the corners of both bodies
bounds their distance from below, within the third power of a span's length; at a point it is the
distance. What is to stay off a body of some shape loses how far that reaches along u, its support
function.

Of few bodies all pairs are compared, piece by piece, by the boxes that they stay in: those farther
apart than some distance that is attained are out. Of many, a spatial index lists the close pairs of
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
from hitchopt.checks.rule import CheckRule, Finder, Finding
from hitchopt.checks.spans import (
    UPWARD,
    cable_names,
    cable_parts,
    clasped_pairs,
    magnitude,
    pair_of,
    part_name,
    part_points,
    position_margin,
)
from hitchopt.geometry import differences, shortest_offset
from hitchopt.geometry.broadphase import Boxes, Pairs, few_close_pairs
from hitchopt.geometry.vectors import unit
from hitchopt.motion.motion import HITCHED_STATE, CableState, Motion
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.enclosed import Bound
from hitchopt.trajectory.search import Extremum, Search, Spans
from hitchopt.values import Array, Indices

FEW = 6000
"""Pairs in all, up to which an index costs more than it saves."""

GROUP = 32_768
"""Pairs times pieces whose boxes are compared at a time."""

SEEDS = 256
"""Pairs whose boxes are nearest: their distances at mid span tell which others matter."""

NEIGHBOURS = 8
"""How many of a body's neighbours are tried for that where there are many."""

MOST = 12
"""Pairs per body above which a span is halved, if motion is to blame."""

MAX_DEPTH = 8
"""Pieces are halved this often at most."""

TIE = 1e-6
"""Relative difference of distances that tie."""

SLACK = 1e-9
"""Relative: boxes are rounded, and so is the distance that they are compared with."""

Flags = NDArray[np.bool_]

Allowed = Callable[[Indices, Indices], Flags]
"""Which pairs (first, second) count."""

Names = tuple[Sequence[str], Sequence[str]]
"""Names of the bodies of both groups."""


class Shape(Protocol):
    """A convex body that stands still."""

    def towards(self, corners: Array) -> Array:
        """Return unit vectors (…, 3) out of it to the nearest point of hulls (…, corners, 3)."""

    def support(self, directions: Array) -> Array:
        """Return how far it reaches (…) [m] along directions (…, 3)."""


class _Origin:
    """A point at the origin: what differences of positions are told from."""

    def towards(self, corners: Array) -> Array:
        return unit(shortest_offset(corners))

    def support(self, directions: Array) -> Array:
        return np.zeros(directions.shape[:-1])


ORIGIN = _Origin()

GROUND = "ground"
"""Stands for the ground where two objects, or a drone and a cable, are named."""

TALL = 1e3
"""[m] Half of the size of what stands for the ground, or for an object as seen from above."""


@dataclass(frozen=True)
class Ground:
    """All that is below a height [m]."""

    height: float

    def towards(self, corners: Array) -> Array:
        """Return the directions (…, 3) out of it."""
        return np.broadcast_to(UPWARD, (*corners.shape[:-2], 3))

    def support(self, directions: Array) -> Array:
        """Return how far it reaches (…) [m] along directions (…, 3), TALL except upward."""
        x, y, z = np.moveaxis(directions, -1, 0)
        return np.asarray(
            TALL * (np.abs(x) + np.abs(y))
            - TALL * np.minimum(z, 0.0)
            + self.height * np.maximum(z, 0.0)
        )


def box_of(shape: Shape) -> Array:
    """Return the lower and upper corner (2, 3) [m] of a box around a shape."""
    return np.stack([-shape.support(-np.eye(3)), shape.support(np.eye(3))])


@dataclass(frozen=True, eq=False)
class Moving:
    """Bodies in motion, hulls of corners, and which pairs of them count.

    Attributes
    ----------
    breaks: (pieces + 1,) [s]
    first: (pieces, bodies, corners, 3, degree + 1) [m]
    second: the same of others; None where pairs i < j within the first group are meant.
    margin: taken off distances to cover rounding [m].
    allowed: which pairs count; None for all.
    shape: what the difference of two positions keeps its distance from.
    counted: (pieces, bodies), on which pieces the first group counts; None for all.
    lengths: (bodies,) [m] of cables that hang between both corners of the first group.
    names: of the bodies of both groups; empty ones are not named.
    swapped: whether the second group is named first.
    formula: bounds the distance of pairs; ``gap`` by default.
    tolerance: how closely distances are bounded; None as closely as a limit asks for [m].
    contact: where given, bodies may come as close as they like, but not so much closer [m].
    """

    breaks: Array
    first: Array
    second: Array | None = None
    margin: float = 0.0
    allowed: Allowed | None = None
    shape: Shape = ORIGIN
    counted: Flags | None = None
    lengths: Array | None = None
    names: Names = ((), ())
    swapped: bool = False
    formula: Callable[[PairSpans], Bound] | None = None
    tolerance: float | None = None
    contact: float | None = None

    @classmethod
    def of(
        cls, motion: Motion, first: Array, second: Array | None, names: Names, **given: Any
    ) -> Moving:
        """Return bodies of a motion; ``given`` as above."""
        further = {"margin": position_margin(motion)} | given
        return cls(motion.drones.breaks, first, second, names=names, **further)

    def named(self, item: int) -> tuple[str, ...]:
        """Return the names of a pair."""
        pair = zip(divmod(item, self.count), self.names, strict=True)
        named = tuple(name for i, names in pair if (name := names[i]))
        return named[::-1] if self.swapped else named

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
        bodies = self.first.shape[1]
        total = bodies * (bodies - 1) // 2 if self.second is None else bodies * self.count
        if total > FEW:
            return None
        if self.second is None:
            return self.chosen(Pairs(*np.triu_indices(bodies, 1)))
        return self.chosen(Pairs(*np.divmod(np.arange(total), self.count)))

    def cutoff(self, attained: float) -> float:
        """Return the distance of boxes from which on pairs are no closer than what is attained."""
        return (attained + self.margin) * (1.0 + SLACK)

    @cached_property
    def boxes(self) -> tuple[Array, Array]:
        """Boxes (2, 3, pieces, bodies) that the bodies of each group stay in.

        As seen from their mean place: what all do together changes no distance.
        """
        drift = np.mean(self.first, axis=(1, 2), keepdims=True)
        own = body_boxes(self.first - drift, self.lengths)
        return own, own if self.second is None else body_boxes(self.second - drift)

    def gaps(self, pairs: Pairs) -> Array:
        """Return distances (pieces, pairs) [m] that the boxes of pairs leave at least."""
        own, others = self.boxes
        a_lower, a_upper = own.take(pairs.first, axis=3)
        b_lower, b_upper = others.take(pairs.second, axis=3)
        lower, upper = box_of(self.shape)[..., None, None]
        apart = np.maximum(a_lower - b_upper - upper, b_lower - a_upper + lower)
        np.maximum(apart, 0.0, out=apart)
        gaps: Array = np.sqrt(np.einsum("cpi,cpi->pi", apart, apart))
        if self.counted is not None:
            gaps[~self.counted[:, pairs.first]] = np.inf
        return gaps

    def part(self, start: int, stop: int) -> Moving:
        """Return the same on a run of pieces."""
        breaks, cut = self.breaks[start : stop + 1], slice(start, stop)
        second = None if self.second is None else self.second[cut]
        counted = None if self.counted is None else self.counted[cut]
        return replace(self, breaks=breaks, first=self.first[cut], second=second, counted=counted)

    def halves(self) -> tuple[Moving, Moving]:
        """Return both halves of the pieces, or of the only one."""
        pieces = len(self.first)
        if pieces > 1:
            return self.part(0, pieces // 2), self.part(pieces // 2, pieces)
        (start, end), middle = self.breaks, self.breaks.mean()
        seconds = (None, None) if self.second is None else bernstein.halve(self.second)
        one, other = (
            replace(self, breaks=np.array(t), first=a, second=b)
            for t, a, b in zip(
                ((start, middle), (middle, end)), bernstein.halve(self.first), seconds, strict=True
            )
        )
        return one, other

    def chosen(self, pairs: Pairs) -> Pairs:
        """Return the pairs that count."""
        if self.allowed is None:
            return pairs
        return pairs.take(self.allowed(pairs.first, pairs.second))

    def spans(self, piece: Indices, item: Indices) -> PairSpans:
        """Return the spans of whole pieces of pairs."""
        return PairSpans(self, self.breaks, piece, item)


def body_boxes(corners: Array, lengths: Array | None = None) -> Array:
    """Return boxes (2, 3, pieces, bodies) around corners (pieces, bodies, k, 3, degree + 1) [m].

    Of cables of ``lengths`` (bodies,) [m] that hang between two of them, if given.
    """
    each = corners.transpose(2, 4, 3, 0, 1).reshape(-1, 3, *corners.shape[:2])  # of points
    found = np.stack([each.min(axis=0), each.max(axis=0)])
    if lengths is not None:
        # Down one drone and up to the other one along its length, no cable comes deeper.
        ends = np.sum(np.min(corners[:, :, :, 2], axis=-1), axis=-1)
        found[0, 2] = np.minimum(found[0, 2], 0.5 * (ends - lengths))
    return found


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


def gap(spans: PairSpans) -> Bound:
    """Return the distances of the bodies [m], zero where they meet."""
    found = distance(*spans.ends, spans.source.shape)
    return Bound(np.maximum(found.value - spans.source.margin, 0.0), found.x)


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
    found = np.min(least, axis=-1)
    # Of places that tie, as those of bodies that come to rest, an end is told.
    start, end = (least[:, i] <= found * (1.0 + TIE) for i in (0, -1))
    inside = np.argmin(least, axis=-1) / order
    return Bound(found, np.where(start, 0.0, np.where(end, 1.0, inside)))


def smallest(moving: Moving, **options: float) -> Extremum:
    """Return the smallest distance of all pairs that count; infinite, item -1, where none does.

    The ``options`` are of ``Search``.
    """
    search: Search[PairSpans] = Search(moving.formula or gap, "min", **options)
    for spans in near(moving, lambda: search.attained):
        search.add(spans)
        if search.attained <= search.absolute:  # they touch: no other pair can do worse
            return Extremum(0.0, search.attained, search.item, search.time)
    return search.finish()


@dataclass(frozen=True, eq=False)
class Nearest:
    """A finder of the smallest distance of all pairs; ``where`` names the two bodies.

    Attributes
    ----------
    cases: what moves past what.
    scale: what distances are multiplied by.
    """

    cases: Callable[[Motion], Iterable[Moving]]
    scale: Callable[[Motion], float] = lambda _: 1.0

    def __call__(self, motion: Motion, limit: float) -> Finding:
        """Return the smallest distance, to be held against a limit."""
        size = self.scale(motion) * magnitude(motion)
        aim, best = within(limit, "min", size, 0.5), Finding(math.inf, 0.0, size=size)
        for moving in self.cases(motion):
            if moving.contact is not None:
                found = smallest(moving, target=2.0 * moving.contact)
                if found.worst < moving.contact < best.worst:
                    best = Finding(0.0, found.time, moving.named(found.item), size)
                continue
            if moving.tolerance is None:
                found = smallest(moving, target=aim, known=best.worst)
            else:  # what is found depends on the span of time, and on nothing else
                found = smallest(moving, relative=moving.tolerance, absolute=moving.tolerance)
            least = max(found.worst, 0.0)
            if least < best.worst and found.item < 0:  # nothing is known to be nearer
                best = replace(best, worst=least)
            elif least < best.worst:
                best = Finding(least, found.time, moving.named(found.item), size)
        return best


def near(moving: Moving, attained: Callable[[], float]) -> Iterator[PairSpans]:
    """Yield spans of all pairs that may be closer than what is attained.

    That is asked for again after every yield. Points at which some pairs are near come first.
    """
    pairs = moving.pairs
    bodies = moving.first.shape[1] + moving.count
    size = max(1, GROUP // max(1, bodies if pairs is None else len(pairs)))
    for start in range(0, len(moving.first), size):
        part = moving.part(start, start + size)
        if pairs is None:
            yield from _indexed(part, attained, 0)
        else:
            yield from _compared(part, attained, pairs)


def _compared(moving: Moving, attained: Callable[[], float], pairs: Pairs) -> Iterator[PairSpans]:
    """Yield the spans of given pairs."""
    gaps = moving.gaps(pairs)
    item = pairs.first * moving.count + pairs.second
    if gaps.size > SEEDS:
        nearest = np.sort(np.argpartition(gaps, SEEDS, axis=None)[:SEEDS])
        piece, pair = np.divmod(nearest[gaps.flat[nearest] < np.inf], len(pairs))
        yield moving.spans(piece, item[pair]).at(np.full(len(piece), 0.5))
    cutoff = min(moving.cutoff(attained()), np.finfo(np.float64).max)
    piece, pair = np.nonzero(~(gaps > cutoff))  # what is no number rules nothing out
    yield moving.spans(piece, item[pair])


def _indexed(moving: Moving, attained: Callable[[], float], depth: int) -> Iterator[PairSpans]:
    """Yield the spans of pairs that a spatial index lists, of which there are not too many."""
    yield from _neighbours(moving)
    reach = moving.cutoff(attained()) + float(np.max(np.linalg.norm(box_of(moving.shape), axis=-1)))
    own, others = (Boxes(b[0].min(axis=1).T, b[1].max(axis=1).T) for b in moving.boxes)
    second = None if moving.second is None else others
    single, moves = len(moving.first) == 1, np.median(own.sizes) > 0.25 * reach
    last = single and (depth == MAX_DEPTH or not moves)
    most = np.inf if last else MOST * (len(own) + len(others))
    pairs = few_close_pairs(own, second, reach, most)
    if pairs is not None:
        yield from _compared(moving, attained, moving.chosen(pairs))
        return
    for half in moving.halves():
        yield from _indexed(half, attained, depth + single)


def _neighbours(moving: Moving) -> Iterator[PairSpans]:
    """Yield some of the nearest pairs of many bodies on the middle one of their pieces."""
    from scipy.spatial import cKDTree

    middle = len(moving.first) // 2
    part = moving.part(middle, middle + 1)
    own, others = (boxes[:, :, 0].mean(axis=0).T for boxes in part.boxes)
    found = cKDTree(others).query(own, k=min(NEIGHBOURS, moving.count))[1]
    j = np.asarray(found, dtype=np.intp).reshape(len(own), -1)
    pairs = Pairs(np.repeat(np.arange(len(j)), j.shape[1]), j.ravel())
    if moving.second is None:
        pairs = pairs.take(pairs.first < pairs.second)
    pairs = moving.chosen(pairs)
    pairs = pairs.take(np.argsort(part.gaps(pairs)[0], kind="stable")[:SEEDS])
    item = pairs.first * moving.count + pairs.second
    yield part.spans(np.zeros_like(item), item).at(np.full(len(item), 0.5))


def scaled_drones(motion: Motion, drones: PiecewisePolynomial) -> Moving:
    """Return all pairs of drones, every axis times ``Separation.scale``: ratios are distances."""
    scale, names = motion.requirements.separation.scale, motion.team.drone_names
    margin = position_margin(motion) * float(np.max(scale))
    points = (drones.coefficients * scale[:, None])[:, :, None]
    return Moving(drones.breaks, points, margin=margin, names=(names, names))


SEPARATED = Nearest(
    lambda motion: [scaled_drones(motion, motion.drones)],
    lambda motion: float(np.max(motion.requirements.separation.scale)),
)

SEPARATION = CheckRule(
    "separation",
    "ratio",
    "min",
    lambda motion: 1.0 if motion.team.drones > 1 else None,
    (Finder(SEPARATED, exported=True, shown=(gap, distance)),),
    "give the drones other leg lengths (of a longer cable or a smaller polygon), "
    "or a smaller separation.radius",
    "place the drones farther apart, use longer cables or a larger polygon, "
    "or allow a smaller separation.radius",
    "length",
)
"""No two drones' ellipsoids meet."""


def plan_points(motion: Motion) -> Array:
    """Return the drones (pieces, 2n, 1, 3, degree + 1) as seen from above, at height 0 [m]."""
    flat: Array = motion.drones.coefficients * np.array([1.0, 1.0, 0.0])[:, None]
    return flat[:, :, None]


def cable_ends(drones: Array) -> Array:
    """Return the ends (pieces, n, 2, 3, degree + 1) of cables between drones (pieces, 2n, …)."""
    return drones.reshape(len(drones), -1, 2, *drones.shape[-2:])


def _taut(motion: Motion) -> Iterator[Moving]:
    """Yield the pairs of parts that share no clasp.

    The two legs of one cable count among them: they cross where both pass a star tip.
    """
    corners, part = cable_parts(motion)
    ends, names = part_points(part, motion.team.layout), [part_name(p) for p in part]

    def unclasped(i: Indices, j: Indices) -> Flags:
        shared: Flags = np.any([a[i] == b[j] for a in ends for b in ends], axis=0)
        return ~shared

    yield Moving.of(motion, corners, None, (names, names), allowed=unclasped)


def _hanging(motion: Motion, allowed: Allowed | None = None) -> Iterator[Moving]:
    """Yield all pairs of cables from above: there they are on their chords."""
    names = cable_names(motion)
    yield Moving.of(motion, cable_ends(plan_points(motion)), None, (names, names), allowed=allowed)


def _clasped(motion: Motion) -> Iterator[Moving]:
    """Yield the same of cables that share no clasp."""
    layout = motion.team.layout
    yield from _hanging(motion, lambda i, j: ~np.isin(pair_of(layout, i, j), clasped_pairs(layout)))


CROSSING = CheckRule(
    "crossing",
    "m",
    "min",
    lambda motion: motion.requirements.separation.crossing,
    (
        Finder(Nearest(_taut), HITCHED_STATE, shown=(gap,)),
        Finder(Nearest(_hanging), frozenset({CableState.GROUND, CableState.FREE}), exported=True),
        Finder(
            Nearest(_clasped),
            frozenset({CableState.CLASPING, CableState.TIGHTENING}),
            exported=True,
        ),
    ),
    "shorten the legs that meet (a shorter cable or a larger polygon), "
    "choose other leg lengths, or lower separation.crossing",
    "place the robots farther apart, or lower separation.crossing",
)
"""Cable parts that share no clasp stay apart.

Hanging cables keep off each other as seen from above, where they are straight lines: in space they
are no closer. Neighbours that are being clasped, or let go, are free to touch.
"""
