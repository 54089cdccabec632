"""Truncated Taylor series of casadi expressions by one parameter.

Derivatives up to the third by repeated differentiation make expressions several times longer than
the arithmetic of series does: a product of two series takes ten products of their coefficients.
"""

from __future__ import annotations

from collections.abc import Callable
from math import factorial

import casadi as ca

Bilinear = Callable[[ca.SX, ca.SX], ca.SX]


class Series:
    """Coefficients ``f^(k) / k!`` of a scalar or a vector.

    Parameters
    ----------
    coefficients: from order zero on; those of both operands of an operation are as many.
    """

    def __init__(self, coefficients: list[ca.SX]) -> None:
        self.coefficients = coefficients

    @classmethod
    def of_jet(cls, jet: ca.SX) -> Series:
        """Return the series of a jet (rows, order + 1), derivatives from order zero on."""
        return cls([jet[:, k] / factorial(k) for k in range(jet.size2())])

    @classmethod
    def constant(cls, value: ca.SX, like: Series) -> Series:
        """Return the series of what does not change, of as many coefficients as ``like``."""
        zero = ca.SX.zeros(value.sparsity())
        return cls([value, *(zero for _ in like.coefficients[1:])])

    @property
    def jet(self) -> ca.SX:
        """(rows, order + 1): value and derivatives."""
        return ca.horzcat(*(factorial(k) * c for k, c in enumerate(self.coefficients)))

    @property
    def value(self) -> ca.SX:
        """The value, of order zero."""
        return self.coefficients[0]

    def row(self, *rows: int) -> Series:
        """Return some rows of a vector."""
        return Series([c[list(rows)] for c in self.coefficients])

    def __add__(self, other: Series) -> Series:
        return Series([a + b for a, b in zip(self.coefficients, other.coefficients, strict=True)])

    def __sub__(self, other: Series) -> Series:
        return Series([a - b for a, b in zip(self.coefficients, other.coefficients, strict=True)])

    def __neg__(self) -> Series:
        return Series([-c for c in self.coefficients])

    def __mul__(self, other: Series) -> Series:
        return convolved(self, other, lambda a, b: a * b)

    def __truediv__(self, divisor: Series) -> Series:
        """Return the quotient by a scalar, from ``q · b = a``."""
        b, found = divisor.coefficients, list[ca.SX]()
        inverse = 1.0 / b[0]
        for k, a in enumerate(self.coefficients):
            known = sum((found[i] * b[k - i] for i in range(k)), ca.SX(0.0))
            found.append((a - known) * inverse)
        return Series(found)

    def __rmul__(self, factor: float) -> Series:
        return self.scaled(factor)

    def __rsub__(self, value: float) -> Series:
        return Series([value - self.value, *(-c for c in self.coefficients[1:])])

    def scaled(self, factor: ca.SX | float) -> Series:
        """Return the product with a constant scalar."""
        return Series([factor * c for c in self.coefficients])


def convolved(a: Series, b: Series, product: Bilinear) -> Series:
    """Return the series of a bilinear product, by Leibniz' rule."""
    x, y = a.coefficients, b.coefficients
    found = []
    for k in range(len(x)):
        terms = [product(x[i], y[k - i]) for i in range(k + 1)]
        found.append(sum(terms[1:], terms[0]))
    return Series(found)


def dot(a: Series, b: Series) -> Series:
    """Return the scalar product of vectors."""
    return convolved(a, b, ca.dot)


def cross(a: Series, b: Series) -> Series:
    """Return the vector product."""
    return convolved(a, b, ca.cross)


def square_root(a: Series) -> Series:
    """Return the root of a positive scalar: from ``r · r = a``."""
    found = [ca.sqrt(a.value)]
    inverse = 0.5 / found[0]
    for k, c in enumerate(a.coefficients[1:], start=1):
        known = sum((found[i] * found[k - i] for i in range(1, k)), ca.SX(0.0))
        found.append((c - known) * inverse)
    return Series(found)


def unit(a: Series) -> Series:
    """Return the direction of a vector."""
    return a / square_root(dot(a, a))


def cosine_and_sine(angle: Series) -> tuple[Series, Series]:
    """Return cosine and sine of an angle, from ``c' = -s ψ'`` and ``s' = c ψ'``."""
    psi = angle.coefficients
    c, s = [ca.cos(psi[0])], [ca.sin(psi[0])]
    for k in range(1, len(psi)):
        c.append(-sum((i * psi[i] * s[k - i] for i in range(1, k + 1)), ca.SX(0.0)) / k)
        s.append(sum((i * psi[i] * c[k - i] for i in range(1, k + 1)), ca.SX(0.0)) / k)
    return Series(c), Series(s)
