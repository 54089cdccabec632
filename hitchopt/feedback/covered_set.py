"""Offsets of drones from their plan that keep every distance, for all times of a cell.

Two bodies (a drone, or a straight part of a cable) with the distance D to keep are parted by a
direction n. The coefficients of their ends' polynomials a(t), b(t) give ``m ≤ n·(a - b)`` for all
t of a cell. With ends off by ``ρ_a``, ``ρ_b`` they keep D if ``n·(ρ_a - ρ_b) ≥ D - m`` for all
pairs of ends. These are linear in the offsets, so a set of half-spaces covers every distance at
every time of the cell; a common shift of all drones and vertices changes none of them. Vertices are
taken to be where they are planned, but for the reserve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hitchopt.checks.bounds.bodies import part_points, positions
from hitchopt.geometry.segments import differences, shortest_offset
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import bernstein
from hitchopt.values import Array, Indices

TRAVEL = 0.05
"""[m] Cells are so short that no drone's curve is longer: directions stay what they are."""

MOST_CELLS = 64
"""Number of cells into which a piece is cut at most."""

LARGEST = 0.25
"""[m] Largest offset of a drone besides the common shift of all of them."""

FARTHEST = 0.4
"""[m] Largest common shift."""

ONES = np.ones(3)
"""Sums the squares of vectors: faster than ``einsum`` where they are few."""

PASSES = 2
"""Rounds of projection onto broken half-spaces, before all is scaled to hold certainly."""


@dataclass(frozen=True, eq=False)
class HalfSpaces:
    """Half-spaces ``rows · offsets ≤ bounds`` of one cell, bounds not negative.

    Attributes
    ----------
    rows: (m, 6n), offsets without their common shift.
    bounds: (m,)
    lower, upper: (3,) [m], the common shift's range that the arena leaves, besides LARGEST.
    """

    rows: Array
    bounds: Array
    lower: Array
    upper: Array

    def within(self, offsets: Array) -> Array:
        """Return offsets (2n, 3) [m] of the set near the given ones."""
        count = len(offsets)
        common = np.add.reduce(offsets, 0) / count
        own = (offsets - common).ravel()
        common = np.minimum(np.maximum(common, self.lower), self.upper)
        beyond = self.rows @ own - self.bounds
        if beyond.size and beyond.max() > 0.0:
            for _ in range(PASSES):
                own = own - np.maximum(beyond, 0.0) @ self.rows
                beyond = self.rows @ own - self.bounds
            each = own.reshape(-1, 3)
            own = (each - np.add.reduce(each, 0) / count).ravel()
            values = self.rows @ own
            broken = values > self.bounds
            if broken.any():
                own = own * float((self.bounds[broken] / values[broken]).min())
        each = own.reshape(-1, 3)
        largest = math.sqrt(((each * each) @ ONES).max())
        if largest > LARGEST:
            each = each * (LARGEST / largest)
        found: Array = each + common
        return found


@dataclass(frozen=True, eq=False)
class CoveredSet:
    """Half-spaces of all cells of the times at which a motion has its hitch.

    Attributes
    ----------
    breaks: (cells + 1,) [s]; cells without a hitch have no half-spaces.
    cells: in order; None without a hitch.
    """

    breaks: Array
    cells: tuple[HalfSpaces | None, ...]


def cell_breaks(motion: Motion) -> Array:
    """Return the breaks of cells in which no drone's coefficients are farther apart than TRAVEL."""
    c, breaks = motion.drones.coefficients, motion.drones.breaks
    travel = np.sum(np.linalg.norm(np.diff(c, axis=-1), axis=2), axis=-1).max(axis=1)
    counts = np.clip(np.ceil(travel / TRAVEL), 1, MOST_CELLS).astype(int)
    parts = [
        np.linspace(first, last, count + 1)[:-1]
        for first, last, count in zip(breaks[:-1], breaks[1:], counts.tolist(), strict=True)
    ]
    found: Array = np.append(np.concatenate(parts), breaks[-1])
    return found


def covered_set(motion: Motion, breaks: Array, reserve: float) -> CoveredSet:
    """Return the half-spaces of all cells.

    Parameters
    ----------
    motion: the plan.
    breaks: of the cells, among them all of the motion's.
    reserve: how far every drone may be off its corrected setpoint, and every vertex off its plan,
        besides, wherever the plan itself leaves so much [m].
    """
    pieces = np.searchsorted(motion.drones.breaks, 0.5 * (breaks[1:] + breaks[:-1])) - 1
    start, h = motion.drones.breaks[pieces], motion.drones.durations[pieces]
    lower = np.clip((breaks[:-1] - start) / h, 0.0, 1.0)
    upper = np.clip((breaks[1:] - start) / h, 0.0, 1.0)
    drones, vertices = positions(motion)
    points = np.concatenate([drones, vertices], axis=1)
    pairs = _pairs(motion)
    formed = motion.formed[pieces]
    cells = [
        _half_spaces(motion, bernstein.restrict(points[piece], low, high), pairs, reserve)
        if there
        else None
        for piece, low, high, there in zip(pieces, lower, upper, formed, strict=True)
    ]
    return CoveredSet(breaks, tuple(cells))


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Pairs of bodies of one kind.

    Attributes
    ----------
    first, second: (pairs, ends) nodes, drones first, then points.
    limit: distance to keep [m], or 1 for drones' ellipsoids.
    scale: (3,), of the metric.
    """

    first: Indices
    second: Indices
    limit: float
    scale: Array


def _pairs(motion: Motion) -> tuple[_Pairs, ...]:
    """Return all pairs that the certificate keeps apart while the hitch holds."""
    team, layout, need = motion.team, motion.team.layout, motion.requirements
    count = team.drones
    part = layout.parts
    before, after = part_points(part, layout)
    kind, cable = part % 3, part // 3
    ends = np.column_stack(
        [
            np.where(kind == 2, layout.ends[cable], layout.starts[cable]) + count,
            np.where(
                kind == 1,
                layout.ends[cable] + count,
                np.where(kind == 0, 2 * cable, 2 * cable + 1),
            ),
        ]
    )
    plain = np.ones(3)
    i, j = np.triu_indices(count, 1)
    pairs = [_Pairs(i[:, None], j[:, None], 1.0, need.separation.scale)]
    drone, body = (x.ravel() for x in np.meshgrid(np.arange(count), np.arange(len(part))))
    on_leg = layout.has_leg.ravel()
    counted = (drone // 2 != cable[body]) | ((kind[body] == 1) & on_leg[drone])
    drone, body = drone[counted], body[counted]
    pairs.append(_Pairs(drone[:, None], ends[body], need.separation.cable, plain))
    i, j = np.triu_indices(len(part), 1)
    shared = (before[i] == before[j]) | (before[i] == after[j])
    shared |= (after[i] == before[j]) | (after[i] == after[j])
    i, j = i[~shared], j[~shared]
    pairs.append(_Pairs(ends[i], ends[j], need.separation.crossing, plain))
    legs = layout.drones_with_legs
    anchors = layout.anchors[legs] + count
    pairs.append(_Pairs(legs[:, None], anchors[:, None], need.limits.leg, plain))
    return tuple(pairs)


def _half_spaces(
    motion: Motion, points: Array, pairs: tuple[_Pairs, ...], reserve: float
) -> HalfSpaces:
    """Return the half-spaces of a cell, from the coefficients (nodes, 3, N + 1) of its points."""
    count = motion.team.drones
    middle = bernstein.evaluate(points, 0.5)
    rows, bounds = [], []
    for pair in pairs:
        shift = middle * pair.scale
        offset = shortest_offset(differences(shift[pair.first], shift[pair.second]))
        size = np.linalg.norm(offset, axis=-1)
        widest = float(np.max(pair.scale))
        near = np.flatnonzero((size < pair.limit + 4.0 * LARGEST * widest) & (size > 0.0))
        n = offset[near] / size[near, None] * pair.scale
        spare = 2.0 * reserve * np.linalg.norm(n, axis=-1)
        for a in pair.first[near].T:
            for b in pair.second[near].T:
                along = np.einsum("pd,pdk->pk", n, points[a] - points[b]).min(axis=-1)
                row = np.zeros((len(near), len(points), 3))
                each = np.arange(len(near))
                row[each, b] += n
                row[each, a] -= n
                bound = np.maximum(along - pair.limit - spare, 0.0)
                own = row[:, :count].reshape(len(near), 3 * count)
                length = np.linalg.norm(own, axis=1)
                kept = (length > 0.0) & (bound < np.sqrt(2.0) * LARGEST * length)
                rows.append(own[kept] / length[kept, None])
                bounds.append(bound[kept] / length[kept])
    lower, upper = np.full(3, -FARTHEST), np.full(3, FARTHEST)
    arena = motion.requirements.arena
    if arena is not None:
        hull = points[:count]
        inner = reserve + LARGEST
        lower = np.clip(arena.lower - hull.min(axis=(0, 2)) + inner, lower, 0.0)
        upper = np.clip(arena.upper - hull.max(axis=(0, 2)) - inner, 0.0, upper)
    return HalfSpaces(np.concatenate(rows), np.concatenate(bounds), lower, upper)
