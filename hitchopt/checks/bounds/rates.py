"""Largest norms of derivatives: what speed, acceleration, jerk and vertex_speed have in common."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.rounding_margins import derivative_margin
from hitchopt.checks.certificate import within
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.extremum import Cells, Estimate, Extremum, largest

Array = NDArray[np.float64]


def largest_rate(part: PiecewisePolynomial, order: int, limit: float = np.inf) -> Extremum:
    """Return the largest norm of a derivative by time of points ``part`` (items, 3).

    It is bounded as closely as it takes to tell whether it keeps the limit.
    A norm is convex, so it is largest at one of the Bernstein coefficients: nothing is squared.
    """
    derivative = part.differentiated(order)
    cells = Cells.over(part.breaks, [derivative.coefficients], derivative_margin(part, order))
    return largest(cells, norm_bound, within(limit, "max", 0.0, 0.5))


def norm_bound(blocks: tuple[Array, ...]) -> Estimate:
    """Bound the norm of vectors from above: one block (cells, d, degree + 1)."""
    (vectors,) = blocks
    norms = np.linalg.norm(vectors, axis=1)
    largest_of = np.argmax(norms, axis=-1)
    x = largest_of / max(1, bernstein.degree(vectors))
    value = np.linalg.norm(bernstein.evaluate(vectors, x[:, None]), axis=-1)
    return Estimate(np.max(norms, axis=-1), value, x)
