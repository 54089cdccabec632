"""Piecewise polynomials of time in Bernstein form, for any quantity."""

from hitchopt.freed_memory import keep_freed_memory
from hitchopt.trajectory.piecewise import PiecewisePolynomial as PiecewisePolynomial
from hitchopt.trajectory.piecewise import joined as joined

keep_freed_memory()
