"""The phases of a motion, and contradictions between their polynomials and the states they state.

Each state brings rules of its own, so a plan must not choose them: where the rules of another state
would be due, the polynomials contradict the one that is stated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from hitchopt.checks.bounds.bodies import clasped_pairs, edge_vectors, leg_vectors
from hitchopt.checks.bounds.chord_crossings import chord_crossings
from hitchopt.checks.bounds.hanging_clearance import above_ground
from hitchopt.checks.cable_length import LIMIT
from hitchopt.geometry.broadphase import Indices
from hitchopt.hitch.cable_spans import cable_of, sag_factors
from hitchopt.motion.motion import CableState, Motion, Phase
from hitchopt.trajectory import bernstein
from hitchopt.values import Array

STILL = 1e-6
"""[m] Drones above the ground move sideways by no more while their cables lie on it."""

CENTRED = 1e-3
"""[m] The middle of two drones that turn about each other moves by no more."""

MOSTLY = 0.5
"""Cables that are at their full length for a larger share of a phase are not being tightened:
tightening comes to rest there, which takes a few hundredths of its time."""

PROBES = np.linspace(0.0, 1.0, 9)
"""Places on a piece, one of which shows that cables are slack there."""


@dataclass(frozen=True, eq=False)
class PhasePart:
    """A phase, its pieces in the whole motion, and the motion on them."""

    phase: Phase
    pieces: slice
    motion: Motion

    @property
    def start(self) -> float:
        """Start time [s]."""
        return float(self.motion.drones.breaks[0])

    @property
    def end(self) -> float:
        """End time [s]."""
        return float(self.motion.drones.breaks[-1])


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


@dataclass(frozen=True, eq=False)
class Wrong:
    """Pairs (k,) of cables, as ``i * n + j`` with i <= j, when it is known [s], and the phase.

    A pair of a cable with itself is that cable alone.
    """

    pairs: Indices
    time: Array
    phase: Phase

    @classmethod
    def at(cls, pairs: Indices, time: float, phase: Phase) -> Wrong:
        """Return pairs that are wrong at one time."""
        return cls(pairs, np.full(len(pairs), time), phase)


def contradicted(part: PhasePart) -> Iterator[Wrong]:
    """Yield the cables and pairs of a phase without a hitch that are not in its state.

    - Not hitched: there are neither legs nor tensions.
    - On the ground: no drone moves sideways, and some cable comes nearer to the ground than one
      that hangs free has to keep.
    - Clasping: drones at a clasp turn about a point that rests, and some chords meet.
    - Being tightened: cables are slack for most of the time. Lengths are added up with the
      cables' tensions as weights: that sum is least at the vertices where the taut cables balance,
      so no choice of vertices hides cables that are at their full length.
    """
    motion, state = part.motion, part.phase.state
    n = motion.team.robots
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
        wrong.append(_not_clasped(motion))
    elif state is CableState.TIGHTENING and _taut_share(motion) > MOSTLY:
        wrong.append(alone)
    yield Wrong.at(np.unique(np.concatenate(wrong)), part.start, part.phase)


def _not_clasped(motion: Motion) -> Indices:
    """Return the neighbouring pairs whose drones do not turn about each other."""
    layout = motion.team.layout
    pairs = clasped_pairs(layout)
    met = chord_crossings(motion.drones)
    if not np.any(np.isin(met.first * layout.robots + met.second, pairs)):
        return pairs
    c = motion.drones.coefficients
    middles = 0.5 * (c[:, 2 * layout.ahead] + c[:, 2 * layout.behind + 1])
    moving: Indices = pairs[np.max(np.ptp(middles, axis=(0, -1)), axis=-1) > CENTRED]
    return moving


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
    taut = np.max(slack, axis=0) <= LIMIT
    return float(np.sum(motion.drones.durations[taut]) / motion.duration)
