"""Splines as piecewise polynomials: from B-spline coefficients, or through given values.

Reference: C. de Boor, "A Practical Guide to Splines", Springer, 1978.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hitchopt.trajectory import bernstein
from hitchopt.trajectory.piecewise import PiecewisePolynomial
from hitchopt.values import Array, Indices

ENDS = np.array([0.0, 1.0])  # Local parameters of a piece's ends


def _local(knots: Array, degree: int, span: Indices, x: Array) -> Array:
    """Return the B-splines (degree + 1, m) that do not vanish on spans (m,), at x (m,) in them.

    Those on the span from knot i to knot i + 1 are numbers i - degree … i.
    """
    near = knots[span + np.arange(1 - degree, degree + 1)[:, None]]
    after, before = near[degree:] - x, x - near[:degree]
    values = np.ones((1, len(x)))
    for k in range(1, degree + 1):
        weights = values / (after[:k] + before[degree - k :])
        values = np.empty((k + 1, len(x)))
        values[1:] = before[degree - k :] * weights
        values[0] = 0.0
        values[:-1] += after[:k] * weights
    return values


def extraction(knots: Array, degree: int) -> tuple[Array, Indices, Array]:
    """Return breaks, and the maps from B-spline to Bernstein coefficients on every piece.

    Parameters
    ----------
    knots: (count + degree + 1,), not decreasing, for ``count`` B-splines.

    Returns
    -------
    breaks: (pieces + 1,), the distinct knots between which the basis is complete.
    columns: (pieces, degree + 1), indices of the B-splines on each piece.
    maps: (pieces, degree + 1, degree + 1)
    """
    last = len(knots) - degree - 1
    (span,) = (knots[degree + 1 : last + 1] > knots[degree:last]).nonzero()
    span += degree
    breaks = knots[np.append(span, last)]
    x = breaks[:-1] + (breaks[1:] - breaks[:-1]) * bernstein.nodes(degree)[:, None]
    values = _local(knots, degree, np.tile(span, degree + 1), x.ravel())
    # (degree + 1 B-splines, degree + 1 nodes, pieces), interpolated at the nodes of each piece
    values = values.reshape(degree + 1, degree + 1, -1).transpose(2, 0, 1)
    columns = span[:, None] + np.arange(-degree, 1)
    return breaks, columns, bernstein.interpolate(values).transpose(0, 2, 1)


def bspline(knots: Array, coefficients: Array, degree: int) -> PiecewisePolynomial:
    """Return the spline with B-spline coefficients (count, *shape)."""
    return _spline(extraction(knots, degree), coefficients)


def _spline(basis: tuple[Array, Indices, Array], coefficients: Array) -> PiecewisePolynomial:
    breaks, columns, maps = basis
    local = coefficients.reshape(len(coefficients), -1)[columns]
    shape = (len(columns), *coefficients.shape[1:], -1)
    return PiecewisePolynomial(breaks, (maps @ local).transpose(0, 2, 1).reshape(shape))


def knots_through(s: Array, degree: int, zero_orders: tuple[int, ...] = ()) -> Array:
    """Return the knots of the spline through values at s (J,); see ``interpolated``."""
    inner = 1 if zero_orders else (degree + 1) // 2
    first, last = [s[0]] * (degree + 1), [s[-1]] * (degree + 1)
    return np.concatenate([first, s[inner : len(s) - inner], last])


def interpolated(
    s: Array, values: Array, degree: int = 5, zero_orders: tuple[int, ...] = ()
) -> PiecewisePolynomial:
    """Return the spline of odd degree through values (J, *shape) at increasing s (J,).

    Parameters
    ----------
    zero_orders: orders of the (degree - 1) / 2 derivatives that vanish at both ends: for quintics
        (1, 2) at rest, (2, 3) straight, (3, 4) for a natural spline. Without them the highest
        derivative is continuous at as many of the inner points next to each end.
    """
    from scipy.linalg.lapack import dgbsv

    knots = knots_through(s, degree, zero_orders)
    basis = breaks, columns, maps = extraction(knots, degree)
    piece = np.searchsorted(breaks[1:-1], s, side="right")
    columns, count = columns[piece], len(zero_orders)
    rows, right = _local(knots, degree, columns[:, -1], s).T, values.reshape(len(s), -1)
    if count:
        slopes = [bernstein.derivative_basis(ENDS, degree, order) for order in zero_orders]
        before, after = np.stack(slopes, axis=1)
        zero = np.zeros((count, right.shape[1]))
        rows = np.concatenate([before @ maps[0], rows, after @ maps[-1]])
        columns = columns[[0] * count + list(range(len(s))) + [-1] * count]
        right = np.concatenate([zero, right, zero])
    # Entry (r, c) is in row 2 degree + r - c of LAPACK's bands.
    bands = np.zeros((3 * degree + 1, len(rows)))
    bands[2 * degree + np.arange(len(rows))[:, None] - columns, columns] = rows
    coefficients = dgbsv(degree, degree, bands, right)[2]
    return _spline(basis, coefficients.reshape(-1, *values.shape[1:]))


@lru_cache(maxsize=64)
def _even_basis(count: int, degree: int) -> PiecewisePolynomial:
    """Return the splines (count,) through 1 at one of ``count`` even points, 0 at the others."""
    return interpolated(np.linspace(0.0, 1.0, count), np.eye(count), degree)


def evenly_interpolated(values: Array, degree: int = 5) -> PiecewisePolynomial:
    """Return the spline of ``interpolated`` through values (J, *shape) at even s from 0 to 1."""
    basis = _even_basis(len(values), degree)
    maps = basis.coefficients.swapaxes(1, 2)
    coefficients = (maps @ values.reshape(len(values), -1)).swapaxes(1, 2)
    return basis.replaced(coefficients.reshape(basis.pieces, *values.shape[1:], -1))
