"""Piecewise polynomials of time in Bernstein form, for any quantity."""

from hitchopt.trajectory.piecewise import PiecewisePolynomial as PiecewisePolynomial
from hitchopt.trajectory.piecewise import joined as joined
