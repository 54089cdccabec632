"""Check ``cable_clearance`` while there is no hitch: drones and the ground keep off hanging cables.

A cable that hangs between its drones is a catenary. Taking off and landing, cables lie on the
ground at least in part, in between their drones: then drones keep off as seen from above.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hitchopt.checks.bounds.free_phases import PhasePart, free_phases
from hitchopt.checks.bounds.hanging_links import (
    LINKS,
    boxes,
    chains,
    cut,
    foreign,
    plan_chords,
    plan_points,
)
from hitchopt.checks.bounds.proximity import smallest_distance
from hitchopt.checks.bounds.rounding_margins import magnitude, position_margin
from hitchopt.checks.certificate import Check, most_pressing, within
from hitchopt.geometry import shortest_offset
from hitchopt.geometry.broadphase import Boxes, close_pairs
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.distance import distance_bound
from hitchopt.trajectory.extremum import Cells, Estimate, Extremum, Search

Array = NDArray[np.float64]

TOLERANCE = 1e-3
"""[m] How far ``worst`` may lie below a distance that is attained, besides what a cable's links are
off it: catenaries are no polynomials, and are closed in on only with the length of a cell."""

GROUND = "ground"
"""Stands for the drone in ``where``."""


def check(motion: Motion) -> Check | None:
    """Return the smallest distance of a drone, or of the ground, to a hanging cable not its own.

    ``where`` names the drone (or ``ground``) and the cable.

    Parameters
    ----------
    motion: a span of time without a hitch.
    """
    found = [each for part in free_phases(motion) for each in _of_phase(part)]
    return most_pressing(found)


def _of_phase(part: PhasePart) -> list[Check]:
    motion = part.motion
    if part.grounded:
        seen = smallest_distance(
            motion.drones.breaks,
            plan_points(motion),
            plan_chords(motion),
            foreign,
            position_margin(motion),
            within(motion.requirements.separation.cable, "min", magnitude(motion), 0.5),
        )
        return [_told(motion, seen)]
    drones = cut(motion.drones)
    return [_told(motion, _to_drones(motion, drones)), ground_clearance(motion)]


def ground_clearance(motion: Motion) -> Check:
    """Return the smallest height of a cable over the ground, all cables taken as hanging free."""
    return _told(motion, _to_ground(motion, cut(motion.drones)))


def _told(motion: Motion, found: Extremum) -> Check:
    n, limit = motion.team.robots, motion.requirements.separation.cable
    who, cable = divmod(found.item, n)
    name = GROUND if who == 2 * n else motion.team.drone_names[who]
    worst = max(found.worst, 0.0) if who < 2 * n else found.worst
    where = (name, f"cable {cable}")
    size = magnitude(motion)
    return Check.of("cable_clearance", worst, limit, "min", "m", found.time, where, size)


def _to_drones(motion: Motion, drones: PiecewisePolynomial) -> Extremum:
    """Return the smallest distance of a drone to a foreign cable."""
    team = motion.team
    search = Search(_distance, relative=TOLERANCE, absolute=TOLERANCE)
    margin = position_margin(motion)
    for piece in range(drones.pieces):
        c = drones.coefficients[piece]
        q, r = c[0::2], c[1::2]
        cutoff = min(search.value, _attained(q, r, c, team.cable_length)) + margin
        pairs = close_pairs(
            Boxes(np.min(c, axis=-1), np.max(c, axis=-1)), boxes(q, r, team.cable_length), cutoff
        )
        pairs = pairs.take(foreign(pairs.first, pairs.second))
        i, k = pairs.first, pairs.second
        rows = np.concatenate([c[i], q[k], r[k]], axis=1)
        times = np.tile(drones.breaks[piece : piece + 2, None], len(pairs))
        search.add(
            Cells(
                (rows, team.cable_length[k][:, None, None]),
                i * team.robots + k,
                times[0],
                times[1],
                np.full(len(pairs), margin),
            )
        )
    return search.finish()


def _to_ground(motion: Motion, drones: PiecewisePolynomial) -> Extremum:
    """Return the smallest height of a cable over the ground, negative below it."""
    n = motion.team.robots
    c = drones.coefficients.copy()
    c[:, :, 2] -= motion.requirements.floor
    rows = np.concatenate([c[:, 0::2], c[:, 1::2]], axis=2)
    lengths = np.broadcast_to(motion.team.cable_length[:, None, None], (*rows.shape[:2], 1, 1))
    search = Search(_height, relative=TOLERANCE, absolute=TOLERANCE)
    cells = Cells.over(drones.breaks, [rows, lengths], position_margin(motion))
    item = 2 * n * n + cells.item
    search.add(Cells(cells.blocks, item, cells.start, cells.end, cells.margin))
    return search.finish()


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
