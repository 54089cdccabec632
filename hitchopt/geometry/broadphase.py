"""Close pairs of many axis-aligned boxes, by a spatial index; one axis may be time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.values import Array, Indices

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True, eq=False)
class Boxes:
    """Axis-aligned boxes with corners (boxes, d) [m]."""

    lower: Array
    upper: Array

    def __len__(self) -> int:
        return len(self.lower)

    @property
    def sizes(self) -> Array:
        """(boxes,) [m]: half of the longest sides."""
        longest: Array = 0.5 * np.max(self.upper - self.lower, axis=-1, initial=0.0)
        return longest


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of bodies: indices (pairs,) into a first and a second group."""

    first: Indices
    second: Indices

    def __len__(self) -> int:
        return len(self.first)

    def take(self, index: Indices | NDArray[np.bool_] | slice) -> Pairs:
        """Return the chosen pairs."""
        return Pairs(self.first[index], self.second[index])


def close_pairs(first: Boxes, second: Boxes | None, cutoff: float) -> Pairs:
    """Return the pairs of boxes within ``cutoff`` [m], of two groups or (i < j) of one."""
    return _close_pairs(first, second, cutoff, _candidates(first, second, cutoff))


def few_close_pairs(
    first: Boxes, second: Boxes | None, cutoff: float, limit: float
) -> Pairs | None:
    """Return ``close_pairs``, or None if the index finds more than ``limit`` candidates.

    Candidates are counted first: a list of all pairs of thousands of boxes could fill the memory.
    """
    candidates = _candidates(first, second, cutoff)
    if limit < np.inf:
        counts = (a.tree.count_neighbors(b.tree, reach, p=np.inf) for a, b, reach in candidates)
        if sum(map(int, counts)) > limit:
            return None
    return _close_pairs(first, second, cutoff, candidates)


def _candidates(first: Boxes, second: Boxes | None, cutoff: float) -> list[_Candidates]:
    """Return pairs of size classes, and the largest distance of the centres of close boxes."""
    groups = _by_size(first, cutoff)
    if second is None:
        pairs = [*combinations_with_replacement(groups, 2)]
    else:
        pairs = [*product(groups, _by_size(second, cutoff))]
    return [(a, b, cutoff + a.size + b.size) for a, b in pairs]


def _close_pairs(
    first: Boxes, second: Boxes | None, cutoff: float, candidates: Sequence[_Candidates]
) -> Pairs:
    """Return the pairs of boxes within ``cutoff`` [m] among those of close centres."""
    other, rows = first if second is None else second, []
    for a, b, reach in candidates:
        if a is b:
            i, j = a.tree.query_pairs(reach, p=np.inf, output_type="ndarray").T
        else:
            table = a.tree.sparse_distance_matrix(b.tree, reach, p=np.inf, output_type="ndarray")
            i, j = table["i"], table["j"]
        rows.append((a.members[i], b.members[j]))
    i, j = (np.concatenate(each) for each in zip(*rows, strict=True))
    if second is None:
        i, j = np.minimum(i, j), np.maximum(i, j)
    gaps = np.maximum(first.lower[i] - other.upper[j], other.lower[j] - first.upper[i])
    is_close = np.sum(np.maximum(gaps, 0.0) ** 2, axis=-1) <= cutoff * cutoff
    return Pairs(i[is_close], j[is_close])


class _SizeClass(NamedTuple):
    """Boxes of similar sizes and their largest size: large boxes do not widen other searches."""

    members: Indices
    size: float
    tree: cKDTree


_Candidates = tuple[_SizeClass, _SizeClass, float]


def _by_size(boxes: Boxes, cutoff: float) -> list[_SizeClass]:
    """Return the boxes grouped by size, in powers of two."""
    from scipy.spatial import cKDTree

    sizes, centres = boxes.sizes, 0.5 * (boxes.lower + boxes.upper)
    unit = max(cutoff, float(np.median(sizes)), 1e-6 * float(np.max(sizes)), TINY)
    rank = np.ceil(np.log2(np.maximum(sizes / unit, 1.0)))
    groups = [np.flatnonzero(rank == value) for value in np.unique(rank)]
    return [_SizeClass(each, float(np.max(sizes[each])), cKDTree(centres[each])) for each in groups]
