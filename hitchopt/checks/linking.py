"""Checks of continuity, linking and duration: ``continuity``, ``interlacing``, ``duration``.

``interlacing``: cables are in the states of their phases, as derived from paths alone. The
*crossing number* of two cables counts how often their chords have passed through each other, with
signs. Free cables, on the ground or hanging, have 0. In a valid hitch, and while cables are being
tightened, neighbours have ±1 (either sense of turning holds) and all others 0; clasping leads from
0 to ±1. An initial hitch is assumed to have been tied with every q going up first, which is 1.
Cables of a hitch cannot pass each other (checks ``equilibrium`` and ``crossing``), but their chords
may: these are followed if cables are released later. Also, no drone may fly inside the hanging
cable of another.

A *chord* is the straight line between a cable's drones. Two chords intersect only where the volume
``(q_j - q_i) · ((r_i - q_i) × (r_j - q_j))`` vanishes. Time is halved until on every span the
chords are certainly *apart*, or *across*: seen along some direction, each crosses the other between
its ends. Chords pass through each other only within spans across, in total as often as the volume's
sign changes; next to a span apart, that sign is certain. No root is computed: chords that touch,
rest in one plane while crossing, or turn back there are counted correctly.

If a drone flies through the *sheet* between a hanging cable and its chord, its cable is caught when
both are drawn taut, although the chords may never have intersected.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from hitchopt.checks.cables import LENGTH_LIMIT, TENSION_LIMIT
from hitchopt.checks.clasps import (
    MAX_PAST_ROLL,
    OPEN_ROLL,
    roll_changes,
    roll_past,
)
from hitchopt.checks.clearance import above_ground, cables_and_drones, chains
from hitchopt.checks.distances import (
    CROSSING,
    MAX_SIDEWAYS,
    Flags,
    Moving,
    PairSpans,
    cable_ends,
    near_pairs,
    nearest,
    upright_pieces,
)
from hitchopt.checks.objects import carried_objects
from hitchopt.checks.rule import CheckRule, Evaluator, WorstCase, accumulated, worst_at_joint
from hitchopt.checks.spans import (
    MotionSpans,
    PhasePart,
    bent_edges,
    clasped_pairs,
    derivative,
    derivative_margin,
    edge_vectors,
    leg_vectors,
    pair_of,
    phase_parts,
    position_margin,
    rate,
)
from hitchopt.errors import check_time
from hitchopt.geometry import shortest_offset
from hitchopt.geometry.vectors import left_of, length, unit
from hitchopt.hitch import Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.forces import cable_of, sag_factors
from hitchopt.hitch.pairs import MIN_GAP
from hitchopt.motion.loads import stated_tensions
from hitchopt.motion.motion import (
    FREE_STATES,
    JOINT,
    LAID_STATES,
    TAUT_STATES,
    UNLINKED_STATES,
    CableState,
    HoldBy,
    Motion,
    Phase,
)
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.bernstein import same_degree
from hitchopt.trajectory.enclosed import Bound, Enclosed, Interval
from hitchopt.trajectory.search import TimeSpans, batches, worst
from hitchopt.values import Array, Indices, true_runs

MIN_DISTANCE = 1e-6  # [m] of chords that do not touch, and of drones outside sheets
MAX_HALVINGS = 30  # Spans still open after these: a chord touches another one's end


@dataclass(frozen=True, eq=False)
class Crossings:
    """Crossings of the chords of pairs of cables first < second; other pairs have none.

    Chords passed through each other ``count`` times, with signs, the last time about ``time`` [s].
    The count is not ``certain`` if an end touched a chord, or if chords touch at either end of the
    motion.
    """

    first: Indices
    second: Indices
    count: Indices
    certain: Flags
    time: Array


def _open_pairs(moving: Moving, decided: Callable[[PairSpans], Flags]) -> tuple[Indices, Array]:
    """Return the pairs that may touch, and the times [s] near which they stay undecided.

    Other spans are halved until decided, except those of pairs that are undecided at mid time:
    chords that overlap for a while would lead to 2**MAX_HALVINGS spans.
    """

    def undecided(spans: PairSpans) -> PairSpans:
        flags = [np.zeros(0, np.bool_), *(decided(batch) for batch in batches(spans))]
        return spans.take(~np.concatenate(flags))

    items, times = [np.zeros(0, dtype=np.intp)], [np.zeros(0)]

    def record(spans: PairSpans) -> None:
        items.append(spans.item)
        times.append(spans.times(np.zeros(len(spans))))

    for whole in near_pairs(moving, lambda: 2.0 * MIN_DISTANCE):
        spans = whole.take(slice(0, 0 if whole.points else None))
        for _ in range(MAX_HALVINGS):
            if not len(spans):
                break
            check_time()
            spans = undecided(spans)
            record(undecided(spans.at(0.5)))
            spans = spans.take(~np.isin(spans.item, items[-1])).halves()
        record(spans)
    return np.concatenate(items), np.concatenate(times)


def chord_crossings(drones: PiecewisePolynomial) -> Crossings:
    """Return the crossings of the chords of drones q0, r0, q1, … of shape (2n, 3) [m]."""
    moving = Moving(drones.breaks, cable_ends(drones.coefficients))
    events = [np.zeros((5, 0))]  # pair, start, end, sign of the volume before and after

    def decided(spans: PairSpans) -> Flags:
        chords = np.concatenate(spans.ends, axis=1)
        separated, across = _are_separated(chords), _are_crossing(chords)
        crossing = spans.take(across & ~separated)
        if len(crossing) and not spans.points:
            ends = [crossing.at(x) for x in (0.0, 1.0)]
            signs = [_sign(np.concatenate(spans_at.ends, axis=1)[..., 0]) for spans_at in ends]
            times = [spans_at.times(np.zeros(len(spans_at))) for spans_at in ends]
            events.append(np.stack([crossing.item, *times, *signs]))
        return separated | across

    open_items, open_times = _open_pairs(moving, decided)
    item, begin, end, before, after = np.concatenate(events, axis=1)
    items = np.concatenate([item, open_items]).astype(np.intp)
    pairs, index = np.unique(items, return_inverse=True)
    event_index, open_index = index[: len(item)], index[len(item) :]
    twice = np.bincount(event_index, after - before, len(pairs))
    ambiguous = (before == 0) & (begin <= drones.breaks[0] + JOINT)
    ambiguous |= (after == 0) & (end >= drones.breaks[-1] - JOINT)
    certain = twice % 2 == 0
    certain[event_index[ambiguous]] = certain[open_index] = False
    time = np.zeros(len(pairs))
    np.maximum.at(time, index, np.concatenate([end, open_times]))
    reported = ~certain | (twice != 0)
    first, second = np.divmod(pairs[reported], moving.count)
    count = twice[reported].astype(np.intp) // 2
    return Crossings(first, second, count, certain[reported], time[reported])


def _are_separated(chords: Array) -> Flags:
    """Return on which spans a plane separates two chords for certain."""
    differences = Enclosed(chords[:, [0, 0, 1, 1]]) - Enclosed(chords[:, [2, 3, 2, 3]])
    along = unit(shortest_offset(differences.middle))
    return np.asarray(np.min(differences.dot(along[:, None]).lower.value, axis=1) > MIN_DISTANCE)


def _are_crossing(chords: Array) -> Flags:
    """Return on which spans, seen along some direction, two chords cross for certain."""
    first_start, first_end, second_start, second_end = (Enclosed(chords[:, k]) for k in range(4))
    first, second = (first_start, first_end), (second_start, second_end)
    chord, other_chord = (first_end - first_start).middle, (second_end - second_start).middle
    normal = Enclosed.of(unit(np.cross(chord, other_chord)))
    crossing = np.ones(len(chords), dtype=np.bool_)
    for (start, end), (one, other) in ((first, second), (second, first)):
        sideways = normal.cross(end - start)
        one_side = sideways.dot(one - start).range
        other_side = sideways.dot(other - start).range
        down = (one_side.low > 0.0) & (other_side.high < 0.0)
        up = (one_side.high < 0.0) & (other_side.low > 0.0)
        crossing &= down | up
    return crossing


def _sign(chords: Array) -> Array:
    """Return the sign of the volume of chords (k, 4, 3) if they are certainly apart, else 0."""
    qi, ri, qj, rj = np.moveaxis(chords, 1, 0)
    normal = np.cross(ri - qi, rj - qj)
    height = np.sum((qj - qi) * normal, axis=-1)
    separated = np.abs(height) > 0.5 * MIN_DISTANCE * np.linalg.norm(normal, axis=-1)
    return np.asarray(np.sign(height) * separated)


def drones_inside_hanging_cables(motion: Motion) -> tuple[Indices, Indices, Array]:
    """Return drones that may fly inside other hanging cables, these cables, and times [s]."""
    moving = cables_and_drones(motion)
    item, time = _open_pairs(moving, _outside_sheet)
    pairs, first = np.unique(item, return_index=True)
    cable, drone = np.divmod(pairs, moving.count)
    return drone, cable, time[first]


def _outside_sheet(spans: PairSpans) -> Flags:
    """Return on which spans a plane separates a drone from the sheet of a hanging cable.

    The sheet is convex: a point on one side of all of its corners is outside.
    """
    ends, drone = spans.ends
    points, tolerance = chains(ends[:, 0], ends[:, 1], spans.lengths)
    offsets = Enclosed(drone - points)
    # Direction of the nearest side of the sheet: one of its links, or the chord.
    ring = np.concatenate([offsets.middle, offsets.middle[:, :1]], axis=1)
    directions = shortest_offset(np.stack([ring[:, :-1], ring[:, 1:]], axis=2))
    nearest = np.argmin(np.linalg.norm(directions, axis=-1), axis=1)
    edgewise = np.take_along_axis(directions, nearest[:, None, None], axis=1)[:, 0]
    chord = ring[:, 0] - ring[:, -2]
    sideways = left_of(chord)
    sideways *= np.sign(np.sum(sideways * ring[:, 0], axis=1))[:, None]
    outside = np.zeros(len(spans), dtype=np.bool_)
    for direction in (edgewise, sideways):
        along = unit(direction)
        smallest = np.min(offsets.dot(along[:, None]).lower.value, axis=1)
        # The cable deviates from its links only vertically.
        outside |= smallest > MIN_DISTANCE + np.abs(along[:, 2]) * np.max(tolerance, axis=1)
    return outside


MAX_LAID_GAP = 0.02  # [m] Largest distance of cables that lie on each other: their sags differ
MAX_JUMP = 1e-6  # [m], [m/s], [m/s²] Largest sum of jumps, far below what a drone can follow
MAX_NAMED = 12  # maximum number of pairs in ``where``
MAX_DRIFT = 1e-3  # [m] Largest motion of the midpoint of two drones that turn about each other
MAX_LEG_DRIFT = 1e-4  # [m] Largest change of legs beyond that of their sag, while they roll
MAX_TAUT_SHARE = 0.5  # largest fraction of a tightening phase with cables at their full length:
# tightening comes to rest there, which takes a few hundredths of its time
PROBES = np.linspace(0.0, 1.0, 9)  # points of a piece, one of which shows that cables are slack


def _largest_jump(motion: Motion, _: float) -> WorstCase:
    """Return the largest sum of jumps at joints: positions [m], velocities, accelerations [m/s²].

    Drones and objects are compared, and vertices, legs and their inner ends while cables are taut.
    """
    parts = [(motion.drones, motion.team.drone_names)]
    if motion.requirements.objects:
        parts.append((motion.poses, tuple(motion.requirements.objects)))
    legs = motion.team.leg_names
    for span in motion.spans(TAUT_STATES):
        parts += [(span.vertices, span.team.point_names), (span.legs.reshaped(-1, 1), legs)]
        if span.has_bent_cables:
            parts.append((span.inner_ends.reshaped(-1, 3), legs))
    cases = [WorstCase(0.0, float(motion.drones.breaks[0]))]
    for part, names in parts:
        rates = [derivative(part, order) for order in range(3)]
        left = np.stack([values[..., 0] for values in rates])
        right = np.stack([values[..., -1] for values in rates])
        jumps = accumulated(length(left[:, 1:] - right[:, :-1]), 1e-3 * MAX_JUMP)
        jumps[0] += position_margin(motion)
        for order in (1, 2):
            margin = derivative_margin(part, order)
            jumps[order] += margin[1:] + margin[:-1]
        cases.append(worst_at_joint(np.maximum.reduce(jumps), part.breaks[1:], names))
    return max(cases, key=lambda case: case.worst)


JUMPS = Evaluator(_largest_jump, formulas=(_largest_jump,))

# No jumps at joints of pieces
CONTINUITY = CheckRule(
    "continuity", "m", "max", MAX_JUMP, (JUMPS,),
    remedy="far from the origin rounding causes jumps: subtract an offset from all coordinates; "
    "near it, please report this",
    whole=True,
)  # fmt: skip


DURATION = CheckRule(
    "duration",
    "s",
    "max",
    lambda motion: motion.requirements.limits.duration,
    (Evaluator(lambda motion, _: WorstCase(motion.duration, float(motion.drones.breaks[-1]))),),
    "raise limits.duration, or the limits of motion",
    whole=True,
)
"""Duration of the plan, exact: the difference of two stored numbers."""


def _interlacing_errors(motion: Motion, _: float) -> WorstCase:
    """Return the number of pairs of cables, or cables, that contradict the state of their phase."""
    first, index_of = dict[int, tuple[float, int]](), motion.phases.index
    for phase, pairs, times in _wrong_cables(motion):
        for pair, time in zip(pairs.tolist(), np.broadcast_to(times, len(pairs)), strict=True):
            first[pair] = min(first.get(pair, (np.inf, 0)), (float(time), index_of(phase)))
    if not first:
        return WorstCase(0.0, float(motion.drones.breaks[-1]))
    named = sorted(first, key=lambda pair: (first[pair], pair))[:MAX_NAMED]
    time, index = first[named[0]]
    where = [f"phase {index} ({motion.phases[index].name})"]
    where += [name for pair in named for name in _names(motion.team, pair)]
    return WorstCase(float(len(first)), time, tuple(where))


Wrong = tuple[Phase, Indices, "Array | float"]
"""A phase, cables ``i n + i`` or pairs ``i n + j`` that contradict it, and times [s]."""


def _wrong_cables(motion: Motion) -> Iterator[Wrong]:
    """Yield phases, and cables and pairs that contradict them."""
    ties = Ties.at_start(motion)
    runs = [
        (state, list(run)) for state, run in groupby(phase_parts(motion), lambda p: p.phase.state)
    ]
    states = [None, *(state for state, _ in runs), None]
    for i, (state, parts) in enumerate(runs):
        first, last = parts[0], parts[-1]
        is_hitched = state is CableState.HITCHED
        is_last = last.pieces.stop == motion.drones.pieces
        if state not in LAID_STATES:
            yield from _wrong_at_start(state, first, ties)
        if is_hitched:
            ties.senses[:] = ties.numbers
        if is_hitched and is_last:  # loaded clasps and separated parts stay linked
            continue
        pieces = slice(first.pieces.start, last.pieces.stop)
        span = motion.slice_pieces(pieces, [part.phase for part in parts])
        if state in LAID_STATES:
            yield from _wrong_while_laid(span, parts, ties, states[i], states[i + 2])
        else:
            yield from _wrong_crossings(span, parts, ties, is_last=is_last)


def _required_number(state: CableState) -> int | None:
    """Return the size of neighbours' crossing numbers in a state; None where it changes."""
    return None if state is CableState.CLASPING else int(state not in UNLINKED_STATES)


def _wrong_at_start(state: CableState, part: PhasePart, ties: Ties) -> Iterator[Wrong]:
    """Yield the neighbours that have another crossing number than a state that begins requires."""
    required, start = _required_number(state), float(part.motion.drones.breaks[0])
    if required is not None:
        yield part.phase, ties.pairs[np.abs(ties.numbers) != required], start
        if state is CableState.HITCHED:
            yield part.phase, ties.pairs[_opposite(ties.pairs, ties.numbers)], start


def _wrong_crossings(
    span: Motion, parts: Sequence[PhasePart], ties: Ties, *, is_last: bool
) -> Iterator[Wrong]:
    """Yield what contradicts one state, on a span of its phases; update the crossing numbers.

    In the ``is_last`` state cables end without ties.
    """
    layout, state, last = span.team.layout, parts[0].phase.state, parts[-1]
    ends = [float(part.motion.drones.breaks[-1]) for part in parts]
    crossings = chord_crossings(span.drones)
    pairs = pair_of(layout, crossings.first, crossings.second)
    is_neighbour = np.isin(pairs, ties.pairs)
    invalid = ~crossings.certain | (~is_neighbour & (crossings.count != 0))
    part_index = np.searchsorted(ends[:-1], crossings.time - JOINT)
    ties_index = np.searchsorted(ties.pairs, pairs[is_neighbour])
    np.add.at(ties.numbers, ties_index, crossings.count[is_neighbour])
    required = 0 if is_last else _required_number(state)
    if required is not None:
        yield last.phase, ties.pairs[np.abs(ties.numbers) != required], ends[-1]
    for index, part in enumerate(parts):
        selected = invalid & (part_index == index)
        yield part.phase, pairs[selected], crossings.time[selected]
        if state is CableState.HITCHED:
            continue
        compared = span if state is CableState.DRAWN else part.motion
        yield part.phase, _contradictions(compared), float(part.motion.drones.breaks[0])
        if state is not CableState.GROUND:  # there, drones keep a horizontal distance
            drone, cable, time = drones_inside_hanging_cables(part.motion)
            yield part.phase, pair_of(layout, drone // 2, cable), time


def _wrong_while_laid(
    span: Motion,
    parts: Sequence[PhasePart],
    ties: Ties,
    before: CableState | None,
    after: CableState | None,
) -> Iterator[Wrong]:
    """Yield what contradicts one of LAID_STATES, on a span of its phases; update the ties.

    The states ``before`` and ``after`` it are None at the ends of the plan.
    """
    last = parts[-1]
    end = float(last.motion.drones.breaks[-1])
    yield last.phase, ties.pairs[ties.followed(last.phase.state, span, before, after)], end
    for part in parts:
        start = float(part.motion.drones.breaks[0])
        yield part.phase, _contradictions(part.motion), start
        if part.phase.state is CableState.ROLLING:
            yield part.phase, ties.pairs[ties.past(part.motion)], start


@dataclass(frozen=True, eq=False)
class Ties:
    """Ties of neighbours, updated along a plan, each (clasps,) in the ``order`` of ``pairs``.

    They are crossing ``numbers``, ``senses`` of clasps, 1 or -1, and ``lying``: 1 where the cable
    ahead lies on the one behind, -1 below it, 0 where they are apart or clasped. Pairs that lie
    across roll by half a turn in the sense of that sign, which becomes their crossing number.
    """

    pairs: Indices
    order: Indices
    numbers: Indices
    senses: Indices
    lying: Indices

    @classmethod
    def at_start(cls, motion: Motion) -> Ties:
        """Return the ties at the start of a plan.

        An initial hitch is assumed to be tied with every q going up first: 1 for neighbours.
        """
        pairs = clasped_pairs(motion.team.layout)
        order = np.argsort(pairs)
        numbers = np.full(len(order), int(motion.formed[0]), dtype=np.intp)
        return cls(np.sort(pairs), order, numbers, numbers.copy(), 0 * numbers)

    def followed(
        self,
        state: CableState,
        motion: Motion,
        before: CableState | None,
        after: CableState | None,
    ) -> Flags:
        """Update the ties in one of LAID_STATES, and return invalid pairs (clasps,)."""
        if state is CableState.BENT:
            return self.bend(motion, before, after)
        if state is CableState.LAYING:
            return self.lay(motion, before, after)
        return self.roll(motion, after)

    def lay(self, motion: Motion, before: CableState | None, after: CableState | None) -> Flags:
        """Update the ties while cables are laid or lifted, and return invalid pairs (clasps,).

        While cables move vertically, all neighbours cross, seen from above. They come down before
        they roll, or rise after that, and the upper one stays above.
        """
        after_rolling = before is CableState.ROLLING
        before_rolling = after is CableState.ROLLING
        min_gap = max(CROSSING.limit_of(motion) or 0.0, MIN_GAP)
        upright = upright_pieces(motion)
        wrong: Flags = (self.numbers != 0) & (not after_rolling)
        wrong |= after_rolling and not upright[0]
        wrong |= before_rolling and not upright[-1]
        signs = 0 * self.lying
        for start, stop in true_runs(upright):
            rising = after_rolling and start == 0
            descending = before_rolling and stop == len(upright)
            gaps = height_gaps(motion.slice_pieces(slice(start, stop), motion.phases))[self.order]
            first, last = gaps[:, 0, 0], gaps[:, -1, -1]
            contact, clearance = (first, last) if rising else (last, first)
            over = np.sign(np.nan_to_num(clearance)).astype(np.intp)
            compared = ~np.isnan(clearance) | rising | descending  # at rest, nothing crosses
            wrong |= compared & ~(np.abs(clearance) >= min_gap)
            least_gap = np.full(len(clearance), min_gap)
            if rising or descending:
                wrong |= ~(np.abs(contact) <= MAX_LAID_GAP)
                wrong |= rising & (over != self.lying)
                least_gap = over * contact - MAX_JUMP
                signs = signs if rising else over
            smallest = np.min(over[:, None, None] * gaps, axis=(1, 2))
            wrong |= compared & ~(smallest >= least_gap)
        self.numbers[:] = 0
        self.lying[:] = signs
        return wrong

    def bend(self, motion: Motion, before: CableState | None, after: CableState | None) -> Flags:
        """Update the ties while cables are bent around an object, and return invalid pairs.

        Before they roll, or after that, both cables of a clasp cross beyond the object, seen from
        above. Since they began to cross, one is above the other, and they come to lie on each
        other. At all other times they keep apart, as their arcs and their ends at different clasps
        do always.
        """
        layout = motion.team.layout
        lying = 0 * self.lying
        wrong: Flags = (self.numbers != 0) & (before is not CableState.ROLLING)
        wrong |= not nearest(_opposite_ends)(motion, MAX_LAID_GAP).worst >= MAX_LAID_GAP
        wrong |= not worst(BothCables.of(motion), opposite_sides, "min", target=0.0).worst > 0.0
        for i, k in enumerate(self.order.tolist()):
            heights = heights_beyond(motion, int(layout.ahead[k]), int(layout.behind[k]))
            # Spans from the one next to rolling on; column of the height at that end of a span
            for neighbour, from_rolling, end in ((before, heights, 0), (after, heights[::-1], 1)):
                if neighbour is not CableState.ROLLING:
                    continue
                crosses = ~np.isnan(from_rolling[:, 0])
                count = int(np.sum(np.logical_and.accumulate(crosses)))
                # On the span on which they begin, or cease, to cross
                bounds = from_rolling[count - 1, 2:] if count else np.zeros(2)
                sign = int(np.all(bounds > 0.0)) - int(np.all(bounds < 0.0))
                wrong[i] |= sign == 0
                wrong[i] |= not abs(from_rolling[0, end]) <= MAX_LAID_GAP
                wrong[i] |= not np.all(sign * from_rolling[:count] >= -MAX_LAID_GAP)
                if neighbour is before:
                    wrong[i] |= sign != self.lying[i]
                if neighbour is after:
                    lying[i] = sign
                from_rolling[:count] = np.inf  # followed: only later crossings may touch
            wrong[i] |= bool(np.any(np.min(heights, 1) * np.max(heights, 1) <= 0.0))
        self.numbers[:] = 0
        self.lying[:] = lying
        return wrong

    def roll(self, motion: Motion, after: CableState | None) -> Flags:
        """Update the ties while cables roll, and return invalid pairs (clasps,).

        Pairs roll by half a turn, in the sense in which they lie. At the start of a plan, no pair
        is open: its curves do not show which cable lies on the other.
        """
        start, change = (each[self.order] for each in roll_changes(motion))
        crossed, wrong = np.abs(start) >= OPEN_ROLL, np.isnan(change)
        change = np.nan_to_num(change)
        wrong |= (crossed != (self.lying != 0)) | (~crossed & (np.abs(self.numbers) != 1))
        self.senses[:] = np.where(crossed, self.lying, self.senses)
        open_roll = -180.0 * self.senses  # roll of a pair that lies across
        start = np.where(crossed, open_roll + (start - open_roll + 180.0) % 360.0 - 180.0, start)
        ends_crossed = np.abs(start + change - open_roll) <= 180.0 - OPEN_ROLL
        wrong |= ~ends_crossed & (np.abs(start + change) >= OPEN_ROLL)
        wrong |= ends_crossed & (after is CableState.HITCHED)
        self.numbers[:] = np.where(crossed, self.senses, self.numbers)
        self.lying[:] = np.where(ends_crossed, self.senses, 0)
        return wrong

    def past(self, motion: Motion) -> Flags:
        """Return pairs that roll past lying across on a motion of one state (clasps,)."""
        senses = np.empty(len(self.order))
        senses[self.order] = self.senses
        return roll_past(motion, senses, MAX_PAST_ROLL)[self.order]


def _opposite(clasped: Indices, numbers: Indices) -> Flags:
    """Return clasps (clasps,) of two cables that clasp twice, in opposite senses.

    ``clasped`` are the sorted pairs. Such cables come apart where the object between them ends.
    """
    same = clasped[:, None] == clasped
    return np.asarray(np.any(same & (numbers[:, None] != numbers), axis=1))


MAX_HEIGHT_ERROR = 5e-3  # [m] Largest width of the interval of the height of a crossing


def heights_beyond(motion: Motion, ahead: int, behind: int) -> Array:
    """Return the heights of a crossing beyond an object, on spans in the order of time (spans, 4).

    The chord of the cable ``ahead`` from its first contact to its q-drone crosses that of the cable
    ``behind`` from its last contact to its r-drone. Its height over the other one [m], where they
    cross seen from above, is given at the start and the end of each span, with its lowest and
    highest value. It is nan where a plane separates them and 0 where they may touch.
    """
    both = outer_chords(motion)[:, [2 * ahead, 2 * behind + 1]]
    chords = both.reshape(len(both), 1, 4, *both.shape[3:])
    spans = TimeSpans(motion, motion.drones.breaks, *np.indices((len(chords), 1)).reshape(2, -1))
    starts, rows = list[Array](), list[Array]()
    for depth in range(MAX_HALVINGS):
        if not len(spans):
            break
        check_time()
        crossing, height = _crossing_height(spans.read(chords))
        apart = _are_separated(spans.read(chords)) & ~crossing
        narrow = crossing & (height.high - height.low <= MAX_HEIGHT_ERROR)
        middle = spans.at(np.full(len(spans), 0.5)).read(chords)
        touching = ~(_are_separated(middle) | _crossing_height(middle)[0])
        done = apart | narrow | touching | (depth == MAX_HALVINGS - 1)
        _, first = _crossing_height(spans.at(np.zeros(len(spans))).read(chords))
        _, last = _crossing_height(spans.at(np.ones(len(spans))).read(chords))
        heights = np.stack([first.low, last.low, height.low, height.high], axis=1)
        heights[~crossing] = 0.0
        heights[apart] = np.nan
        starts.append(spans.times(np.zeros(len(spans)))[done])
        rows.append(heights[done])
        spans = spans.take(~done).halves()
    in_order = np.argsort(np.concatenate(starts), kind="stable")
    return np.asarray(np.concatenate(rows)[in_order])


def _crossing_height(chords: Array) -> tuple[Flags, Interval]:
    """Return on which spans two chords cross for certain, seen from above, and the first's height.

    Heights are over the second chord [m].
    """
    first_start, first_end, second_start, second_end = (Enclosed(chords[:, k]) for k in range(4))
    first, second = (first_start, first_end), (second_start, second_end)
    crossing = np.ones(len(chords), dtype=np.bool_)
    for (start, end), (one, other) in ((first, second), (second, first)):
        along = (end - start).xy
        one_side = along.cross((one - start).xy).range
        other_side = along.cross((other - start).xy).range
        left_to_right = (one_side.low > 0.0) & (other_side.high < 0.0)
        right_to_left = (other_side.low > 0.0) & (one_side.high < 0.0)
        crossing &= left_to_right | right_to_left
    normal = (first_end - first_start).cross(second_end - second_start)
    with np.errstate(all="ignore"):
        height = (first_start - second_start).dot(normal).range * normal[2].range.inverse
    return crossing, height


def outer_chords(motion: Motion) -> Array:
    """Return chords from contacts with an object to drones (pieces, 2n, 2, 3, degree + 1) [m]."""
    drones, contacts = same_degree(motion.drones.coefficients, motion.contacts.coefficients)
    return np.stack([contacts.reshape(drones.shape), drones], axis=2)


def _opposite_ends(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of chords of bent cables that lead to different clasps."""
    names = motion.team.drone_names
    pairs = Moving.of(motion, outer_chords(motion), names=(names, names))
    yield replace(pairs, allowed=lambda i, j: (i + j) % 2 == 0)


class BothCables(MotionSpans):
    """Spans of two cables together."""

    names = staticmethod(lambda _: ("both cables",))


def opposite_sides(spans: BothCables) -> Bound:
    """Return a bound [m] that is positive where two bent cables are on opposite sides of a line.

    An arc leads from its first to its last contact, and turns right by less than half a turn. It is
    on one side of a line if both contacts are, and neither straight part of its edge leads across
    that line toward the object.
    """
    motion, cables = spans.source, np.broadcast_to([0, 1], (len(spans), 2))
    parts = [spans.read(edges, cables)[..., :2, :] for edges in bent_edges(motion)]
    normals = np.stack(same_degree(*parts), axis=2)[..., ::-1, :] * [[-1.0], [1.0]]  # to the left
    contacts = Enclosed(spans.read(motion.contacts.coefficients, cables), spans.noise).xy
    directions = unit(Enclosed(normals).middle)  # (spans, cable, end, 2)
    along = unit(np.sum(directions[:, 0] - directions[:, 1], axis=1))[:, None, None]
    turned = Enclosed(normals, spans.noise).dot(along * [[[1.0]], [[-1.0]]])
    places = contacts.dot(along).range
    gap = np.min(places.low[:, 0], axis=-1) - np.max(places.high[:, 1], axis=-1) - MIN_GAP
    return Bound(np.minimum(gap, np.min(turned.lower.value, axis=(1, 2))), np.full(len(spans), 0.5))


def height_gaps(motion: Motion) -> Array:
    """Return the height of cables ahead above those behind (clasps, pieces, degree + 1) [m].

    Cables move vertically. Heights are those at the crossing of their chords, seen from above; nan
    if they do not cross.
    """
    layout, drones = motion.team.layout, motion.drones.coefficients
    ahead, behind = layout.ahead, layout.behind
    q, r = drones[0, 0::2, :, 0], drones[0, 1::2, :, 0]
    chords = r - q
    cables = Catenary.between(q, r, motion.team.cable_length)
    lifts = drones[:, 0::2, 2] - drones[:1, 0::2, 2, :1]  # (pieces, n, degree + 1)

    def heights(cable: Indices, fraction: Array) -> Array:
        """Return the heights of cables at fractions of their chords (clasps, pieces, …) [m]."""
        on_chord = np.where((fraction > 0.0) & (fraction < 1.0), fraction, np.nan)
        place = np.full(motion.team.robots, np.nan)  # from -1 at q to 1 at r
        place[cable] = 2.0 * on_chord - 1.0
        level = q[:, 2] + 0.5 * (1.0 + place) * chords[:, 2] - cables.depth(place)
        return np.asarray(level[cable][:, None, None] + np.moveaxis(lifts[:, cable], 1, 0))

    offset = (q[behind] - q[ahead])[:, :2]
    chord_ahead, chord_behind = chords[ahead][:, :2], chords[behind][:, :2]
    turn = _cross(chord_ahead, chord_behind)
    with np.errstate(all="ignore"):
        fraction_ahead = _cross(offset, chord_behind) / turn
        fraction_behind = _cross(offset, chord_ahead) / turn
    return heights(ahead, fraction_ahead) - heights(behind, fraction_behind)


def _cross(first: Array, second: Array) -> Array:
    """Return the cross products (…) of vectors (…, 2)."""
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])


def _names(team: Team, pair: int) -> list[str]:
    layout = team.layout
    if pair in (pairs := clasped_pairs(layout)):
        return [f"p{layout.clasps[int(np.argmax(pairs == pair))]}"]
    return [team.cable_names[k] for k in sorted({*divmod(pair, layout.robots)})]


def _contradictions(motion: Motion) -> Indices:
    """Return the cables and pairs that contradict the state of a motion with a single state.

    Legs and tensions are zero without a hitch. Other rules are those of ``CONTRADICTING_CABLES``,
    by state, and of clasping pairs.
    """
    state = motion.phases[0].state
    wrong = _have_hitch_values(motion) & ~motion.taut[0]
    if state in CONTRADICTING_CABLES:
        wrong = wrong | CONTRADICTING_CABLES[state](motion)
    cables = np.flatnonzero(wrong)
    items = cables * (motion.team.robots + 1)  # as pairs of a cable with itself
    if state is CableState.CLASPING:
        items = np.concatenate([items, _wrong_clasping_pairs(motion)])
    return np.unique(items)


def _have_hitch_values(motion: Motion) -> Flags:
    """Return the cables (n,) with a leg or a tension other than zero."""
    robots = motion.team.robots
    curves = motion.legs, motion.tensions, motion.pulls
    largest = [np.max(np.abs(curve.coefficients), axis=(0, -1)) for curve in curves]
    by_cable = np.concatenate([sizes.reshape(robots, -1) for sizes in largest], axis=1)
    return np.asarray(np.any(by_cable > 0.0, axis=1))


def _off_ground(motion: Motion) -> Flags:
    """Return the cables (n,) that contradict lying on the ground.

    Drones move only vertically, and some cable is closer to the ground than one may be that hangs.
    """
    level = motion.drones.coefficients[:, :, :2]
    travel = np.ptp(level, axis=(0, -1)).reshape(motion.team.robots, -1)
    return np.asarray(np.any(travel > MAX_SIDEWAYS, axis=1) | above_ground(motion))


def _not_drawn(motion: Motion) -> Flags:
    """Return the cables (n,) that contradict being drawn taut.

    Their drones keep their heights and move either apart or together.
    """
    heights = motion.drones.coefficients[:, :, 2]
    rises = np.max(np.ptp(heights, axis=-1), axis=0).reshape(motion.team.robots, 2)
    chord_rates = rate(motion, chord_squares)
    approaches = np.min(chord_rates, axis=(0, -1)) < -MAX_DRIFT
    recedes = np.max(chord_rates, axis=(0, -1)) > MAX_DRIFT
    return np.asarray(np.any(rises > MAX_SIDEWAYS, axis=1) | (approaches & recedes))


def _not_laid(motion: Motion) -> Flags:
    """Return the cables (n,) that contradict being laid: those that turn."""
    drones = motion.drones.coefficients
    chords = drones[:, 1::2] - drones[:, 0::2]
    changes = np.max(np.ptp(chords, axis=(0, -1)), axis=-1)
    return np.asarray(changes > MAX_SIDEWAYS)


def _not_rolling(motion: Motion) -> Flags:
    """Return all cables (n,) if one contradicts rolling.

    Vertices are at rest, and legs but for the sag of their tension; some clasp is open. Unequal
    tensions, loads and objects are not allowed.
    """
    is_wrong = _vertices_move(motion) or _legs_change(motion) or _pulls_differ(motion)
    is_wrong = is_wrong or not _has_open_clasp(motion) or _is_loaded(motion)
    is_wrong = is_wrong or bool(np.ptp(motion.team.tension) > 0.0)
    return np.full(motion.team.robots, is_wrong)


def _vertices_move(motion: Motion) -> bool:
    """Return whether a vertex moves."""
    travel = np.ptp(motion.vertices.coefficients, axis=(0, -1))
    return bool(np.max(travel) > MAX_SIDEWAYS)


def _legs_change(motion: Motion) -> bool:
    """Return whether a leg changes by more than its sag at the lowest tension."""
    legs = motion.legs.coefficients
    lowest_tensions = np.min(stated_tensions(motion)[..., 0], axis=0)
    sag = sag_factors(motion.team, lowest_tensions)[:, None] * np.max(legs, axis=(0, -1)) ** 3
    return bool(np.any(np.ptp(legs, axis=(0, -1)) > sag + MAX_LEG_DRIFT))


def _pulls_differ(motion: Motion) -> bool:
    """Return whether a drone's cable pulls with another tension than that of its edge."""
    pieces, robots = len(motion.drones.durations), motion.team.robots
    pulls = motion.pulls.coefficients.reshape(pieces, robots, 2, -1)
    differences = np.abs(pulls - motion.tensions.coefficients[:, :, None])
    return bool(np.max(differences) > TENSION_LIMIT)


def _has_open_clasp(motion: Motion) -> bool:
    """Return whether a pair lies across at the start or at the end."""
    start, change = roll_changes(motion)
    return bool(np.any(np.abs([start, start + change]) >= OPEN_ROLL))


def _is_loaded(motion: Motion) -> bool:
    """Return whether clasps carry a load, or an object that moves or rests on them."""
    if np.any(carried_objects(motion)) or np.any(motion.team.load):
        return True
    holds = (phase.hold for phase in motion.phases)
    return any(hold is not None and hold.by is HoldBy.REST for hold in holds)


def _not_tightening(motion: Motion) -> Flags:
    """Return all cables (n,) unless they are slack for most of the time."""
    return np.full(motion.team.robots, _taut_share(motion) > MAX_TAUT_SHARE)


CONTRADICTING_CABLES: dict[CableState, Callable[[Motion], Flags]] = {
    CableState.GROUND: _off_ground,
    CableState.DRAWN: _not_drawn,
    CableState.LAYING: _not_laid,
    CableState.ROLLING: _not_rolling,
    CableState.TIGHTENING: _not_tightening,
}
"""Functions that return the cables (n,) which contradict a state."""


def _wrong_clasping_pairs(motion: Motion) -> Indices:
    """Return the pairs that contradict clasping.

    Some chords cross, and drones at a clasp turn about a fixed point.
    """
    layout, drones = motion.team.layout, motion.drones.coefficients
    pairs: Indices = clasped_pairs(layout)
    crossings = chord_crossings(motion.drones)
    crossed = crossings.first * motion.team.robots + crossings.second
    if not np.any(np.isin(crossed, pairs)):
        return pairs
    centres = 0.5 * (drones[:, 2 * layout.ahead] + drones[:, 2 * layout.behind + 1])
    drift = np.max(np.ptp(centres, axis=(0, -1)), axis=-1)
    drifting: Indices = pairs[drift > MAX_DRIFT]
    return drifting


def chord_squares(motion: Motion) -> Array:
    """Return squared lengths of cables' chords (pieces, n, degree + 1) [m²]."""
    chords = motion.drones.coefficients[:, 1::2] - motion.drones.coefficients[:, 0::2]
    return bernstein.dot(chords, chords)


def _taut_share(motion: Motion) -> float:
    """Return the fraction of time in which cables are not provably slack around the vertices.

    Lengths are weighted by tensions: their sum is smallest where taut cables balance, so no choice
    of vertices hides cables at their full length.
    """
    legs, edges = (
        bernstein.evaluate(vectors[None], PROBES[:, None, None, None])
        for vectors in (leg_vectors(motion), edge_vectors(motion))
    )
    sag = sag_factors(motion.team, motion.team.tension)
    parts = edges, legs[:, :, 0::2], legs[:, :, 1::2]
    lengths = sum(cable_of(vectors, sag) for vectors in parts)
    weights, full_lengths = motion.team.tension, motion.team.cable_length
    taut = np.max(1.0 - lengths @ weights / float(full_lengths @ weights), axis=0) <= LENGTH_LIMIT
    return float(np.sum(motion.drones.durations[taut]) / motion.duration)


INTERLACING = CheckRule(
    "interlacing",
    "1",
    "max",
    lambda motion: None if motion.cable_states <= {CableState.HITCHED} else 0.0,
    (Evaluator(_interlacing_errors, FREE_STATES | TAUT_STATES),),
    "place the drones so that cables need not pass each other",
    whole=True,
)
