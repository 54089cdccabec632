"""Compiled values of a plan's derivatives on a grid, and bounds between, for ``DerivativeGrid``."""

from __future__ import annotations

import numpy as np

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.values import Array, Indices


@kernel
def grid_values(c: Array, pieces: Indices, x: Array) -> Array:
    """Return (nodes, drones, 3): polynomials (pieces, drones, 3, m) at x (nodes,) of pieces."""
    count, drones, m = len(x), c.shape[1], c.shape[3]
    out, weights = np.zeros((count, drones, 3)), np.empty(m)
    for i in range(count):
        weights[0] = 1.0
        for order in range(1, m):  # one degree higher each time
            weights[order] = weights[order - 1] * x[i]
            for k in range(order - 1, 0, -1):
                weights[k] = weights[k] * (1.0 - x[i]) + weights[k - 1] * x[i]
            weights[0] *= 1.0 - x[i]
        for drone in range(drones):
            for axis in range(3):
                total, row = 0.0, c[pieces[i], drone, axis]
                for k in range(m):
                    total += weights[k] * row[k]
                out[i, drone, axis] = total
    return out


@kernel
def _size(v: Array) -> float:
    return np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


@kernel
def grid_sizes(
    values: tuple[Array, Array, Array],
    left: Indices,
    piece: Indices,
    width: Array,
    margins: Array,
) -> Array:
    """Return (3, cells, drones), bounds of the norms of three derivatives, as ``_bounded``.

    Parameters
    ----------
    values: (nodes, drones, 3) each, the derivatives.
    left: (cells,), the nodes at which cells begin.
    piece: (cells,) in which each lies.
    width: (cells,) [s]
    margins: (5, pieces, drones), of the three, and bounds of the fourth and fifth.
    """
    drones = values[0].shape[1]
    out = np.empty((3, len(left), drones))
    for cell in range(len(left)):
        node, p, bend = left[cell], piece[cell], width[cell] ** 2 / 8.0
        for drone in range(drones):
            V, A, J = (
                max(_size(values[0][node, drone]), _size(values[0][node + 1, drone])),
                max(_size(values[1][node, drone]), _size(values[1][node + 1, drone])),
                max(_size(values[2][node, drone]), _size(values[2][node + 1, drone])),
            )
            J += bend * margins[4, p, drone] + margins[2, p, drone]
            A += bend * margins[3, p, drone] + margins[1, p, drone]
            out[0, cell, drone] = V + bend * J + margins[0, p, drone]
            out[1, cell, drone], out[2, cell, drone] = A, J
    return out
