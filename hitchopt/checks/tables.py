"""Drones and taut cable parts as moving points and segments, with their names.

Cable k has three parts: the q-leg from ``p_k`` to ``q_k``, edge k, and the r-leg from ``p_{k+1}``
to ``r_k``. Part ``3 k + type`` is cable k's, with types in that order; bodies are those that
``Layout.parts`` lists, as the drones at the ends of a chain have no leg.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hitchopt.checks.spans import shared
from hitchopt.hitch.team import Layout
from hitchopt.motion.loads import lowered
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import bernstein
from hitchopt.values import Array, Indices

PART_NAMES = ("q-leg", "edge", "r-leg")


def positions(motion: Motion) -> tuple[Array, Array]:
    """Return the polynomials of the drones (pieces, 2n, 3, N+1) and points (pieces, P, 3, N+1) [m].

    Both have the larger of their degrees.
    """
    drones, vertices = same_degree(motion.drones.coefficients, motion.vertices.coefficients)
    return drones, vertices


@shared
def leg_vectors(motion: Motion) -> Array:
    """Return (pieces, 2n, 3, N+1) [m] from its vertex to each drone q0, r0, q1, …."""
    drones, vertices = positions(motion)
    return drones - vertices[:, motion.team.layout.anchors]


@shared
def pull_vectors(motion: Motion) -> Array:
    """Return (pieces, 2n, 3, N+1) [m] to each drone along the straight piece of cable it ends."""
    if motion.team.layout.closed:
        return leg_vectors(motion)
    drones, vertices = positions(motion)
    return drones - vertices[:, motion.team.layout.pulled_to]


@shared
def edge_vectors(motion: Motion) -> Array:
    """Return the edges ``p_{k+1} - p_k`` (pieces, n, 3, N+1) [m]."""
    return motion.team.layout.edges(positions(motion)[1], axis=1)


def concatenated(parts: Sequence[Array], axis: int) -> Array:
    """Return arrays of polynomials (…, degree + 1) in a row, in the largest of their degrees."""
    return np.concatenate(same_degree(*parts), axis=axis)


def bent_edges(motion: Motion) -> tuple[Array, Array]:
    """Return what edges are at both of their ends, each (pieces, n, 3, N+1) [m].

    Edge k leaves ``p_k`` along the first and arrives at ``p_{k+1}`` along the second: up to where
    it is wrapped around an object, or the whole edge where all are straight.
    """
    if motion.contacts is None:
        edges = edge_vectors(motion)
        return edges, edges
    layout = motion.team.layout
    vertices, contacts = same_degree(motion.vertices.coefficients, motion.contacts.coefficients)
    leaving = contacts[:, :, 0] - vertices[:, layout.starts]
    return leaving, vertices[:, layout.ends] - contacts[:, :, 1]


@dataclass(frozen=True, eq=False)
class CableParts:
    """The cable parts as segments.

    Attributes
    ----------
    corners: (pieces, bodies, 2, 3, degree + 1) [m]: their ends.
    part: (bodies,), the part that each is of. An edge that is wrapped around an object has three
        segments: what is straight of it, and between the chord of its arc, which is on the object.
    """

    corners: Array
    part: Indices

    def __len__(self) -> int:
        return len(self.part)


@shared
def cable_parts(motion: Motion) -> CableParts:
    """Return the cable parts in the order of ``Layout.parts``, edges' segments in theirs."""
    drones, vertices = positions(motion)
    layout, kinds = motion.team.layout, [0, 1, 2]
    listed: slice | Indices = slice(None)
    before, following = vertices[:, layout.starts], vertices[:, layout.ends]
    ends = [before, drones[:, 0::2], before, following, following, drones[:, 1::2]]
    if motion.contacts is not None:  # all hitches that are wrapped around something are closed
        first, last = np.moveaxis(motion.contacts.coefficients, 2, 0)
        ends[3:3], kinds = [first, first, last, last], [0, 1, 1, 1, 2]
    elif not layout.closed:
        listed = layout.parts
    corners = np.stack(same_degree(*ends), axis=2)
    corners = corners.reshape(len(corners), -1, 2, *corners.shape[3:])[:, listed]
    part = 3 * np.arange(layout.robots)[:, None] + kinds
    return CableParts(corners, part.ravel()[listed])


def part_points(parts: Indices, layout: Layout) -> tuple[Indices, Indices]:
    """Return the first and last point that each part touches; the same one for a leg."""
    k, kind = np.divmod(parts, 3)
    before, following = layout.starts[k], layout.ends[k]
    return np.where(kind == 2, following, before), np.where(kind == 0, before, following)


def clasped_pairs(layout: Layout) -> Indices:
    """Return the pairs of cables (clasps,) that hold each other: ``i * n + j`` with i < j."""
    return pair_of(layout, layout.ahead, layout.behind)


def pair_of(layout: Layout, first: Indices, second: Indices) -> Indices:
    """Return pairs of cables as ``i * n + j`` with i <= j."""
    return np.minimum(first, second) * layout.robots + np.maximum(first, second)


def part_name(part: int) -> str:
    """Return such as ``q-leg 2`` or ``edge 0``."""
    return f"{PART_NAMES[part % 3]} {part // 3}"


def same_degree(*parts: Array) -> list[Array]:
    """Return polynomials (…, degree + 1) in the largest of their degrees."""
    order = max(bernstein.degree(part) for part in parts)
    return [bernstein.elevate(part, order) for part in parts]


def without_shared_zeros(parts: dict[str, list[Array]]) -> dict[str, Array]:
    """Return polynomials without the factor ``x^a (1 - x)^b`` that those of an item share.

    Parameters
    ----------
    parts: by name, rows (pieces, items, degree + 1) each.

    Returns
    -------
    By name (pieces, items, rows, degree + 1), constants in degree 0.
    """
    tables = {
        name: lowered(concatenated([row[:, :, None] for row in rows], axis=2))
        for name, rows in parts.items()
    }
    ends = [
        [np.all(table[..., end] == 0.0, axis=2) for table in tables.values()] for end in (0, -1)
    ]
    if not np.any(np.all(ends, axis=1)):
        return tables
    table = concatenated(list(tables.values()), axis=2)
    table = _divided(_divided(table)[..., ::-1])[..., ::-1]
    lasts = np.cumsum([each.shape[2] for each in tables.values()])[:-1]
    return dict(zip(tables, np.split(table, lasts, axis=2), strict=True))


def _divided(table: Array) -> Array:
    """Return polynomials (pieces, items, rows, degree + 1) over the power of x that rows share."""
    order = bernstein.degree(table)
    while True:
        shared = np.all(table[..., 0] == 0.0, axis=2) & np.any(table != 0.0, axis=(2, 3))
        if order == 0 or not np.any(shared):
            return table
        steps = np.arange(1, order + 1)
        over = bernstein.elevate(table[..., 1:] * (order / steps), order)
        table = np.where(shared[..., None, None], over, table)
