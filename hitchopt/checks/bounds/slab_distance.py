"""Distances of moving points and segments to upright convex bodies, bounded for all t."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.geometry.vectors import GOLDEN
from hitchopt.objects import Slab
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.extremum import Cells, Estimate, Extremum, smallest
from hitchopt.values import Array

FIRST = 16
"""Pairs of a hull and a piece that are looked at first, for an attained distance."""

SECTIONS = 36
"""Golden sections of a segment in search of its nearest point: it is found within 3e-8 of it."""


def smallest_gap(
    breaks: Array,
    hulls: Array,
    slab: Slab,
    margin: ArrayLike = 0.0,
    target: float = -np.inf,
    counted: NDArray[np.bool_] | None = None,
) -> Extremum:
    """Return the smallest distance of moving points or segments to a body [m], zero within.

    Parameters
    ----------
    breaks: (pieces + 1,) [s]
    hulls: (pieces, items, 1 or 2, 3, degree + 1) [m], the ends, as seen from the body.
    slab: the body.
    margin, target: as of Cells and Search [m].
    counted: (pieces, items), which of them count; None for all.
    """
    pieces, items = hulls.shape[:2]
    rows = hulls.reshape(pieces, items, -1, hulls.shape[-1])
    cells = Cells.over(breaks, [rows], margin)
    near = _near(hulls, slab)
    if counted is not None:
        near = np.where(counted, near, np.inf)
    near = near.ravel()
    if not np.any(np.isfinite(near)):
        return Extremum(math.inf, math.inf, -1, 0.0)
    first = np.argsort(near, kind="stable")[:FIRST]
    attained = float(np.min(_bound(cells.take(first[np.isfinite(near[first])]).blocks, slab).value))
    found = smallest(cells.take(near <= attained), partial(_bound, slab=slab), target)
    return Extremum(max(found.worst, 0.0), found.value, found.item, found.time)


def _near(hulls: Array, slab: Slab) -> Array:
    """Return (pieces, items) distances [m] that boxes around hulls and a circle leave at least."""
    lower, upper = np.min(hulls, axis=(2, 4)), np.max(hulls, axis=(2, 4))
    reach = slab.section.circumradius
    aside = np.maximum(np.maximum(lower[..., :2], -upper[..., :2]), 0.0)
    level = np.maximum(np.linalg.norm(aside, axis=-1) - reach, 0.0)
    upward = np.maximum(np.maximum(lower[..., 2] - slab.upper, slab.lower - upper[..., 2]), 0.0)
    near: Array = np.hypot(level, upward) * (1.0 - 1e-12)
    return near


def _bound(blocks: tuple[Array, ...], slab: Slab) -> Estimate:
    """Return what bounds the distance to a body from below.

    The distance is the largest, over vectors n no longer than one, of the least n·p over a
    segment's ends less the largest n·v over the body. Along the normals at both ends of a cell, and
    between them in between.
    """
    (rows,) = blocks
    degree = rows.shape[-1] - 1
    ends = rows.reshape(len(rows), -1, 3, degree + 1)
    towards, lengths = [], []
    for end in (0, -1):
        distance, normals = nearest(ends[..., end], slab)
        product = np.einsum("md,mkdi->mki", normals, ends)
        towards.append(product - slab.support(normals)[:, None, None])
        lengths.append(np.maximum(distance, 0.0))
    weight = np.arange(degree + 2) / (degree + 1)
    coefficients = np.zeros((*towards[0].shape[:-1], degree + 2))
    coefficients[..., :-1] = (1.0 - weight[:-1]) * bernstein.elevate(towards[0], degree)
    coefficients[..., 1:] += weight[1:] * towards[1]
    lowest = np.maximum(np.min(coefficients, axis=(1, 2)), 0.0)
    x = np.argmin(lengths, axis=0)
    return Estimate(lowest, np.min(lengths, axis=0), x.astype(np.float64))


def nearest(ends: Array, slab: Slab) -> tuple[Array, Array]:
    """Return distances (…) [m] of points or segments (…, 1 or 2, 3), and the directions (…, 3)."""
    first, along = ends[..., 0, :], ends[..., -1, :] - ends[..., 0, :]
    if ends.shape[-2] == 1:
        found = slab.clearance(first)
        return found.distance, found.normals

    def distances(share: Array) -> Array:
        return slab.clearance(first + share[..., None] * along).distance

    lower, upper = np.zeros(first.shape[:-1]), np.ones(first.shape[:-1])
    left, right = np.full(lower.shape, 1.0 - GOLDEN), np.full(lower.shape, GOLDEN)
    at_left, at_right = distances(left), distances(right)
    for _ in range(SECTIONS):  # the distance to a convex body is convex along a segment
        down = at_left < at_right
        lower, upper = np.where(down, lower, left), np.where(down, right, upper)
        inner = np.where(down, 1.0 - GOLDEN, GOLDEN)
        fresh = lower + inner * (upper - lower)
        there = distances(fresh)
        left, right = np.where(down, fresh, right), np.where(down, left, fresh)
        at_left, at_right = np.where(down, there, at_right), np.where(down, at_left, there)
    shares = np.stack([np.zeros(lower.shape), 0.5 * (lower + upper), np.ones(lower.shape)])
    each = slab.clearance(first + shares[..., None] * along)
    best = np.argmin(each.distance, axis=0)[None]
    normals = np.take_along_axis(each.normals, best[..., None], axis=0)[0]
    return np.take_along_axis(each.distance, best, axis=0)[0], normals
