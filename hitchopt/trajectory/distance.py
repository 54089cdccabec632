"""Distance of points and segments whose ends move along polynomials, bounded from below.

Two bodies are given by the *differences* of their ends, as in ``hitchopt.geometry.segments``. For
any vector of length at most one, its product with all the differences bounds the distance from
below, as all points of the bodies lie between their ends. Of a vector n of any length, distances
are at least the product over ``|n|``, which is at most ``(1 + |n|²) / 2``.

Here n is the quadratic through the directions of the shortest connections at both ends of a cell
and in its middle, which turns as they do: where all coefficients of the products are at least β
times those of ``(1 + |n|²) / 2``, no distance is smaller than β. Bodies that turn about each other
are bounded within the third power of a cell's length.
"""

from __future__ import annotations

import numpy as np

from hitchopt.geometry import shortest_offset
from hitchopt.geometry.vectors import length
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.extremum import Estimate
from hitchopt.values import Array

PLACES = np.array([0.0, 0.5, 1.0])
"""Places on a cell where shortest connections are taken."""

TIE = 1e-12
"""Share by which a distance in a cell's middle is smaller if it is: where bodies stand still, the
smallest one is the first."""


def distance_bound(blocks: tuple[Array, ...]) -> Estimate:
    """Bound the distance from below.

    Parameters
    ----------
    blocks: one, (cells, 3 · 1, 2 or 4, degree + 1): the differences' coordinates.
    """
    (rows,) = blocks
    rows = bernstein.elevate(rows, max(bernstein.degree(rows), 2))
    order = bernstein.degree(rows) + 2  # of the products
    differences = rows.reshape(len(rows), rows.shape[1] // 3, 3, order - 1)
    there = differences @ bernstein.basis(PLACES, order - 2).T
    offsets = shortest_offset(np.moveaxis(there, -1, 0))
    lengths = length(offsets)
    # Where bodies touch there is no direction: the vector is zero.
    units = offsets / np.where(lengths > 0.0, lengths, np.inf)[..., None]
    units[1] = 2.0 * units[1] - 0.5 * (units[0] + units[2])  # the quadratic's coefficient
    towards = np.matmul(units[:, :, None, None], differences)[..., 0, :]
    coefficients = np.zeros((*towards.shape[1:-1], order + 1))
    k = np.arange(order - 1)
    for j, factor in enumerate(
        ((order - k) * (order - k - 1), 2 * (k + 1) * (order - k - 1), (k + 1) * (k + 2))
    ):
        coefficients[..., j : order - 1 + j] += factor / (order * (order - 1)) * towards[j]
    squares = bernstein.elevate(bernstein.dot(*[np.moveaxis(units, 0, -1)] * 2), order)
    sizes = 0.5 + 0.5 * np.maximum(squares, 0.0)
    bound = np.maximum(np.min(np.min(coefficients, axis=-2) / sizes, axis=-1), 0.0)
    first, middle, last = lengths
    value, x = np.minimum(first, last), np.where(last < first, 1.0, 0.0)
    inside = middle < (1.0 - TIE) * value
    return Estimate(bound, np.where(inside, middle, value), np.where(inside, 0.5, x))
