"""Which drones and cable parts of a way come near enough to matter, and along which normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from hitchopt.geometry import differences, shortest_offset
from hitchopt.geometry.broadphase import Boxes, close_pairs
from hitchopt.hitch import Separation
from hitchopt.hitch.parts import CABLE, CROSSING, SEPARATION, Parts
from hitchopt.planners.optimise.layout import Layout

Array = NDArray[np.float64]
Index = NDArray[np.intp]

REACH = 0.5
"""[m] Pairs farther apart than their limit and this are let go: within a step of the optimiser
(STEP in ``program``) they cannot come near."""


@dataclass(frozen=True, eq=False)
class PairRows:
    """Distances to keep, over the inner knots' variables in a row.

    Attributes
    ----------
    first, second: (m, 2), the places of two drones each.
    apart: (m,) [m] that they keep.
    rows: (r, variables), ``rows @ x ≥ least``: two bodies on their sides of a normal.
    least: (r,) [m]
    """

    first: Index
    second: Index
    apart: Array
    rows: sparse.csc_matrix
    least: Array


def pair_rows(layout: Layout, table: Array, separation: Separation, margins: Array) -> PairRows:
    """Return the rows of all near pairs at the inner knots of a table (knots, size).

    Normals are those of the table: a row bounds the distance from below whatever the bodies do,
    and is tight where they do not turn. Linear in knots · n.

    Parameters
    ----------
    layout, table: the variables and the way.
    separation: distances to keep.
    margins: (knots - 2,), how many times those.
    """
    inner = table[1:-1]
    parts = Parts.of(layout.robots)
    limits = np.array([2.0 * separation.radius, separation.cable, separation.crossing])
    nodes = inner[:, layout.nodes]
    frame, i, j, kind = _near(nodes, parts, limits * float(np.max(margins)))
    ends = [nodes[frame[:, None], parts.nodes[body]] for body in (i, j)]
    offset = shortest_offset(differences(*ends))
    distance = np.linalg.norm(offset, axis=1)
    kept = limits[kind] * margins[frame]
    close = distance < kept + REACH
    frame, i, j, kind = (a[close] for a in (frame, i, j, kind))
    offset, distance, kept = offset[close], distance[close], kept[close]
    middle = (ends[0] - ends[1]).mean(axis=1)[close]
    normal = np.where(distance[:, None] > 1e-6, offset, middle)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)

    def places(pair: Index, node: Index) -> Index:
        columns: Index = layout.size * frame[pair, None] + layout.nodes[node]
        return columns

    drones = np.flatnonzero(kind == SEPARATION)
    combinations = [
        (pair, parts.nodes[i[pair], a], parts.nodes[j[pair], b])
        for which, firsts in ((CABLE, (0,)), (CROSSING, (0, 1)))
        for pair in [np.flatnonzero(kind == which)]
        for a in firsts
        for b in (0, 1)
    ]
    pair, a, b = (np.concatenate(column) for column in zip(*combinations, strict=True))
    row = np.repeat(np.arange(len(pair)), 2)
    rows = sparse.csc_matrix(
        (
            np.concatenate([normal[pair].ravel(), -normal[pair].ravel()]),
            (np.tile(row, 2), np.concatenate([places(pair, a).ravel(), places(pair, b).ravel()])),
        ),
        shape=(len(pair), inner.size),
    )
    return PairRows(
        places(drones, parts.nodes[i[drones], 0]),
        places(drones, parts.nodes[j[drones], 0]),
        kept[drones],
        rows,
        kept[pair],
    )


def _near(nodes: Array, parts: Parts, limits: Array) -> tuple[Index, Index, Index, Index]:
    """Return (knot, body, body, kind) of all pairs whose boxes come near; nodes (K, 3n, 2)."""
    corners = nodes[:, parts.nodes]
    lower, upper = corners.min(axis=2).reshape(-1, 2), corners.max(axis=2).reshape(-1, 2)
    cutoff = float(np.max(limits)) + REACH
    # A third coordinate keeps the knots apart, so that one tree serves them all.
    step = 4.0 * (cutoff + float(np.max(upper) - np.min(lower)))
    level = np.repeat(np.arange(len(nodes)) * step, len(parts.nodes))
    boxes = Boxes(np.column_stack([lower, level]), np.column_stack([upper, level]))
    pairs = close_pairs(boxes, None, cutoff)
    frame, i = np.divmod(pairs.first, len(parts.nodes))
    j = pairs.second % len(parts.nodes)
    kind = parts.kind(i, j)
    wanted = (kind >= 0) & (limits[kind] > 0.0)
    return frame[wanted], i[wanted], j[wanted], kind[wanted]
