"""Distances of drones, and of the ground, to hanging cables."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from hitchopt.checks.bounds.hanging_links import LINKS, chains, cut, drone_cable_cells
from hitchopt.checks.bounds.rounding_margins import magnitude, position_margin
from hitchopt.checks.certificate import within
from hitchopt.geometry import shortest_offset
from hitchopt.geometry.vectors import unit
from hitchopt.hitch.catenary import SERIES, level_length, steepness
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.distance import distance_bound
from hitchopt.trajectory.extremum import Cells, Estimate, Extremum, Search
from hitchopt.values import Array

TOLERANCE = 1e-3
"""[m] How far ``worst`` may lie below a distance that is attained, besides what a cable's links are
off it: catenaries are no polynomials, and are closed in on only with the length of a cell."""

SHIFT = 1.12
"""How far a point of a cable moves with its ends, over how far they move: at most √(1 + ¼), since
its shares in their level and upward parts differ by up to a half."""


def above_ground(motion: Motion) -> bool:
    """Return whether cables, if all hung free, would keep ``separation.cable`` off the ground."""
    limit = motion.requirements.separation.cable
    return height_above_ground(motion).worst >= within(limit, "min", magnitude(motion))


def distance_to_drones(motion: Motion) -> Extremum:
    """Return the smallest distance of a drone to a foreign cable; items ``drone * n + cable``."""
    length, drones = motion.team.cable_length, cut(motion.drones)
    search = Search(_distance, relative=TOLERANCE, absolute=TOLERANCE)
    margin = position_margin(motion)
    for piece in range(drones.pieces):
        c = drones.coefficients[piece]
        cutoff = min(search.value, _attained(c[0::2], c[1::2], c, length)) + margin
        search.add(drone_cable_cells(drones, piece, length, cutoff, margin))
    found = search.finish()
    return replace(found, worst=max(found.worst, 0.0))


def height_above_ground(motion: Motion) -> Extremum:
    """Return the smallest height of a cable over the ground, negative below it.

    Items count on from those of ``distance_to_drones``, the ground being one more drone.
    """
    n, drones = motion.team.robots, cut(motion.drones)
    c = drones.coefficients.copy()
    c[:, :, 2] -= motion.requirements.floor
    rows = np.concatenate([c[:, 0::2], c[:, 1::2]], axis=2)
    lengths = np.broadcast_to(motion.team.cable_length[:, None, None], (*rows.shape[:2], 1, 1))
    search = Search(_height, relative=TOLERANCE, absolute=TOLERANCE)
    search.add(Cells.over(drones.breaks, [rows, lengths], position_margin(motion)))
    found = search.finish()
    return replace(found, item=2 * n * n + found.item)


def _distance(blocks: tuple[Array, ...]) -> Estimate:
    """Bound the distance of drones to cables from below: rows of drone, q, r; lengths."""
    rows, length = blocks
    drone, q, r = rows[:, 0:3], rows[:, 3:6], rows[:, 6:9]
    hung = chains(q, r, length[:, 0, 0])
    apart = drone[:, None] - hung.points  # (cells, LINKS + 1, 3, degree + 1)
    ends = np.stack([apart[:, :-1], apart[:, 1:]], axis=2)
    each = distance_bound((ends.reshape(-1, 6, ends.shape[-1]),))
    bound = np.min(each.bound.reshape(-1, LINKS) - hung.off, axis=1)
    half = bernstein.basis(np.array(0.5), bernstein.degree(rows))
    there = np.linalg.norm(shortest_offset(ends @ half), axis=-1)
    value = np.min(there - hung.bend, axis=1)  # the most that any cell about here can show
    return Estimate(np.maximum(bound, 0.0), value, np.full(len(rows), 0.5))


def _height(blocks: tuple[Array, ...]) -> Estimate:
    """Bound the height of cables from below: rows of q, r; lengths."""
    rows, length = blocks
    hung = chains(rows[:, 0:3], rows[:, 3:6], length[:, 0, 0])
    heights = hung.points[:, :, 2]
    lower = np.min(heights, axis=-1)
    lower = np.minimum(lower[:, 1:], lower[:, :-1])
    there = heights @ bernstein.basis(np.array(0.5), bernstein.degree(rows))
    value = np.min(np.minimum(there[:, 1:], there[:, :-1]) - hung.bend, axis=1)
    return Estimate(np.min(lower - hung.off, axis=1), value, np.full(len(rows), 0.5))


def _attained(q: Array, r: Array, drones: Array, length: Array) -> float:
    """Return a distance that some drone has to a foreign cable at mid time."""
    half = bernstein.basis(np.array(0.5), bernstein.degree(drones))
    points = chains(q, r, length).points @ half  # (n, LINKS + 1, 3)
    tree = cKDTree(points.reshape(-1, 3))
    count = min(LINKS + 2, points.shape[0] * (LINKS + 1))
    distances, index = tree.query(drones @ half, k=count)
    apart = index // (LINKS + 1) != (np.arange(len(drones)) // 2)[:, None]
    return float(np.min(np.where(apart, distances, np.inf)))


def moved_by(motion: Motion) -> Callable[[float], float]:
    """Return how much nearer [m] drones and hanging cables come if every drone is off by r [m].

    A point of a cable (at μ, see ``hitchopt.hitch.catenary``) moves with its two ends, across by
    shares ``(1 ± μ)/2`` of them, upward by ``(1 ± sinh μσ / sinh σ)/2``, and by ¼ (L + |h|) per
    change of σ at most. That follows from ``(coth σ - 1/σ) dσ = d ln(Λ/s)``, where s and h change
    by 2r at most.
    """
    drones, L = cut(motion.drones).coefficients, motion.team.cable_length
    offset = drones[:, 1::2] - drones[:, 0::2]
    level = offset[:, :, :2]
    middle = level @ bernstein.basis(np.array(0.5), bernstein.degree(level))
    along = unit(middle)
    nearest = np.min(np.einsum("pci,pcin->pcn", along, level), axis=-1)
    farthest = np.max(np.linalg.norm(level, axis=2), axis=-1)
    height = np.max(np.abs(offset[:, :, 2]), axis=-1)

    def moved(radius: float) -> float:
        closer, higher = nearest - 2.0 * radius, height + 2.0 * radius
        if np.any(closer <= 0.0) or np.any(higher >= L):
            return np.inf
        flattest = steepness(level_length(higher, L) / (farthest + 2.0 * radius))
        if np.any(flattest < SERIES):  # nearly taut: how deep it hangs changes without a bound
            return np.inf
        ratio = np.log(nearest / closer) + np.log(level_length(height, L) / level_length(higher, L))
        steeper = ratio / (1.0 / np.tanh(flattest) - 1.0 / flattest)
        return radius + SHIFT * radius + float(np.max(0.25 * (L + higher) * steeper))

    return moved
