"""Branch and bound as in ``hitchopt.trajectory.extremum``, compiled, for bounds known here.

A cell is bounded number by number: what follows says the same as the functions that are named, for
cells of ordinary cables.
"""

from __future__ import annotations

import numpy as np

from hitchopt.compiled.cable_kernels import balance, band, lengths, turns
from hitchopt.compiled.distance_kernel import distance
from hitchopt.compiled.enclosure_kernels import directions, work_space
from hitchopt.compiled.kernel_switch import inlined, kernel
from hitchopt.compiled.polynomial_kernels import Blocks, Found, Known, largest_column, value_at
from hitchopt.compiled.thrust_kernels import thrust, tilt
from hitchopt.values import Array, Indices

NORM, DISTANCE, THRUST, TILT, BALANCE, LENGTHS, TURNS, BAND = range(8)
KINDS = {
    "norm": NORM,
    "distance": DISTANCE,
    "thrust": THRUST,
    "tilt": TILT,
    "balance": BALANCE,
    "lengths": LENGTHS,
    "turns": TURNS,
    "band": BAND,
}
"""Kinds of bounds, of ``rates``, ``distance``, ``thrust``, ``tilt``, ``equilibrium``,
``cable_length``, ``convexity`` and ``tension``."""


@inlined
def _norm(v: Array, enough: float) -> Found:
    """Return bound, value and place as ``norm_bound``; no value of a bound that is ``enough``."""
    size, x = largest_column(v)
    if size <= enough:
        return size, -np.inf, x
    square = 0.0
    for i in range(len(v)):
        square += value_at(v[i], x) ** 2
    return size, np.sqrt(square), x


@inlined
def _bounded(
    kind: int,
    blocks: Blocks,
    c: int,
    weights: Array,
    along: Known,
    numbers: tuple[float, float, float],
    space: Array,
    enough: float,
) -> Found:
    """Return bound, value and place of a cell, given the directions that its kind takes.

    The value of a largest one is -inf where the bound is no larger than ``enough``.
    """
    rows = blocks[0][c]
    if kind == NORM:
        found = _norm(rows, enough)
    elif kind == DISTANCE:
        found = distance(rows, space[:, :1])
    elif kind in (THRUST, TILT):
        cell, k = (rows, blocks[1][c], blocks[2][c], blocks[3][c]), along[2][c, 0]
        if kind == THRUST:
            found = thrust(cell, along[0][k], along[1][k], numbers[1], enough)
        else:
            found = tilt(cell, along[0][k], along[1][k], numbers[1], enough)
    elif kind == BALANCE:
        found = balance(rows, blocks[1][c], along[0], along[1], along[2][c], numbers, enough)
    elif kind == LENGTHS:
        found = lengths(rows, blocks[1][c], weights, space, enough)
    elif kind == TURNS:
        found = turns(rows, blocks[1][c, 0, 0], numbers)
    else:
        found = band(rows[0], blocks[1][c, 0, 0], blocks[1][c, 1, 0])
    return found


@kernel
def _directed(kind: int, blocks: Blocks, weights: Array, noise: float) -> Known:
    """Return the directions that cells of a kind take, cell by cell; of no length where none."""
    count = len(blocks[0])
    if kind == BALANCE:
        each = 4
        vectors = blocks[0].copy().reshape(4 * count, 3, blocks[0].shape[2])
    elif kind in (THRUST, TILT):
        each = 1
        vectors = blocks[1]
    else:
        return np.empty((0, 3, 0)), np.empty(0), np.zeros((count, 1), dtype=np.intp)
    along, errors = directions(vectors, weights, noise)
    return along, errors, np.arange(each * count).reshape(count, each)


@kernel
def _halved(block: Array, chosen: Indices) -> Array:
    """Return the chosen cells' first halves, then their second ones."""
    count, rows, n = len(chosen), block.shape[1], block.shape[2]
    out = np.empty((2 * count, rows, n))
    for c in range(count):
        for i in range(rows):
            left, right = out[c, i], out[count + c, i]
            right[:] = block[chosen[c], i]
            for k in range(n):
                left[k] = right[0]
                for j in range(n - 1 - k):
                    right[j] = 0.5 * (right[j] + right[j + 1])
    return out


@kernel
def _below(block: Array, most: float) -> bool:
    """Return whether all numbers are smaller than one; nan is not."""
    fine = True
    for number in block.reshape(-1):
        fine = fine & bool(abs(number) < most)
    return fine


@kernel
def _twice(values: Array, chosen: Indices) -> Array:
    return np.concatenate((values[chosen], values[chosen]))


@kernel
def search(
    kind: int,
    sign: float,
    blocks: Blocks,
    weights: Array,
    along: Known,
    numbers: tuple[float, float, float],
    item: Indices,
    cells: tuple[Array, Array, Array],
    aims: tuple[float, float, float, float],
    most: tuple[int, int],
) -> tuple[float, float, int, float]:
    """Return worst, value, item and time of an extremum, times the sign; item -1 if not found.

    Parameters
    ----------
    kind: of the bound.
    sign: 1 of a smallest value, -1 of a largest.
    blocks: four, (cells, rows, degree + 1) each; (cells, 0, 1) in place of missing ones.
    weights: of polynomials at nodes, then of those through them.
    along: directions (m, 3, ·) of the given cells, their errors (m,) and each cell's (cells, k);
        none where the kind takes none, or none are known.
    numbers: noise [m], length [m] without a direction, and relative rounding.
    item: (cells,)
    cells: (cells,) each, start [s], end [s] and margin.
    aims: relative and absolute tightness, and target, as of a Search; and from which number on
        blocks are not looked at, as their products might overflow.
    most: numbers of halvings and of cells.
    """
    value, which, time, floor, looked, depth = np.inf, -1, 0.0, np.inf, 0, 0
    space, (start, end, margin) = work_space(), cells
    if not (
        _below(blocks[0], aims[3])
        and _below(blocks[1], aims[3])
        and _below(blocks[2], aims[3])
        and _below(blocks[3], aims[3])
    ):
        return -np.inf, -np.inf, -1, 0.0
    bounds, enough = np.full(len(item), -np.inf), most[1]
    while True:
        if len(along[2]) < len(item):
            along = _directed(kind, blocks, weights, numbers[0])
        for c in range(len(item)):
            largest = -value if sign < 0.0 else -np.inf
            low, here, x = _bounded(kind, blocks, c, weights, along, numbers, space, largest)
            low, here = sign * low, sign * here
            if np.isnan(low + here):
                low, here = -np.inf, -np.inf
            bounds[c] = max(bounds[c], low)
            if here < value or which < 0:
                value, which = here, item[c]
                time = start[c] + x * (end[c] - start[c])
        looked += len(item)
        if depth == 0:
            enough = max(most[1], 10 * looked) + looked
        threshold = value
        if np.isfinite(value):
            threshold = value - max(aims[1], aims[0] * abs(value))
            threshold = max(threshold, aims[2]) if value >= aims[2] else threshold
        done = bounds >= threshold
        if depth == most[0] or looked > enough:
            done[:] = True
        for c in range(len(item)):
            if done[c]:
                floor = min(floor, bounds[c] - margin[c])
        left = np.flatnonzero(~done)
        if len(left) == 0:
            return min(floor, value), value, which, time
        middle = 0.5 * (start + end)
        start = np.concatenate((start[left], middle[left]))
        end = np.concatenate((middle[left], end[left]))
        margin = _twice(margin, left)
        blocks = (
            _halved(blocks[0], left),
            _halved(blocks[1], left),
            _halved(blocks[2], left),
            _halved(blocks[3], left),
        )
        item = np.concatenate((item[left], item[left]))
        bounds, depth = _twice(bounds, left), depth + 1
        along = along[0][:0], along[1][:0], along[2][:0]
