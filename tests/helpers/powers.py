"""Bernstein polynomials in powers, from their definition."""

import math

import numpy as np
from numpy.polynomial import Polynomial


def in_powers(coefficients: np.ndarray) -> Polynomial:
    """Return the same polynomial: the sum of c_i C(m, i) x^i (1 - x)^(m - i)."""
    m, x = len(coefficients) - 1, Polynomial([0.0, 1.0])
    terms = (c * math.comb(m, i) * x**i * (1.0 - x) ** (m - i) for i, c in enumerate(coefficients))
    return sum(terms, Polynomial([0.0]))
