"""How often moving chords pass through each other, and which drones fly inside hanging cables.

A *chord* is the straight line between a cable's drones. Two chords meet only where their four ends
lie in one plane, where the volume ``(q_j - q_i) · ((r_i - q_i) × (r_j - q_j))`` vanishes. Time is
halved until every span of it is one of two kinds:

- *apart*: the chords' distance is bounded away from zero, parallel and coplanar ones included;
- *across*: seen along one direction, each chord crosses the other between its ends, for certain.

Chords pass through each other only within spans of the second kind, as often, in sum, as the
volume's sign changes; and next to a span of the first kind, that sign is certain. So no root has to
be found: chords that touch, rest in one plane at the very moment of crossing, or turn back there
are counted rightly.

A drone that pulls its cable through the *sheet* between a hanging cable and its chord is caught
when both come taut, although their chords need never have met.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from hitchopt.checks.distances import Flags, Moving, PairSpans, cable_ends, near
from hitchopt.checks.hanging import cables_and_drones, chains
from hitchopt.errors import check_time
from hitchopt.geometry import shortest_offset
from hitchopt.geometry.vectors import unit
from hitchopt.motion.motion import JOINT, Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.enclosed import Enclosed
from hitchopt.trajectory.search import batches
from hitchopt.values import Array, Indices

APART = 1e-6
"""[m] Chords at least this far apart do not touch; drones this far from a sheet are not in it."""

MAX_HALVINGS = 30
"""Spans halved so often, and still open, are where a chord runs into another one's end."""


@dataclass(frozen=True, eq=False)
class Crossings:
    """What pairs did in some time; pairs that are not listed did nothing.

    Attributes
    ----------
    first, second: (pairs,), cables i < j; or a drone and the cable whose sheet it is in.
    count: (pairs,), how often chords passed through each other, with signs.
    certain: (pairs,), false where that could not be told: an end ran into the other chord, or the
        time is over while they touch.
    time: (pairs,) [s], when they last met, or when it could not be told.
    """

    first: Indices
    second: Indices
    count: Indices
    certain: Flags
    time: Array


def _listed(moving: Moving) -> Iterator[PairSpans]:
    """Yield the spans of whole pieces of all pairs that may touch."""
    return (spans for spans in near(moving, lambda: 2.0 * APART) if not spans.points)


def _undecided(spans: PairSpans, decided: Callable[[PairSpans], Flags]) -> PairSpans:
    """Return spans on which nothing is ever decided, all else being halved until it is.

    Where nothing is at mid time itself, nothing more is learnt about such a pair: chords that
    overlap for a while would be halved into 2**MAX_HALVINGS spans.
    """

    def left(spans: PairSpans) -> PairSpans:
        flags = [np.zeros(0, np.bool_), *(decided(batch) for batch in batches(spans))]
        return spans.take(~np.concatenate(flags))

    open_ = [spans.take(slice(0, 0))]
    for _ in range(MAX_HALVINGS):
        if not len(spans):
            break
        check_time()
        spans = left(spans)
        open_.append(left(spans.at(np.full(len(spans), 0.5))))
        spans = spans.take(~np.isin(spans.item, open_[-1].item)).halves()
    return PairSpans.joined([*open_, spans])


def chord_crossings(drones: PiecewisePolynomial) -> Crossings:
    """Return what the chords of drones q0, r0, q1, … of shape (2n, 3) [m] did."""
    moving = Moving(drones.breaks, cable_ends(drones.coefficients))
    rows = [np.zeros((5, 0))]  # pairs, when they may have met, and the volume's sign before, after
    unclear = [np.zeros((2, 0))]

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

    for spans in _listed(moving):
        left = _undecided(spans, decided)
        unclear.append(np.stack([left.item, left.times(np.zeros(len(left)))]))
    item, begin, end, before, after = np.concatenate(rows, axis=1)
    open_, opened = np.concatenate(unclear, axis=1)
    pairs, index = np.unique(np.concatenate([item, open_]).astype(np.intp), return_inverse=True)
    here, there = index[: len(item)], index[len(item) :]
    twice, certain = np.zeros(len(pairs)), np.ones(len(pairs), bool)
    np.add.at(twice, here, after - before)
    certain[twice % 2 == 1] = False
    certain[here[(before == 0) & (begin <= drones.breaks[0] + JOINT)]] = False
    certain[here[(after == 0) & (end >= drones.breaks[-1] - JOINT)]] = False
    certain[there] = False
    time = np.zeros(len(pairs))
    np.maximum.at(time, here, end)
    np.maximum.at(time, there, opened)
    some = ~certain | (twice != 0)
    first, second = np.divmod(pairs[some], moving.count)
    count = (twice[some] // 2).astype(np.intp)
    return Crossings(first, second, count, certain[some], time[some])


def _apart(chords: Array) -> Flags:
    """Return on which spans chords certainly do not touch, as seen along one direction."""
    differences = Enclosed(chords[:, [0, 0, 1, 1]]) - Enclosed(chords[:, [2, 3, 2, 3]])
    along = unit(shortest_offset(differences.middle))
    found: Flags = np.min(differences.dot(along[:, None]).below.value, axis=1) > APART
    return found


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


def _sign(chords: Array) -> Indices:
    """Return the sign of the volume of chords (k, 4, 3) that are certainly apart, else 0."""
    qi, ri, qj, rj = np.moveaxis(chords, 1, 0)
    normal = np.cross(ri - qi, rj - qj)
    height = np.sum((qj - qi) * normal, axis=-1)
    sure = np.abs(height) > 0.5 * APART * np.linalg.norm(normal, axis=-1)
    return np.where(sure, np.sign(height), 0.0).astype(np.intp)


def entered(motion: Motion) -> Crossings:
    """Return which drones fly, or may fly, inside foreign cables.

    Parameters
    ----------
    motion: a phase without a hitch, no cable lying on the ground.
    """
    moving, rows = cables_and_drones(motion), [np.zeros((2, 0))]
    for spans in _listed(moving):
        inside = _undecided(spans, _off)
        rows.append(np.stack([inside.item, inside.times(np.zeros(len(inside)))]))
    item, time = np.concatenate(rows, axis=1)
    pairs, first = np.unique(item.astype(np.intp), return_index=True)
    cable, drone = np.divmod(pairs, moving.count)
    none = np.zeros(len(pairs), np.intp)
    return Crossings(drone, cable, none, none > 0, time[first])


def _off(spans: PairSpans) -> Flags:
    """Return on which spans one direction tells a drone from the whole sheet between q and r.

    A sheet is convex: whatever is on one side of all of its corners is off it.
    """
    ends, drone = spans.ends
    hung = chains(ends[:, 0], ends[:, 1], spans.lengths)
    apart = Enclosed(drone - hung.points)
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
        sure |= least > APART + np.abs(along[:, 2]) * np.max(hung.off, axis=1)
    return sure
