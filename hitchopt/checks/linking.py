"""Checks of continuity, linking and duration: ``continuity``, ``interlacing``, ``duration``.

``interlacing``: cables are in the states of their phases, as derived from paths alone. The
*crossing number* of two cables counts how often their chords have passed through each other, with
signs (``chords.py``). Free cables, on the ground or hanging, have 0. In a valid hitch, and while
cables are being tightened, neighbours have ±1 (either sense of turning holds) and all others 0;
clasping leads from 0 to ±1. An initial hitch is assumed to have been tied with every q going up
first, which is 1. Cables of a hitch cannot pass each other (checks ``equilibrium`` and
``crossing``), but their chords may: these are followed if cables are released later. Also, no drone
may fly inside the hanging cable of another.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import NamedTuple

import numpy as np

from hitchopt.checks.cable_states import contradictions
from hitchopt.checks.certificate import Check
from hitchopt.checks.chords import (
    chord_crossings,
    drones_inside_hanging_cables,
)
from hitchopt.checks.rule import CheckRule, Evaluator, WorstCase, accumulated, worst_at_joint
from hitchopt.checks.spans import (
    PhasePart,
    clasped_pairs,
    derivative,
    derivative_margin,
    pair_of,
    phase_parts,
    position_margin,
)
from hitchopt.geometry.vectors import length
from hitchopt.hitch import Team
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.motion import JOINT, Motion, Phase
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, Indices

MAX_JUMP = 1e-6  # [m], [m/s], [m/s²] Largest sum of jumps, far below what a drone can follow
JUMP_UNITS = "m", "m/s", "m/s²"  # Units of jumps of positions, velocities and accelerations

MAX_NAMED = 12  # Maximum number of pairs in ``where``


def _largest_jump(motion: Motion, _: float) -> WorstCase:
    """Return the largest sum of jumps at joints: positions [m], velocities, accelerations [m/s²].

    Drones and objects are compared, vertices while cables pull drones, and legs of taut cables.
    """
    curves = [(motion.drones, motion.team.drone_names)]
    if motion.requirements.objects:
        curves.append((motion.poses, tuple(motion.requirements.objects)))
    team = motion.team
    pulling = motion.spans(lambda state: state.pulls)
    taut = motion.spans(lambda state: state.hitched)
    curves += [(span.vertices, team.point_names) for span in pulling]
    curves += [(span.legs.reshaped(-1, 1), team.leg_names) for span in taut]
    cases = [WorstCase(-math.inf, float(motion.drones.breaks[0]))]
    for curve, names in curves:
        for jumps, of in zip(_jumps(curve, position_margin(motion)), JUMP_UNITS, strict=True):
            case = worst_at_joint(jumps, curve.breaks[1:], names)
            cases.append(replace(case, unit=of))
    return max(cases, key=lambda case: case.worst)


def _jumps(curve: PiecewisePolynomial, margin: float) -> Array:
    """Return the jumps (3, joints, items) of positions, velocities and accelerations.

    ``margin`` is the rounding error of positions [m].
    """
    rates = [derivative(curve, order) for order in range(3)]
    left = np.stack([values[..., 0] for values in rates])
    right = np.stack([values[..., -1] for values in rates])
    jumps = accumulated(length(left[:, 1:] - right[:, :-1]), 1e-3 * MAX_JUMP)
    jumps[0] += margin
    for order in (1, 2):
        rate_margin = derivative_margin(curve, order)
        jumps[order] += rate_margin[1:] + rate_margin[:-1]
    return jumps


LATE = 1e6  # [s] Time from which on its rounding may cause jumps


def _shorter(motion: Motion, _: Check) -> str:
    """Return the suggested change where times are so late that their rounding causes jumps."""
    is_late = motion.duration > LATE
    return f"after {LATE:g} s rounding causes jumps: shorten durations" if is_late else ""


JUMPS = Evaluator(_largest_jump, formulas=(_largest_jump, _jumps))

CONTINUITY = CheckRule(
    "continuity",
    "m",
    "max",
    MAX_JUMP,
    (JUMPS,),
    "far from the origin rounding causes jumps: subtract an offset from all coordinates; near it, "
    "please report this",
    remedy_at=_shorter,
    whole=True,
    group="timing",
    proves="the largest sum of jumps in position [m], velocity or acceleration",
    unproven="jumps of the jerk, which are allowed",
)
"""No jumps at joints of pieces."""


DURATION = CheckRule(
    "duration",
    "s",
    "max",
    lambda motion: motion.requirements.limits.duration,
    (Evaluator(lambda motion, _: WorstCase(motion.duration, float(motion.drones.breaks[-1]))),),
    "raise limits.duration, or raise the limits of motion",
    whole=True,
    group="timing",
    key="limits.duration",
    proves="the duration [s], if it is limited",
    unproven="the time for uploads and pauses",
)
"""Duration of the plan, exact: the difference of two stored numbers."""


class Contradiction(NamedTuple):
    """Cables and pairs of cables that contradict the state of a phase."""

    phase: Phase  # The phase
    pairs: Indices  # (k,), ``i n + j`` for pairs; cables are pairs with themselves
    times: Array | float  # One or (k,) [s]


def _interlacing_errors(motion: Motion, _: float) -> WorstCase:
    """Return the number of pairs of cables, or cables, that contradict the state of their phase."""
    earliest = dict[int, tuple[float, int]]()  # time and index of the phase, by pair
    for phase, pairs, times in _contradictions(motion):
        index = motion.phases.index(phase)
        for pair, time in zip(pairs.tolist(), np.broadcast_to(times, len(pairs)), strict=True):
            earliest[pair] = min(earliest.get(pair, (np.inf, 0)), (float(time), index))
    if not earliest:
        return WorstCase(0.0, float(motion.drones.breaks[-1]))
    in_order = sorted(earliest, key=lambda pair: (earliest[pair], pair))
    time, index = earliest[in_order[0]]
    where = [f"phase {index} ({motion.phases[index].name})"]
    for pair in in_order[:MAX_NAMED]:
        where += _names(motion.team, pair)
    return WorstCase(float(len(earliest)), time, tuple(where))


def _names(team: Team, pair: int) -> list[str]:
    """Return the names of a pair: its clasp, its cables, or a cable."""
    layout = team.layout
    clasped = clasped_pairs(layout)
    if pair in clasped:
        return [f"p{layout.clasps[int(np.argmax(clasped == pair))]}"]
    return [team.cable_names[k] for k in sorted({*divmod(pair, layout.robots)})]


def _contradictions(motion: Motion) -> Iterator[Contradiction]:
    """Yield what contradicts the states of all phases."""
    ties = Ties.at_start(motion)
    runs = [
        (state, list(parts))
        for state, parts in groupby(phase_parts(motion), lambda part: part.phase.state)
    ]
    for i, (state, parts) in enumerate(runs):
        first = parts[0]
        last = parts[-1]
        is_last = last.pieces.stop == motion.drones.pieces
        if state.loose and i > 0:  # plans begin with a loss
            start = float(first.motion.drones.breaks[0])
            yield Contradiction(first.phase, ties.pairs, start)
        yield from _contradictions_at_start(state, first, ties)
        if state.hitched and is_last:  # loaded clasps and separated parts stay linked
            continue
        pieces = slice(first.pieces.start, last.pieces.stop)
        span = motion.slice_pieces(
            pieces, [phase for part in parts for phase in part.motion.phases]
        )
        yield from _contradicting_crossings(span, parts, ties, is_last=is_last)


def _required_number(state: CableState) -> int | None:
    """Return the size of neighbours' crossing numbers in a state; None where it changes."""
    return None if state.clasping else int(state.tied)


def _contradictions_at_start(
    state: CableState, part: PhasePart, ties: Ties
) -> Iterator[Contradiction]:
    """Yield the neighbours that have another crossing number than a state that begins requires."""
    required = _required_number(state)
    if required is None:
        return
    start = float(part.motion.drones.breaks[0])
    yield Contradiction(part.phase, ties.pairs[np.abs(ties.numbers) != required], start)


def _contradicting_crossings(
    span: Motion, parts: Sequence[PhasePart], ties: Ties, *, is_last: bool
) -> Iterator[Contradiction]:
    """Yield what contradicts one state, on a span of its phases; update the crossing numbers.

    In the ``is_last`` state cables end without ties.
    """
    layout = span.team.layout
    state = parts[0].phase.state
    ends = [float(part.motion.drones.breaks[-1]) for part in parts]
    crossings = chord_crossings(span.drones)
    pairs = pair_of(layout, crossings.first, crossings.second)
    is_neighbour = np.isin(pairs, ties.pairs)
    tie = np.searchsorted(ties.pairs, pairs[is_neighbour])
    np.add.at(ties.numbers, tie, crossings.count[is_neighbour])
    required = 0 if is_last else _required_number(state)
    if required is not None:
        wrong_number = np.abs(ties.numbers) != required
        yield Contradiction(parts[-1].phase, ties.pairs[wrong_number], ends[-1])
    invalid = ~crossings.certain | (~is_neighbour & (crossings.count != 0))
    part_of_crossing = np.searchsorted(ends[:-1], crossings.time - JOINT)
    for index, (phase, _, motion) in enumerate(parts):
        selected = invalid & (part_of_crossing == index)
        yield Contradiction(phase, pairs[selected], crossings.time[selected])
        if state.hitched:
            continue
        compared = span if state.tightening else motion
        yield Contradiction(phase, contradictions(compared), float(motion.drones.breaks[0]))
        if state.hangs:  # in other states, all keep a distance
            drone, cable, time = drones_inside_hanging_cables(motion)
            yield Contradiction(phase, pair_of(layout, drone // 2, cable), time)


@dataclass(frozen=True, eq=False)
class Ties:
    """Ties of neighbours, updated along a plan, each (clasps,) in the order of ``pairs``."""

    pairs: Indices  # Pairs of neighbours, sorted
    numbers: Indices  # Crossing numbers

    @classmethod
    def at_start(cls, motion: Motion) -> Ties:
        """Return the ties at the start of a plan.

        An initial hitch, taut or to be tightened, is assumed to be tied with every q going up
        first: 1 for neighbours.
        """
        pairs = np.sort(clasped_pairs(motion.team.layout))
        is_tied = motion.in_states(lambda state: state.tied)[0]
        return cls(pairs, np.full(len(pairs), int(is_tied), dtype=np.intp))


INTERLACING = CheckRule(
    "interlacing",
    "1",
    "max",
    lambda motion: None if all(state.hitched for state in motion.cable_states) else 0.0,
    (Evaluator(_interlacing_errors, lambda state: state.has_cables),),
    "place the drones so that cables need not pass each other",
    whole=True,
    group="cables",
    proves="the number of cable pairs with a wrong {term}`crossing number`, and of cables not in "
    "their phase's state",
    unproven="that ropes with friction clasp; how an initial hitch was tied",
)
