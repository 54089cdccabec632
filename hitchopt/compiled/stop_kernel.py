"""Compiled search for the shortest stops, and bounds that show them, one after the other.

As ``quick_stops`` and ``stop_bounds`` do it for all of them at once; the formulas are explained
there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hitchopt.compiled.grid_kernel import stop_grid
from hitchopt.compiled.kernel_switch import kernel
from hitchopt.compiled.stop_tables import StopTables
from hitchopt.values import Array

SWITCH = 5.0 / 12.0
"""Plan time over duration at which the clock's jerk changes its sign."""

SLACK = 1e-9
"""Relative margin for the clock's rounding."""


class _Row(NamedTuple):
    """A part of a stop within one cell; see ``stop_bounds``."""

    cell: int
    late: bool
    whole: bool
    T: float
    tau: tuple[float, float]
    s: tuple[float, float]
    a: tuple[float, float]
    j: float
    v: float
    time: float


@kernel
def _rate(p: float, late: bool, T: float) -> tuple[float, float, float, float]:
    """Return 1 - w, w, the rate and its derivative at a plan time, from its begin over T."""
    if late:
        v = np.cbrt(max(0.75 - 1.5 * p, 0.0))
        return v, 1.0 - v, 2.0 * v * v, -4.0 / T * v
    share = min(max(3.0 / np.sqrt(2.0) * p, 0.0), 1.0)
    w = np.sqrt(2.0) * np.sin(np.arcsin(share) / 3.0)
    return 1.0 - w, w, 1.0 - 2.0 * w * w, -4.0 / T * w


@kernel
def _row(
    tables: StopTables,
    cell: int,
    start: float,
    T: float,
    late: bool,
    known: tuple[float, float, float, float],
) -> tuple[_Row, tuple[float, float, float, float]]:
    """Return the part of a stop that lies in a cell, and the clock where it ends.

    ``known`` is the clock where the part begins, at a cell's begin; elsewhere it is not used.
    """
    begin, until, width = tables.begin[cell], tables.until[cell], tables.width[cell]
    first = max(begin, start + (SWITCH * T if late else 0.0))
    last = min(until, start + (0.5 if late else SWITCH) * T)
    v0, w0, s0, a0 = known if known[0] >= 0.0 else _rate((first - start) / T, late, T)
    end = _rate((last - start) / T, late, T)
    _, w1, s1, a1 = end
    j = (4.0 if late else -4.0) / T**2
    tau = ((first - begin) / width, (last - begin) / width)
    whole = first == begin and last == until
    return _Row(cell, late, whole, T, tau, (s0, s1), (a0, a1), j, v0, (w1 - w0) * T), end


@kernel
def _sized(V: float, A: float, J: float, row: _Row) -> tuple[float, float]:
    """Return bounds of acceleration and jerk for given ones of the derivatives."""
    s, a, j = row.s[0], max(abs(row.a[0]), abs(row.a[1])), abs(row.j)
    return s * s * A + a * V, s**3 * J + 3.0 * s * a * A + j * V


@kernel
def _sizes(tables: StopTables, cell: int, drone: int) -> tuple[float, float, float]:
    """Return the bounds of the derivatives of a drone in a cell."""
    first, second, third = tables.sizes
    return first[cell, drone], second[cell, drone], third[cell, drone]


@kernel
def _bent(tables: StopTables, row: _Row, drone: int) -> tuple[float, float]:
    """Return how far acceleration and jerk may be from those at the ends of a row."""
    margins = tables.margins[:, tables.piece[row.cell], drone]
    A, J = _sizes(tables, row.cell, drone)[1:]
    width = tables.width[row.cell]
    chord = 0.0 if row.whole else width**2 / 8.0
    time, T, v, s, j = row.time**2 / 8.0, row.T, row.v, row.s[0], abs(row.j)
    a = max(abs(row.a[0]), abs(row.a[1]))
    fourth, fifth = margins[0], margins[1]
    bent = time * (s**4 * fourth + 6.0 * s**2 * a * J + (3.0 * a**2 + 4.0 * s * j) * A)
    bent += chord * (s**2 * fourth + a * J) + s**2 * margins[3] + a * margins[2]
    if row.late:
        bend = 112.0 / T**2 * J + 72.0 / T * v**3 * fourth + 8.0 * v**6 * fifth
        bend *= (width * (row.tau[1] - row.tau[0])) ** 2 / 8.0
    else:
        bend = s**5 * fifth + 10.0 * s**3 * a * fourth + 10.0 * a * j * A
        bend = time * (bend + (15.0 * s * a**2 + 10.0 * s**2 * j) * J)
    bend += chord * (s**3 * fifth + 3.0 * s * a * fourth + j * J)
    return bent, bend + s**3 * margins[4] + 3.0 * s * a * margins[3] + j * margins[2]


@kernel
def _ends(tables: StopTables, row: _Row, drone: int, end: int) -> tuple[float, float]:
    """Return acceleration and jerk at an end of a row, between the grid's nodes on chords."""
    first, second, third = tables.values[0], tables.values[1], tables.values[2]
    node, share, s, a = tables.left[row.cell], row.tau[end], row.s[end], row.a[end]
    acceleration = jerk = 0.0
    for axis in range(3):
        x1, x2, x3 = first[node, drone, axis], second[node, drone, axis], third[node, drone, axis]
        x1 += share * (first[node + 1, drone, axis] - x1)
        x2 += share * (second[node + 1, drone, axis] - x2)
        x3 += share * (third[node + 1, drone, axis] - x3)
        acceleration += (s**2 * x2 + a * x1) ** 2
        jerk += (s**3 * x3 + 3.0 * s * a * x2 + row.j * x1) ** 2
    return np.sqrt(acceleration), np.sqrt(jerk)


@kernel
def _force_keeps(tables: StopTables, row: _Row, drone: int, bent: float) -> bool:
    """Return whether a drone is shown to keep thrust and tilt."""
    margins = tables.margins[:, tables.piece[row.cell], drone]
    mass, strongest = tables.team[0, drone], tables.team[1, drone]
    cos, sin = np.cos(tables.limits[2]), np.sin(tables.limits[2])
    chord = 0.0 if row.whole else tables.width[row.cell] ** 2 / 8.0
    time, s, a = row.time**2 / 8.0, row.s[0], max(abs(row.a[0]), abs(row.a[1]))
    radius = margins[7] + mass * bent + chord * margins[9]
    radius += time * (s**2 * margins[9] + a * margins[8])
    node, force = tables.left[row.cell], np.empty(3)
    first, second, static = tables.values[0], tables.values[1], tables.values[3]
    for end in range(2):
        share = row.tau[end]
        for axis in range(3):
            x1, x2 = first[node, drone, axis], second[node, drone, axis]
            x1 += share * (first[node + 1, drone, axis] - x1)
            x2 += share * (second[node + 1, drone, axis] - x2)
            held = static[node, drone, axis]
            held += share * (static[node + 1, drone, axis] - held)
            force[axis] = held + mass * (row.s[end] ** 2 * x2 + row.a[end] * x1)
        level = np.hypot(force[0], force[1])
        if not np.hypot(level, force[2]) + radius <= strongest:
            return False
        if not level * cos - force[2] * sin + radius <= 0.0:
            return False
    return True


@kernel
def _keeps(tables: StopTables, row: _Row, drone: int) -> bool:
    """Return whether a drone is shown to keep all limits in a row."""
    most, margins = (
        _sized(*_sizes(tables, row.cell, drone), row),
        tables.margins[:, tables.piece[row.cell], drone],
    )
    strongest, extra = tables.team[1, drone], tables.team[0, drone] * most[0] * (1.0 + SLACK)
    if (
        most[0] * (1.0 + SLACK) <= tables.limits[0]
        and most[1] * (1.0 + SLACK) <= tables.limits[1]
        and margins[5] + extra <= strongest
        and margins[6] + extra <= 0.0
    ):
        return True
    bent, bend = _bent(tables, row, drone)
    begin, end = _ends(tables, row, drone, 0), _ends(tables, row, drone, 1)
    acceleration = min(max(begin[0], end[0]) + bent, most[0]) * (1.0 + SLACK)
    jerk = min(max(begin[1], end[1]) + bend, most[1]) * (1.0 + SLACK)
    if not (acceleration <= tables.limits[0] and jerk <= tables.limits[1]):
        return False
    extra = tables.team[0, drone] * acceleration
    if margins[5] + extra <= strongest and margins[6] + extra <= 0.0:
        return True
    return _force_keeps(tables, row, drone, bent)


@kernel
def _row_keeps(tables: StopTables, row: _Row) -> bool:
    """Return whether all drones are shown to keep all limits in a row."""
    most = tables.largest[row.cell]
    acceleration, jerk = _sized(most[0], most[1], most[2], row)
    acceleration, jerk = acceleration * (1.0 + SLACK), jerk * (1.0 + SLACK)
    most_accelerated = min(tables.limits[0], tables.spare[tables.piece[row.cell]])
    if acceleration <= most_accelerated and jerk <= tables.limits[1]:
        return True
    kept = True
    for drone in range(tables.team.shape[1]):
        kept = kept and _keeps(tables, row, drone)
    return kept


@kernel
def _kept(tables: StopTables, start: float, duration: float, samples: Array) -> bool:
    """Return whether a stop keeps the limits of acceleration and jerk at samples."""
    first, second, third = tables.values[0], tables.values[1], tables.values[2]
    for i in range(samples.shape[1]):
        time = start + samples[0, i] * duration
        cell = max(np.searchsorted(tables.begin, time, side="right") - 1, 0)
        node, most = tables.left[cell], tables.largest[cell]
        s, a, j = samples[1, i], samples[2, i] / duration, samples[3, i] / duration**2
        whole = s**3 * most[2] + 3.0 * s * abs(a) * most[1] + abs(j) * most[0]
        if s**2 * most[1] + abs(a) * most[0] <= tables.limits[0] and whole <= tables.limits[1]:
            continue  # no drone can break a limit anywhere in the cell
        for drone in range(first.shape[1]):
            x1, x2, x3 = first[node, drone], second[node, drone], third[node, drone]
            acceleration = jerk = 0.0
            for axis in range(3):
                acceleration += (s**2 * x2[axis] + a * x1[axis]) ** 2
                jerk += (s**3 * x3[axis] + 3.0 * s * a * x2[axis] + j * x1[axis]) ** 2
            if not acceleration <= tables.limits[0] ** 2:
                return False
            if not jerk <= tables.limits[1] ** 2:
                return False
    return True


@kernel
def _least(tables: StopTables, start: float, samples: Array, span: Array, rounds: int) -> float:
    """Return the duration [s] below which samples break a limit."""
    if _kept(tables, start, span[0], samples):
        return float(span[0])
    low, high = np.log(span[0]), np.log(span[1])
    for _ in range(rounds):
        middle = 0.5 * (low + high)
        if _kept(tables, start, np.exp(middle), samples):
            high = middle
        else:
            low = middle
    return float(np.exp(high))


@kernel
def _shown(tables: StopTables, t: float, T: float) -> bool:
    """Return whether a stop is shown to keep all limits, as ``StopBounds.show``."""
    for late in (False, True):
        low = t + (SWITCH * T if late else 0.0)
        high = t + (0.5 if late else SWITCH) * T
        if low >= tables.until[-1]:
            continue
        first = np.searchsorted(tables.begin, low, side="right") - 1
        last = np.searchsorted(tables.begin, high, side="left") - 1
        clock = (-1.0, 0.0, 0.0, 0.0)
        for cell in range(first, last + 1):
            row, clock = _row(tables, cell, t, T, late, clock)
            if not _row_keeps(tables, row):
                return False
    return True


@kernel
def quick_stops(
    plan: tuple[Array, Array],
    static: tuple[Array, Array],
    team: Array,
    limits: Array,
    spacing: tuple[float, float, float],
    rounding: tuple[float, float],
    starts: Array,
    samples: Array,
    span: Array,
    rounds: int,
    longer: Array,
) -> Array:
    """Return the durations (m,) [s] of ``quick_stop_table``; infinite where no stop is shown.

    Parameters
    ----------
    plan, static, team, limits, spacing, rounding: of ``stop_grid``.
    starts: (m,) [s]
    samples: (4, samples) plan time, rate and its derivatives, of a stop of one second.
    span: durations [s] between which the least ones lie.
    rounds: of bisection.
    longer: multiples of the least duration that are tried.
    """
    tables = stop_grid(plan[0], plan[1], static, team, limits, spacing, rounding)
    durations = np.full(len(starts), np.inf)
    for i in range(len(starts)):
        least = _least(tables, starts[i], samples, span, rounds)
        for factor in longer:
            if _shown(tables, starts[i], factor * least):
                durations[i] = factor * least
                break
    return durations
