"""Compiled arithmetic of Taylor coefficients: derivatives over factorials.

Products are short sums of them.
"""

from __future__ import annotations

import numpy as np

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.values import Array

JET = 4
"""Number of derivatives, the zeroth included."""

Jet = tuple[float, float, float, float]
"""Taylor coefficients."""

FACTORIALS = np.array([1.0, 1.0, 2.0, 6.0])
"""What coefficients are multiplied by to be derivatives."""


@kernel
def times(a: Jet, b: Jet) -> Jet:
    """Return a product."""
    return (
        a[0] * b[0],
        a[0] * b[1] + a[1] * b[0],
        a[0] * b[2] + a[1] * b[1] + a[2] * b[0],
        a[0] * b[3] + a[1] * b[2] + a[2] * b[1] + a[3] * b[0],
    )


@kernel
def minus(a: Jet, b: Jet) -> Jet:
    """Return a difference."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3]


@kernel
def plus(a: Jet, b: Jet) -> Jet:
    """Return a sum."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]


@kernel
def square_root(a: Jet) -> Jet:
    """Return a square root; nan where there is none."""
    first = np.sqrt(a[0])
    second = a[1] / (2.0 * first)
    third = (a[2] - second * second) / (2.0 * first)
    return first, second, third, (a[3] - 2.0 * second * third) / (2.0 * first)


@kernel
def over(a: Jet, b: Jet) -> Jet:
    """Return a quotient; nan where there is none."""
    first = a[0] / b[0]
    second = (a[1] - first * b[1]) / b[0]
    third = (a[2] - first * b[2] - second * b[1]) / b[0]
    return first, second, third, (a[3] - first * b[3] - second * b[2] - third * b[1]) / b[0]


@kernel
def jet(row: Array) -> Jet:
    """Return a jet of an array."""
    return row[0], row[1], row[2], row[3]


@kernel
def edge(points: Array, first: int, last: int) -> tuple[Jet, Jet, Jet, Jet]:
    """Return the vector from one point to another, and its length."""
    x = minus(jet(points[last, 0]), jet(points[first, 0]))
    y = minus(jet(points[last, 1]), jet(points[first, 1]))
    z = minus(jet(points[last, 2]), jet(points[first, 2]))
    return x, y, z, square_root(plus(plus(times(x, x), times(y, y)), times(z, z)))
