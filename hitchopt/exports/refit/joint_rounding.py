"""Control points rounded together, so that their errors cancel in velocity and acceleration.

A control point rounded on its own is off by half a quantum, its neighbour by as much in the
opposite direction: over a piece of degree N and h seconds that is up to ``N / h`` quanta a second
of velocity. So each is rounded with the errors of those before it in mind: among the remaining real
coefficients the ones that make up best for them are found by least squares (Babai's nearest plane),
in a norm of the errors of position, velocity and acceleration over the piece.
"""

from __future__ import annotations

import numpy as np

from hitchopt.exports.refit.pieces import Scale
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array


def rounded(curves: PiecewisePolynomial, quantum: float, scale: Scale) -> PiecewisePolynomial:
    """Return the curves (D, 3) with all coefficients multiples of ``quantum``, joined exactly.

    Parameters
    ----------
    curves: whose pieces meet at their ends.
    quantum: [m]
    scale: errors that weigh alike.
    """
    wanted = curves.coefficients / quantum
    found = np.empty_like(wanted)
    last = np.rint(wanted[0, ..., 0])
    for piece, h in enumerate(curves.durations):
        found[piece] = _nearest(wanted[piece], last, _gram(curves.degree, float(h), scale))
        last = found[piece, ..., -1]
    return PiecewisePolynomial(curves.breaks, found * quantum)


def _nearest(wanted: Array, first: Array, gram: Array) -> Array:
    """Return integers (…, N + 1) near to ``wanted`` in the norm, the first of them given."""
    # With G = L Lᵀ the error's norm is |Lᵀ e|: row i of Lᵀ holds e_i and those after it. The last
    # coefficient to be chosen is thus the first one of the basis, so the order is turned round.
    factor = np.linalg.cholesky(gram[::-1, ::-1]).T
    c = wanted[..., ::-1]
    size = c.shape[-1]
    errors = np.zeros_like(c)
    found = np.empty_like(c)
    for i in range(size - 1, -1, -1):
        aim = c[..., i] - errors[..., i + 1 :] @ factor[i, i + 1 :] / factor[i, i]
        found[..., i] = first if i == size - 1 else np.rint(aim)
        errors[..., i] = found[..., i] - c[..., i]
    return found[..., ::-1]


def _gram(degree: int, h: float, scale: Scale) -> Array:
    """Return the basis's Gram matrix (N + 1, N + 1) for errors over a piece of ``h`` seconds."""
    nodes, weights = np.polynomial.legendre.leggauss(degree + 1)
    x = 0.5 * (nodes + 1.0)
    gram = np.zeros((degree + 1, degree + 1))
    for order, size in enumerate(scale):
        values = bernstein.derivative_basis(x, degree, order) / (size * h**order)
        gram += values.T @ (0.5 * weights[:, None] * values)
    return gram
