"""Truncated Taylor series in one parameter, over numpy arrays or casadi expressions.

The first axis of a coefficient holds the components of a vector; a scalar has one. A coefficient
that is zero everywhere, such as the higher ones of constants, may be None.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import factorial
from typing import Any

import numpy as np

from hitchopt.values import Array, Indices

ORDER = 3
"""Order of the highest derivative in jets: the jerk."""

JET = ORDER + 1
"""Number of columns of a jet."""

UP = [0.0, 0.0, 1.0]

FACTORIALS = [float(factorial(k)) for k in range(JET)]


class Series:
    """Coefficients ``f^(k) / k!`` of a scalar or a vector; operands have equally many."""

    __array_ufunc__ = None  # numpy arrays defer sums and products to this class

    def __init__(self, coefficients: Sequence[Any]) -> None:
        self.coefficients = coefficients

    @classmethod
    def of_vectors(cls, vectors: Array) -> Series:
        """Return the series of order zero of vectors (…, rows)."""
        return cls([vectors.transpose(-1, *range(vectors.ndim - 1))])

    @classmethod
    def of_jet(cls, jet: Array) -> Series:
        """Return the series, with coefficients (rows, …), of jets (…, rows, JET) of derivatives."""
        columns = jet.transpose(-1, -2, *range(jet.ndim - 2))
        return cls([column / FACTORIALS[k] for k, column in enumerate(columns)])

    def constant(self, value: Any) -> Series:
        """Return a constant as a series with equally many coefficients."""
        return Series([value, *[None] * (len(self.coefficients) - 1)])

    @property
    def jet(self) -> Array:
        """(…, rows, JET): value and derivatives of a series over arrays."""
        jet = np.zeros((*self.value.shape, len(self.coefficients)), self.value.dtype)
        for k, c in enumerate(self.coefficients):
            if c is not None:
                jet[..., k] = FACTORIALS[k] * c
        return jet.transpose(*range(1, jet.ndim - 1), 0, -1)

    @property
    def value(self) -> Any:
        """The coefficient of order zero."""
        return self.coefficients[0]

    def row(self, *rows: int) -> Series:
        """Return the rows of a vector at some indices."""
        index = list(rows)
        return Series([None if c is None else c[index] for c in self.coefficients])

    def select(self, index: Indices) -> Series:
        """Return the items at some indices of the last axis of arrays."""
        return Series([None if c is None else c[..., index] for c in self.coefficients])

    @property
    def upward(self) -> Series:
        """A vector along z whose z component is this scalar."""
        up = np.array(UP).reshape(-1, *[1] * (self.value.ndim - 1)) if _is_array(self.value) else UP
        return Series([None if c is None else c * up for c in self.coefficients])

    def __add__(self, other: Series) -> Series:
        pairs = zip(self.coefficients, other.coefficients, strict=True)
        return Series([b if a is None else a if b is None else a + b for a, b in pairs])

    def __sub__(self, other: Series) -> Series:
        pairs = zip(self.coefficients, other.coefficients, strict=True)
        return Series([a if b is None else -b if a is None else a - b for a, b in pairs])

    def __neg__(self) -> Series:
        return Series([None if c is None else -c for c in self.coefficients])

    def __mul__(self, other: Series | float) -> Series:
        """Return the product of components, by Leibniz' rule; scalars multiply all of a vector."""
        if not isinstance(other, Series):
            return Series([None if c is None else other * c for c in self.coefficients])
        x, y = self.coefficients, other.coefficients
        product: list[Any] = [None] * len(x)
        for k in range(len(product)):
            for a, b in zip(x[: k + 1], y[k::-1], strict=True):
                if a is not None and b is not None:
                    product[k] = a * b if product[k] is None else product[k] + a * b
        return Series(product)

    __rmul__ = __mul__

    def __truediv__(self, divisor: Series) -> Series:
        """Return the quotient q by a scalar b, from ``q · b = a``."""
        b, quotient = divisor.coefficients, list[Any]()
        inverse = 1.0 / b[0]
        for k, a in enumerate(self.coefficients):
            rest = _remainder(a, quotient, b[k:0:-1])
            quotient = [*quotient, None if rest is None else rest * inverse]
        return Series(quotient)

    def __rsub__(self, value: float) -> Series:
        return self.constant(value) - self

    def dot(self, other: Series) -> Series:
        """Return the scalar product of vectors."""
        total = np.add.reduce if _is_array(self.value) else _total
        product = (self * other).coefficients
        return Series([None if c is None else total(c, axis=0, keepdims=True) for c in product])

    def cross(self, other: Series) -> Series:
        """Return the vector product."""
        ahead, behind = (1, 2, 0), (2, 0, 1)
        forward = self.row(*ahead) * other.row(*behind)
        return forward - self.row(*behind) * other.row(*ahead)

    @property
    def root(self) -> Series:
        """The square root of a positive scalar, from ``r · r = a``."""
        value = self.value
        root = [np.sqrt(value) if _is_array(value) else value.sqrt()]
        inverse = 0.5 / root[0]
        for c in self.coefficients[1:]:
            rest = _remainder(c, root[1:], root[:0:-1])
            root = [*root, None if rest is None else rest * inverse]
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
            rates = [None if psi[i] is None else i / k * psi[i] for i in range(1, k + 1)]
            opposite = [None if x is None else -x for x in c[::-1]]
            c, s = (
                [*c, _remainder(None, rates, s[::-1])],
                [*s, _remainder(None, rates, opposite)],
            )
        return Series(c), Series(s)


def _remainder(a: Any, x: Sequence[Any], y: Sequence[Any]) -> Any:
    """Return a minus the products of pairs of x and y."""
    for b, c in zip(x, y, strict=True):
        if b is not None and c is not None:
            a = -(b * c) if a is None else a - b * c
    return a


def _is_array(value: Any) -> bool:
    return isinstance(value, np.ndarray)


def _total(vector: Any, **_: Any) -> Any:
    """Return the sum of the components of a casadi vector."""
    return sum((vector[i] for i in range(1, vector.size1())), vector[0])
