"""Pairs of many boxes that come close, by a spatial index; one axis may be time."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement, product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hitchopt.values import Array, Indices

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes along the axes.

    Attributes
    ----------
    lower, upper: (boxes, d) [m]
    """

    lower: Array
    upper: Array

    def __len__(self) -> int:
        return len(self.lower)

    @classmethod
    def around(cls, points: Array) -> Boxes:
        """Return the boxes that hold what has the control points (boxes, corners, 3, m)."""
        return cls(np.min(points, axis=(1, 3)), np.max(points, axis=(1, 3)))

    @property
    def centres(self) -> Array:
        """(boxes, d) [m]: middles of the boxes."""
        return 0.5 * (self.lower + self.upper)

    @property
    def sizes(self) -> Array:
        """(boxes,) [m]: half of the longest side."""
        longest: Array = 0.5 * np.max(self.upper - self.lower, axis=-1, initial=0.0)
        return longest


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of bodies.

    Attributes
    ----------
    first, second: (pairs,), indices into the first and the second group.
    """

    first: Indices
    second: Indices

    def __len__(self) -> int:
        return len(self.first)

    def take(self, index: Indices | NDArray[np.bool_] | slice) -> Pairs:
        """Return the chosen pairs."""
        return Pairs(self.first[index], self.second[index])


def all_pairs(first: int, second: int | None) -> Pairs:
    """Return every pair of two groups of that many, or i < j within the first one."""
    if second is None:
        return Pairs(*np.triu_indices(first, 1))
    i, j = np.divmod(np.arange(first * second), second)
    return Pairs(i, j)


def close_pairs(first: Boxes, second: Boxes | None, cutoff: float) -> Pairs:
    """Return every pair of boxes at most ``cutoff`` [m] apart, of two groups or (i < j) of one."""
    return _listed(first, second, cutoff, _reaches(first, second, cutoff))


def few_close_pairs(first: Boxes, second: Boxes | None, cutoff: float, most: int) -> Pairs | None:
    """Return what ``close_pairs`` does, or None with more than ``most`` within the index's reach.

    They are counted first: a list of all pairs of thousands of boxes is what must not happen.
    """
    reaches = _reaches(first, second, cutoff)
    found = sum(int(a.tree.count_neighbors(b.tree, reach, p=np.inf)) for a, b, reach in reaches)
    return None if found > most else _listed(first, second, cutoff, reaches)


@dataclass(frozen=True, eq=False)
class _SizeClass:
    """Boxes of about one size: a few large ones must not widen the search for all."""

    members: Indices
    size: float
    tree: cKDTree


Reaches = list[tuple[_SizeClass, _SizeClass, float]]
"""Two classes, and how far apart the centres of two close boxes of theirs can be [m]."""


def _reaches(first: Boxes, second: Boxes | None, cutoff: float) -> Reaches:
    groups = _classes(first, cutoff)
    others = None if second is None else _classes(second, cutoff)
    both = (
        [*combinations_with_replacement(groups, 2)]
        if others is None
        else [*product(groups, others)]
    )
    return [(a, b, cutoff + a.size + b.size) for a, b in both]


def _listed(first: Boxes, second: Boxes | None, cutoff: float, reaches: Reaches) -> Pairs:
    found = []
    for a, b, reach in reaches:
        if second is None and a is b:
            i, j = a.tree.query_pairs(reach, p=np.inf, output_type="ndarray").T
        else:
            table = a.tree.sparse_distance_matrix(b.tree, reach, p=np.inf, output_type="ndarray")
            i, j = table["i"], table["j"]
        found.append((a.members[i], b.members[j]))
    i, j = (np.concatenate(each) for each in zip(*found, strict=True))
    if second is None:
        i, j = np.minimum(i, j), np.maximum(i, j)
    other = first if second is None else second
    gaps = np.maximum(first.lower[i] - other.upper[j], other.lower[j] - first.upper[i])
    near = np.sum(np.maximum(gaps, 0.0) ** 2, axis=-1) <= cutoff * cutoff
    return Pairs(i[near], j[near])


def _classes(boxes: Boxes, cutoff: float) -> list[_SizeClass]:
    from scipy.spatial import cKDTree

    sizes = boxes.sizes
    floor = max(1e-6 * float(np.max(sizes)), np.finfo(np.float64).tiny)
    unit = max(cutoff, float(np.median(sizes)), floor)
    rank = np.ceil(np.log2(np.maximum(sizes / unit, 1.0)))
    groups = [np.flatnonzero(rank == value) for value in np.unique(rank)]
    return [
        _SizeClass(members, float(np.max(sizes[members])), cKDTree(boxes.centres[members]))
        for members in groups
    ]
