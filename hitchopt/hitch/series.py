"""Truncated Taylor series in one parameter, over numpy arrays; of order zero, also over casadi.

Arrays of coefficients have shapes (count, rows, …): rows are the components of a vector, one for a
scalar. A constant has a single coefficient; all others in a formula have equally many.
"""

from __future__ import annotations

from math import factorial
from typing import Any

import numpy as np

from hitchopt.values import Array, Indices

ORDER = 3  # Order of the highest derivative in jets: the jerk
JET = ORDER + 1  # Number of columns of a jet

UP = [0.0, 0.0, 1.0]

FACTORIALS = np.array([float(factorial(k)) for k in range(JET)])


class Series:
    """Coefficients ``f^(k) / k!`` of a scalar or a vector."""

    __array_ufunc__ = None  # numpy arrays defer sums and products to this class

    def __init__(self, coefficients: Any) -> None:
        self.coefficients = coefficients

    @classmethod
    def of_vectors(cls, vectors: Array) -> Series:
        """Return the constant of vectors (…, rows)."""
        return cls(vectors.transpose(-1, *range(vectors.ndim - 1))[None])

    @classmethod
    def of_jet(cls, jet: Array) -> Series:
        """Return the series, with rows (rows, …), of jets (…, rows, count) of derivatives."""
        columns = jet.transpose(-1, -2, *range(jet.ndim - 2))
        scale = FACTORIALS[: jet.shape[-1]].reshape(-1, *(1,) * (jet.ndim - 1))
        return cls(np.divide(columns, scale, order="C"))

    def constant(self, value: Any) -> Series:
        """Return a constant whose rows (rows, …) broadcast against those of this series."""
        c = self.coefficients
        return Series(np.array(value, ndmin=c.ndim) if _is_array(c) else value)

    @property
    def jet(self) -> Array:
        """(…, rows, count): value and derivatives of a series over arrays."""
        c = self.coefficients
        jet: Array = np.multiply(
            c.transpose(*range(2, c.ndim), 1, 0), FACTORIALS[: len(c)], order="C"
        )
        return jet

    @property
    def value(self) -> Any:
        """The coefficient of order zero."""
        return self.coefficients[0] if _is_array(self.coefficients) else self.coefficients

    def row(self, *rows: int) -> Series:
        """Return the rows of a vector at some indices."""
        c, index = self.coefficients, list(rows)
        return Series(c[:, index] if _is_array(c) else c[index])

    def select(self, index: Indices) -> Series:
        """Return the items at some indices of the last axis of arrays."""
        return Series(self.coefficients[..., index])

    @property
    def upward(self) -> Series:
        """A vector along z whose z component is this scalar."""
        c = self.coefficients
        return Series(c * (np.array(UP).reshape(-1, *[1] * (c.ndim - 2)) if _is_array(c) else UP))

    def __add__(self, other: Series) -> Series:
        a, b = self.coefficients, other.coefficients
        if _is_array(a) and len(a) != len(b):
            a, b = (a, b) if len(a) > len(b) else (b, a)
            total = a.copy()
            total[: len(b)] += b
            return Series(total)
        return Series(a + b)

    def __sub__(self, other: Series) -> Series:
        a, b = self.coefficients, other.coefficients
        return self + -other if _is_array(a) and len(a) != len(b) else Series(a - b)

    def __neg__(self) -> Series:
        return Series(-self.coefficients)

    def __mul__(self, other: Series | float) -> Series:
        """Return the product of components, by Leibniz' rule; scalars multiply all of a vector."""
        if not isinstance(other, Series):
            return Series(other * self.coefficients)
        a, b = self.coefficients, other.coefficients
        if not _is_array(a) or len(b) == 1:
            return Series(a * b)
        a, b = (a, b) if len(a) <= len(b) else (b, a)
        product = a[0] * b
        for k in range(1, len(a)):
            product[k:] += a[k] * b[:-k]
        return Series(product)

    __rmul__ = __mul__

    def __truediv__(self, divisor: Series) -> Series:
        """Return the quotient q by a scalar b, from ``q · b = a``."""
        a, b = self.coefficients, divisor.coefficients
        if not _is_array(a) or len(b) == 1:
            return Series(a * (1.0 / b))
        inverse, quotient = 1.0 / b[0], np.zeros(np.broadcast_shapes(a[:1].shape, b.shape))
        quotient[: len(a)] = a
        for k in range(len(b)):
            quotient[k] *= inverse
            quotient[k + 1 :] -= quotient[k] * b[1 : len(b) - k]
        return Series(quotient)

    def __rsub__(self, value: float) -> Series:
        return self.constant(value) - self

    def dot(self, other: Series) -> Series:
        """Return the scalar product of vectors."""
        product = (self * other).coefficients
        if _is_array(product):
            return Series(np.add.reduce(product, axis=1, keepdims=True))
        return Series(sum((product[i] for i in range(1, product.size1())), product[0]))

    def cross(self, other: Series) -> Series:
        """Return the vector product."""
        ahead, behind = (1, 2, 0), (2, 0, 1)
        forward = self.row(*ahead) * other.row(*behind)
        return forward - self.row(*behind) * other.row(*ahead)

    @property
    def root(self) -> Series:
        """The square root of a positive scalar, from ``r · r = a``."""
        a = self.coefficients
        if not _is_array(a):
            return Series(a.sqrt())
        root = np.array(a)
        np.sqrt(a[0], out=root[0])
        inverse = 0.5 / root[0]
        for k in range(1, len(a)):
            for i in range(1, k):
                root[k] -= root[i] * root[k - i]
            root[k] *= inverse
        return Series(root)

    @property
    def direction(self) -> Series:
        """The unit vector along a vector."""
        return self / self.dot(self).root

    @property
    def cosine_and_sine(self) -> tuple[Series, Series]:
        """Cosine and sine of an angle, from ``c' = -s ψ'`` and ``s' = c ψ'``."""
        psi = self.coefficients
        if not _is_array(psi):
            return Series(psi.cos()), Series(psi.sin())
        c, s = np.zeros((2, *psi.shape))
        c[0], s[0] = np.cos(psi[0]), np.sin(psi[0])
        for k in range(1, len(psi)):
            for i in range(1, k + 1):
                rate = i / k * psi[i]
                c[k] -= rate * s[k - i]
                s[k] += rate * c[k - i]
        return Series(c), Series(s)


def _is_array(value: Any) -> bool:
    return isinstance(value, np.ndarray)


def product(a: Array, b: Array) -> Array:
    """Return the jet (…, m) of a·b; both have equally many axes."""
    return (Series.of_jet(a) * Series.of_jet(b)).jet


def chained(outer: Array, inner: Array) -> Array:
    """Return the jet (…, 4) of f(g(t)) in t by Faà di Bruno's formula.

    Parameters
    ----------
    outer: (…, 4), derivatives of f at g(t).
    inner: (…, 4), derivatives of g at t.
    """
    first, second, third = chained_rates(outer, inner)
    jets = np.empty((*third.shape, 4), third.dtype)
    for k, each in enumerate((outer[..., 0], first, second, third)):
        jets[..., k] = each
    return jets


def chained_rates(outer: Array, inner: Array) -> tuple[Array, Array, Array]:
    """Return the first three derivatives (…) of f(g(t)), with arguments as in ``chained``."""
    f1, f2, f3 = outer[..., 1], outer[..., 2], outer[..., 3]
    g1, g2, g3 = inner[..., 1], inner[..., 2], inner[..., 3]
    return f1 * g1, f2 * g1**2 + f1 * g2, f3 * g1**3 + 3.0 * f2 * g1 * g2 + f1 * g3
