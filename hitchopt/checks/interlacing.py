"""Check ``interlacing``: cables are in the states that phases state, from paths alone.

The *crossing number* of two cables counts how often their chords have passed through each other,
with signs. Free cables, on the ground or hanging, have 0. A hitch is right when neighbours have ±1
(either sense of turning holds) and all others 0; so they have while cables are being tightened, and
clasping leads from the one to the other. A hitch that is there at first is taken to have been tied
with every q going up first, which is 1. Besides, no drone may fly inside the hanging cable of
another: what it pulls there is caught although no chords have met. What else a state asks of the
motion is in ``hitchopt.checks.bounds.cable_states``.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby

import numpy as np

from hitchopt.checks.bounds.bodies import clasped_pairs, pair_of
from hitchopt.checks.bounds.cable_states import Wrong, contradicted, phase_parts
from hitchopt.checks.bounds.chord_crossings import chord_crossings
from hitchopt.checks.bounds.strands import entered
from hitchopt.checks.rule import CheckRule, Finder, Finding
from hitchopt.hitch.layout import Layout
from hitchopt.motion.motion import JOINT, CableState, Motion
from hitchopt.motion.phases import FREE_STATES, HITCHED_STATE

NUMBERS = {
    CableState.GROUND: 0,
    CableState.FREE: 0,
    CableState.TIGHTENING: 1,
    CableState.HITCHED: 1,
}
"""Size of the crossing numbers of neighbours before and after phases in these states."""

MOST_NAMED = 12
"""Pairs that ``where`` names at most."""


def _find(motion: Motion, _: float) -> Finding:
    """Return how many pairs of cables, or single ones, are not in the state that a phase states.

    ``where`` names the first phase in which that is so, the vertex of neighbours, both cables of
    other pairs and single cables.
    """
    layout = motion.team.layout
    found = list(_wrong(motion))
    pairs = np.concatenate([each.pairs for each in found])
    times = np.concatenate([each.time for each in found])
    wrong, first = np.unique(pairs, return_index=True)
    order = np.argsort(times[first], kind="stable")
    named = [name for pair in wrong[order][:MOST_NAMED] for name in _names(layout, int(pair))]
    time = float(motion.drones.breaks[-1])
    if len(times):
        time = float(np.min(times))
        phase = next(each.phase for each in found if time in each.time)
        named.insert(0, f"phase {motion.phases.index(phase)} ({phase.name})")
    return Finding(float(len(wrong)), time, tuple(named))


def _wrong(motion: Motion) -> Iterator[Wrong]:
    """Yield the pairs and cables that are wrong, run by run of phases in one state."""
    layout = motion.team.layout
    clasped = np.sort(clasped_pairs(layout))
    # A hitch that is there at first has been tied with every q going up first: 1 for neighbours.
    numbers = np.full(len(clasped), int(motion.formed[0]), dtype=np.intp)
    for state, run in groupby(phase_parts(motion), lambda part: part.phase.state):
        parts = list(run)
        first, last = parts[0], parts[-1]
        required = NUMBERS.get(state)
        if required is not None:
            yield Wrong.at(clasped[np.abs(numbers) != required], first.start, first.phase)
        if state is CableState.HITCHED:
            continue
        span = motion.taken(slice(first.pieces.start, last.pieces.stop), [p.phase for p in parts])
        met = chord_crossings(span.drones)
        pairs = pair_of(layout, met.first, met.second)
        known = np.isin(pairs, clasped)
        bad = ~met.certain | (~known & (met.count != 0))
        in_part = np.searchsorted([part.end for part in parts[:-1]], met.time - JOINT)
        counted = np.zeros(len(clasped), dtype=np.intp)
        counted[np.searchsorted(clasped, pairs[known])] = met.count[known]
        numbers = numbers + counted
        if last.pieces.stop == motion.drones.pieces:
            required = 0
        if required is not None:
            yield Wrong.at(clasped[np.abs(numbers) != required], last.end, last.phase)
        for i, part in enumerate(parts):
            here = bad & (in_part == i)
            yield Wrong(pairs[here], met.time[here], part.phase)
            yield from contradicted(part)
            if part.phase.state is CableState.GROUND:
                continue  # drones keep off cables on the ground as seen from above
            inside = entered(part.motion)
            caught = pair_of(layout, inside.drone // 2, inside.cable)
            yield Wrong(caught, inside.time, part.phase)


def _names(layout: Layout, pair: int) -> tuple[str, ...]:
    i, j = divmod(pair, layout.robots)
    if i == j:
        return (f"cable {i}",)
    if pair in (pairs := clasped_pairs(layout)):
        return (f"p{layout.clasps[int(np.argmax(pairs == pair))]}",)
    return (f"cable {i}", f"cable {j}")


RULE = CheckRule(
    "interlacing",
    "1",
    "max",
    lambda motion: None if np.all(motion.formed) else 0.0,
    (Finder(_find, FREE_STATES | HITCHED_STATE),),
    "place the drones so that cables need not pass each other",
    whole=True,
)
