"""Several teams: distances of drones, cables and objects of two plans."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from .arithmetic import BIG, Array, Index, Items, Line, Mask, maximum, minimum
from .drones import moves
from .objects import body_gap
from .reading import LAID, Plan
from .shapes import Slab, distance, prism_gap
from .spans import Row, Spans, prove


class Pair(Plan):
    """Two plans on common breaks; a plan rests before its start and after its end.

    Items of its spans are pairs of items. Minimum distances are the largest of all teams.
    """

    erring_bodies = 2

    def __init__(
        self, p: Plan, q: Plan, separation: dict[str, float], tube: tuple[float, float]
    ) -> None:
        self.plans, self.size, self.effort = (p, q), max(p.size, q.size), p.effort
        breaks = np.concatenate([p.breaks, q.breaks])
        self.breaks = np.unique(breaks)
        self.h = np.diff(self.breaks)
        self.set_distances(separation, tube)

    def pieces(self, time: Array) -> Iterator[Items]:
        """Yield pieces of each plan at times (m,), the first or last one beyond its duration."""
        for p in self.plans:
            yield np.clip(np.searchsorted(p.breaks, time) - 1, 0, len(p.h) - 1)

    def both(self, s: Spans) -> Iterator[Spans]:
        """Yield spans of each plan."""
        for p, piece in zip(self.plans, self.pieces(s.time), strict=True):
            x = (s.time - p.breaks[piece]) / p.h[piece]
            own = Spans(p, piece, s.item, np.clip(x, 0.0, 1.0), 0.0 * x)
            own.t, own.zero, own.moving = s.t, s.zero, 1.0 * ((x > 0.0) & (x < 1.0))
            yield own

    def items(self, first: Solid, second: Solid) -> Spans:
        """Return spans of all pairs of items of both plans."""
        one, two = self.pieces(self.breaks[:-1] + 0.5 * self.h)
        items = np.indices((len(first[1]), len(second[1]))).reshape(2, -1).T
        return Spans.of(self, first[0][one] & second[0][two], items, first[1], second[1])


Solid = tuple[Mask, Sequence[str], Callable[..., Any]]


def solids(p: Plan) -> list[Solid]:
    """Return masks of pieces, names and corners of drones and of cables.

    Cables are segments, sheets if they hang, strips if they are laid, or hulls if they clasp.
    """
    drones, laid = (p.all_pieces, p.names, lambda s, i: [s.point(i)]), p.state == LAID
    hanging = p.free & ~laid & ~p.clasping
    sheets = (hanging, p.cables, Spans.sheet), (laid, p.cables, Spans.strip)
    hulls = p.clasping, p.cables, Spans.hull
    return [drones, (p.taut, p.segment_names, Spans.segment), *sheets, hulls]


def between_plans(pair: Pair) -> Iterator[Row]:
    """Prove distances between drones and cables of two plans.

    Vertical regions contain cables without a hitch. Distances to them are horizontal or vertical
    ones.
    """

    def ratio(a: list[Line], b: list[Line]) -> Line:
        return ((a[0] - b[0]) * pair.scale).norm()

    def below(a: list[Line], b: list[Line]) -> Line:
        """Return the distance over half an ellipsoid, large for cables above the drone.

        The distance of a point from a strip is that of the chord above from the points up to the
        strip's depth over that point.
        """
        drone, cable = (a[0], b) if len(a) == 1 else (b[0], a)
        drone, *cable = (x * pair.wash for x in (drone, *cable))
        rise = minimum(*(x[2] for x in cable)) - drone[2] - pair.wash_lead
        over = [drone + (cable[0] - cable[2])] if cable[2:] else []
        return distance([drone, *over], cable[:2]).unless(rise)

    def gap(s: Spans, *items: Index, of: Sequence[Solid], measure: Callable[..., Line]) -> Line:
        return measure(*(x[2](t, k) for x, t, k in zip(of, pair.both(s), items, strict=True)))

    for (i, one), (j, two) in product(*(enumerate(solids(p)) for p in pair.plans)):
        measure = partial(prism_gap if max(i, j) > 1 else distance, ratio=pair.ratio)
        limit, s = pair.cable_limit if 0 in (i, j) else pair.crossing_limit, pair.items(one, two)
        if i == j == 0:
            measure, limit = partial(ratio), ("separation ratio min", 1.0)
        yield prove(*limit, s, partial(gap, of=(one, two), measure=measure))
        if {i, j} in ({0, 1}, {0, 3}):  # cables are taut, or laid
            yield prove("downwash ratio min", 1.0, s, partial(gap, of=(one, two), measure=below))


def object_distances(pair: Pair) -> Iterator[Row]:
    """Prove distances of drones, cables and objects of a plan to another plan's own objects.

    Distances of hanging cables are horizontal ones.
    """
    p, q = pair.plans

    def own_objects(p: Plan, q: Plan) -> Iterator[tuple[int, Slab, Solid]]:
        mine, theirs = (x.settings["objects"] for x in (p, q))
        for b, slab in p.slabs:
            name = p.bodies[b].name
            if np.any(p.moving[b]) or mine[name] != theirs.get(name):
                yield b, slab, (p.all_pieces, [name], Spans.world)

    def gap(s: Spans, *i: Index, b: int, slab: Slab, corners: Any) -> Line:
        mine, theirs = pair.both(s)
        points = [theirs.local(b, x) for x in corners(mine, i[0])]
        if len(points) < 5:
            return slab.gap(*points[:2], ratio=pair.ratio)
        *outline, lowest = points
        height = (lowest[2] - top[b]) * (1.0 / pair.ratio)
        return maximum(slab.gap(*outline, outline[0], ratio=pair.ratio), height)

    def height_ratio(s: Spans, i: Index, _: Index, b: int, slab: Slab) -> Line:
        mine, theirs = pair.both(s)
        return slab.below(theirs.local(b, mine.point(i)) * pair.wash, pair.wash_lead)

    def object_gap(s: Spans, *_: Index, b: int, slab: Slab, o: int, block: Slab) -> Line:
        mine, theirs = pair.both(s)
        return body_gap(mine, o, block, theirs, b, slab, pair.ratio)

    top = [max(slab.upper for slab in body.slabs) for body in q.bodies]
    cable_limit = pair.object_limit[0], pair.object_limit[1] + pair.tracking  # objects err too
    for b, slab, body in own_objects(q, p):
        for i, one in enumerate(solids(p)):
            limit = cable_limit if i else ("keep_out m min", pair.sep["radius"] + pair.tracking)
            tall = slab.enlarged(0.0, -BIG, BIG) if i > 1 else slab
            yield prove(*limit, pair.items(one, body), partial(gap, b=b, slab=tall, corners=one[2]))
        if np.any(q.moving[b]) or moves(p, q.bodies[b]):
            drones = solids(p)[0]
            over = partial(height_ratio, b=b, slab=slab.scaled(pair.wash))
            yield prove("downwash ratio min", 1.0, pair.items(drones, body), over)
        for o, block, other in own_objects(p, q):
            gaps = partial(object_gap, b=b, slab=slab, o=o, block=block)
            yield prove(*cable_limit, pair.items(other, body), gaps)
