"""Which bodies of a motion come near each other, and how near: segments in the plane.

Distances come from ends and an orientation test, in no way as the certificate finds them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from benchmarks.samples import Samples

Array = NDArray[np.float64]
Index = NDArray[np.intp]

REACH = 0.4
"""[m] Bodies farther apart than this at all of the coarse times keep every limit: they would have
to near each other at 5 m/s."""


@dataclass(frozen=True, eq=False)
class Near:
    """Pairs (m, 2) that come near each other: drones, drone and part, parts."""

    drones: Index
    cables: Index
    parts: Index


def cable_parts(s: Samples) -> tuple[Array, Array]:
    """Return both ends (J, 3n, 2) [m] of q-leg, edge and r-leg of cable 0, of cable 1, …."""
    here, there = s.vertices, np.roll(s.vertices, -1, axis=1)
    q, r = s.positions[:, 0::2], s.positions[:, 1::2]
    count = len(here)
    first = np.stack([here, here, there], axis=2).reshape(count, -1, 3)
    last = np.stack([q, there, r], axis=2).reshape(count, -1, 3)
    return first[..., :2], last[..., :2]


def near_pairs(n: int, coarse: Samples) -> Near:
    """Return the pairs that are not free to touch and come near at one of the coarse times."""
    first, last = cable_parts(coarse)
    middle, half = 0.5 * (first + last), 0.5 * float(np.max(np.linalg.norm(last - first, axis=-1)))
    drones, cables, parts = [], [], []
    for point, centre in zip(coarse.positions[..., :2], middle, strict=True):
        tree, part_tree = KDTree(point), KDTree(centre)
        drones.append(tree.query_pairs(REACH, output_type="ndarray"))
        found = tree.sparse_distance_matrix(part_tree, half + REACH, output_type="ndarray")
        cables.append(np.column_stack([found["i"], found["j"]]))
        parts.append(part_tree.query_pairs(2.0 * half + REACH, output_type="ndarray"))
    pairs = [np.unique(np.concatenate(kind), axis=0) for kind in (drones, cables, parts)]
    drone, part = pairs[1].T
    pairs[1] = pairs[1][(drone // 2 != part // 3) | (part % 3 == 1)]
    i, j = pairs[2].T
    clasps = [np.stack([k // 3 + (k % 3 == 2), k // 3 + (k % 3 > 0)]) % n for k in (i, j)]
    shared = np.any(clasps[0][:, None] == clasps[1][None, :], axis=(0, 1))
    pairs[2] = pairs[2][~shared]
    gaps = [
        to_segment(coarse.positions[:, pairs[1][:, 0], :2], *_ends(first, last, pairs[1][:, 1])),
        between(*_ends(first, last, pairs[2][:, 0]), *_ends(first, last, pairs[2][:, 1])),
    ]
    close = [pair[np.min(gap, axis=0) < REACH] for pair, gap in zip(pairs[1:], gaps, strict=True)]
    return Near(pairs[0], *close)


def _ends(first: Array, last: Array, part: Index) -> tuple[Array, Array]:
    return first[:, part], last[:, part]


def to_segment(point: Array, first: Array, last: Array) -> Array:
    """Return the distances of points to segments, (…, 2) each [m]."""
    along = last - first
    share = dot(point - first, along) / dot(along, along)
    foot = first + np.clip(share, 0.0, 1.0)[..., None] * along
    distance: Array = length(point - foot)
    return distance


def between(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Return the distances of segments ab and cd in the plane, (…, 2) each [m]."""

    def side(p: Array, q: Array, x: Array) -> Array:
        u, v = q - p, x - p
        return np.sign(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])

    # Disjoint segments of one line, as legs along one edge are, seem to cross by their rounding.
    lower = np.maximum(np.minimum(a, b), np.minimum(c, d))
    upper = np.minimum(np.maximum(a, b), np.maximum(c, d))
    crosses = np.all(lower <= upper, axis=-1)
    crosses &= (side(a, b, c) * side(a, b, d) < 0.0) & (side(c, d, a) * side(c, d, b) < 0.0)
    ends = [
        to_segment(a, c, d),
        to_segment(b, c, d),
        to_segment(c, a, b),
        to_segment(d, a, b),
    ]
    return np.where(crosses, 0.0, np.min(ends, axis=0))


def dot(a: Array, b: Array) -> Array:
    """Return scalar products of vectors (…, d)."""
    products: Array = np.einsum("...i,...i->...", a, b)
    return products


def length(a: Array) -> Array:
    """Return lengths of vectors (…, d)."""
    lengths: Array = np.sqrt(dot(a, a))
    return lengths
