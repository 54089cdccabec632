"""Cables before they are tied and after: on the ground, hanging, clasping and tightened."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from .arithmetic import (
    POS_TOL,
    UP,
    Index,
    Items,
    Line,
    concatenate,
    minimum,
)
from .cables import range_excess
from .catenary import above_floor, catenary_links, own_cable_gap, shift
from .plan import (
    CLASPING,
    EXACT_RANGE,
    GROUNDED,
    LOOSE,
    TIGHTENED,
    UNLINKED,
    Plan,
)
from .shapes import distance, hull_distance, prism_gap
from .spans import Row, Spans, prove


def free_cables(p: Plan) -> Iterator[Row]:
    """Prove distances of cables that lie, hang, clasp or are tightened."""
    k = range(p.n)
    pairs = np.triu_indices(p.n, 1)
    clasped = p.clasped[pairs] & ~np.isin(p.state, UNLINKED)[:, None]
    both = Spans.of(p, p.free[:, None] & ~clasped, np.column_stack(pairs), p.cables, p.cables)
    free, tightened = (Spans.of(p, on, k, p.cables) for on in (p.free, p.state == TIGHTENED))
    yield prove("span ratio max", 1.0, free, chord_share)
    yield prove(*p.crossing_limit, both, chord_gap)
    yield from hanging_cables(p)
    yield from clasping_cables(p)
    longer = "cable_length ratio max", 1e-4  # bound of lengths along vertices
    yield prove(*longer, tightened, lambda s, k: s.route_length(k) * (1.0 / p.length[k]) - 1.0)
    yield prove("tension N max", 1e-4, tightened, range_excess)
    yield from loose_cables(p)


def chord_share(s: Spans, k: Index) -> Line:
    """Return chords, longer by errors of both ends, over lengths.

    ``loss_displacement`` assumes how loose cables may be pulled.
    """
    p = s.plan
    chord = s.q_to_r(k)
    error = np.where((p.state != LOOSE)[s.piece, None], 2.0 * p.tracking, 0.0)
    if p.ratio == 1.0:
        return (chord.norm() + error) * (1.0 / p.length[k])
    level = chord[:2].norm() + error
    height = chord[2].norm() + error * p.ratio
    return concatenate(level, height).norm() * (1.0 / p.length[k])


def chord_gap(s: Spans, i: Index, j: Index) -> Line:
    """Return distances of chords in plan view."""
    return distance(s.level_chord(i), s.level_chord(j))


def foreign_drones(p: Plan) -> Items:
    """Return pairs (k, 2) of drones and cables of other robots."""
    return np.argwhere(np.arange(p.N)[:, None] // 2 != np.arange(p.n))


def hanging_cables(p: Plan) -> Iterator[Row]:
    """Prove distances of drones from cables that lie on the ground, or hang below their drones."""
    foreign = foreign_drones(p)
    ends = (p.names, p.cables)
    level = p.state == GROUNDED
    hangs = p.free & ~level & (p.state != LOOSE)
    lying = Spans.of(p, p.free & level, foreign, *ends)
    hanging = Spans.of(p, hangs, range(p.n), p.cables)

    def to_cable(s: Spans, i: Index, k: Index) -> Line:
        links = catenary_links(s, k)
        gaps = (distance([s.point(i)], x, p.ratio) for x in pairwise(links.cable))
        return minimum(*gaps) - links.sag - shift(s, k)

    yield prove(*p.cable_limit, lying, lambda s, i, k: distance([s.point(i)[:2]], s.level_chord(k)))
    yield prove(*p.cable_limit, hanging, above_floor)
    # Distances of a point of a cable to both ends sum to at most its length
    s = Spans.of(p, hangs, foreign, *ends)
    total = sum(((s.point(s.item[:, 0]) - x).norm() for x in s.ends(s.item[:, 1])), s.zero)
    reach = (p.sep["cable"] + EXACT_RANGE) * p.ratio
    s = s.select(total.low < p.length[s.item[:, 1], 0] + 2.0 * reach)
    yield prove(*p.cable_limit, s, to_cable)
    yield prove("cable_loops m min", POS_TOL, s, sheet_gap)
    own = np.column_stack([np.arange(p.N), np.arange(p.N) // 2])
    yield prove(*p.cable_limit, Spans.of(p, hangs, own, *ends), own_cable_gap)


def sheet_gap(s: Spans, i: Index, k: Index) -> Line:
    """Return distances of drones from sheets between hanging cables and their chords."""
    links = catenary_links(s, k)
    lower = [x - UP * links.sag for x in links.cable]
    parts = zip(pairwise(links.chord), pairwise(lower), strict=True)
    return minimum(*(prism_gap([s.point(i)], [*top, *bottom]) for top, bottom in parts))


def clasping_cables(p: Plan) -> Iterator[Row]:
    """Prove distances of hulls of cables that clasp from each other, and of drones from them."""
    pairs = np.triu_indices(p.n, 1)
    foreign = foreign_drones(p)
    apart = p.clasping[:, None] & ~p.clasped[pairs]
    loose = Spans.of(p, apart, np.column_stack(pairs), p.cables, p.cables)
    on_clasps = p.pairs[np.stack([p.begin, p.end], -1)[foreign[:, 1]] - p.N]
    turning = np.any(on_clasps == foreign[:, :1, None], axis=(1, 2))
    beside = p.clasping[:, None] & ~(turning & (p.state == CLASPING)[:, None])

    def between_hulls(s: Spans, i: Index, j: Index) -> Line:
        return hull_distance(*([x[:2] for x in s.hull(k)[:-1]] for k in (i, j)))

    def to_hull(s: Spans, i: Index, k: Index) -> Line:
        return prism_gap([s.point(i)], s.hull(k), p.ratio)

    yield prove(*p.crossing_limit, loose, between_hulls)
    s = Spans.of(p, beside, foreign, p.names, p.cables)
    s = s.near_hulls(s.item[:, 1], s.point(s.item[:, 0]), p.cable_limit[1] + EXACT_RANGE)
    yield prove(*p.cable_limit, s, to_hull)


def loose_cables(p: Plan) -> Iterator[Row]:
    """Prove heights of cables that are loose after a loss over the ground."""

    def height(s: Spans, k: Index) -> Line:
        more: float = (p.ratio - 1.0) * p.settings["separation"]["cable"]
        return (s.hull(k)[-1][2] - p.floor + more) * (1.0 / p.ratio)

    yield prove(*p.cable_limit, Spans.of(p, p.state == LOOSE, range(p.n), p.cables), height)
