"""Which drones and cable parts of a way come near enough to matter, and along which normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from hitchopt.geometry import differences, shortest_offset
from hitchopt.geometry.broadphase import Boxes, close_pairs
from hitchopt.hitch.parts import SEPARATION, Parts, end_combinations
from hitchopt.planners.optimise.variables import Layout
from hitchopt.requirements import Separation

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class NearPairs:
    """Pairs of bodies that come near one another, each at one of K instants.

    Attributes
    ----------
    frame: (m,), the instant.
    first, second: (m, 2), nodes (of 3n) at the ends of each body; a drone's are the same.
    kind: (m,), as in ``hitch.parts``.
    normal: (m, 2), unit vector from the second body to the first where they are closest.
    kept: (m,) [m], the distance to keep.
    """

    frame: Index
    first: Index
    second: Index
    kind: Index
    normal: Array
    kept: Array

    def of(self, chosen: Index) -> NearPairs:
        """Return the chosen pairs."""
        return NearPairs(
            self.frame[chosen],
            self.first[chosen],
            self.second[chosen],
            self.kind[chosen],
            self.normal[chosen],
            self.kept[chosen],
        )

    def sides(self) -> tuple[Index, Index, Index]:
        """Return (pair, node of the first, node of the second) of all their ends against all.

        Bodies whose ends all lie on their sides of a normal are apart by as much.
        """
        return end_combinations(self.kind, self.first, self.second)


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


def pair_rows(
    layout: Layout, table: Array, separation: Separation, margins: Array, reach: float
) -> PairRows:
    """Return the rows of all near pairs at the inner knots of a table (knots, size).

    Normals are those of the table: a row bounds the distance from below whatever the bodies do,
    and is tight where they do not turn. Linear in knots · n.

    Parameters
    ----------
    layout, table: the variables and the way.
    separation: distances to keep.
    margins: (knots - 2,), how many times those.
    reach: pairs farther apart than their limit and this [m] are let go.
    """
    inner = table[1:-1]
    pairs = near_pairs(inner[:, layout.nodes], separation, margins, reach)

    def places(frame: Index, node: Index) -> Index:
        columns: Index = layout.size * frame[:, None] + layout.nodes[node]
        return columns

    drones = pairs.of(np.flatnonzero(pairs.kind == SEPARATION))
    others = pairs.of(np.flatnonzero(pairs.kind != SEPARATION))
    pair, a, b = others.sides()
    row = np.repeat(np.arange(len(pair)), 2)
    frame, normal = others.frame[pair], others.normal[pair]
    rows = sparse.csc_matrix(
        (
            np.concatenate([normal.ravel(), -normal.ravel()]),
            (np.tile(row, 2), np.concatenate([places(frame, a).ravel(), places(frame, b).ravel()])),
        ),
        shape=(len(pair), inner.size),
    )
    return PairRows(
        places(drones.frame, drones.first[:, 0]),
        places(drones.frame, drones.second[:, 0]),
        drones.kept,
        rows,
        others.kept[pair],
    )


def near_pairs(nodes: Array, separation: Separation, margins: Array, reach: float) -> NearPairs:
    """Return all pairs that come within ``reach`` [m] of what they have to keep.

    Parameters
    ----------
    nodes: (K, 3n, 2) [m]
    separation: distances to keep.
    margins: (K,), how many times those.
    reach: [m]
    """
    parts = Parts.of(nodes.shape[1] // 3)
    limits = np.array([2.0 * separation.radius, separation.cable, separation.crossing])
    frame, i, j, kind = _near(nodes, parts, limits, float(np.max(limits * np.max(margins))) + reach)
    ends = [nodes[frame[:, None], parts.nodes[body]] for body in (i, j)]
    offset = shortest_offset(differences(*ends))
    distance = np.linalg.norm(offset, axis=1)
    middle = (ends[0] - ends[1]).mean(axis=1)
    normal = np.where(distance[:, None] > 1e-6, offset, middle)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    kept = limits[kind] * margins[frame]
    found = NearPairs(frame, parts.nodes[i], parts.nodes[j], kind, normal, kept)
    return found.of(np.flatnonzero(distance < kept + reach))


def _near(
    nodes: Array, parts: Parts, limits: Array, cutoff: float
) -> tuple[Index, Index, Index, Index]:
    """Return (instant, body, body, kind) of all pairs whose boxes come near; nodes (K, 3n, 2)."""
    corners = nodes[:, parts.nodes]
    lower, upper = corners.min(axis=2).reshape(-1, 2), corners.max(axis=2).reshape(-1, 2)
    # A third coordinate keeps the instants apart, so that one tree serves them all.
    step = 4.0 * (cutoff + float(np.max(upper) - np.min(lower)))
    level = np.repeat(np.arange(len(nodes)) * step, len(parts.nodes))
    boxes = Boxes(np.column_stack([lower, level]), np.column_stack([upper, level]))
    pairs = close_pairs(boxes, None, cutoff)
    frame, i = np.divmod(pairs.first, len(parts.nodes))
    j = pairs.second % len(parts.nodes)
    kind = parts.kind(i, j)
    wanted = (kind >= 0) & (limits[kind] > 0.0)
    return frame[wanted], i[wanted], j[wanted], kind[wanted]
