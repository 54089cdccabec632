"""Which boxes come near each other: the spatial index under all pairs that matter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Pairs = NDArray[np.intp]


def nearby_boxes(lower: Array, upper: Array, cutoff: float) -> Pairs:
    """Return all pairs of boxes whose distance is at most ``cutoff``.

    A k-d tree over the centres finds the candidates within reach of the largest boxes, so the
    cost is that of the output as long as the boxes are of similar size.

    Parameters
    ----------
    lower, upper: (m, d) [m], opposite corners.
    cutoff: [m]

    Returns
    -------
    (pairs, 2), the first index below the second, in lexicographic order.
    """
    centres, halves = 0.5 * (lower + upper), 0.5 * (upper - lower)
    reach = 2.0 * float(np.max(np.linalg.norm(halves, axis=1), initial=0.0)) + cutoff
    pairs = cKDTree(centres).query_pairs(reach * (1.0 + 1e-9), output_type="ndarray")
    i, j = np.sort(pairs, axis=1).T
    gap = np.abs(centres[i] - centres[j]) - halves[i] - halves[j]
    near = np.linalg.norm(np.maximum(gap, 0.0), axis=1) <= cutoff * (1.0 + 1e-9)
    i, j = i[near], j[near]
    order = np.lexsort((j, i))
    return np.column_stack([i[order], j[order]])
