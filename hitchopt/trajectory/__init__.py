"""Floor 3: piecewise polynomials of time in Bernstein form. Knows no hitch."""

from hitchopt.trajectory.piecewise import PiecewisePolynomial, joined

__all__ = ["PiecewisePolynomial", "joined"]
