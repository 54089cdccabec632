"""Piecewise polynomials of time in Bernstein form, for any quantity."""

from hitchopt.trajectory.piecewise import PiecewisePolynomial, joined

__all__ = ["PiecewisePolynomial", "joined"]
