"""Links of cables: half crossings along a plan, against the states of phases."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from .arithmetic import (
    BIG,
    DEGREES,
    POS_TOL,
    Array,
    Index,
    Items,
    Line,
    Mask,
    maximum,
    norm,
    normalize,
)
from .cables import OPEN_ROLL, has_tension
from .catenary import catenary, catenary_depth
from .plan import CROSSINGS, HITCHED, LAID, LOOSE, ROLLING, SAG_TOL, TIGHTENED, Plan
from .shapes import distance, intersections
from .spans import Fault, Row, Spans, fault_row, prove

PAST_ROLL = 0.286  # [deg] largest roll past 180°, where cables pull by 5e-3 of their tension


def past_roll(s: Spans, c: Index, sense: Array) -> Line:
    """Return 0 where pairs certainly do not roll past lying across; otherwise negative values.

    From lying across, at -180° times its sense, a pair rolls to its clasp, and may pass it by a
    right angle.
    """
    k, j = s.plan.clasps[c], s.plan.behind[c]
    q, r = (s.leg_chord(i).unit() * s.pull(i) for i in (2 * k, 2 * j + 1))
    axis = (q + r).unit()
    bisector = s.edge(k)[0].unit() + s.edge(j)[1].unit()
    sine = axis.cross(bisector).dot(q - r) * sense[s.piece, c, None]
    cosine = axis.dot(bisector) * axis.dot(q - r) - bisector.dot(q - r)
    x = maximum(sine + cosine * math.tan(PAST_ROLL / DEGREES), -cosine).where(has_tension(s, k, j))
    return Line(np.minimum(x.v, 0.0), s.zero.g, np.where(x.low >= 0.0, 0.0, BIG), s.t)


def cable_heights(s: Spans, k: Items, share: Array) -> Array:
    """Return heights (m,) of hanging cables at relative positions along their chords."""
    with np.errstate(all="ignore"):
        chord, g = (x.v for x in catenary(s, 2 * k))
        depth = catenary_depth(s.plan.length[k, 0], chord[:, 2], g[:, 0], 2.0 * share - 1.0)
    return np.asarray(s.point(2 * k).v[:, 2] + share * chord[:, 2] - depth)


def crossing_heights(p: Plan, q: int, end: int) -> Array:
    """Return heights of cables over those behind where they cross at an end of piece q, or nan."""
    s = Spans.of(p, np.arange(len(p.h)) == q, p.clasps).subspan(2.0 * end - 1.0)
    chords = [(s.point(2 * k).v, s.q_to_r(k).v) for k in (p.clasps, p.behind)]
    x, y = intersections(*chords[0], *chords[1])
    return cable_heights(s, p.clasps, x) - cable_heights(s, p.behind, y)


def roll_changes(p: Plan, run: Items) -> tuple[Array, Array, Mask]:
    """Return rolls at the start of a run, their changes (c,) [deg], and a mask of valid changes.

    Rolls are sampled several times per piece, so that legs turn by much less than a right angle.
    """
    count = len(p.clasps)
    parts = 6
    places = np.repeat((np.arange(parts) + 0.5) / parts, count)
    q = np.repeat(run, len(places))
    x = np.asarray(np.tile(places, len(run)), np.float64)
    c = np.tile(np.arange(count), parts * len(run))
    s = Spans(p, q, c[:, None], x, 0.0 * x + 0.5 / parts)
    k, j = p.clasps[c], p.behind[c]
    with np.errstate(all="ignore"):  # legs may vanish
        q_, r = (s.leg_chord(i).unit() for i in (2 * k, 2 * j + 1))
        axis = (q_ + r).unit()
        u = s.edge(k)[0].unit() + s.edge(j)[1].unit()
        m, m0 = (y - axis * axis.dot(y) for y in (q_ - r, u))
        valid = (m.deviation < 0.5 * norm(m.v)) & (m0.deviation < 0.1 * norm(m0.v))
    sine = np.sum(np.cross(m0.v, axis.v) * m.v, -1)
    angles = np.degrees(np.arctan2(sine, np.sum(m0.v * m.v, -1))).reshape(-1, count)
    steps = (np.diff(angles, axis=0) + 180.0) % 360.0 - 180.0
    return angles[0], np.sum(steps, axis=0), np.all(valid.reshape(-1, count), axis=0)


class Run(NamedTuple):
    """Consecutive pieces of one state of cables, and the states before and after, or empty."""

    state: str
    pieces: Items
    before: str
    after: str


def runs_of_states(p: Plan) -> list[Run]:
    """Return the runs of a plan's pieces of one state."""
    runs = [(str(x), np.array([*q])) for x, q in groupby(range(len(p.h)), lambda q: p.state[q])]
    states = ["", *(state for state, _ in runs), ""]
    return [Run(state, q, states[k], states[k + 2]) for k, (state, q) in enumerate(runs)]


def rolled(
    p: Plan, run: Run, linked: Mask, sense: Array, order: Array
) -> tuple[Array, Array, list[tuple[Mask, str]]]:
    """Return senses and height orders (c,) after pairs have rolled, and masks of faults."""
    start, change, valid = roll_changes(p, run.pieces)
    opened = np.abs(start) >= OPEN_ROLL
    valid &= (opened == (order != 0.0)) & (opened | linked)
    sense = np.where(order != 0.0, order, sense)
    roll = start + 180.0 * sense  # relative to lying across
    roll = np.where(opened, (roll + 180.0) % 360.0 - 180.0, roll) + change
    across = np.abs(roll) <= 180.0 - OPEN_ROLL
    short = ~across & (np.abs(roll - 180.0 * sense) >= OPEN_ROLL)
    faults = [
        (opened & (not run.before), "a clasp is open at the start"),
        (~valid, "unlinked cables roll"),
        (short | across & (run.after == HITCHED), "pairs do not roll by a half turn"),
    ]
    return sense, np.where(across, sense, 0.0), faults


class Replay:
    """Half crossings of neighbours that are laid, bend and roll, followed run by run.

    For every clasp (c,), ``sense`` is that of its link, and ``order`` that of heights: 1 if the
    cable ahead lies on the one behind, 0 if they do not touch. On pieces (m, c) with vertical
    motion, ``sign`` is that of the upper cable, and ``least`` the smallest height of its q over the
    other one's, times that sign; on pieces that roll, ``sign`` is that of the sense.
    """

    def __init__(self, p: Plan, half_crossings: Array, sense: Array) -> None:
        self.p = p
        self.half_crossings = half_crossings
        self.sense = sense
        self.order = 0.0 * sense
        self.neighbours = np.minimum(p.clasps, p.behind), np.maximum(p.clasps, p.behind)
        self.faults = list[Fault]()
        self.sign = np.zeros((len(p.h), len(p.clasps)))
        self.least = np.full((len(p.h), len(p.clasps)), -BIG)

    def follow(self) -> None:
        """Follow all runs, and add half crossings on the way."""
        for run in runs_of_states(self.p):
            before = self.half_crossings[*self.neighbours, : run.pieces[0] + 1]
            number = np.sum(before, axis=-1)
            linked = np.abs(number) == 1.0
            if run.state == LAID:
                self.lay(run, linked)
            elif run.state == ROLLING:
                self.roll(run, linked)
            elif run.state == HITCHED and run.before not in ("", ROLLING):
                self.sense = number

    def check(self, run: Run, wrong: Any, text: str) -> None:
        """Note a fault of a run."""
        self.faults.append((float(self.p.breaks[run.pieces[0]]), bool(np.any(wrong)), text))

    def lay(self, run: Run, linked: Mask) -> None:
        """Follow cables that are laid, lifted and moved."""
        touching = linked | (self.order != 0.0)
        self.check(run, (run.before != ROLLING) & touching, "linked cables are laid")
        for vertical, part in groupby(run.pieces.tolist(), lambda q: bool(self.p.vertical[q])):
            self.move_laid(run, [*part], vertical)
        if run.before == ROLLING:
            self.half_crossings[*self.neighbours, run.pieces[0] + 1] -= self.sense

    def move_laid(self, run: Run, pieces: list[int], vertical: bool) -> None:
        """Follow laid cables on pieces on which they all move vertically, or none does."""
        p = self.p
        lifted = run.before == ROLLING and pieces[0] == run.pieces[0]
        lowered = run.after == ROLLING and pieces[-1] == run.pieces[-1]
        touch = lifted or lowered
        self.check(run, touch and (lowered == lifted or not vertical), "touching cables move")
        if not vertical:
            return
        at_start = crossing_heights(p, pieces[0], 0)
        at_end = crossing_heights(p, pieces[-1], 1)
        near, far = (at_start, at_end) if lifted else (at_end, at_start)
        upper = np.sign(np.nan_to_num(far))
        apart = np.isnan(far) & (not touch)
        clear = apart | (np.abs(far) >= p.crossing_limit[1])
        self.check(run, ~clear, "the height order of cables is not clear")
        heights = p.points.c[0][..., 2, :]
        z = heights[pieces[0], :, 0] if lifted else heights[pieces[-1], :, -1]
        rise = (z[2 * p.clasps] - z[2 * p.behind]) * upper
        least = rise if touch else rise - upper * near + p.crossing_limit[1]
        self.sign[pieces] = upper
        self.least[pieces] = np.where(apart, -BIG, least)
        self.check(run, touch and ~(np.abs(near) <= SAG_TOL), "cables do not touch")
        self.check(run, lifted and upper != self.order, "a cable is lifted through another one")
        self.order = upper if lowered else 0.0 * upper

    def roll(self, run: Run, linked: Mask) -> None:
        """Follow pairs that roll by half a turn."""
        crossed = np.where(linked, 0.0, self.order)
        np.add.at(self.half_crossings[..., run.pieces[-1] + 1], self.neighbours, crossed)
        self.sense, self.order, wrong = rolled(self.p, run, linked, self.sense, self.order)
        self.sign[run.pieces] = self.sense
        for mask, text in wrong:
            self.check(run, mask, text)


def interlacing(p: Plan) -> Iterator[Row]:
    """Check the crossings of all pairs of cables against the states of phases."""
    if np.any(p.free) or np.any(np.isin(p.state, (LAID, ROLLING))):
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

    # replay checks laid or rolling neighbours
    both = np.triu_indices(n, 1)
    laid = np.isin(p.state, (LAID, ROLLING))
    later_free = np.flip(np.logical_or.accumulate(np.flip(p.free)))
    loose = later_free[:, None] & ~(laid[:, None] & p.clasped[both])
    pairs = Spans.of(p, loose, np.column_stack(both), p.cables, p.cables)
    row = prove("interlacing 1 min", 0.0, pairs, decided)
    yield row.time, row.verdict != "proven", row.where
    i, j = np.minimum(p.behind, p.clasps), np.maximum(p.behind, p.clasps)
    tied = p.formed[0] or p.state[0] in (TIGHTENED, LOOSE)  # as at the start of a plan
    linked = np.full(len(p.clasps), float(tied))
    half_crossings[i, j, 0] = linked
    if np.any(laid):
        replay = Replay(p, half_crossings, linked)
        replay.follow()
        yield from replay.faults
        s = Spans.of(p, p.state == ROLLING, range(len(p.clasps)), p.labels[p.V])
        row = prove("roll 1 min", 0.0, s, partial(past_roll, sense=replay.sign))
        past = f"the pair at {row.where} rolls past lying across"
        yield row.time, row.verdict != "proven", past
    count = np.cumsum(half_crossings, axis=-1)
    numbers = np.array([CROSSINGS.get(state, -1) for state in p.state])
    expected = np.where(p.clasped[..., None], numbers, 0)
    same = np.concatenate([[False], p.formed[1:] & p.formed[:-1], [False]])  # within a hitch
    wrong = (np.abs(count[..., 1:]) != expected) & ~same[1:]
    wrong = (wrong | (np.abs(count[..., :-1]) != expected) & ~same[:-1]) & (expected >= 0)
    wrong[..., -1] |= (count[..., -1] != 0.0) & ~p.formed[-1]
    for k, o, q in np.argwhere(wrong & np.triu(np.ones((n, n), dtype=bool), 1)[..., None]):
        yield float(p.breaks[q]), True, f"{p.cables[k]}, {p.cables[o]}"
