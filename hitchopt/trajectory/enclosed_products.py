"""Sums and products of enclosed vectors and scalars, with bounds of their errors.

All are functions on [0, 1] with coefficients (…, d, degree + 1), d = 1 of a scalar; the radius
(…) bounds the Euclidean norm of the error.
"""

from __future__ import annotations

import numpy as np

from hitchopt.geometry.vectors import column_lengths
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.enclosure import Enclosure
from hitchopt.values import Array


def exact(coefficients: Array, radius: Array | float = 0.0) -> Enclosure:
    """Return polynomials (…, d, degree + 1) that err by no more than ``radius``."""
    return Enclosure(coefficients, np.broadcast_to(radius, coefficients.shape[:-2]))


def total(*parts: Enclosure) -> Enclosure:
    """Enclose the sum."""
    order = max(bernstein.degree(part.coefficients) for part in parts)
    elevated = [bernstein.elevate(part.coefficients, order) for part in parts]
    return Enclosure(np.sum(elevated, axis=0), np.sum([part.radius for part in parts], axis=0))


def scaled(vector: Enclosure, scalar: Enclosure) -> Enclosure:
    """Enclose a vector times a scalar."""
    product = bernstein.multiply(vector.coefficients, scalar.coefficients)
    return Enclosure(product, _error(vector, scalar))


def inner(a: Enclosure, b: Enclosure) -> Enclosure:
    """Enclose the scalar product."""
    product = bernstein.dot(a.coefficients, b.coefficients)[..., None, :]
    return Enclosure(product, _error(a, b))


def crossed(a: Enclosure, b: Enclosure) -> Enclosure:
    """Enclose the cross product."""
    x, y = a.coefficients, b.coefficients
    ahead, behind = [1, 2, 0], [2, 0, 1]
    product = bernstein.multiply(x[..., ahead, :], y[..., behind, :]) - bernstein.multiply(
        x[..., behind, :], y[..., ahead, :]
    )
    return Enclosure(product, _error(a, b))


def reduced(part: Enclosure, order: int) -> Enclosure:
    """Return the enclosure in degree ``order`` at most; what that loses goes to the radius."""
    c = part.coefficients
    if bernstein.degree(c) <= order:
        return part
    weights = bernstein.basis(bernstein.nodes(order), bernstein.degree(c))
    low = bernstein.interpolate(bernstein.combined(c, weights))
    lost = bernstein.elevate(low, bernstein.degree(c)) - c
    return Enclosure(low, part.radius + largest_norm(lost))


def largest_norm(coefficients: Array) -> Array:
    """Return a bound (…) of the norm of polynomials (…, d, degree + 1)."""
    largest: Array = np.max(column_lengths(coefficients), axis=-1)
    return largest


def _error(a: Enclosure, b: Enclosure) -> Array:
    """Return the error of a product that is no longer than the factors together.

    Nothing times a factor without a bound is nothing.
    """
    sizes = largest_norm(a.coefficients), largest_norm(b.coefficients)
    parts = ((sizes[0], b.radius), (sizes[1], a.radius), (a.radius, b.radius))
    error: Array = np.sum(
        [np.where((x == 0.0) | (y == 0.0), 0.0, x * np.where(x == 0.0, 0.0, y)) for x, y in parts],
        axis=0,
    )
    return error
