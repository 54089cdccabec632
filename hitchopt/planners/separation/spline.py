"""Curves on a common time grid: clamped B-splines that start and end at rest.

Continuity is built in (all derivatives but the last are continuous), so that programs need no rows
for it; the Bernstein coefficients of every piece are a fixed linear function of few coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline

from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

DEGREE = 5
"""Degree of the curves, with which jerk is continuous as well."""

HELD = 3
"""Number of coefficients at each end that hold position, zero velocity and acceleration."""


@dataclass(frozen=True, eq=False)
class Grid:
    """The span of time [0, 1] cut into pieces, and the splines on it.

    Attributes
    ----------
    breaks: (pieces + 1,) from 0 to 1.
    """

    breaks: Array

    @property
    def pieces(self) -> int:
        """Number of pieces."""
        return len(self.breaks) - 1

    @property
    def count(self) -> int:
        """Number of coefficients of a spline."""
        return self.pieces + DEGREE

    @property
    def free(self) -> slice:
        """The coefficients that the ends do not hold."""
        return slice(HELD, self.count - HELD)

    @cached_property
    def knots(self) -> Array:
        """(pieces + 2·DEGREE + 1,): every end as often as a clamped spline needs it."""
        ends = np.ones(DEGREE)
        return np.concatenate([0.0 * ends, self.breaks, ends])

    @cached_property
    def extraction(self) -> Array:
        """(pieces, DEGREE + 1, DEGREE + 1): maps a piece's coefficients to Bernstein ones.

        Piece m is shaped by the spline's coefficients m … m + DEGREE.
        """
        each = PiecewisePolynomial.from_spline(BSpline(self.knots, np.eye(self.count), DEGREE))
        index = np.arange(self.pieces)[:, None] + np.arange(DEGREE + 1)
        local: Array = np.take_along_axis(each.coefficients, index[..., None], axis=1)
        return np.swapaxes(local, 1, 2)

    def sampled(self, s: Array, derivative: int = 0) -> Array:
        """Return the basis functions, or a derivative of theirs, at ``s`` as (*s.shape, count)."""
        splines = BSpline(self.knots, np.eye(self.count), DEGREE)
        function = splines.derivative(derivative) if derivative else splines
        return function(np.clip(s, 0.0, 1.0))

    @cached_property
    def quadrature(self) -> tuple[Array, Array]:
        """Return samples (m,) and weights (m,) of an integral over [0, 1]: Gauss on each piece."""
        x, w = np.polynomial.legendre.leggauss(DEGREE + 1)  # exact for squares of splines
        h = np.diff(self.breaks)[:, None]
        s = self.breaks[:-1, None] + 0.5 * h * (x + 1.0)
        return s.ravel(), (0.5 * h * w).ravel()

    @cached_property
    def rates(self) -> tuple[Array, Array, Array]:
        """Matrices (count - k, count), k = 1, 2, 3, to coefficients of the k-th derivative.

        A derivative lies within the hull of its coefficients.
        """
        matrices = []
        matrix = np.eye(self.count)
        knots = self.knots
        for k in range(1, 4):
            order = DEGREE + 1 - k
            m = self.count - k
            widths = knots[k : k + m + order][order : order + m] - knots[k : k + m]
            matrix = order * np.diff(matrix, axis=0) / widths[:, None]
            matrices.append(matrix)
        return matrices[0], matrices[1], matrices[2]

    def pieces_of(self, coefficients: Array) -> Array:
        """Return Bernstein coefficients (pieces, N, 3, DEGREE + 1) of splines (N, count, 3)."""
        index = np.arange(self.pieces)[:, None] + np.arange(DEGREE + 1)
        local = coefficients[:, index]  # (N, pieces, DEGREE + 1, 3)
        pieces: Array = np.einsum("pbk,npkd->pndb", self.extraction, local, optimize=True)
        return pieces

    def curves(self, coefficients: Array, duration: float) -> PiecewisePolynomial:
        """Return the splines (N, count, 3) [m] flown in ``duration`` [s]."""
        return PiecewisePolynomial(duration * self.breaks, self.pieces_of(coefficients))
