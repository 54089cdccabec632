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

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.clock_limits import ClockLimits
from hitchopt.checks.bounds.derivative_grid import WIDTH, DerivativeGrid, axis_lengths
from hitchopt.checks.bounds.rounding_margins import ROUNDING
from hitchopt.checks.bounds.stop_rows import (
    LimitTables,
    StopRows,
    acceleration_bound,
    cut_stops,
    jerk_bound,
)
from hitchopt.time_limit import check_time
from hitchopt.values import Array, Indices

Flags = NDArray[np.bool_]

ROWS = 20_000
"""Parts of stops that are looked at in one go."""

VECTORS = 60_000
"""Vectors of each kind that are looked at in one go."""

_W = np.array([0.0, 0.05, 0.1, 0.25, 0.5])
"""Shares of a stop's time at which samples are taken."""

SLACK = 1e-9
"""Relative margin for the clock's rounding."""


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
        self._mass, self._max_thrust = limits.motion.team.mass, limits.motion.team.max_thrust
        self._vectors = max(1, VECTORS // max(1, len(self._mass)))

    @cached_property
    def _tables(self) -> LimitTables:
        return LimitTables.of(self.limits, self.grid)

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
        """Return (stops,) whether leading drones keep limits at samples; what breaks one is out."""
        kept = np.zeros(len(start), dtype=np.bool_)
        size = max(1, VECTORS // (len(_W) * len(self.grid.leading)))
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
            self._look(cut_stops(self.grid, start, duration, np.flatnonzero(group == first)), kept)
        return kept

    def _samples(self, start: Array, duration: Array) -> Flags:
        """Return (stops,) whether leading drones keep limits in the first halves of stops."""
        limits = self.limits.motion.requirements.limits
        w, T = (each.ravel() for each in np.broadcast_arrays(_W[:, None], duration))
        time = np.tile(start, len(_W)) + (w - 2.0 / 3.0 * w * w * w) * T
        time = np.minimum(time, self.grid.until[-1])
        cell = np.maximum(np.searchsorted(self.grid.begin, time, side="right") - 1, 0)
        share = (time - self.grid.begin[cell]) / self.grid.width[cell]
        drones = self.grid.leading[:, None]
        x1, x2, x3 = self.grid.on_chord(slice(3), drones, cell, share[None])[:, :, 0]
        s, a, j = 1.0 - 2.0 * w * w, -4.0 * w / T, -4.0 / (T * T)
        s2 = s * s
        fine = axis_lengths(s2 * s * x3 + (3.0 * s * a) * x2 + j * x1) <= limits.jerk
        fine &= axis_lengths(s2 * x2 + a * x1) <= limits.acceleration
        kept: Flags = np.all(fine, axis=0).reshape(len(_W), -1).all(axis=0)
        return kept

    def _look(self, rows: StopRows, kept: Flags) -> None:
        """Set ``kept`` to False for stops that are not shown to keep a limit in these rows."""
        limits = self.limits.motion.requirements.limits
        most = self._tables.largest.take(rows.cell, axis=1)
        acceleration = acceleration_bound(most, rows) * (1.0 + SLACK)
        fine = acceleration <= limits.acceleration
        fine &= jerk_bound(most, rows) * (1.0 + SLACK) <= limits.jerk
        fine &= acceleration <= self._tables.spare[self.grid.piece[rows.cell]]
        left = np.flatnonzero(~fine)
        size = self._vectors
        for first in range(0, len(left), size):
            check_time()
            part = left[first : first + size]
            part = part[kept[rows.stop[part]]]
            if len(part):
                own = rows.taken(part)
                kept[own.stop[~self._keeps(own)]] = False

    def _keeps(self, rows: StopRows) -> Flags:
        """Return (rows,) whether all drones are shown to keep all limits."""
        limits, tables = self.limits.motion.requirements.limits, self._tables
        sizes = tables.sizes.take(rows.cell, axis=2)
        acceleration, jerk = acceleration_bound(sizes, rows), jerk_bound(sizes, rows)
        fine = acceleration * (1.0 + SLACK) <= limits.acceleration
        fine &= jerk * (1.0 + SLACK) <= limits.jerk
        hover, beyond = tables.loads.take(self.grid.piece[rows.cell], axis=2)
        extra = self._mass[:, None] * acceleration * (1.0 + SLACK)
        fine &= hover + extra <= self._max_thrust[:, None]
        fine &= beyond + extra <= 0.0
        drone, row = (np.flatnonzero(~np.all(fine, axis=axis)) for axis in (1, 0))
        kept = np.ones(len(rows.cell), dtype=np.bool_)
        if len(row):
            known = np.stack([acceleration, jerk, sizes[1], sizes[2], hover, beyond])
            known = known.take(drone, axis=1).take(row, axis=2)
            kept[row] = self._vectors_keep(rows.taken(row), drone, known)
        return kept

    def _vectors_keep(self, rows: StopRows, drone: Indices, known: Array) -> Flags:
        """Return (rows,) whether some drones are shown to keep all limits, by their vectors.

        Parameters
        ----------
        rows: parts of stops.
        drone: (drones,), those that are looked at.
        known: (6, drones, rows), bounds of acceleration and jerk, those of the second and third
            derivatives, and the ``loads`` of the tables.
        """
        limits, grid, cell = self.limits.motion.requirements.limits, self.grid, rows.cell
        acceleration, jerk, A, J, hover, beyond = known
        at = drone[:, None] * len(grid.fourth) + grid.piece[cell]
        fourth, fifth, first, second, third = self._tables.margins.take(at, axis=1)
        chord, time = rows.chord, rows.time * rows.time / 8.0
        step = (grid.width[cell] * (rows.tau[1] - rows.tau[0])) ** 2 / 8.0
        T, v, s = rows.T, rows.v, rows.s[0]
        a, j = np.maximum(*np.abs(rows.a)), np.abs(rows.j)
        s2, a2, v3 = s * s, a * a, v * v * v
        s3, sa = s2 * s, 3.0 * s * a
        # How far vectors may be from those at the ends of rows, these taken on chords of cells.
        bent = (time * s2 * s2 + chord * s2) * fourth + s2 * second + a * first
        bent += (6.0 * time * s2 + chord) * a * J + time * (3.0 * a2 + 4.0 * s * j) * A
        late, none = rows.late, 0.0 * s
        bend = np.where(late, step * 8.0 * v3 * v3, time * s3 * s2) + chord * s3
        bend = bend * fifth + s3 * third + sa * second + j * first
        bend += (np.where(late, step * 72.0 / T * v3, time * 10.0 * s3 * a) + chord * sa) * fourth
        turned = time * (15.0 * s * a2 + 10.0 * s2 * j)
        bend += (np.where(late, step * 112.0 / T**2, turned) + chord * j) * J
        bend += np.where(late, none, time * 10.0 * a * j) * A
        x1, x2, x3 = grid.on_chord(slice(3), drone[:, None], cell, rows.tau[:, None])
        s, a, j = rows.s[:, None], rows.a[:, None], rows.j
        s2 = s * s
        ends = s2 * x2 + a * x1
        there = np.maximum(*axis_lengths(s2 * s * x3 + 3.0 * s * a * x2 + j * x1))
        acceleration = np.minimum(np.maximum(*axis_lengths(ends)) + bent, acceleration)
        acceleration *= 1.0 + SLACK
        jerk = np.minimum(there + bend, jerk) * (1.0 + SLACK)
        kept: Flags = (acceleration <= limits.acceleration) & (jerk <= limits.jerk)
        extra = self._mass[drone][:, None] * acceleration
        fine = hover + extra <= self._max_thrust[drone][:, None]
        fine &= beyond + extra <= 0.0
        if not np.all(fine):
            i, row = np.nonzero(kept & ~fine)
            own = rows.taken(row)
            kept[i, row] = self._force_keeps(own, drone[i], ends[:, :, i, row], bent[i, row])
        every: Flags = np.all(kept, axis=0)
        return every

    def _force_keeps(
        self, rows: StopRows, drone: Indices, accelerations: Array, bent: Array
    ) -> Flags:
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
        force = self.grid.on_chord(slice(3, 4), drone, rows.cell, rows.tau)[0]
        force += team.mass[drone] * accelerations
        thrust = axis_lengths(force) + radius
        beyond = np.hypot(force[0], force[1]) * cos - force[2] * sin + radius
        kept: Flags = np.all((thrust <= team.max_thrust[drone]) & (beyond <= 0.0), axis=0)
        return kept
