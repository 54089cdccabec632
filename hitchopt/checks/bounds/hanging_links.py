"""Hanging cables, enclosed in continuous time: moving chains of segments and how far they are off.

On a cell of time a cable is stood in for by the points of the catenary at fixed μ, its steepness
taken from mid time and its height difference from the polynomials themselves. The catenary is never
farther from that chain than a bound on how it bends between the points, plus ¼ (L + |h|) of how far
its steepness is from that of mid time (see ``hitchopt.hitch.catenary``): the shorter the cell, the
closer the chain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.moving_bodies import Bodies
from hitchopt.geometry.broadphase import Boxes, Indices, close_pairs
from hitchopt.geometry.vectors import unit
from hitchopt.hitch.catenary import SERIES, Catenary, depth_terms, level_length, steepness
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.extremum import Cells
from hitchopt.trajectory.splitting import on_breaks
from hitchopt.values import Array

BY_LENGTH, BY_PLACE = 20, 16
"""A chain's points: so many links of equal length, which follow a cable down its steep ends, and
so many more points evenly across, which follow it around where it is lowest."""

LINKS = BY_LENGTH + BY_PLACE
"""Segments that stand in for a cable: it is off them by about 0.2 % of its length at most, where it
bends the most, and much less elsewhere."""

FARTHEST = 0.25
"""[m] Pieces on which a drone may go farther are cut before anything else."""


@dataclass(frozen=True, eq=False)
class Chains:
    """Chains of segments that stand in for hanging cables on cells of time.

    Attributes
    ----------
    points: (cells, LINKS + 1, 3, degree + 1) [m]
    off: (cells, LINKS) [m]: the cable is nowhere farther from that segment, at no time of the cell.
    bend: (cells, LINKS) [m]: the part of it that remains at mid time.
    """

    points: Array
    off: Array
    bend: Array


def chains(q: Array, r: Array, length: Array) -> Chains:
    """Return the chains of cables between ends (cells, 3, degree + 1) [m], ``length`` (cells,)."""
    offset = r - q
    half = bernstein.basis(np.array(0.5), bernstein.degree(q))
    cable = Catenary.between(q @ half, r @ half, length)
    by_length = cable.place(np.linspace(0.0, 1.0, BY_LENGTH + 1)[:, None])
    by_place = (np.arange(BY_PLACE) + 0.5)[:, None] * (2.0 / BY_PLACE) - 1.0
    evenly = np.broadcast_to(by_place, (BY_PLACE, len(length)))
    mu = np.sort(np.concatenate([by_length, evenly]), axis=0)  # (LINKS + 1, cells)
    level, skew = depth_terms(cable.sigma, mu)
    share = (0.5 * (1.0 + mu)).T[..., None, None]
    points = q[:, None] + share * offset[:, None]
    points[:, :, 2] -= (length * level).T[..., None] + skew.T[..., None] * offset[:, None, 2]
    lower, upper = steepness_range(offset, length)
    drift = np.maximum(upper - cable.sigma, cable.sigma - lower)
    height = np.max(np.abs(offset[:, 2]), axis=-1)
    bend = _bends(cable, mu)
    off = bend + (0.25 * (length + height) * drift)[:, None]
    return Chains(points, off, bend)


def _bends(cable: Catenary, mu: Array) -> Array:
    """Return (cells, LINKS) [m] how far each cable sags below its links, between points μ, midway.

    Measured in Λ / 2 sinh σ the cable is a hyperbolic cosine, farthest below its chord where it is
    parallel to it.
    """
    sigma = np.maximum(cable.sigma, SERIES)
    y = mu * sigma + np.arcsinh(cable.tilt)
    first, last = y[:-1], y[1:]
    width = np.maximum(last - first, 1e-12)
    slope = (np.cosh(last) - np.cosh(first)) / width
    touching = np.clip(np.arcsinh(slope), first, last)
    gap = np.cosh(first) + slope * (touching - first) - np.cosh(touching)
    unit = 0.5 * level_length(cable.rise, cable.length) / np.sinh(sigma)
    rounding = 2.0**-40 * cable.length
    bends: Array = (unit * np.maximum(gap, 0.0) + rounding).T
    return bends


def steepness_range(offset: Array, length: Array) -> tuple[Array, Array]:
    """Return the smallest and largest σ (cells,) of cables, from first to second end ``offset``.

    Parameters
    ----------
    offset: (cells, 3, degree + 1) [m]
    length: (cells,) [m]
    """
    half = bernstein.basis(np.array(0.5), bernstein.degree(offset))
    level = offset[:, :2]
    along = unit(level @ half)
    nearest = np.min(np.einsum("ci,cin->cn", along, level), axis=-1)
    farthest = np.max(np.linalg.norm(level, axis=1), axis=-1)
    heights = np.abs(offset[:, 2])
    highest = np.max(heights, axis=-1)
    same_sign = np.min(offset[:, 2], axis=-1) * np.max(offset[:, 2], axis=-1) > 0.0
    lowest = np.where(same_sign, np.min(heights, axis=-1), 0.0)
    tiny = 1e-6 * length
    lower = steepness(level_length(highest, length) / np.maximum(farthest, tiny))
    upper = steepness(level_length(lowest, length) / np.maximum(nearest, tiny))
    return lower, upper


def boxes(q: Array, r: Array, length: Array) -> Boxes:
    """Return boxes around the hanging cables (n, 3, degree + 1)."""
    both = np.concatenate([q, r], axis=-1)
    lower, upper = np.min(both, axis=-1), np.max(both, axis=-1)
    # Down one drone and up to the other one along its length, no cable comes deeper.
    ends = np.min(q[:, 2], axis=-1) + np.min(r[:, 2], axis=-1)
    lower[:, 2] = np.minimum(lower[:, 2], 0.5 * (ends - length))
    return Boxes(lower, upper)


def plan_chords(motion: Motion) -> Bodies:
    """Return the straight lines between the drones of each cable, as seen from above.

    Hanging cables, and cables that lie on the ground between their drones, are above or below them.
    """
    flat = motion.drones.coefficients * np.array([1.0, 1.0, 0.0])[:, None]
    pairs = flat.reshape(len(flat), -1, 2, *flat.shape[2:])
    return Bodies(pairs)


def plan_points(motion: Motion) -> Bodies:
    """Return the drones as points, as seen from above."""
    flat = motion.drones.coefficients * np.array([1.0, 1.0, 0.0])[:, None]
    return Bodies(flat[:, :, None])


def foreign(drones: Indices, cables: Indices) -> NDArray[np.bool_]:
    """Return which drones do not carry which cables."""
    apart: NDArray[np.bool_] = drones // 2 != cables
    return apart


def drone_cable_cells(
    drones: PiecewisePolynomial, piece: int, length: Array, cutoff: float, margin: float = 0.0
) -> Cells:
    """Return one cell per drone and foreign cable that may come within ``cutoff`` [m] on a piece.

    Items are ``drone * n + cable``; blocks are rows of drone, q and r, and the cables' lengths.
    """
    c = drones.coefficients[piece]
    q, r = c[0::2], c[1::2]
    around = Boxes(np.min(c, axis=-1), np.max(c, axis=-1))
    pairs = close_pairs(around, boxes(q, r, length), cutoff)
    pairs = pairs.take(foreign(pairs.first, pairs.second))
    i, k = pairs.first, pairs.second
    start, end = np.tile(drones.breaks[piece : piece + 2, None], len(pairs))
    return Cells(
        (np.concatenate([c[i], q[k], r[k]], axis=1), length[k][:, None, None]),
        i * len(length) + k,
        start,
        end,
        np.full(len(pairs), margin),
    )


def cut(drones: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return the same curves on pieces so short that no drone goes FARTHEST on any of them."""
    reach = np.max(np.linalg.norm(np.ptp(drones.coefficients, axis=-1), axis=-1), axis=1)
    counts = np.maximum(1, np.ceil(reach / FARTHEST)).astype(np.intp)
    if np.all(counts == 1):
        return drones
    piece = np.repeat(np.arange(drones.pieces), counts)
    first = np.arange(len(piece)) - np.repeat(np.cumsum(counts) - counts, counts)
    starts = drones.breaks[piece] + first / counts[piece] * drones.durations[piece]
    return on_breaks(drones, np.append(starts, drones.breaks[-1]))
