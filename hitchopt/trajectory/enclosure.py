"""Norms and directions of polynomial vectors, as polynomials with a bounded error.

Neither is a polynomial. A low interpolant w of 1/|y| is, and the coefficients of |y|² w² - 1
bound how wrong it is everywhere: no sampling, whatever w came from. Likewise for |y| itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.geometry.vectors import column_lengths
from hitchopt.trajectory import bernstein
from hitchopt.values import Array

DIRECTION_ORDER = 4
"""Degree of w: on the cells that matter |y| varies by per cents, and w then errs by 1e-9."""

NORM_ORDER = 6
"""Degree of the interpolant of |y|, which enters no product and so may be higher."""

ROUNDING = 2.0**-46
"""Rounding in a residual's coefficients, relative to the products that it is summed from."""


@dataclass(frozen=True, eq=False)
class Enclosure:
    """Functions on [0, 1] known up to an error.

    Attributes
    ----------
    coefficients: Bernstein coefficients of their approximations (…, degree + 1).
    radius: what bounds the (Euclidean) error everywhere; nan or inf never occur.
    """

    coefficients: Array
    radius: Array


def direction(vectors: Array, noise: float = 0.0) -> Enclosure:
    """Enclose y / |y|.

    Where the residual says nothing (y is zero or nearly so somewhere), the zero vector with
    radius 1 stands for every direction.

    Parameters
    ----------
    vectors: (…, 3, degree + 1), coefficients of y.
    noise: by how much y itself may be off, in its unit.

    Returns
    -------
    Coefficients (…, 3, degree + 1 + DIRECTION_ORDER) and radius (…).
    """
    y, scale = _scaled(vectors)
    w, error = _inverse_lengths(y, scale, noise)
    unit = bernstein.multiply(y, w[..., None, :])
    return Enclosure(unit, error)


def inverse_norm(vectors: Array, noise: Array | float = 0.0) -> Enclosure:
    """Enclose 1 / |y|; the radius is infinite where y may be zero.

    Parameters
    ----------
    vectors: (…, 3, degree + 1), coefficients of y.
    noise: (…), by how much y itself may be off, in its unit.

    Returns
    -------
    Coefficients (…, 1, DIRECTION_ORDER + 1) and radius (…).
    """
    y, scale = _scaled(vectors)
    w, error = _inverse_lengths(y, scale, noise)
    # | w - 1/|y| | = | |y| w - 1 | / |y|, and 1/|y| <= max w / (1 - error).
    size = np.max(np.abs(w), axis=-1)
    known = error < 1.0
    left = np.where(known, 1.0 - error, 1.0)
    safe = np.where(scale > 0.0, scale, 1.0)
    radius = np.where(known, error * size / left / safe, np.inf)
    return Enclosure((w / safe[..., None])[..., None, :], radius)


def _inverse_lengths(y: Array, scale: Array, noise: Array | float) -> tuple[Array, Array]:
    """Return w (…, DIRECTION_ORDER + 1) and a bound (…) of ``| |y| w - 1 |``; 0 and 1 if none."""
    lengths = _lengths(y, DIRECTION_ORDER)
    known = np.min(lengths, axis=-1) > 0.0
    if not np.all(known):
        lengths = np.where(known[..., None], lengths, 1.0)
    w = bernstein.interpolate(1.0 / lengths)
    product = bernstein.multiply(bernstein.dot(y, y), bernstein.multiply(w, w))
    size = np.max(np.abs(w), axis=-1)
    residual = np.max(np.abs(product - 1.0), axis=-1) + ROUNDING * (1.0 + size * size)
    known &= residual < 1.0
    # | |y| w - 1 | = | |y|² w² - 1 | / (|y| w + 1), and |y| w >= sqrt(1 - residual).
    least = np.sqrt(np.where(known, 1.0 - residual, 1.0))
    error = residual / (1.0 + least)
    error = error + 2.0 * noise / np.where(scale > 0.0, scale, 1.0) * size / least
    known &= (scale > 0.0) & (error < 1.0)
    if np.all(known):
        return w, error
    return np.where(known[..., None], w, 0.0), np.where(known, error, 1.0)


def norm(vectors: Array) -> Enclosure:
    """Enclose |y|.

    Parameters
    ----------
    vectors: (…, 3, degree + 1), coefficients of y.

    Returns
    -------
    Coefficients (…, NORM_ORDER + 1) and radius (…), in the unit of y.
    """
    y, scale = _scaled(vectors)
    v = bernstein.interpolate(_lengths(y, NORM_ORDER))
    squared = bernstein.dot(y, y)
    order = max(bernstein.degree(squared), 2 * NORM_ORDER)
    residual = bernstein.elevate(squared, order) - bernstein.elevate(
        bernstein.multiply(v, v), order
    )
    # | |y| - v | = | |y|² - v² | / (|y| + v); where v may vanish, 0 <= |y| <= |coefficients|.
    least = np.min(v, axis=-1)
    known = least > 0.0
    error = (np.max(np.abs(residual), axis=-1) + ROUNDING) / np.where(known, least, 1.0)
    largest = np.max(column_lengths(y), axis=-1) * (1.0 + ROUNDING)
    v = np.where(known[..., None], v, 0.5 * largest[..., None])
    error = np.where(known, error, 0.5 * largest)
    return Enclosure(v * scale[..., None], error * scale)


def _scaled(vectors: Array) -> tuple[Array, Array]:
    """Return vectors whose largest coefficient is one, and by what they were divided."""
    scale = np.max(np.abs(vectors), axis=(-2, -1))
    safe = np.where(scale > 0.0, scale, 1.0)
    return vectors / safe[..., None, None], scale


def _lengths(y: Array, order: int) -> Array:
    """Return |y| at the nodes that ``bernstein.interpolate`` takes values at, (…, order + 1)."""
    weights = bernstein.basis(bernstein.nodes(order), bernstein.degree(y))
    return column_lengths(bernstein.combined(y, weights))
