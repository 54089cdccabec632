"""Links of cables: half crossings along a plan, against the states of phases."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .arithmetic import (
    BIG,
    POS_TOL,
    Array,
    Index,
    Line,
    normalize,
)
from .plan import CROSSINGS, LOOSE, TIGHTENED, Plan
from .shapes import distance
from .spans import Fault, Row, Spans, fault_row, prove


def interlacing(p: Plan) -> Iterator[Row]:
    """Check the crossings of all pairs of cables against the states of phases."""
    if np.any(p.free):
        yield fault_row("interlacing", link_faults(p))


def link_faults(p: Plan) -> Iterator[Fault]:
    """Count crossings of chords on pieces on which cables are free now or later.

    A hitch keeps its links: chords are followed through it if cables are released later. On spans
    on which chords may touch, each must provably cross the other, projected along their common
    normal; the sign of ``(q_j - q_i)·((r_i - q_i) × (r_j - q_j))`` changes with each crossing.
    """
    n = p.n
    m = len(p.h)
    half_crossings = np.zeros((n, n, m + 1))  # initial ones, then those of each piece

    def sign(s: Spans, end: float) -> Array:
        """Return the sign at an end of spans; at joints the one of the later piece."""
        x = s.x + end * s.w
        later = (x >= 1.0) & (s.piece < m - 1)
        there = Spans(p, s.piece + later, s.item, np.where(later, 0.0, x), 0.0 * x)
        i, j = s.item.T
        off = (there.point(2 * j) - there.point(2 * i)).v
        return np.asarray(np.sign(np.sum(off * np.cross(there.q_to_r(i).v, there.q_to_r(j).v), -1)))

    def decided(s: Spans, i: Index, j: Index) -> Line:
        ends, chords = (s.ends(i), s.ends(j)), (s.q_to_r(i), s.q_to_r(j))
        apart = distance(*ends).low > POS_TOL
        normal = normalize(np.cross(chords[0].v, chords[1].v))
        crosses = ~apart
        for chord, (base, _), others in zip(chords, ends, ends[::-1], strict=True):
            a, b = (chord.cross(x - base).dot(normal) for x in others)
            crosses &= ((a.low > 0) & (b.high < 0)) | ((a.high < 0) & (b.low > 0))
        step = 0.5 * (sign(s, 1.0) - sign(s, -1.0)) * crosses
        np.add.at(half_crossings, (*s.item.T, s.piece + 1), step)
        return Line(s.zero.v, s.zero.g, np.where(apart | crosses, 0.0, BIG), s.t)

    both = np.column_stack(np.triu_indices(n, 1))
    later_free = np.flip(np.logical_or.accumulate(np.flip(p.free)))
    pairs = Spans.of(p, later_free, both, p.cables, p.cables)
    row = prove("interlacing 1 min", 0.0, pairs, decided)
    yield row.time, row.verdict != "proven", row.where
    i, j = np.minimum(p.behind, p.clasps), np.maximum(p.behind, p.clasps)
    tied = p.formed[0] or p.state[0] in (TIGHTENED, LOOSE)  # as at the start of a plan
    half_crossings[i, j, 0] = float(tied)
    count = np.cumsum(half_crossings, axis=-1)
    numbers = np.array([CROSSINGS.get(state, -1) for state in p.state])
    expected = np.where(p.clasped[..., None], numbers, 0)
    same = np.concatenate([[False], p.formed[1:] & p.formed[:-1], [False]])  # within a hitch
    wrong = (np.abs(count[..., 1:]) != expected) & ~same[1:]
    wrong = (wrong | (np.abs(count[..., :-1]) != expected) & ~same[:-1]) & (expected >= 0)
    wrong[..., -1] |= (count[..., -1] != 0.0) & ~p.formed[-1]
    for k, o, q in np.argwhere(wrong & np.triu(np.ones((n, n), dtype=bool), 1)[..., None]):
        yield float(p.breaks[q]), True, f"{p.cables[k]}, {p.cables[o]}"
