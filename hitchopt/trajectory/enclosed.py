"""Arithmetic with polynomials enclosed by balls: formulas bounded for all t.

An ``Enclosed`` value is, for many spans of time at once, a polynomial in Bernstein form and the
radius of a ball around it. Sums, products, norms and directions are enclosed values too, rounding
included, so one formula gives a bound over every span. At a point, a span of no length, the degree
is 0 and the ball covers rounding alone: there the same formula gives values.

Roots and inverses are not polynomials. They are replaced by interpolants of low degree: for w, an
interpolant of 1/a, the coefficients of ``a w - 1`` bound the error, and ``a - v²`` for a root.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.geometry.vectors import column_lengths
from hitchopt.trajectory import bernstein
from hitchopt.values import Array

EPS = 2.0**-46
"""Rounding of an operation relative to the sizes that enter it: 64 units in the last place."""

ROOT_ORDER, INVERSE_ORDER = 6, 4
"""Degrees of interpolants: they err by 1e-9 where numbers vary by per cents, as on the spans that
matter. An inverse enters more products than a root."""


@dataclass(frozen=True, eq=False)
class Bound:
    """Bounds (spans,) of a quantity on each of many spans.

    The quantity is closest to its bound near the local parameter x (spans,), in [0, 1].
    """

    value: Array
    x: Array


@dataclass(frozen=True, eq=False)
class Interval:
    """Intervals with lower and upper ends (…)."""

    low: Array
    high: Array

    def __mul__(self, other: Interval) -> Interval:
        a, b = np.broadcast_arrays(self.low, self.high), np.broadcast_arrays(other.low, other.high)
        products = np.stack([x * y for x in a for y in b])
        return Interval(np.min(products, axis=0), np.max(products, axis=0))

    def __add__(self, other: Interval) -> Interval:
        return Interval(self.low + other.low, self.high + other.high)

    @property
    def inverse(self) -> Interval:
        """The inverses of positive numbers."""
        return Interval(1.0 / self.high, 1.0 / self.low)

    @property
    def enclosed(self) -> Enclosed:
        """A constant (…, 1 component) with a ball around it."""
        middle = 0.5 * (self.low + self.high)
        return Enclosed(middle[..., None, None], 0.5 * (self.high - self.low))


@dataclass(frozen=True, eq=False)
class Enclosed:
    """Vector polynomials on [0, 1], each enclosed by a ball."""

    c: Array  # (…, components, degree + 1), Bernstein coefficients
    # (…), bound of the Euclidean norm of the error everywhere; infinite if unbounded
    r: Array | float = 0.0

    __array_ufunc__ = None  # so that numpy's arrays leave sums and products to this class

    @classmethod
    def of(cls, value: Enclosed | ArrayLike) -> Enclosed:
        """Return enclosed values unchanged, and numbers or vectors (…, components) as constants."""
        if isinstance(value, Enclosed):
            return value
        numbers = np.asarray(value, dtype=np.float64)
        return cls(np.atleast_1d(numbers)[..., None])

    @property
    def degree(self) -> int:
        """Degree of the polynomials."""
        return bernstein.degree(self.c)

    @cached_property
    def size(self) -> Array:
        """(…): bound of the polynomials' norm, without the ball."""
        sizes = np.abs(self.c[..., 0, :]) if self.c.shape[-2] == 1 else column_lengths(self.c)
        # Along the first axis, this takes a tenth of the time.
        largest: Array = np.maximum.reduce(np.ascontiguousarray(sizes.T)).T
        return largest

    def __getitem__(self, component: int) -> Enclosed:
        """Return one component."""
        rows = slice(component, component + 1 or None)
        return Enclosed(self.c[..., rows, :], self.r)

    def widened(self, radius: Array | float) -> Enclosed:
        """Return the value with a larger ball."""
        return Enclosed(self.c, self.r + radius)

    def __neg__(self) -> Enclosed:
        return Enclosed(-self.c, self.r)

    def __add__(self, other: Enclosed | ArrayLike) -> Enclosed:
        other = Enclosed.of(other)
        order = max(self.degree, other.degree)
        c = bernstein.elevate(self.c, order) + bernstein.elevate(other.c, order)
        return Enclosed(c, self.r + other.r + EPS * (self.size + other.size))

    def __sub__(self, other: Enclosed | ArrayLike) -> Enclosed:
        return self + -Enclosed.of(other)

    def __mul__(self, other: Enclosed | ArrayLike) -> Enclosed:
        """Return the product with a scalar (one component), or component by component."""
        other = Enclosed.of(other)
        return Enclosed(bernstein.multiply(self.c, other.c), _error(self, other))

    __radd__, __rmul__ = __add__, __mul__

    def __rsub__(self, other: ArrayLike) -> Enclosed:
        return -self + other

    def dot(self, other: Enclosed | ArrayLike) -> Enclosed:
        """Return the scalar product."""
        other = Enclosed.of(other)
        if self.c.shape[:-1] == other.c.shape[:-1]:
            c = bernstein.dot(self.c, other.c)[..., None, :]
        else:
            c = np.sum(bernstein.multiply(self.c, other.c), axis=-2, keepdims=True)
        return Enclosed(c, _error(self, other))

    def cross(self, other: Enclosed) -> Enclosed:
        """Return the cross product of three components; of two, its third component."""
        a, b = self.c, other.c
        ahead, behind = ([1, 2, 0], [2, 0, 1]) if a.shape[-2] == 3 else ([0], [1])
        c = bernstein.multiply(a[..., ahead, :], b[..., behind, :])
        c = c - bernstein.multiply(a[..., behind, :], b[..., ahead, :])
        return Enclosed(c, _error(self, other))

    def sum(self, axis: int = -1) -> Enclosed:
        """Return the sum over a leading axis, counted from the last one of these."""
        r = np.sum(self.r + EPS * self.size, axis=axis)
        return Enclosed(np.sum(self.c, axis=axis - 2), r)

    def reduced(self, order: int) -> Enclosed:
        """Return the value in at most degree ``order``, with the error added to the ball."""
        if self.degree <= order:
            return self
        nodal = bernstein.transform(self.c, bernstein.at_nodes(order, self.degree))
        low = bernstein.interpolate(nodal)
        error = Enclosed(bernstein.elevate(low, self.degree) - self.c)
        return Enclosed(low, self.r + error.size + EPS * self.size)

    @property
    def xy(self) -> Enclosed:
        """The first two components."""
        return Enclosed(self.c[..., :2, :], self.r)

    def along_z(self) -> Enclosed:
        """Return a scalar as a vector along z."""
        zero = np.zeros_like(self.c)
        return Enclosed(np.concatenate([zero, zero, self.c], axis=-2), self.r)

    @property
    def direction(self) -> Enclosed:
        """Unit vector y / |y|; the zero vector and radius 1 where y may vanish."""
        inverse = self.norm.inverse
        unit = self * inverse
        valid = np.asarray(np.isfinite(inverse.r) & (unit.r < 1.0))
        c = np.where(valid[..., None, None], unit.c, 0.0)
        return Enclosed(c, np.where(valid, unit.r, 1.0))

    @cached_property
    def inverse(self) -> Enclosed:
        """Inverse of a positive scalar; the radius is infinite where it may not be positive."""
        order = INVERSE_ORDER if self.degree else 0
        nodal = bernstein.transform(self.c, bernstein.at_nodes(order, self.degree))
        valid = np.min(nodal, axis=(-2, -1)) > 0.0
        w = bernstein.interpolate(1.0 / np.where(valid[..., None, None], nodal, 1.0))
        size = np.max(np.abs(w), axis=(-2, -1))
        product = bernstein.multiply(self.c, w)
        # | w - 1/a | = | a w - 1 | / a, and 1/a <= max w / (1 - | a w - 1 |).
        residual = np.max(np.abs(product - 1.0), axis=(-2, -1)) + size * (self.r + EPS * self.size)
        valid &= residual < 1.0
        radius = np.where(valid, residual * size / np.where(valid, 1.0 - residual, 1.0), np.inf)
        return Enclosed(np.where(valid[..., None, None], w, 0.0), radius)

    @cached_property
    def norm(self) -> Enclosed:
        """Euclidean norm."""
        return self.dot(self).root

    @cached_property
    def root(self) -> Enclosed:
        """Square root of a scalar, 0 where it is negative."""
        order = ROOT_ORDER if self.degree else 0
        nodal = bernstein.transform(self.c, bernstein.at_nodes(order, self.degree))
        v = bernstein.interpolate(np.sqrt(np.maximum(nodal, 0.0)))
        degree = max(self.degree, 2 * order)
        squared = bernstein.elevate(bernstein.multiply(v, v), degree)
        residual = np.abs(bernstein.elevate(self.c, degree) - squared)[..., 0, :]
        # | √a - v | = | a - v² | / (√a + v); for any v, 0 <= √a <= √(|coefficients| + radius).
        lower, upper = np.min(v[..., 0, :], axis=-1), np.sqrt((self.size + self.r) * (1.0 + EPS))
        error = np.max(residual, axis=-1) + EPS * self.size + self.r
        error = np.divide(error, lower, out=np.full_like(error, np.inf), where=lower > 0.0)
        # Where a is smaller than its rounding, the middle of that interval errs less.
        half = 0.5 * upper
        valid = ~(half < error)
        v = np.where(valid[..., None, None], v, half[..., None, None])
        error = np.where(valid, error, half)
        return Enclosed(v, error + EPS * upper)

    @property
    def norm_upper(self) -> Bound:
        """Upper bound of the norm: it is convex, hence largest at a coefficient."""
        return Enclosed((column_lengths(self.c) * (1.0 + EPS))[..., None, :], self.r).upper

    @property
    def norm_lower(self) -> Bound:
        """Lower bound of the norm, at least 0: the component along the direction at mid span."""
        direction = self.middle
        size = np.sqrt(np.sum(direction * direction, axis=-1, keepdims=True))
        direction = np.divide(direction, size, out=np.zeros_like(direction), where=size > 0.0)
        lower = self.dot(direction).lower
        return Bound(np.maximum(lower.value, 0.0), lower.x)

    @property
    def upper(self) -> Bound:
        """Upper bound of a scalar."""
        row = self.c[..., 0, :]
        index = row.argmax(axis=-1)
        return Bound(np.maximum.reduce(row, axis=-1) + self.r, index / max(1, self.degree))

    @property
    def lower(self) -> Bound:
        """Lower bound of a scalar."""
        upper = (-self).upper
        return Bound(-upper.value, upper.x)

    @property
    def range(self) -> Interval:
        """Interval that contains a scalar."""
        row = self.c[..., 0, :]
        lowest, highest = np.minimum.reduce(row, axis=-1), np.maximum.reduce(row, axis=-1)
        return Interval(lowest - self.r, highest + self.r)

    @property
    def norm_range(self) -> Interval:
        """Interval that contains the norm."""
        return Interval(self.norm_lower.value, self.norm_upper.value)

    @property
    def middle(self) -> Array:
        """(…, components): the polynomials at mid span."""
        if self.degree == 0:
            return self.c[..., 0]
        values: Array = self.c @ bernstein.at_nodes(0, self.degree)[0]
        return values


def _error(a: Enclosed, b: Enclosed) -> Array:
    """Return the error of a product whose norm is at most the product of norms, rounding included.

    Zero times an unbounded factor is zero.
    """
    x, y = a.size, b.size
    if isinstance(a.r, float) and isinstance(b.r, float) and a.r == b.r == 0.0:
        return EPS * (x * y)
    with np.errstate(invalid="ignore", over="ignore"):
        error: Array = x * (EPS * y + b.r) + a.r * (y + b.r)
        if math.isnan(np.add.reduce(error, axis=None)):
            error = EPS * (x * y)
            for size, radius in ((x, b.r), (y, a.r), (a.r, b.r)):
                is_zero = (np.asarray(size) == 0.0) | (radius == 0.0)
                error = error + np.where(is_zero, 0.0, size * radius)
    return error


def vector(*parts: Enclosed) -> Enclosed:
    """Return the vector of the components of all parts, in order."""
    order = max(part.degree for part in parts)
    shape = np.broadcast_shapes(*(part.c.shape[:-2] for part in parts))
    each = [bernstein.elevate(part.c, order) for part in parts]
    c = [np.broadcast_to(rows, (*shape, *rows.shape[-2:])) for rows in each]
    r: Array = np.sqrt(sum(np.square(part.r) for part in parts))
    return Enclosed(np.concatenate(c, axis=-2), r)


def largest_of(bounds: list[Bound], floor: float = -np.inf) -> Bound:
    """Return, on each span, the largest of several bounds and of ``floor``."""
    values = np.stack([bound.value for bound in bounds])
    index = np.argmax(values, axis=0)[None]
    x = np.take_along_axis(np.stack([bound.x for bound in bounds]), index, axis=0)[0]
    return Bound(np.maximum(np.max(values, axis=0), floor), x)
