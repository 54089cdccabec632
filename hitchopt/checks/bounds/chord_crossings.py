"""How often two moving chords pass through each other, with signs, exactly.

A *chord* is the straight line between a cable's drones. Two chords meet only where their four ends
lie in one plane, where the volume ``(q_j - q_i) · ((r_i - q_i) × (r_j - q_j))`` vanishes. Time is
halved until every cell of it is one of two kinds:

- *apart*: the chords' distance is bounded away from zero, parallel and coplanar ones included;
- *across*: seen along one direction, each chord crosses the other between its ends, for certain.

Chords pass through each other only within runs of cells of the second kind, as often, in sum, as
the volume's sign changes from the run's beginning to its end; and there, next to a cell of the
first kind, that sign is certain. So no root has to be found: chords that touch, rest in one plane
at the very moment of crossing, or turn back there are counted rightly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.broadphase import Boxes, Indices, close_pairs
from hitchopt.geometry.vectors import unit
from hitchopt.time_limit import check_time
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.distance import distance_bound
from hitchopt.trajectory.extremum import Cells, joined_cells
from hitchopt.values import Array

APART = 1e-6
"""[m] Chords that are certainly at least this far apart do not touch."""

MAX_HALVINGS = 30
"""A cell halved so often, and still neither, is where a chord runs into another one's end."""


@dataclass(frozen=True, eq=False)
class Crossings:
    """What pairs of chords did in some time; pairs that are not listed never met.

    Attributes
    ----------
    first, second: (pairs,), cables i < j.
    count: (pairs,), how often they passed through each other, with signs.
    certain: (pairs,), false where that could not be told: an end ran into the other chord, or the
        time is over while they touch.
    time: (pairs,) [s], when they last met, or when it could not be told.
    """

    first: Indices
    second: Indices
    count: Indices
    certain: NDArray[np.bool_]
    time: Array


def chord_crossings(drones: PiecewisePolynomial) -> Crossings:
    """Return what the chords of drones q0, r0, q1, … of shape (2n, 3) [m] did."""
    cells = _candidates(drones)
    across, unclear = [cells.take(slice(0, 0))], [cells.take(slice(0, 0))]
    for _ in range(MAX_HALVINGS):
        if len(cells) == 0:
            break
        check_time()
        cells = cells.take(~_apart(cells.blocks[0]))
        crossing = _across(cells.blocks[0])
        across.append(cells.take(crossing))
        cells = cells.take(~crossing)
        touching = cells.take(_touching(cells.blocks[0]))
        unclear.append(touching)
        cells = cells.take(~np.isin(cells.item, touching.item)).halves()
    return _counted(drones.shape[0] // 2, joined_cells(across), joined_cells([*unclear, cells]))


def _candidates(drones: PiecewisePolynomial) -> Cells:
    """Return one cell per piece and pair ``i * n + j`` of chords whose boxes meet.

    Its block holds the ends q_i, r_i, q_j, r_j (cells, 4, 3, degree + 1).
    """
    n = drones.shape[0] // 2
    found = []
    for piece in range(drones.pieces):
        c = drones.coefficients[piece].reshape(n, 2, 3, -1)
        pairs = close_pairs(Boxes.around(c), None, 2.0 * APART)
        start, end = np.tile(drones.breaks[piece : piece + 2, None], len(pairs))
        ends = np.concatenate([c[pairs.first], c[pairs.second]], axis=1)
        item = pairs.first * n + pairs.second
        found.append(Cells((ends,), item, start, end, np.zeros(len(pairs))))
    return joined_cells(found)


def _apart(e: Array) -> NDArray[np.bool_]:
    """Return on which cells the chords certainly do not touch."""
    differences = np.stack([e[:, i] - e[:, j] for i in (0, 1) for j in (2, 3)], axis=1)
    bound = distance_bound((differences.reshape(len(e), 12, e.shape[-1]),)).bound
    return bound > APART


def _across(ends: Array) -> NDArray[np.bool_]:
    """Return on which cells, seen along one direction, each chord crosses the other for certain."""
    middle = ends @ bernstein.basis(np.array(0.5), bernstein.degree(ends))
    normal = unit(np.cross(middle[:, 1] - middle[:, 0], middle[:, 3] - middle[:, 2]))
    qi, ri, qj, rj = (ends[:, k] for k in range(4))
    sides = []
    for a, b, c, d in ((qi, ri, qj, rj), (qj, rj, qi, ri)):
        along = b - a
        one, other = (_strictly(_side(normal, along, to - a)) for to in (c, d))
        sides.append(one * other)
    return (sides[0] < 0) & (sides[1] < 0)


def _touching(ends: Array) -> NDArray[np.bool_]:
    """Return on which cells the chords touch at mid time without crossing there.

    However short, a cell about that time is neither apart nor across: nothing more is learnt about
    such a pair, and chords that overlap for a while would be halved into 2**MAX_HALVINGS cells.
    """
    there = (ends @ bernstein.basis(np.array(0.5), bernstein.degree(ends)))[..., None]
    return ~_apart(there) & ~_across(there)


def _side(normal: Array, along: Array, to: Array) -> Array:
    """Return the coefficients (cells, m) of ``normal · (along × to)``."""
    return bernstein.dot(np.cross(normal[..., None], along, axis=1), to)


def _strictly(coefficients: Array) -> Indices:
    """Return 1 or -1 (cells,) where a polynomial has that sign throughout, else 0."""
    size = APART * np.max(np.abs(coefficients), axis=-1, initial=0.0)
    positive = np.min(coefficients, axis=-1) > size
    negative = np.max(coefficients, axis=-1) < -size
    sign: Indices = positive.astype(np.intp) - negative.astype(np.intp)
    return sign


def _counted(n: int, across: Cells, unclear: Cells) -> Crossings:
    """Return the sums over all runs of cells, pair by pair."""
    cells = across.take(np.lexsort((across.start, across.item)))
    new = (np.diff(cells.item) != 0) | (cells.start[1:] > cells.end[:-1])
    edges = np.flatnonzero(new)
    some = min(len(cells.item), 1)
    first = np.concatenate([np.zeros(some, dtype=np.intp), edges + 1])
    final = np.concatenate([edges, np.full(some, len(cells.item) - 1)])
    before, after = _sign(cells.blocks[0][first][..., 0]), _sign(cells.blocks[0][final][..., -1])
    pairs, run = np.unique(np.concatenate([cells.item[first], unclear.item]), return_inverse=True)
    count = np.zeros(len(pairs), dtype=np.intp)
    np.add.at(count, run[: len(first)], (after - before) // 2)
    certain = np.ones(len(pairs), dtype=np.bool_)
    certain[run[: len(first)][(before == 0) | (after == 0)]] = False
    certain[run[len(first) :]] = False
    time = np.zeros(len(pairs))
    np.maximum.at(time, run, np.concatenate([cells.end[final], unclear.end]))
    return Crossings(*np.divmod(pairs, n), count, certain, time)


def _sign(ends: Array) -> Indices:
    """Return the sign of the volume of chords (runs, 4, 3) that are certainly apart, else 0."""
    along, other = ends[:, 1] - ends[:, 0], ends[:, 3] - ends[:, 2]
    normal = np.cross(along, other)
    height = np.sum((ends[:, 2] - ends[:, 0]) * normal, axis=-1)
    sure = np.abs(height) > 0.5 * APART * np.linalg.norm(normal, axis=-1)
    return np.where(sure, np.sign(height), 0.0).astype(np.intp)
