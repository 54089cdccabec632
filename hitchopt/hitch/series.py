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
"""Factors of derivatives over coefficients."""


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
        if not _is_array(self.coefficients):
            return Series(value)
        return Series(np.array(value, ndmin=self.coefficients.ndim))

    @property
    def jet(self) -> Array:
        """(…, rows, count): value and derivatives of a series over arrays."""
        coefficients: Array = self.coefficients
        columns = coefficients.transpose(*range(2, coefficients.ndim), 1, 0)
        jet: Array = np.multiply(columns, FACTORIALS[: len(coefficients)], order="C")
        return jet

    @property
    def value(self) -> Any:
        """The coefficient of order zero."""
        return self.coefficients[0] if _is_array(self.coefficients) else self.coefficients

    def row(self, *rows: int) -> Series:
        """Return the rows of a vector at some indices."""
        index = list(rows)
        if _is_array(self.coefficients):
            return Series(self.coefficients[:, index])
        return Series(self.coefficients[index])

    def select(self, index: Indices) -> Series:
        """Return the items at some indices of the last axis of arrays."""
        return Series(self.coefficients[..., index])

    def __getitem__(self, component: int) -> Series:
        """Return one component of a vector."""
        return self.row(component)

    @property
    def xy(self) -> Series:
        """The first two components of a vector."""
        return self.row(0, 1)

    def along_z(self) -> Series:
        """Return a scalar as a vector along z."""
        if not _is_array(self.coefficients):
            return Series(self.coefficients * UP)
        items = self.coefficients.ndim - 2
        return Series(self.coefficients * np.array(UP).reshape(-1, *[1] * items))

    def __add__(self, other: Series) -> Series:
        a = self.coefficients
        b = other.coefficients
        if not _is_array(a) or len(a) == len(b):
            return Series(a + b)
        longer, shorter = (a, b) if len(a) > len(b) else (b, a)
        total = longer.copy()
        total[: len(shorter)] += shorter
        return Series(total)

    def __sub__(self, other: Series) -> Series:
        a = self.coefficients
        b = other.coefficients
        if not _is_array(a) or len(a) == len(b):
            return Series(a - b)
        return self + -other

    def __neg__(self) -> Series:
        return Series(-self.coefficients)

    def __mul__(self, other: Series | float) -> Series:
        """Return the product of components, by Leibniz' rule; scalars multiply all of a vector."""
        if not isinstance(other, Series):
            return Series(other * self.coefficients)
        a = self.coefficients
        b = other.coefficients
        # Expressions of casadi have order zero, and a constant has no derivatives: one product each
        is_order_zero = not _is_array(a)
        if is_order_zero or len(b) == 1:
            return Series(a * b)
        shorter, longer = (a, b) if len(a) <= len(b) else (b, a)
        product = shorter[0] * longer
        for order in range(1, len(shorter)):
            product[order:] += shorter[order] * longer[:-order]
        return Series(product)

    __rmul__ = __mul__

    def __truediv__(self, divisor: Series) -> Series:
        """Return the quotient q by a scalar b, from ``q · b = a``."""
        a = self.coefficients
        b = divisor.coefficients
        if not _is_array(a) or len(b) == 1:
            return Series(a * (1.0 / b))
        inverse = 1.0 / b[0]
        quotient = np.zeros(np.broadcast_shapes(a[:1].shape, b.shape))
        quotient[: len(a)] = a
        for order in range(len(b)):
            quotient[order] *= inverse
            quotient[order + 1 :] -= quotient[order] * b[1 : len(b) - order]
        return Series(quotient)

    def __radd__(self, value: float) -> Series:
        return self.constant(value) + self

    def __rsub__(self, value: float) -> Series:
        return self.constant(value) - self

    def dot(self, other: Series) -> Series:
        """Return the scalar product of vectors."""
        products = (self * other).coefficients
        if _is_array(products):
            return Series(np.add.reduce(products, axis=1, keepdims=True))
        first, *others = (products[row] for row in range(products.size1()))
        return Series(sum(others, first))

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
        for order in range(1, len(a)):
            for lower in range(1, order):
                root[order] -= root[lower] * root[order - lower]
            root[order] *= inverse
        return Series(root)

    @property
    def inverse(self) -> Series:
        """The inverse of a scalar."""
        return self.constant(1.0) / self

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
        cosine, sine = np.zeros((2, *psi.shape))
        cosine[0] = np.cos(psi[0])
        sine[0] = np.sin(psi[0])
        for order in range(1, len(psi)):
            for part in range(1, order + 1):
                rate = part / order * psi[part]
                cosine[order] -= rate * sine[order - part]
                sine[order] += rate * cosine[order - part]
        return Series(cosine), Series(sine)


def _is_array(value: Any) -> bool:
    """Return whether coefficients are an array of numpy, not an expression of casadi."""
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
    jets[..., 0] = outer[..., 0]
    jets[..., 1] = first
    jets[..., 2] = second
    jets[..., 3] = third
    return jets


def chained_rates(outer: Array, inner: Array) -> tuple[Array, Array, Array]:
    """Return the first three derivatives (…) of f(g(t)), with arguments as in ``chained``."""
    _, f1, f2, f3 = np.moveaxis(outer, -1, 0)
    _, g1, g2, g3 = np.moveaxis(inner, -1, 0)
    first = f1 * g1
    second = f2 * g1**2 + f1 * g2
    third = f3 * g1**3 + 3.0 * f2 * g1 * g2 + f1 * g3
    return first, second, third
