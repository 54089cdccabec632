"""Checks of continuity, linking and duration: ``continuity``, ``interlacing``, ``duration``.

``interlacing``: cables are in the states that phases state, from paths alone. The *crossing number*
of two cables counts how often their chords have passed through each other, with signs. Free cables,
on the ground or hanging, have 0. In a valid hitch, and while cables are being tightened, neighbours
have ±1 (either sense of turning holds) and all others 0; clasping leads from the one to the other.
An initial hitch is assumed to have been tied with every q going up first, which is 1. While it
exists its cables cannot pass each other (checks ``equilibrium`` and ``crossing``), but their chords
may: they are followed if cables are released later. Also, no drone may fly inside the hanging
cable of another.

A *chord* is the straight line between a cable's drones. Two chords meet only where the volume
``(q_j - q_i) · ((r_i - q_i) × (r_j - q_j))`` vanishes. Time is halved until on every span of it the
chords are certainly *apart*, or *across*: seen along one direction each crosses the other between
its ends. Chords pass through each other only within spans across, as often, in sum, as the volume's
sign changes; next to a span apart that sign is certain. So no root has to be found: chords that
touch, rest in one plane at the moment of crossing, or turn back there are counted correctly.

The cable of a drone that flies through the *sheet* between a hanging cable and its chord is caught
when both are drawn taut, although their chords need never have met.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from hitchopt.checks.cables import LENGTH_LIMIT as SLACK
from hitchopt.checks.cables import TENSION_LIMIT
from hitchopt.checks.clasps import OPEN_STATES, ROLLED, turns
from hitchopt.checks.clearance import above_ground, cables_and_drones, chains
from hitchopt.checks.distances import (
    CROSSING,
    SIDEWAYS,
    TOUCHING,
    Flags,
    Moving,
    PairSpans,
    cable_ends,
    near,
    upright_pieces,
)
from hitchopt.checks.rule import CheckRule, Evaluator, WorstCase, summed, worst_at_joint
from hitchopt.checks.spans import (
    PART_NAMES,
    clasped_pairs,
    derivative,
    derivative_margin,
    edge_vectors,
    leg_vectors,
    pair_of,
    phase_parts,
    position_margin,
)
from hitchopt.errors import check_time
from hitchopt.geometry import shortest_offset
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch import Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.forces import cable_of, sag_factors
from hitchopt.motion.motion import FREE_STATES, HITCHED_STATE, JOINT, CableState, Motion, Phase
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.enclosed import Enclosed
from hitchopt.trajectory.search import batches
from hitchopt.values import Array, Indices

APART = 1e-6  # chords at least so far apart do not touch, drones so far from a sheet are off it [m]
MAX_HALVINGS = 30  # spans halved so often, and still open: a chord runs into another one's end


@dataclass(frozen=True, eq=False)
class Crossings:
    """Crossings of the chords of pairs of cables first < second; pairs not listed have none.

    Chords passed through each other ``count`` times, with signs, the last time about ``time`` [s].
    The count is not ``certain`` if an end ran into a chord, or if they touch at the end of time.
    """

    first: Indices
    second: Indices
    count: Indices
    certain: Flags
    time: Array


def _undecided(moving: Moving, decided: Callable[[PairSpans], Flags]) -> tuple[Indices, Array]:
    """Return the pairs that may touch, and the times [s] near which they stay undecided.

    Other spans are halved until decided, except of pairs that are undecided at mid time itself:
    chords that overlap for a while would be halved into 2**MAX_HALVINGS spans.
    """

    def left(spans: PairSpans) -> PairSpans:
        flags = [np.zeros(0, np.bool_), *(decided(batch) for batch in batches(spans))]
        return spans.take(~np.concatenate(flags))

    items, times = [np.zeros(0, dtype=np.intp)], [np.zeros(0)]

    def note(spans: PairSpans) -> None:
        items.append(spans.item)
        times.append(spans.times(np.zeros(len(spans))))

    for whole in near(moving, lambda: 2.0 * APART):
        spans = whole.take(slice(0, 0 if whole.points else None))
        for _ in range(MAX_HALVINGS):
            if not len(spans):
                break
            check_time()
            spans = left(spans)
            note(left(spans.at(np.full(len(spans), 0.5))))
            spans = spans.take(~np.isin(spans.item, items[-1])).halves()
        note(spans)
    return np.concatenate(items), np.concatenate(times)


def chord_crossings(drones: PiecewisePolynomial) -> Crossings:
    """Return the crossings of the chords of drones q0, r0, q1, … of shape (2n, 3) [m]."""
    moving = Moving(drones.breaks, cable_ends(drones.coefficients))
    rows = [np.zeros((5, 0))]  # pairs, when they may have met, and the volume's sign before, after

    def decided(spans: PairSpans) -> Flags:
        chords = np.concatenate(spans.ends, axis=1)
        apart, across = _apart(chords), _across(chords)
        met = spans.take(across & ~apart)
        if len(met) and not spans.points:
            ends = [met.at(np.full(len(met), x)) for x in (0.0, 1.0)]
            signs = [_sign(np.concatenate(each.ends, axis=1)[..., 0]) for each in ends]
            rows.append(
                np.stack([met.item, *(each.times(np.zeros(len(each))) for each in ends), *signs])
            )
        return apart | across

    open_, opened = _undecided(moving, decided)
    item, begin, end, before, after = np.concatenate(rows, axis=1)
    pairs, index = np.unique(np.concatenate([item, open_]).astype(np.intp), return_inverse=True)
    here, there = index[: len(item)], index[len(item) :]
    twice = np.bincount(here, after - before, len(pairs))
    unsure = (before == 0) & (begin <= drones.breaks[0] + JOINT)
    unsure |= (after == 0) & (end >= drones.breaks[-1] - JOINT)
    certain = twice % 2 == 0
    certain[here[unsure]] = certain[there] = False
    time = np.zeros(len(pairs))
    np.maximum.at(time, index, np.concatenate([end, opened]))
    some = ~certain | (twice != 0)
    first, second = np.divmod(pairs[some], moving.count)
    return Crossings(first, second, twice[some].astype(np.intp) // 2, certain[some], time[some])


def _apart(chords: Array) -> Flags:
    """Return on which spans chords certainly do not touch, as seen along one direction."""
    differences = Enclosed(chords[:, [0, 0, 1, 1]]) - Enclosed(chords[:, [2, 3, 2, 3]])
    along = unit(shortest_offset(differences.middle))
    apart: Flags = np.min(differences.dot(along[:, None]).below.value, axis=1) > APART
    return apart


def _across(chords: Array) -> Flags:
    """Return on which spans, seen along one direction, each chord crosses the other for certain."""
    qi, ri, qj, rj = (Enclosed(chords[:, k]) for k in range(4))
    normal = Enclosed.of(unit(np.cross((ri - qi).middle, (rj - qj).middle)))
    crossing = np.ones(len(chords), dtype=np.bool_)
    for a, b, c, d in ((qi, ri, qj, rj), (qj, rj, qi, ri)):
        sideways = normal.cross(b - a)
        one, other = (sideways.dot(to - a).range for to in (c, d))
        crossing &= ((one.low > 0.0) & (other.high < 0.0)) | ((one.high < 0.0) & (other.low > 0.0))
    return crossing


def _sign(chords: Array) -> Array:
    """Return the sign of the volume of chords (k, 4, 3) that are certainly apart, else 0."""
    qi, ri, qj, rj = np.moveaxis(chords, 1, 0)
    normal = np.cross(ri - qi, rj - qj)
    height = np.sum((qj - qi) * normal, axis=-1)
    sign: Array = np.sign(height) * (np.abs(height) > 0.5 * APART * np.linalg.norm(normal, axis=-1))
    return sign


def drones_inside_hanging_cables(motion: Motion) -> tuple[Indices, Indices, Array]:
    """Return drones that may fly inside other hanging cables, these cables, and when [s]."""
    moving = cables_and_drones(motion)
    item, time = _undecided(moving, _off)
    pairs, first = np.unique(item, return_index=True)
    cable, drone = np.divmod(pairs, moving.count)
    return drone, cable, time[first]


def _off(spans: PairSpans) -> Flags:
    """Return on which spans one direction separates a drone from the sheet between q and r.

    A sheet is convex: a point on one side of all of its corners is off it.
    """
    ends, drone = spans.ends
    points, off = chains(ends[:, 0], ends[:, 1], spans.lengths)
    apart = Enclosed(drone - points)
    # Towards the nearest side of the sheet: one of its links, or the chord.
    ring = np.concatenate([apart.middle, apart.middle[:, :1]], axis=1)
    offsets = shortest_offset(np.stack([ring[:, :-1], ring[:, 1:]], axis=2))
    nearest = np.argmin(np.linalg.norm(offsets, axis=-1), axis=1)
    edgewise = np.take_along_axis(offsets, nearest[:, None, None], axis=1)[:, 0]
    chord = ring[:, 0] - ring[:, -2]
    sideways = np.column_stack([-chord[:, 1], chord[:, 0], np.zeros(len(chord))])
    sideways *= np.sign(np.sum(sideways * ring[:, 0], axis=1))[:, None]
    sure = np.zeros(len(spans), dtype=np.bool_)
    for towards in (edgewise, sideways):
        along = unit(towards)
        least = np.min(apart.dot(along[:, None]).below.value, axis=1)
        # The cable is off its links upward or downward only.
        sure |= least > APART + np.abs(along[:, 2]) * np.max(off, axis=1)
    return sure


LAID = 0.02  # [m] Largest distance of cables that lie on one another: their sags differ
JUMP = 1e-6  # [m], [m/s], [m/s²] Largest sum of jumps, far below what a drone can follow
# States in which neighbours have the crossing number 0; in clasping it changes, else it is 1
BEFORE = frozenset({CableState.GROUND, CableState.FREE})
LAID_STATES = OPEN_STATES | {CableState.LAYING}  # followed by half crossings
MAX_NAMED = 12  # maximum number of pairs in ``where``
MAX_DRIFT = 1e-3  # [m] Largest motion of the middle of two drones that turn about each other
LAST_DRIFT = 1e-4  # [m] Largest change of legs beyond that of their sag, while they roll
MAX_PASSED = 0.02  # [m] Largest change of legs as cables that lie across pass weight
MAX_TAUT_SHARE = 0.5  # largest share of a tightening phase with cables at their full length:
# tightening comes to rest there, which takes a few hundredths of its time
PROBES = np.linspace(0.0, 1.0, 9)  # places on a piece, one of which shows that cables are slack


def _largest_jump(motion: Motion, _: float) -> WorstCase:
    """Return the largest sum of jumps at joints: positions [m], velocities, accelerations [m/s²].

    Drones and objects are compared, and vertices and legs while the hitch exists.
    """
    parts = [(motion.drones, motion.team.drone_names)]
    if motion.poses is not None:
        parts.append((motion.poses, tuple(motion.requirements.objects)))
    legs = tuple(f"{name} {k}" for k in motion.team.labels for name in PART_NAMES[0::2])
    for span in motion.spans(HITCHED_STATE):
        parts += [(span.vertices, span.team.point_names), (span.legs.reshaped(-1, 1), legs)]
    return jump_of(motion, parts)


def jump_of(
    motion: Motion, parts: Sequence[tuple[PiecewisePolynomial, Sequence[str]]]
) -> WorstCase:
    """Return the largest sum of jumps of curves on a motion's breaks, whose items have names."""
    cases = [WorstCase(0.0, float(motion.drones.breaks[0]))]
    for part, names in parts:
        for order in range(3):
            rates = derivative(part, order)
            left, right = rates[..., 0], rates[..., -1]
            margin = derivative_margin(part, order)
            noise = margin[1:] + margin[:-1] if order else position_margin(motion)
            jumps = summed(length(left[1:] - right[:-1]), 1e-3 * JUMP) + noise
            cases.append(worst_at_joint(jumps, part.breaks[1:], names))
    return max(cases, key=lambda case: case.worst)


JUMPS = Evaluator(_largest_jump, shown=(_largest_jump,))

# No jumps at joints of pieces, however many there are
CONTINUITY = CheckRule("continuity", "m", "max", JUMP, (JUMPS,), whole=True)


DURATION = CheckRule(
    "duration",
    "s",
    "max",
    lambda motion: motion.requirements.limits.duration,
    (Evaluator(lambda motion, _: WorstCase(motion.duration, float(motion.drones.breaks[-1]))),),
    "raise limits.duration, or the limits of motion",
    whole=True,
)
"""Duration of the plan, without a margin: the difference of two stored numbers."""


def _interlaced(motion: Motion, _: float) -> WorstCase:
    """Return the number of pairs of cables, or single cables, not in the state of their phase."""
    first, index_of = dict[int, tuple[float, int]](), motion.phases.index
    passing = [each for each in motion.phases if each.state is CableState.LYING]  # none joins here
    alone = range(0, motion.team.robots**2, motion.team.robots + 1)
    wrong = [*wrong_cables(motion, Ties.at_start(motion))]
    for phase, pair, time in (*wrong, *((each, k, each.start) for each in passing for k in alone)):
        first[pair] = min(first.get(pair, (np.inf, 0)), (time, index_of(phase)))
    if not first:
        return WorstCase(0.0, float(motion.drones.breaks[-1]))
    named = sorted(first, key=lambda pair: (first[pair], pair))[:MAX_NAMED]
    time, index = first[named[0]]
    where = [f"phase {index} ({motion.phases[index].name})"]
    where += [name for pair in named for name in _names(motion.team, pair)]
    return WorstCase(float(len(first)), time, tuple(where))


def wrong_cables(
    motion: Motion, ties: Ties, before: CableState | None = None, after: CableState | None = None
) -> Iterator[tuple[Phase, int, float]]:
    """Yield phases, their wrong cables ``i n + i`` and pairs ``i n + j``, and times [s].

    ``ties`` are those at the start, and become those at the end; ``before`` and ``after`` are the
    states of cables before and after the motion, None if nothing is known of it.
    """
    for phase, pairs, times in _wrong(motion, ties, before, after):
        for pair, time in zip(pairs.tolist(), np.broadcast_to(times, len(pairs)), strict=True):
            yield phase, pair, float(time)


def _wrong(
    motion: Motion, ties: Ties, before: CableState | None, after: CableState | None
) -> Iterator[tuple[Phase, Indices, Array | float]]:
    """Yield phases, and for each all pairs that are wrong at once."""
    layout, numbers = motion.team.layout, ties.numbers
    clasped = np.sort(clasped_pairs(layout))
    runs = [
        (state, list(run))
        for state, run in groupby(phase_parts(motion), lambda p: _followed(p.phase))
    ]
    around = [before, *(state for state, _ in runs), after]
    for i, (state, parts) in enumerate(runs):
        first, last, hitched = parts[0], parts[-1], state is CableState.HITCHED
        ends = [float(part.motion.drones.breaks[-1]) for part in parts]
        required = None if state is CableState.CLASPING else int(state not in BEFORE)
        if required is not None and state not in LAID_STATES:
            start = float(first.motion.drones.breaks[0])
            yield first.phase, clasped[np.abs(numbers) != required], start
        at_last = last.pieces.stop == motion.drones.pieces
        if hitched:
            ties.senses[:] = numbers
        if hitched and at_last:  # loaded clasps and separated parts stay linked
            continue
        span = motion.slice_pieces(
            slice(first.pieces.start, last.pieces.stop), [p.phase for p in parts]
        )
        if state in LAID_STATES:
            follow = ties.laid if state is CableState.LAYING else ties.rolled
            wrong = follow(span, around[i], around[i + 2])
            yield last.phase, clasped[wrong], ends[-1]
            for part in parts:
                yield part.phase, _contradicted(part.motion), float(part.motion.drones.breaks[0])
            continue
        met = chord_crossings(span.drones)
        pairs = pair_of(layout, met.first, met.second)
        known = np.isin(pairs, clasped)
        bad = ~met.certain | (~known & (met.count != 0))
        in_part = np.searchsorted(ends[:-1], met.time - JOINT)
        np.add.at(numbers, np.searchsorted(clasped, pairs[known]), met.count[known])
        if at_last:
            required = 0
        if required is not None:
            yield last.phase, clasped[np.abs(numbers) != required], ends[-1]
        for index, part in enumerate(parts):
            here = bad & (in_part == index)
            yield part.phase, pairs[here], met.time[here]
            if hitched:
                continue
            yield part.phase, _contradicted(part.motion), float(part.motion.drones.breaks[0])
            if state is not CableState.GROUND:  # on the ground drones stay clear as seen from above
                drone, cable, time = drones_inside_hanging_cables(part.motion)
                yield part.phase, pair_of(layout, drone // 2, cable), time


def _followed(phase: Phase) -> CableState:
    """Return the state as whose phases it is followed: lying across is a part of rolling."""
    return CableState.ROLLING if phase.state is CableState.LYING else phase.state


@dataclass(frozen=True, eq=False)
class Ties:
    """Ties of neighbours, each (clasps,) in the ``order`` of pairs; they change along a plan.

    Crossing numbers; the sense of a clasp, 1 or -1; and ``lying``, 1 where the cable ahead lies on
    the one behind, -1 below it, 0 where they are apart or clasped. Pairs that lie across roll by
    half a turn in the sense of that sign, which is then their crossing number.
    """

    order: Indices
    numbers: Indices
    senses: Indices
    lying: Indices

    @classmethod
    def at_start(cls, motion: Motion) -> Ties:
        """Return the ties as a plan begins.

        An initial hitch is assumed to be tied with every q going up first: 1 for neighbours.
        """
        order = np.argsort(clasped_pairs(motion.team.layout))
        numbers = np.full(len(order), int(motion.formed[0]), dtype=np.intp)
        return cls(order, numbers, numbers.copy(), 0 * numbers)

    def laid(self, motion: Motion, before: CableState | None, after: CableState | None) -> Flags:
        """Return (clasps,) the pairs that are not laid, or lifted, on a run of its pieces.

        Where cables go straight up or down all neighbours cross, seen from above. They come down to
        where they roll, or rise from there; the one that is above is so all the time.
        """
        upright, least = upright_pieces(motion), max(CROSSING.limit_of(motion) or 0.0, TOUCHING)
        ties = before is CableState.ROLLING, after is CableState.ROLLING
        wrong: Flags = (self.numbers != 0) & (not ties[0])
        wrong |= (ties[0] and not upright[0]) or (ties[1] and not upright[-1])
        signs = 0 * self.lying
        edges = np.flatnonzero(np.diff(np.concatenate([[False], upright, [False]])))
        for start, stop in edges.reshape(-1, 2).tolist():
            gaps = height_gaps(motion.slice_pieces(slice(start, stop), motion.phases))[self.order]
            rises, comes = ties[0] and start == 0, ties[1] and stop == len(upright)
            there, away = gaps[:, 0, 0], gaps[:, -1, -1]
            there, away = (there, away) if rises else (away, there)
            over = np.sign(np.nan_to_num(away)).astype(np.intp)
            compared = ~np.isnan(away) | (rises or comes)  # at rest apart nothing crosses
            wrong |= compared & ~(np.abs(away) >= least)
            floor = np.full(len(away), least)
            if rises or comes:
                wrong |= ~(np.abs(there) <= LAID)
                wrong |= rises & (over != self.lying)
                floor, signs = over * there - JUMP, signs if rises else over
            wrong |= compared & ~(np.min(over[:, None, None] * gaps, axis=(1, 2)) >= floor)
        self.numbers[:], self.lying[:] = 0, signs
        return wrong

    def rolled(self, motion: Motion, before: CableState | None, after: CableState | None) -> Flags:
        """Return (clasps,) the pairs that roll otherwise than by half a turn in the right sense.

        Pairs that are open when a plan begins are assumed to lie as they roll.
        """
        start, change = (each[self.order] for each in turns(motion))
        lies, wrong = np.abs(start) >= ROLLED, np.isnan(change)
        change = np.nan_to_num(change)
        if before is None:
            self.lying[:] = np.where(lies, np.sign(change), 0)
        wrong |= (lies != (self.lying != 0)) | (~lies & (np.abs(self.numbers) != 1))
        self.senses[:] = np.where(lies, self.lying, self.senses)
        opened = -180.0 * self.senses  # roll of a pair that lies across
        start = np.where(lies, opened + (start - opened + 180.0) % 360.0 - 180.0, start)
        across = np.abs(start + change - opened) <= 180.0 - ROLLED
        wrong |= ~across & (np.abs(start + change) >= ROLLED)
        wrong |= across & (after is CableState.HITCHED)
        self.numbers[:] = np.where(lies, self.senses, self.numbers)
        self.lying[:] = np.where(across, self.senses, 0)
        return wrong


def height_gaps(motion: Motion) -> Array:
    """Return by how much the cable ahead is above the one behind (clasps, pieces, degree + 1) [m].

    At the crossing of their chords, seen from above, of cables that go straight up or down; nan
    where they do not cross.
    """
    layout, c = motion.team.layout, motion.drones.coefficients
    q, r = c[0, 0::2, :, 0], c[0, 1::2, :, 0]
    cables = Catenary.between(q, r, motion.team.cable_length)
    ahead, behind = layout.ahead, layout.behind
    u, v, apart = (
        (x[:, 0], x[:, 1]) for x in ((r - q)[ahead], (r - q)[behind], (q[behind] - q[ahead]))
    )
    turn = u[0] * v[1] - u[1] * v[0]
    with np.errstate(all="ignore"):
        shares = [(apart[0] * w[1] - apart[1] * w[0]) / turn for w in (v, u)]
    rises = c[:, 0::2, 2] - c[:1, 0::2, 2, :1]  # (pieces, n, degree + 1)
    heights = []
    for cable, share in zip((ahead, behind), shares, strict=True):
        mu = 2.0 * np.where((share > 0.0) & (share < 1.0), share, np.nan) - 1.0
        whole = np.full(motion.team.robots, np.nan)
        whole[cable] = mu
        level = (q[:, 2] + 0.5 * (1.0 + whole) * (r - q)[:, 2] - cables.depth(whole))[cable]
        heights.append(level[:, None, None] + np.moveaxis(rises[:, cable], 1, 0))
    difference: Array = heights[0] - heights[1]
    return difference


def _names(team: Team, pair: int) -> list[str]:
    layout = team.layout
    if pair in (pairs := clasped_pairs(layout)):
        return [f"p{layout.clasps[int(np.argmax(pairs == pair))]}"]
    return [f"cable {team.labels[k]}" for k in sorted({*divmod(pair, layout.robots)})]


def _contradicted(motion: Motion) -> Indices:
    """Return the cables and pairs, in a phase of one state, that are not in it.

    Legs and tensions are zero without a hitch. On the ground no drone moves sideways, and some
    cable is closer to it than a hanging cable may be. In clasping, drones at a clasp turn about a
    point at rest, and some chords meet. While tightened, cables are slack for most of the time.
    Cables that are laid do not turn. Where they roll, vertices and legs rest, and unequal tensions,
    loads and objects are not allowed.
    """
    state, n = motion.phases[0].state, motion.team.robots
    alone = np.arange(n) * (n + 1)
    parts = [motion.legs.coefficients, motion.tensions.coefficients, motion.pulls.coefficients]
    sizes = [np.max(np.abs(c), axis=(0, -1)).reshape(n, -1) for c in parts]
    told = np.any(np.concatenate(sizes, axis=1) > 0.0, axis=1) & ~motion.formed[0]
    wrong = [alone[told]]
    if state is CableState.GROUND:
        level = motion.drones.coefficients[:, :, :2]
        moved = np.ptp(level, axis=(0, -1)).reshape(n, -1)
        wrong.append(alone[np.any(moved > SIDEWAYS, axis=1)])
        if above_ground(motion):
            wrong.append(alone)
    elif state is CableState.CLASPING:
        layout, c = motion.team.layout, motion.drones.coefficients
        pairs, met = clasped_pairs(layout), chord_crossings(motion.drones)
        middles = 0.5 * (c[:, 2 * layout.ahead] + c[:, 2 * layout.behind + 1])
        moved = np.max(np.ptp(middles, axis=(0, -1)), axis=-1)
        if np.any(np.isin(met.first * n + met.second, pairs)):
            pairs = pairs[moved > MAX_DRIFT]
        wrong.append(pairs)
    elif state is CableState.LAYING:
        offsets = motion.drones.coefficients[:, 1::2] - motion.drones.coefficients[:, 0::2]
        wrong.append(alone[np.max(np.ptp(offsets, axis=(0, -1)), axis=-1) > SIDEWAYS])
    elif state in OPEN_STATES:
        pulled = motion.pulls.coefficients.reshape(len(motion.drones.durations), n, 2, -1)
        loaded = any(phase.hold is not None for phase in motion.phases) or np.any(motion.team.load)
        moved = np.max(np.ptp(motion.vertices.coefficients, axis=(0, -1))) > SIDEWAYS
        lying, legs = state is CableState.LYING, motion.legs.coefficients
        sags = sag_factors(motion.team, motion.team.tension)[:, None] * np.max(legs, (0, -1)) ** 3
        drift = MAX_PASSED if lying else sags + LAST_DRIFT
        moved |= bool(np.any(np.ptp(legs, axis=(0, -1)) > drift))
        moved |= np.max(np.abs(pulled - motion.tensions.coefficients[:, :, None])) > TENSION_LIMIT
        start, change = turns(motion)
        moved |= not np.any(np.abs([start, start + change]) >= ROLLED)  # nothing opens, or is open
        moved |= lying and bool(np.any(np.abs(change) >= 180.0 - ROLLED))
        if moved or loaded or np.ptp(motion.team.tension) > 0.0:
            wrong.append(alone)
    elif state is CableState.TIGHTENING and _taut_share(motion) > MAX_TAUT_SHARE:
        wrong.append(alone)
    return np.unique(np.concatenate(wrong))


def _taut_share(motion: Motion) -> float:
    """Return the share of time in which cables are not provably slack around the vertices.

    Lengths are weighted by tensions: their sum is least where taut cables balance, so that no
    choice of vertices hides cables at their full length.
    """
    legs, edges = (
        bernstein.evaluate(vectors[None], PROBES[:, None, None, None])
        for vectors in (leg_vectors(motion), edge_vectors(motion))
    )
    sag = sag_factors(motion.team, motion.team.tension)
    lengths = sum(cable_of(each, sag) for each in (edges, legs[:, :, 0::2], legs[:, :, 1::2]))
    weights, full = motion.team.tension, motion.team.cable_length
    taut = np.max(1.0 - lengths @ weights / float(full @ weights), axis=0) <= SLACK
    return float(np.sum(motion.drones.durations[taut]) / motion.duration)


INTERLACING = CheckRule(
    "interlacing",
    "1",
    "max",
    lambda motion: (
        None if motion.cable_states <= {CableState.HITCHED} or motion.team.robots == 1 else 0.0
    ),
    (Evaluator(_interlaced, FREE_STATES | HITCHED_STATE),),
    "place the drones so that cables need not pass each other",
    whole=True,
)
