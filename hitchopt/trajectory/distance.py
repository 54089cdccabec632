"""Distance of points and segments whose ends move along polynomials, bounded from below.

Two bodies are given by the *differences* of their ends, as in ``hitchopt.geometry.segments``. For
any vector of length at most one, its product with all the differences bounds the distance from
below, as all points of the bodies lie between their ends. Taken along the shortest connections at
both ends of a cell, the bound comes closer with the square of the cell's length.
"""

from __future__ import annotations

import numpy as np

from hitchopt.geometry import shortest_offset
from hitchopt.geometry.vectors import length
from hitchopt.trajectory.extremum import Estimate
from hitchopt.values import Array


def distance_bound(blocks: tuple[Array, ...]) -> Estimate:
    """Bound the distance from below.

    Parameters
    ----------
    blocks: one, (cells, 3 · 1, 2 or 4, degree + 1): the differences' coordinates.
    """
    (rows,) = blocks
    degree = rows.shape[-1] - 1
    differences = rows.reshape(len(rows), rows.shape[1] // 3, 3, degree + 1)
    offsets = shortest_offset(differences[..., [0, -1]].transpose(3, 0, 1, 2))  # at both ends
    lengths = length(offsets)
    # A vector that turns with time, from one end's shortest connection to the other end's:
    # the product with a polynomial is one degree higher. Where bodies touch it is zero.
    units = offsets / np.where(lengths > 0.0, lengths, np.inf)[..., None]
    towards_first, towards_last = np.matmul(units[:, :, None, None], differences)[..., 0, :]
    weight = np.arange(degree + 2) / (degree + 1)
    coefficients = np.zeros((*towards_first.shape[:-1], degree + 2))
    coefficients[..., :-1] = (1.0 - weight[:-1]) * towards_first
    coefficients[..., 1:] += weight[1:] * towards_last
    bound = np.maximum(np.min(coefficients, axis=(-2, -1)), 0.0)
    x = np.argmin(lengths, axis=0)
    return Estimate(bound, np.min(lengths, axis=0), x.astype(np.float64))
