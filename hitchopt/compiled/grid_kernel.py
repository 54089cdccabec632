"""Compiled values of a plan's derivatives on a grid, and bounds between, for ``DerivativeGrid``."""

from __future__ import annotations

import numpy as np

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.compiled.polynomial_kernels import basis_at
from hitchopt.values import Array, Indices


@kernel
def grid_values(c: Array, pieces: Indices, x: Array) -> Array:
    """Return (nodes, drones, 3): polynomials (pieces, drones, 3, m) at x (nodes,) of pieces.

    Pieces are in order.
    """
    columns, m, last = c.shape[1] * 3, c.shape[3], -1
    out, turned = np.zeros((len(x), columns)), np.empty((m, columns))
    for i in range(len(x)):
        if pieces[i] != last:
            last = pieces[i]
            turned[:] = c[last].reshape(columns, m).T
        weights, row = basis_at(m - 1, x[i]), out[i]
        for k in range(m):
            w, onward = weights[k], turned[k]
            for j in range(columns):
                row[j] += w * onward[j]
    return out.reshape(len(x), c.shape[1], 3)


@kernel
def _size(v: Array) -> float:
    return float(np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]))


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
