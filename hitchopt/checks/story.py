"""Checks of the story of the plan: ``continuity``, ``interlacing``, ``duration``.

``interlacing``: cables are in the states that phases state, from paths alone. The *crossing number*
of two cables counts how often their chords have passed through each other, with signs. Free cables,
on the ground or hanging, have 0. A hitch is right when neighbours have ±1 (either sense of turning
holds) and all others 0; so they have while cables are being tightened, and clasping leads from the
one to the other. A hitch that is there at first is taken to have been tied with every q going up
first, which is 1. Besides, no drone may fly inside the hanging cable of another.

Each state brings rules of its own, so a plan must not choose them: where the rules of another state
would be due, the polynomials contradict the one that is stated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from hitchopt.checks.cables import LENGTH_LIMIT as SLACK
from hitchopt.checks.crossings import chord_crossings, entered
from hitchopt.checks.hanging import above_ground
from hitchopt.checks.rule import CheckRule, Finder, Finding
from hitchopt.checks.spans import derivative_margin, position_margin
from hitchopt.checks.tables import PART_NAMES, clasped_pairs, edge_vectors, leg_vectors, pair_of
from hitchopt.geometry.vectors import length
from hitchopt.hitch.forces import cable_of, sag_factors
from hitchopt.hitch.team import Layout
from hitchopt.motion.motion import FREE_STATES, HITCHED_STATE, JOINT, CableState, Motion, Phase
from hitchopt.trajectory import bernstein
from hitchopt.values import Array, Indices

JUMP = 1e-6
"""[m], [m/s], [m/s²] Largest jump: no drone tells a smaller one from none."""

NUMBERS = {
    CableState.GROUND: 0,
    CableState.FREE: 0,
    CableState.TIGHTENING: 1,
    CableState.HITCHED: 1,
}
"""Size of the crossing numbers of neighbours before and after phases in these states."""

MOST_NAMED = 12
"""Pairs that ``where`` names at most."""

STILL = 1e-6
"""[m] Drones above the ground move sideways by no more while their cables lie on it."""

CENTRED = 1e-3
"""[m] The middle of two drones that turn about each other moves by no more."""

MOSTLY = 0.5
"""Cables that are at their full length for a larger share of a phase are not being tightened:
tightening comes to rest there, which takes a few hundredths of its time."""

PROBES = np.linspace(0.0, 1.0, 9)
"""Places on a piece, one of which shows that cables are slack there."""


def _largest_jump(motion: Motion, _: float) -> Finding:
    """Return the largest jump at a joint of position [m], velocity [m/s] or acceleration [m/s²].

    Drones and objects are looked at, and vertices and legs while the hitch exists; the unit is
    given as m, whichever of the three it is. A jump of a vector is measured by its norm. ``where``
    names the drone, the object, the vertex or the leg.
    """
    parts = [(motion.drones, motion.team.drone_names)]
    if motion.poses is not None:
        parts.append((motion.poses, tuple(motion.requirements.objects)))
    legs = tuple(f"{name} {k}" for k in range(motion.team.robots) for name in PART_NAMES[0::2])
    for span in motion.spans(HITCHED_STATE):
        parts += [(span.vertices, span.team.point_names), (span.legs.reshaped(-1, 1), legs)]
    found = Finding(0.0, float(motion.drones.breaks[0]))
    for part, names in parts:
        if part.pieces == 1:
            continue
        ends = [part.ends(derivative) for derivative in range(3)]
        jump = length(np.array([left[1:] - right[:-1] for left, right in ends]))
        jump[0] += position_margin(motion)
        for derivative in (1, 2):
            margin = derivative_margin(part, derivative)
            jump[derivative] += margin[1:] + margin[:-1]
        place = np.unravel_index(int(np.argmax(jump)), jump.shape)
        if jump[place] > found.worst:
            time = float(part.breaks[place[1] + 1])
            found = Finding(float(jump[place]), time, (names[place[2]],))
    return found


CONTINUITY = CheckRule(
    "continuity", "m", "max", JUMP, (Finder(_largest_jump, shown=(_largest_jump,)),), whole=True
)
"""Nothing jumps where one piece follows another."""


DURATION = CheckRule(
    "duration",
    "s",
    "max",
    lambda motion: motion.requirements.limits.duration,
    (Finder(lambda motion, _: Finding(motion.duration, float(motion.drones.breaks[-1]))),),
    "raise limits.duration, or the limits of motion",
    whole=True,
)
"""That of the whole plan, without a margin: the difference of two stored numbers."""


@dataclass(frozen=True, eq=False)
class PhasePart:
    """A phase, its pieces in the whole motion, and the motion on them."""

    phase: Phase
    pieces: slice
    motion: Motion


def phase_parts(motion: Motion) -> Iterator[PhasePart]:
    """Yield the phases of a motion, each piece in the phase of its middle.

    Of blended steps, phases end within pieces.
    """
    index, breaks = motion.phase_of_piece, motion.drones.breaks
    for i, phase in enumerate(motion.phases):
        pieces = np.flatnonzero(index == i)
        if len(pieces):
            run = slice(int(pieces[0]), int(pieces[-1]) + 1)
            own = replace(phase, start=float(breaks[run.start]), end=float(breaks[run.stop]))
            yield PhasePart(phase, run, motion.taken(run, (own,)))


def _interlaced(motion: Motion, _: float) -> Finding:
    """Return how many pairs of cables, or single ones, are not in the state that a phase states.

    ``where`` names the first phase in which that is so, the vertex of neighbours, both cables of
    other pairs and single cables.
    """
    layout, wrong = motion.team.layout, dict[int, tuple[float, int]]()
    for phase, pairs, times in _wrong(motion):
        index = motion.phases.index(phase)
        for pair, time in zip(pairs.tolist(), np.broadcast_to(times, len(pairs)), strict=True):
            wrong[pair] = min(wrong.get(pair, (np.inf, 0)), (float(time), index))
    if not wrong:
        return Finding(0.0, float(motion.drones.breaks[-1]))
    named = sorted(wrong, key=lambda pair: (wrong[pair], pair))[:MOST_NAMED]
    time, index = wrong[named[0]]
    where = [f"phase {index} ({motion.phases[index].name})"]
    where += [name for pair in named for name in _names(layout, pair)]
    return Finding(float(len(wrong)), time, tuple(where))


def _wrong(motion: Motion) -> Iterator[tuple[Phase, Indices, Array | float]]:
    """Yield what is wrong in a phase, and when: pairs of cables ``i * n + j`` with i <= j.

    A pair of a cable with itself is that cable alone.
    """
    layout = motion.team.layout
    clasped = np.sort(clasped_pairs(layout))
    # A hitch that is there at first has been tied with every q going up first: 1 for neighbours.
    numbers = np.full(len(clasped), int(motion.formed[0]), dtype=np.intp)
    for state, run in groupby(phase_parts(motion), lambda part: part.phase.state):
        parts = list(run)
        first, last = parts[0], parts[-1]
        ends = [float(part.motion.drones.breaks[-1]) for part in parts]
        required = NUMBERS.get(state)
        if required is not None:
            start = float(first.motion.drones.breaks[0])
            yield first.phase, clasped[np.abs(numbers) != required], start
        if state is CableState.HITCHED:
            continue
        span = motion.taken(slice(first.pieces.start, last.pieces.stop), [p.phase for p in parts])
        met = chord_crossings(span.drones)
        pairs = pair_of(layout, met.first, met.second)
        known = np.isin(pairs, clasped)
        bad = ~met.certain | (~known & (met.count != 0))
        in_part = np.searchsorted(ends[:-1], met.time - JOINT)
        np.add.at(numbers, np.searchsorted(clasped, pairs[known]), met.count[known])
        if last.pieces.stop == motion.drones.pieces:
            required = 0
        if required is not None:
            yield last.phase, clasped[np.abs(numbers) != required], ends[-1]
        for i, part in enumerate(parts):
            here = bad & (in_part == i)
            yield part.phase, pairs[here], met.time[here]
            yield part.phase, _contradicted(part.motion), float(part.motion.drones.breaks[0])
            if state is not CableState.GROUND:  # there drones keep off cables seen from above
                inside = entered(part.motion)
                yield part.phase, pair_of(layout, inside.first // 2, inside.second), inside.time


def _names(layout: Layout, pair: int) -> tuple[str, ...]:
    i, j = divmod(pair, layout.robots)
    if i == j:
        return (f"cable {i}",)
    if pair in (pairs := clasped_pairs(layout)):
        return (f"p{layout.clasps[int(np.argmax(pairs == pair))]}",)
    return (f"cable {i}", f"cable {j}")


def _contradicted(motion: Motion) -> Indices:
    """Return the cables and pairs, in a phase without a hitch, that are not in its state.

    - Not hitched: there are neither legs nor tensions.
    - On the ground: no drone moves sideways, and some cable comes nearer to the ground than one
      that hangs free has to keep.
    - Clasping: drones at a clasp turn about a point that rests, and some chords meet.
    - Being tightened: cables are slack for most of the time. Lengths are added up with the
      cables' tensions as weights: that sum is least at the vertices where the taut cables balance,
      so no choice of vertices hides cables that are at their full length.
    """
    state, n = motion.phases[0].state, motion.team.robots
    alone = np.arange(n) * (n + 1)
    parts = [motion.legs.coefficients, motion.tensions.coefficients, motion.pulls.coefficients]
    sizes = [np.max(np.abs(c), axis=(0, -1)).reshape(n, -1) for c in parts]
    wrong = [alone[np.any(np.concatenate(sizes, axis=1) > 0.0, axis=1)]]
    if state is CableState.GROUND:
        level = motion.drones.coefficients[:, :, :2]
        moved = np.ptp(level, axis=(0, -1)).reshape(n, -1)
        wrong.append(alone[np.any(moved > STILL, axis=1)])
        if above_ground(motion):
            wrong.append(alone)
    elif state is CableState.CLASPING:
        layout, c = motion.team.layout, motion.drones.coefficients
        pairs, met = clasped_pairs(layout), chord_crossings(motion.drones)
        middles = 0.5 * (c[:, 2 * layout.ahead] + c[:, 2 * layout.behind + 1])
        moved = np.max(np.ptp(middles, axis=(0, -1)), axis=-1)
        if np.any(np.isin(met.first * n + met.second, pairs)):
            pairs = pairs[moved > CENTRED]
        wrong.append(pairs)
    elif state is CableState.TIGHTENING and _taut_share(motion) > MOSTLY:
        wrong.append(alone)
    return np.unique(np.concatenate(wrong))


def _taut_share(motion: Motion) -> float:
    """Return the share of time in which cables are not seen to be slack around the vertices."""
    legs, edges = (
        bernstein.evaluate(vectors[None], PROBES[:, None, None, None])
        for vectors in (leg_vectors(motion), edge_vectors(motion))
    )
    sag = sag_factors(motion.team, motion.team.tension)
    lengths = cable_of(edges, sag)  # (probes, pieces, n)
    for end in (0, 1):
        lengths = lengths + cable_of(legs[:, :, end::2], sag)
    weights, full = motion.team.tension, motion.team.cable_length
    slack = 1.0 - lengths @ weights / float(full @ weights)
    taut = np.max(slack, axis=0) <= SLACK
    return float(np.sum(motion.drones.durations[taut]) / motion.duration)


INTERLACING = CheckRule(
    "interlacing",
    "1",
    "max",
    lambda motion: None if np.all(motion.formed) else 0.0,
    (Finder(_interlaced, FREE_STATES | HITCHED_STATE),),
    "place the drones so that cables need not pass each other",
    whole=True,
)
