"""Whether stops of the common clock keep all limits: bounds of second order on a fine grid.

A stop of duration T that begins at plan time t has, at w of its time, the rate ``1 - 2 w²`` up to
its middle and ``2 v²`` after that, v = 1 - w; its plan time is ``t + T (w - 2/3 w³)`` and then
``t + T (1/2 - 2/3 v³)``. All derivatives by plan time are known at the grid's nodes; between two of
them, a vector F is no longer than at the longer end plus ``h²/8`` times a bound of F'':

- acceleration and first half of the jerk: by real time, F'' is the plan's fourth or fifth
  derivative on the clock;
- second half of the jerk: a polynomial of v³, which is linear in plan time, so F'' is taken by that
  and stays small up to the rest;
- static forces: by real time, ``s² h'' + ṡ h'``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.clock_limits import ClockLimits
from hitchopt.checks.bounds.derivative_grid import WIDTH, DerivativeGrid, Sizes, axis_lengths
from hitchopt.checks.bounds.rounding_margins import ROUNDING
from hitchopt.time_limit import check_time
from hitchopt.values import Array, Indices

Flags = NDArray[np.bool_]

SWITCH = 5.0 / 12.0
"""Plan time over duration at which the clock's jerk changes its sign."""

ROWS = 20_000
"""Parts of stops that are looked at in one go."""

VECTORS = 60_000
"""Vectors of each kind that are looked at in one go."""

_W = np.array([0.0, 0.05, 0.1, 0.25, 0.5])
"""Shares of a stop's time at which samples are taken."""

SLACK = 1e-9
"""Relative margin for the clock's rounding."""


class _Rows(NamedTuple):
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

    def taken(self, index: Indices) -> _Rows:
        """Return the chosen rows."""
        return _Rows._make(each.take(index, axis=-1) for each in self)


class StopBounds:
    """Limits of a motion, for stops from full rate.

    Parameters
    ----------
    limits: of the motion, for clocks of any kind.
    width: largest distance of the grid's nodes [s].
    """

    def __init__(self, limits: ClockLimits, width: float = WIDTH) -> None:
        self.limits = limits
        self.grid = DerivativeGrid(limits, width)
        self._vectors = max(1, VECTORS // max(1, len(limits.motion.team.mass)))

    def keep(self, start: Array, duration: Array) -> Flags:
        """Return (stops,) whether stops that begin at plan times [s] are shown to keep all limits.

        All but that of turning.

        Parameters
        ----------
        start, duration: (stops,) [s].
        """
        kept = self.may_keep(start, duration)
        stops = np.flatnonzero(kept)
        kept[stops] = self.show(start[stops], duration[stops])
        return kept

    def may_keep(self, start: Array, duration: Array) -> Flags:
        """Return (stops,) whether stops keep limits at samples; what breaks one is out."""
        kept = np.zeros(len(start), dtype=np.bool_)
        size = max(1, self._vectors // len(_W))
        for first in range(0, len(start), size):
            part = slice(first, first + size)
            kept[part] = self._samples(start[part], duration[part])
        return kept

    def show(self, start: Array, duration: Array) -> Flags:
        """Return (stops,) whether stops are shown to keep limits, all of their time bounded."""
        kept = np.ones(len(start), dtype=np.bool_)
        count = np.searchsorted(self.grid.begin, start + 0.5 * duration) + 3
        count = np.cumsum(count - np.searchsorted(self.grid.begin, start))
        group = count // ROWS
        for first in range(int(group[-1]) + 1 if len(group) else 0):
            check_time()
            self._look(self._rows(start, duration, np.flatnonzero(group == first)), kept)
        return kept

    def _samples(self, start: Array, duration: Array) -> Flags:
        """Return (stops,) whether drones keep their limits in the first halves of stops."""
        limits = self.limits.motion.requirements.limits
        w, T = (each.ravel() for each in np.broadcast_arrays(_W[:, None], duration))
        time = np.tile(start, len(_W)) + (w - 2.0 / 3.0 * w * w * w) * T
        time = np.minimum(time, self.grid.until[-1])
        cell = np.maximum(np.searchsorted(self.grid.begin, time, side="right") - 1, 0)
        share = (time - self.grid.begin[cell]) / self.grid.width[cell]
        x1, x2, x3 = (self.grid.on_chord(order, cell, share) for order in range(3))
        s, a, j = (each[:, None] for each in (1.0 - 2.0 * w * w, -4.0 * w / T, -4.0 / (T * T)))
        s2 = s * s
        fine = axis_lengths(s2 * s * x3 + (3.0 * s * a) * x2 + j * x1) <= limits.jerk
        fine &= axis_lengths(s2 * x2 + a * x1) <= limits.acceleration
        kept: Flags = np.all(fine, axis=1).reshape(len(_W), -1).all(axis=0)
        return kept

    def _rows(self, start: Array, duration: Array, stops: Indices) -> _Rows:
        """Return stops cut at the grid's nodes; a plan rests after its end."""
        t, T = (np.repeat(each[stops], 2) for each in (start, duration))
        late = np.arange(len(t)) % 2 == 1
        low = t + np.where(late, SWITCH * T, 0.0)
        high = t + np.where(late, 0.5, SWITCH) * T
        first = np.searchsorted(self.grid.begin, low, side="right") - 1
        last = np.searchsorted(self.grid.begin, high, side="left") - 1
        count = np.where(low < self.grid.until[-1], last - first + 1, 0)
        own = np.repeat(np.arange(len(t)), count)
        cell = np.arange(len(own)) - np.repeat(np.cumsum(count) - count - first, count)
        begin, until = self.grid.begin[cell], self.grid.until[cell]
        tau = np.stack([np.maximum(begin, low[own]), np.minimum(until, high[own])])
        whole = (tau[0] == begin) & (tau[1] == until)
        chord = np.where(whole, 0.0, self.grid.width[cell] ** 2 / 8.0)
        late, t, T = late[own], t[own], T[own]
        p = (tau - t) / T
        early = np.sqrt(2.0) * np.sin(np.arcsin(np.clip(3.0 / np.sqrt(2.0) * p, 0.0, 1.0)) / 3.0)
        v = np.where(late, np.cbrt(np.maximum(0.75 - 1.5 * p, 0.0)), 1.0 - early)
        w = 1.0 - v
        s = np.where(late, 2.0 * v * v, 1.0 - 2.0 * w * w)
        a = -4.0 / T * np.where(late, v, w)
        j = np.where(late, 4.0, -4.0) / T**2
        share = (tau - begin) / self.grid.width[cell]
        return _Rows(
            np.repeat(stops, 2)[own], cell, late, chord, T, share, s, a, j, v[0], (w[1] - w[0]) * T
        )

    def _look(self, rows: _Rows, kept: Flags) -> None:
        """Set ``kept`` to False for stops that are not shown to keep a limit in these rows."""
        limits, team = self.limits.motion.requirements.limits, self.limits.motion.team
        most = self.grid.largest.taken(rows.cell)
        acceleration = _acceleration(most, rows)[:, 0] * (1.0 + SLACK)
        jerk = _jerk(most, rows)[:, 0] * (1.0 + SLACK)
        piece = self.grid.piece[rows.cell]
        fine = (acceleration <= limits.acceleration) & (jerk <= limits.jerk)
        fine &= acceleration <= np.min((team.max_thrust - self.limits.hover) / team.mass, 1)[piece]
        fine &= acceleration <= np.min(-self.limits.beyond / team.mass, 1)[piece]
        left = np.flatnonzero(~fine)
        size = self._vectors
        for first in range(0, len(left), size):
            check_time()
            part = left[first : first + size]
            part = part[kept[rows.stop[part]]]
            if len(part):
                own = rows.taken(part)
                kept[own.stop[~self._keeps(own)]] = False

    def _keeps(self, rows: _Rows) -> Flags:
        """Return (rows,) whether all drones are shown to keep all limits."""
        limits, team = self.limits.motion.requirements.limits, self.limits.motion.team
        piece, sizes = self.grid.piece[rows.cell], self.grid.sizes.taken(rows.cell)
        acceleration, jerk = _acceleration(sizes, rows), _jerk(sizes, rows)
        extra = team.mass * acceleration * (1.0 + SLACK)
        fine = acceleration * (1.0 + SLACK) <= limits.acceleration
        fine &= jerk * (1.0 + SLACK) <= limits.jerk
        fine &= self.limits.hover[piece] + extra <= team.max_thrust
        fine &= self.limits.beyond[piece] + extra <= 0.0
        row, drone = np.nonzero(~fine)
        kept = np.ones(len(piece), dtype=np.bool_)
        held = self._pairs_keep(rows.taken(row), drone, acceleration[row, drone], jerk[row, drone])
        kept[row[~held]] = False
        return kept

    def _pairs_keep(self, rows: _Rows, drone: Indices, acceleration: Array, jerk: Array) -> Flags:
        """Return (pairs,) whether drones are shown to keep all limits in a row each.

        Parameters
        ----------
        rows: one for each pair.
        drone: (pairs,).
        acceleration, jerk: (pairs,) bounds of these that are known.
        """
        limits, team = self.limits.motion.requirements.limits, self.limits.motion.team
        grid, count = self.grid, len(team.mass)
        cell = rows.cell
        at, on = grid.piece[cell] * count + drone, cell * count + drone
        fourth, fifth = grid.fourth.take(at), grid.fifth.take(at)
        first, second, third = (margin.take(at) for margin in self.limits.margins)
        A, J = grid.sizes.second.take(on), grid.sizes.third.take(on)
        chord, time = rows.chord, rows.time * rows.time / 8.0
        step = (grid.width[cell] * (rows.tau[1] - rows.tau[0])) ** 2 / 8.0
        T, v, s = rows.T, rows.v, rows.s[0]
        a, j = np.maximum(*np.abs(rows.a)), np.abs(rows.j)
        s2, a2, v3 = s * s, a * a, v * v * v
        s3 = s2 * s
        # How far vectors may be from those at the ends of rows, these taken on chords of cells.
        bent = time * (s2 * s2 * fourth + 6.0 * s2 * a * J + (3.0 * a2 + 4.0 * s * j) * A)
        bent += chord * (s2 * fourth + a * J) + s2 * second + a * first
        early = (s3 * s2 * fifth + 10.0 * s3 * a * fourth) + 10.0 * a * j * A
        early += (15.0 * s * a2 + 10.0 * s2 * j) * J
        late = 112.0 / T**2 * J + 72.0 / T * v3 * fourth + 8.0 * v3 * v3 * fifth
        bend = np.where(rows.late, step * late, time * early)
        bend += chord * (s3 * fifth + 3.0 * s * a * fourth + j * J)
        bend += s3 * third + 3.0 * s * a * second + j * first
        x1, x2, x3 = (grid.on_chord(order, cell, rows.tau, drone) for order in range(3))
        s, a, j = rows.s, rows.a, rows.j
        s2 = s * s
        ends = s2 * x2 + a * x1
        there = np.maximum(*axis_lengths(s2 * s * x3 + 3.0 * s * a * x2 + j * x1))
        acceleration = np.minimum(np.maximum(*axis_lengths(ends)) + bent, acceleration)
        acceleration *= 1.0 + SLACK
        jerk = np.minimum(there + bend, jerk) * (1.0 + SLACK)
        kept: Flags = (acceleration <= limits.acceleration) & (jerk <= limits.jerk)
        extra = team.mass[drone] * acceleration
        fine = self.limits.hover.take(at) + extra <= team.max_thrust[drone]
        fine &= self.limits.beyond.take(at) + extra <= 0.0
        left = np.flatnonzero(kept & ~fine)
        if len(left):
            kept[left] = self._force_keeps(
                rows.taken(left), drone[left], ends[..., left], bent[left]
            )
        return kept

    def _force_keeps(self, rows: _Rows, drone: Indices, accelerations: Array, bent: Array) -> Flags:
        """Return (pairs,) whether thrusts and tilts are shown to keep their limits.

        Parameters
        ----------
        rows, drone: of the pairs.
        accelerations: (3, 2, pairs) at both ends of rows [m/s²].
        bent: (pairs,), by how much they differ from these within.
        """
        team, piece = self.limits.motion.team, self.grid.piece[rows.cell]
        cos, sin = np.cos(self.limits.tilt), np.sin(self.limits.tilt)
        chord, time, s = rows.chord, rows.time**2 / 8.0, rows.s[0]
        a = np.maximum(*np.abs(rows.a))
        slope, bend = self.grid.slope[piece, drone], self.grid.bend[piece, drone]
        radius = self.limits.static.thrust.radius[piece, drone]
        radius = radius + ROUNDING * self.limits.hover[piece, drone]
        radius += team.mass[drone] * bent + chord * bend + time * (s**2 * bend + a * slope)
        force = self.grid.on_chord(3, rows.cell, rows.tau, drone)
        force += team.mass[drone] * accelerations
        thrust = axis_lengths(force) + radius
        beyond = np.hypot(force[0], force[1]) * cos - force[2] * sin + radius
        kept: Flags = np.all((thrust <= team.max_thrust[drone]) & (beyond <= 0.0), axis=0)
        return kept


def _acceleration(sizes: Sizes, rows: _Rows) -> Array:
    """Return a bound of the acceleration [m/s²]."""
    s, a = rows.s[0], np.maximum(*np.abs(rows.a))
    found: Array = (s * s)[:, None] * sizes.second + a[:, None] * sizes.first
    return found


def _jerk(sizes: Sizes, rows: _Rows) -> Array:
    """Return a bound of the jerk [m/s³]."""
    s, a, j = rows.s[0], np.maximum(*np.abs(rows.a)), np.abs(rows.j)
    found: Array = (
        (s * s * s)[:, None] * sizes.third
        + (3.0 * s * a)[:, None] * sizes.second
        + j[:, None] * sizes.first
    )
    return found
