"""Truncated Taylor series in one parameter, over numpy arrays or casadi expressions.

The first axis of a coefficient holds the components of a vector; a scalar has one. The higher
coefficients of constants are the number 0, whose products are skipped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import factorial
from typing import Any

import numpy as np

from hitchopt.values import Array, Indices

ORDER = 3
"""Order of the highest derivative in jets: the jerk."""

JET = ORDER + 1
"""Number of columns of a jet."""

UP = [0.0, 0.0, 1.0]

Bilinear = Callable[[Any, Any], Any]


class Series:
    """Coefficients ``f^(k) / k!`` of a scalar or a vector; operands have equally many."""

    __array_ufunc__ = None  # numpy arrays defer sums and products to this class

    def __init__(self, coefficients: Sequence[Any]) -> None:
        self.coefficients = list(coefficients)

    @classmethod
    def of_vectors(cls, vectors: Array) -> Series:
        """Return the series of order zero of vectors (…, rows)."""
        return cls([np.moveaxis(vectors, -1, 0)])

    @classmethod
    def of_jet(cls, jet: Array) -> Series:
        """Return the series, with coefficients (rows, …), of jets (…, rows, JET) of derivatives."""
        columns = jet.transpose(-1, -2, *range(jet.ndim - 2))
        return cls([column / factorial(k) for k, column in enumerate(columns)])

    def constant(self, value: Any) -> Series:
        """Return a constant as a series with equally many coefficients."""
        return Series([value, *(0.0 for _ in self.coefficients[1:])])

    @property
    def jet(self) -> Array:
        """(…, rows, JET): value and derivatives of a series over arrays."""
        columns = np.stack([factorial(k) * c for k, c in enumerate(self.coefficients)])
        return columns.transpose(*range(2, columns.ndim), 1, 0)

    @property
    def value(self) -> Any:
        """The coefficient of order zero."""
        return self.coefficients[0]

    def row(self, *rows: int) -> Series:
        """Return the rows of a vector at some indices."""
        return self._each(lambda c: c[list(rows)])

    def select(self, index: Indices) -> Series:
        """Return the items at some indices of the last axis of arrays."""
        return self._each(lambda c: c.take(index, -1))

    @property
    def upward(self) -> Series:
        """A vector along z whose z component is this scalar."""
        return self._each(lambda c: np.concatenate([0 * c, 0 * c, c]) if _is_array(c) else c * UP)

    def _each(self, change: Callable[[Any], Any]) -> Series:
        return Series([c if isinstance(c, float) else change(c) for c in self.coefficients])

    def __add__(self, other: Series) -> Series:
        pairs = zip(self.coefficients, other.coefficients, strict=True)
        return Series([_sum([a, b]) for a, b in pairs])

    def __sub__(self, other: Series) -> Series:
        return self + -other

    def __neg__(self) -> Series:
        return Series([-c for c in self.coefficients])

    def __mul__(self, other: Series | float) -> Series:
        if not isinstance(other, Series):
            return self._each(lambda c: other * c)
        return _convolved(self, other, lambda a, b: a * b)

    __rmul__ = __mul__

    def __truediv__(self, divisor: Series) -> Series:
        """Return the quotient q by a scalar b, from ``q · b = a``."""
        b, quotient = divisor.coefficients, list[Any]()
        inverse = 1.0 / b[0]
        for k, a in enumerate(self.coefficients):
            partial = _sum([_times(quotient[i], b[k - i]) for i in range(k)])
            quotient.append(_times(_sum([a, -partial]), inverse))
        return Series(quotient)

    def __rsub__(self, value: float) -> Series:
        return Series([value - self.value, *(-c for c in self.coefficients[1:])])

    def dot(self, other: Series) -> Series:
        """Return the scalar product of vectors."""
        return _convolved(self, other, _dot)

    def cross(self, other: Series) -> Series:
        """Return the vector product."""
        return _convolved(self, other, _cross)

    @property
    def root(self) -> Series:
        """The square root of a positive scalar, from ``r · r = a``."""
        value = self.value
        root = [np.sqrt(value) if _is_array(value) else value.sqrt()]
        inverse = 0.5 / root[0]
        for k, c in enumerate(self.coefficients[1:], start=1):
            partial = _sum([_times(root[i], root[k - i]) for i in range(1, k)])
            root.append(_times(_sum([c, -partial]), inverse))
        return Series(root)

    @property
    def direction(self) -> Series:
        """The unit vector along a vector."""
        return self / self.dot(self).root

    @property
    def cosine_and_sine(self) -> tuple[Series, Series]:
        """Cosine and sine of an angle, from ``c' = -s ψ'`` and ``s' = c ψ'``."""
        psi = self.coefficients
        angle = psi[0]
        numbers = _is_array(angle)
        c = [np.cos(angle) if numbers else angle.cos()]
        s = [np.sin(angle) if numbers else angle.sin()]
        for k in range(1, len(psi)):
            rates = [i / k * psi[i] for i in range(1, k + 1)]
            c.append(-_sum([_times(rate, s[k - i]) for i, rate in enumerate(rates, start=1)]))
            s.append(_sum([_times(rate, c[k - i]) for i, rate in enumerate(rates, start=1)]))
        return Series(c), Series(s)


def _convolved(a: Series, b: Series, product: Bilinear) -> Series:
    """Return the series of a bilinear product, by Leibniz' rule."""
    x, y = a.coefficients, b.coefficients
    return Series(
        [_sum([_times(x[i], y[k - i], product) for i in range(k + 1)]) for k in range(len(x))]
    )


def _is_zero(value: Any) -> bool:
    return isinstance(value, float) and value == 0.0


def _times(a: Any, b: Any, product: Bilinear = lambda a, b: a * b) -> Any:
    return 0.0 if _is_zero(a) or _is_zero(b) else product(a, b)


def _sum(terms: list[Any]) -> Any:
    terms = [term for term in terms if not _is_zero(term)]
    return sum(terms[1:], terms[0]) if terms else 0.0


def _is_array(value: Any) -> bool:
    return isinstance(value, np.ndarray)


def _dot(a: Any, b: Any) -> Any:
    product = a * b
    if _is_array(product):
        return np.add.reduce(product, axis=0, keepdims=True)
    return sum((product[i] for i in range(1, product.size1())), product[0])


def _cross(a: Any, b: Any) -> Any:
    ahead, behind = [1, 2, 0], [2, 0, 1]
    return a[ahead] * b[behind] - a[behind] * b[ahead]
