"""Chords of cables: how often they pass through each other, and their heights where they cross.

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

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hitchopt.checks.bodies import cable_ends
from hitchopt.checks.distances import Flags, Moving, PairSpans, near_pairs
from hitchopt.checks.hanging import cables_and_drones, chains
from hitchopt.errors import check_time
from hitchopt.geometry import shortest_offset
from hitchopt.geometry.vectors import left_of, unit
from hitchopt.motion.motion import JOINT, Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.enclosed import Enclosed
from hitchopt.trajectory.search import batches
from hitchopt.values import Array, Indices

MIN_DISTANCE = 1e-6  # [m] Distance of chords that do not touch, and of drones outside sheets

MAX_HALVINGS = 30
"""Maximum number of halvings of a span: if it is still open, a chord touches another one's end."""


@dataclass(frozen=True, eq=False)
class Crossings:
    """Crossings of the chords of pairs of cables; pairs that are not listed have none."""

    first: Indices  # (pairs,), the first cable of each pair
    second: Indices  # (pairs,), the second cable, with a higher number
    count: Indices  # (pairs,): how often the chords have passed through each other, with signs
    certain: Flags
    """(pairs,): whether the count is certain, as it is unless an end touches a chord, or chords
    touch at either end of the motion."""

    time: Array  # (pairs,) [s], about the last crossing


class SpansAcross(NamedTuple):
    """Spans on which two chords are across, and may pass through each other."""

    pair: Indices  # (spans,), ``i * n + j`` of cables i and j
    start: Array  # (spans,) [s]
    end: Array  # (spans,) [s]
    sign_before: Array  # (spans,), sign of the volume at the start; 0 if uncertain
    sign_after: Array  # (spans,), sign of the volume at the end; 0 if uncertain

    @classmethod
    def of(cls, spans: PairSpans) -> SpansAcross:
        """Return spans with the signs at their ends."""
        at_start = spans.at(0.0)
        at_end = spans.at(1.0)
        return cls(
            pair=spans.item,
            start=at_start.times(0.0),
            end=at_end.times(0.0),
            sign_before=_sign(np.concatenate(at_start.ends, axis=1)[..., 0]),
            sign_after=_sign(np.concatenate(at_end.ends, axis=1)[..., 0]),
        )


NONE_ACROSS = SpansAcross(np.zeros(0, np.intp), *np.zeros((4, 0)))  # No spans across


def _undecided(spans: PairSpans, decided: Callable[[PairSpans], Flags]) -> PairSpans:
    """Return the spans that are not decided."""
    flags = [np.zeros(0, np.bool_), *(decided(batch) for batch in batches(spans))]
    return spans.take(~np.concatenate(flags))


def _open_pairs(moving: Moving, decided: Callable[[PairSpans], Flags]) -> tuple[Indices, Array]:
    """Return the pairs that may touch, and the times [s] near which they stay undecided.

    Other spans are halved until decided, except those of pairs that are undecided at mid time:
    chords that overlap for a while would lead to 2**MAX_HALVINGS spans.
    """
    pairs = [np.zeros(0, dtype=np.intp)]
    times = [np.zeros(0)]

    def record(spans: PairSpans) -> None:
        pairs.append(spans.item)
        times.append(spans.times(np.zeros(len(spans))))

    for near_spans in near_pairs(moving, lambda: 2.0 * MIN_DISTANCE):
        if near_spans.points:
            continue
        spans = near_spans
        for _ in range(MAX_HALVINGS):
            if not len(spans):
                break
            check_time()
            spans = _undecided(spans, decided)
            touching = _undecided(spans.at(0.5), decided)
            record(touching)
            spans = spans.take(~np.isin(spans.item, touching.item)).halves()
        record(spans)
    return np.concatenate(pairs), np.concatenate(times)


def chord_crossings(drones: PiecewisePolynomial) -> Crossings:
    """Return the crossings of the chords of drones q0, r0, q1, … of shape (2n, 3) [m]."""
    moving = Moving(drones.breaks, cable_ends(drones.coefficients))
    parts = [NONE_ACROSS]

    def decided(spans: PairSpans) -> Flags:
        chords = np.concatenate(spans.ends, axis=1)
        separated = are_separated(chords)
        across = _are_across(chords)
        crossing = spans.take(across & ~separated)
        if len(crossing) and not spans.points:
            parts.append(SpansAcross.of(crossing))
        return separated | across

    open_pairs, open_times = _open_pairs(moving, decided)
    spans = SpansAcross(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    pairs, index = np.unique(np.concatenate([spans.pair, open_pairs]), return_inverse=True)
    index_of_span = index[: len(spans.pair)]
    index_of_open = index[len(spans.pair) :]
    # Each crossing changes the sign by 2 or -2.
    sign_changes = np.bincount(index_of_span, spans.sign_after - spans.sign_before, len(pairs))
    at_start = (spans.sign_before == 0) & (spans.start <= drones.breaks[0] + JOINT)
    at_end = (spans.sign_after == 0) & (spans.end >= drones.breaks[-1] - JOINT)
    certain = sign_changes % 2 == 0
    certain[index_of_span[at_start | at_end]] = False
    certain[index_of_open] = False
    last_time = np.zeros(len(pairs))
    np.maximum.at(last_time, index, np.concatenate([spans.end, open_times]))
    reported = ~certain | (sign_changes != 0)
    first, second = np.divmod(pairs[reported], moving.count)
    return Crossings(
        first=first,
        second=second,
        count=sign_changes[reported].astype(np.intp) // 2,
        certain=certain[reported],
        time=last_time[reported],
    )


def are_separated(chords: Array) -> Flags:
    """Return on which spans a plane certainly separates two chords (spans, 4, 3, …)."""
    differences = Enclosed(chords[:, [0, 0, 1, 1]]) - Enclosed(chords[:, [2, 3, 2, 3]])
    along = unit(shortest_offset(differences.middle))
    return np.asarray(np.min(differences.dot(along[:, None]).lower.value, axis=1) > MIN_DISTANCE)


def _are_across(chords: Array) -> Flags:
    """Return on which spans, seen along some direction, two chords certainly cross."""
    first_start, first_end, second_start, second_end = (Enclosed(chords[:, k]) for k in range(4))
    first_chord = (first_end - first_start).middle
    second_chord = (second_end - second_start).middle
    normal = Enclosed.of(unit(np.cross(first_chord, second_chord)))
    across_first = normal.cross(first_end - first_start)
    across_second = normal.cross(second_end - second_start)
    return _on_both_sides(
        across_first.dot(second_start - first_start), across_first.dot(second_end - first_start)
    ) & _on_both_sides(
        across_second.dot(first_start - second_start), across_second.dot(first_end - second_start)
    )


def _on_both_sides(first: Enclosed, second: Enclosed) -> Flags:
    """Return on which spans two distances from a line certainly have opposite signs."""
    start = first.range
    end = second.range
    down = (start.low > 0.0) & (end.high < 0.0)
    up = (start.high < 0.0) & (end.low > 0.0)
    return np.asarray(down | up)


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
    open_pairs, times = _open_pairs(moving, _outside_sheet)
    pairs, first = np.unique(open_pairs, return_index=True)
    cable, drone = np.divmod(pairs, moving.count)
    return drone, cable, times[first]


def _outside_sheet(spans: PairSpans) -> Flags:
    """Return on which spans a plane separates a drone from the sheet of a hanging cable.

    The sheet is convex: a point on one side of all of its corners is outside.
    """
    cable_ends, drone = spans.ends
    corners, tolerance = chains(cable_ends[:, 0], cable_ends[:, 1], spans.lengths)
    offsets = Enclosed(drone - corners)
    # Direction of the nearest side of the sheet: one of its links, or the chord.
    ring = np.concatenate([offsets.middle, offsets.middle[:, :1]], axis=1)
    to_sides = shortest_offset(np.stack([ring[:, :-1], ring[:, 1:]], axis=2))
    nearest_side = np.argmin(np.linalg.norm(to_sides, axis=-1), axis=1)
    edgewise = np.take_along_axis(to_sides, nearest_side[:, None, None], axis=1)[:, 0]
    chord = ring[:, 0] - ring[:, -2]
    sideways = left_of(chord)
    sideways *= np.sign(np.sum(sideways * ring[:, 0], axis=1))[:, None]
    outside = np.zeros(len(spans), dtype=np.bool_)
    for direction in (edgewise, sideways):
        along = unit(direction)
        smallest = np.min(offsets.dot(along[:, None]).lower.value, axis=1)
        # The cable deviates from its links only vertically.
        deviation = np.abs(along[:, 2]) * np.max(tolerance, axis=1)
        outside |= smallest > MIN_DISTANCE + deviation
    return outside
