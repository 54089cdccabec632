"""Compiled derivatives of piecewise polynomials, of all orders that checks ask for at once."""

from __future__ import annotations

import numpy as np

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.values import Array


@kernel
def _slope(c: Array, h: Array) -> Array:
    """Return the derivative of polynomials (pieces, values, degree + 1); zero of constants."""
    order = c.shape[2] - 1
    out = np.zeros((c.shape[0], c.shape[1], max(order, 1)))
    for piece in range(len(c)):
        for i in range(c.shape[1]):
            for k in range(order):
                out[piece, i, k] = (c[piece, i, k + 1] - c[piece, i, k]) * order / h[piece]
    return out


@kernel
def slopes(c: Array, h: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Return the derivatives by time of orders 1 to 5.

    Parameters
    ----------
    c: coefficients (pieces, values, degree + 1).
    h: durations (pieces,) [s].
    """
    first = _slope(c, h)
    second = _slope(first, h)
    third = _slope(second, h)
    fourth = _slope(third, h)
    return first, second, third, fourth, _slope(fourth, h)
