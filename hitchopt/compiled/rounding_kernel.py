"""Compiled margins of derivatives, of all orders that checks ask for at once."""

from __future__ import annotations

import numpy as np

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.values import Array


@kernel
def derivative_margins(
    c: Array, h: Array, orders: int, last_place: float, rounding: float
) -> Array:
    """Return (orders, pieces, items) what ``derivative_margin`` does of orders from 1 on.

    Parameters
    ----------
    c: coefficients (pieces, items, d, degree + 1).
    h: durations (pieces,) [s].
    last_place, rounding: as there.
    """
    pieces, items, axes, count = c.shape
    out, row = np.zeros((orders, pieces, items)), np.empty(count)
    for piece in range(pieces):
        for item in range(items):
            size, differences = np.zeros(orders), 0.0
            for axis in range(axes):
                row[:] = c[piece, item, axis]
                for order in range(min(orders, count - 1)):
                    for k in range(count - 1 - order):
                        row[k] = row[k + 1] - row[k]
                        size[order] = max(size[order], abs(row[k]))
                differences = max(differences, size[0])
            scale = 1.0
            for order in range(orders):
                scale *= max(0, count - 1 - order) / h[piece]
                noise = last_place * 2.0 ** (order + 1) * differences
                out[order, piece, item] = scale * (noise + rounding * size[order])
    return out
