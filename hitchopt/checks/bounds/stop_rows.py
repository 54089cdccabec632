"""Parts of stops between the nodes of a grid, and what they are held against there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.clock_limits import ClockLimits
from hitchopt.checks.bounds.derivative_grid import DerivativeGrid
from hitchopt.values import Array, Indices

Flags = NDArray[np.bool_]

SWITCH = 5.0 / 12.0
"""Plan time over duration at which the clock's jerk changes its sign."""


class StopRows(NamedTuple):
    """Parts of stops within one cell of the grid; each array is (rows,), pairs are of both ends.

    Attributes
    ----------
    stop: whose they are.
    cell: of the grid.
    late: whether in the second half.
    chord: (width of its cell)² / 8 [s²]; 0 where a row covers its cell.
    T: duration of the stop [s].
    tau: (2, rows), plan time from the cell's begin over its width.
    s, a: (2, rows), rate and its derivative.
    j: second derivative of the rate.
    v: 1 - w where each begins.
    time: how long each takes [s].
    """

    stop: Indices
    cell: Indices
    late: Flags
    chord: Array
    T: Array
    tau: Array
    s: Array
    a: Array
    j: Array
    v: Array
    time: Array

    def taken(self, index: Indices) -> StopRows:
        """Return the chosen rows."""
        return StopRows._make(each.take(index, axis=-1) for each in self)


def cut_stops(grid: DerivativeGrid, start: Array, duration: Array, stops: Indices) -> StopRows:
    """Return chosen stops, cut at a grid's nodes; a plan rests after its end.

    Parameters
    ----------
    grid: of the plan's derivatives.
    start, duration: (m,) [s], of stops.
    stops: indices of those that are chosen.
    """
    t, T = (np.repeat(each[stops], 2) for each in (start, duration))
    late = np.arange(len(t)) % 2 == 1
    low = t + np.where(late, SWITCH * T, 0.0)
    high = t + np.where(late, 0.5, SWITCH) * T
    first = np.searchsorted(grid.begin, low, side="right") - 1
    last = np.searchsorted(grid.begin, high, side="left") - 1
    count = np.where(low < grid.until[-1], last - first + 1, 0)
    own = np.repeat(np.arange(len(t)), count)
    cell = np.arange(len(own)) - np.repeat(np.cumsum(count) - count - first, count)
    begin, until = grid.begin[cell], grid.until[cell]
    tau = np.stack([np.maximum(begin, low[own]), np.minimum(until, high[own])])
    whole = (tau[0] == begin) & (tau[1] == until)
    chord = np.where(whole, 0.0, grid.width[cell] ** 2 / 8.0)
    late, t, T = late[own], t[own], T[own]
    p = (tau - t) / T
    early = np.sqrt(2.0) * np.sin(np.arcsin(np.clip(3.0 / np.sqrt(2.0) * p, 0.0, 1.0)) / 3.0)
    v = np.where(late, np.cbrt(np.maximum(0.75 - 1.5 * p, 0.0)), 1.0 - early)
    w = 1.0 - v
    s = np.where(late, 2.0 * v * v, 1.0 - 2.0 * w * w)
    a = -4.0 / T * np.where(late, v, w)
    j = np.where(late, 4.0, -4.0) / T**2
    share = (tau - begin) / grid.width[cell]
    return StopRows(
        np.repeat(stops, 2)[own], cell, late, chord, T, share, s, a, j, v[0], (w[1] - w[0]) * T
    )


class LimitTables(NamedTuple):
    """What rows are held against, drone by drone: operations on many rows are quick.

    Attributes
    ----------
    sizes: (3, drones, cells), bounds of the derivatives by plan time.
    largest: (3, cells), of all drones.
    margins: (5, drones · pieces), the fourth and fifth derivatives' and what rounding makes of the
        first three.
    loads: (2, drones, pieces), the largest thrust at rest and how far that is beyond the cone.
    spare: (pieces,), acceleration that all drones can have in any direction.
    """

    sizes: Array
    largest: Array
    margins: Array
    loads: Array
    spare: Array

    @classmethod
    def of(cls, limits: ClockLimits, grid: DerivativeGrid) -> LimitTables:
        """Return those of a motion."""
        team = limits.motion.team
        margins = np.stack([grid.fourth, grid.fifth, *limits.margins]).transpose(0, 2, 1)
        spare = np.minimum(team.max_thrust - limits.hover, -limits.beyond) / team.mass
        return cls(
            np.ascontiguousarray(grid.sizes),
            grid.largest,
            margins.reshape(len(margins), -1),
            np.stack([limits.hover.T, limits.beyond.T]),
            np.min(spare, axis=1),
        )


def acceleration_bound(sizes: Array, rows: StopRows) -> Array:
    """Return a bound (…, rows) of the acceleration [m/s²], given those of derivatives (3, …)."""
    first, second, _ = sizes
    s, a = rows.s[0], np.maximum(*np.abs(rows.a))
    found: Array = s * s * second + a * first
    return found


def jerk_bound(sizes: Array, rows: StopRows) -> Array:
    """Return a bound (…, rows) of the jerk [m/s³], given those of derivatives (3, …)."""
    first, second, third = sizes
    s, a, j = rows.s[0], np.maximum(*np.abs(rows.a)), np.abs(rows.j)
    found: Array = s * s * s * third + 3.0 * s * a * second + j * first
    return found
