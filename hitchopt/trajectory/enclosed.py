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

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.geometry.vectors import column_lengths, unit
from hitchopt.trajectory import bernstein
from hitchopt.values import Array, lazy

EPS = 2.0**-46
"""Rounding of an operation relative to the sizes that enter it: 64 units in the last place."""

UPWARD = np.array([[0.0], [0.0], [1.0]])

ROOT_ORDER = 6
"""Degree of interpolants of roots: they err by 1e-9 where numbers vary by per cents, as on the
spans that matter."""

INVERSE_ORDER = 4  # Degree of interpolants of inverses, which enter more products than roots


@dataclass(eq=False)
class Bound:
    """Bounds (spans,) of a quantity on each of many spans.

    The quantity is closest to its bound near the local parameter x (spans,), in [0, 1].
    """

    value: Array
    x: Array


@dataclass(eq=False)
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


@dataclass(eq=False)
class Enclosed:
    """Vector polynomials on [0, 1], each enclosed by a ball."""

    c: Array  # (…, components, degree + 1), Bernstein coefficients
    # (…), bound of the Euclidean norm of the error everywhere; infinite if unbounded
    r: Array | float = 0.0

    __array_ufunc__ = None  # so that numpy's arrays leave sums and products to this class

    @classmethod
    def of(cls, value: Enclosed | ArrayLike) -> Enclosed:
        """Return enclosed values unchanged, and numbers or vectors (…, components) as constants."""
        if type(value) is Enclosed:
            return value
        numbers = np.array(value, dtype=np.float64, ndmin=1)
        return cls(numbers[..., None])

    @property
    def degree(self) -> int:
        """Degree of the polynomials."""
        return bernstein.degree(self.c)

    @lazy
    def size(self) -> Array:
        """(…): bound of the polynomials' norm, without the ball."""
        c = self.c
        return _largest(np.abs(c[..., 0, :]) if c.shape[-2] == 1 else column_lengths(c))

    def __getitem__(self, component: int) -> Enclosed:
        """Return one component."""
        return Enclosed(self.c[..., component, None, :], self.r)

    def widened(self, radius: Array | float) -> Enclosed:
        """Return the value with a larger ball."""
        return Enclosed(self.c, self.r + radius)

    def __neg__(self) -> Enclosed:
        return Enclosed(-self.c, self.r)

    def __add__(self, other: Enclosed | ArrayLike) -> Enclosed:
        return self.plus(other, 1.0)

    def __sub__(self, other: Enclosed | ArrayLike) -> Enclosed:
        return self.plus(other, -1.0)

    def plus(self, other: Enclosed | ArrayLike, sign: float) -> Enclosed:
        """Return the sum with a value, or for the sign -1 the difference."""
        other = Enclosed.of(other)
        a, b = self.c, other.c
        if a.shape[-1] != b.shape[-1]:
            a, b = bernstein.same_degree(a, b)
        return Enclosed(a + sign * b, self.r + other.r + EPS * (self.size + other.size))

    def __mul__(self, other: Enclosed | ArrayLike) -> Enclosed:
        """Return the product with a scalar (one component), or component by component."""
        other = Enclosed.of(other)
        return Enclosed(bernstein.multiply(self.c, other.c), _error(self, other))

    __radd__, __rmul__ = __add__, __mul__

    def __rsub__(self, other: ArrayLike) -> Enclosed:
        return Enclosed.of(other) - self

    def dot(self, other: Enclosed | ArrayLike) -> Enclosed:
        """Return the scalar product."""
        other = Enclosed.of(other)
        if self.c.shape[-2] == other.c.shape[-2]:
            c = bernstein.dot(self.c, other.c)[..., None, :]
        else:
            c = np.add.reduce(bernstein.multiply(self.c, other.c), axis=-2, keepdims=True)
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
        r = np.add.reduce(self.r + EPS * self.size, axis=axis)
        return Enclosed(np.add.reduce(self.c, axis=axis - 2), r)

    def reduced(self, order: int) -> Enclosed:
        """Return the value in at most degree ``order``, with the error added to the ball."""
        degree = self.c.shape[-1] - 1
        if degree <= order:
            return self
        low = bernstein.transform(self.c, bernstein.lowering(degree, order))
        error = Enclosed(bernstein.elevate(low, degree) - self.c)
        return Enclosed(low, self.r + error.size + EPS * self.size)

    @property
    def xy(self) -> Enclosed:
        """The first two components."""
        return Enclosed(self.c[..., :2, :], self.r)

    def with_z(self, height: Enclosed) -> Enclosed:
        """Return a horizontal vector with a vertical component."""
        return vector(self, height)

    def along_z(self) -> Enclosed:
        """Return a scalar as a vector along z."""
        return Enclosed(self.c * UPWARD, self.r)

    def angle_to(self, other: Enclosed | ArrayLike) -> Angle:
        """Return the angle to another vector; anything from 0 to 180° where one may vanish."""
        return Angle(self.direction.dot(Enclosed.of(other).direction))

    @lazy
    def direction(self) -> Enclosed:
        """Unit vector y / |y|; the zero vector and radius 1 where y may vanish."""
        inverse = self.norm.inverse
        unit = self * inverse
        valid = np.isfinite(inverse.r) & (unit.r < 1.0)
        if np.logical_and.reduce(valid, axis=None):
            return unit
        c = np.where(valid[..., None, None], unit.c, 0.0)
        return Enclosed(c, np.where(valid, unit.r, 1.0))

    @lazy
    def inverse(self) -> Enclosed:
        """Inverse of a positive scalar; the radius is infinite where it may not be positive."""
        nodal = _at_nodes(self.c, INVERSE_ORDER)
        positive = np.minimum.reduce(nodal, axis=-1)[..., 0] > 0.0
        w = _through_nodes(1.0 / np.where(positive[..., None, None], nodal, 1.0))
        size = _largest(np.abs(w[..., 0, :]))
        product = bernstein.multiply(self.c, w)[..., 0, :]
        # | w - 1/a | = | a w - 1 | / a, and 1/a <= max w / (1 - | a w - 1 |).
        residual = _largest(np.abs(product - 1.0)) + size * (self.r + EPS * self.size)
        valid = positive & (residual < 1.0)
        if np.logical_and.reduce(valid, axis=None):
            return Enclosed(w, residual * size / (1.0 - residual))
        radius = np.where(valid, residual * size / np.where(valid, 1.0 - residual, 1.0), np.inf)
        return Enclosed(np.where(valid[..., None, None], w, 0.0), radius)

    @lazy
    def norm(self) -> Enclosed:
        """Euclidean norm."""
        return self.dot(self).root

    @lazy
    def root(self) -> Enclosed:
        """Square root of a scalar, 0 where it is negative."""
        v = _through_nodes(np.sqrt(np.maximum(_at_nodes(self.c, ROOT_ORDER), 0.0)))
        c, squared = bernstein.same_degree(self.c, bernstein.multiply(v, v))
        residual = _largest(np.abs(c - squared)[..., 0, :]) + EPS * self.size + self.r
        # | √a - v | = | a - v² | / (√a + v); for any v, 0 <= √a <= √(|coefficients| + radius).
        lower = np.minimum.reduce(v[..., 0, :], axis=-1)
        upper = np.sqrt((self.size + self.r) * (1.0 + EPS))
        # Where a is smaller than its rounding, the middle of that interval errs less.
        half, positive = 0.5 * upper, lower > 0.0
        error = residual / np.where(positive, lower, 1.0)
        valid = positive & (error <= half)
        if not np.logical_and.reduce(valid, axis=None):
            v = np.where(valid[..., None, None], v, half[..., None, None])
            error = np.where(valid, error, half)
        return Enclosed(v, error + EPS * upper)

    @property
    def norm_upper(self) -> Bound:
        """Upper bound of the norm: it is convex, hence largest at a coefficient."""
        lengths = column_lengths(self.c)
        x = lengths.argmax(axis=-1) / (lengths.shape[-1] - 1 or 1)
        return Bound(_largest(lengths) * (1.0 + EPS) + self.r, x)

    @property
    def norm_lower(self) -> Bound:
        """Lower bound of the norm, at least 0: the component along the direction at mid span."""
        along = (unit(self.middle)[..., None, :] @ self.c)[..., 0, :]
        lower = np.minimum.reduce(along, axis=-1) - (self.r + EPS * self.size) * (1.0 + EPS)
        x = along.argmin(axis=-1) / (along.shape[-1] - 1 or 1)
        return Bound(np.maximum(lower, 0.0), x)

    @property
    def upper(self) -> Bound:
        """Upper bound of a scalar."""
        row = self.c[..., 0, :]
        x = row.argmax(axis=-1) / (row.shape[-1] - 1 or 1)
        return Bound(np.maximum.reduce(row, axis=-1) + self.r, x)

    @property
    def lower(self) -> Bound:
        """Lower bound of a scalar."""
        row = self.c[..., 0, :]
        x = row.argmin(axis=-1) / (row.shape[-1] - 1 or 1)
        return Bound(np.minimum.reduce(row, axis=-1) - self.r, x)

    @property
    def range(self) -> Interval:
        """Interval that contains a scalar."""
        return Interval(self.lower.value, self.upper.value)

    @property
    def norm_range(self) -> Interval:
        """Interval that contains the norm."""
        return Interval(self.norm_lower.value, self.norm_upper.value)

    @property
    def middle(self) -> Array:
        """(…, components): the polynomials at mid span."""
        if self.c.shape[-1] == 1:
            return self.c[..., 0]
        values: Array = self.c @ bernstein.at_nodes(0, self.degree)[0]
        return values


@dataclass(eq=False)
class Angle:
    """Angles [deg] from 0 to 180, by their cosines."""

    cosine: Enclosed

    @property
    def upper(self) -> Bound:
        """Upper bound, at the smallest cosine."""
        cosine = self.cosine.lower
        return Bound(np.minimum(_degrees(cosine) * (1.0 + EPS), 180.0), cosine.x)

    @property
    def lower(self) -> Bound:
        """Lower bound, at the largest cosine."""
        cosine = self.cosine.upper
        return Bound(_degrees(cosine) * (1.0 - EPS), cosine.x)


def _degrees(cosine: Bound) -> Array:
    """Return the angles [deg] of cosines; those beyond 1 are of rounding."""
    angles: Array = np.degrees(np.arccos(np.clip(cosine.value, -1.0, 1.0)))
    return angles


def _largest(rows: Array) -> Array:
    """Return the largest of each row (…, k)."""
    if rows.shape[-1] == 1:
        return rows[..., 0]
    # Along the first axis, this takes a tenth of the time.
    largest: Array = np.maximum.reduce(np.ascontiguousarray(rows.T)).T
    return largest


def _at_nodes(c: Array, order: int) -> Array:
    """Return the values of polynomials at ``nodes(order)``; those of constants at one node."""
    degree = c.shape[-1] - 1
    return bernstein.transform(c, bernstein.at_nodes(order, degree)) if degree else c


def _through_nodes(values: Array) -> Array:
    """Return the polynomials through values of ``_at_nodes``."""
    return bernstein.interpolate(values) if values.shape[-1] > 1 else values


def _error(a: Enclosed, b: Enclosed) -> Array:
    """Return the error of a product whose norm is at most the product of norms, rounding included.

    Zero times an unbounded factor is zero.
    """
    x, y = a.size, b.size
    if type(a.r) is type(b.r) is float and a.r == b.r == 0.0:
        return EPS * (x * y)
    if math.isfinite(np.add.reduce(a.r + b.r, axis=None)):
        return x * (EPS * y + b.r) + a.r * (y + b.r)
    error = EPS * (x * y)
    with np.errstate(invalid="ignore"):
        for size, radius in ((x, b.r), (y, a.r), (a.r, b.r)):
            is_zero = (np.asarray(size) == 0.0) | (np.asarray(radius) == 0.0)
            error = error + np.where(is_zero, 0.0, size * radius)
    return error


def vector(*parts: Enclosed) -> Enclosed:
    """Return the vector of the components of all parts, in order."""
    each = bernstein.same_degree(*[part.c for part in parts])
    shape = np.broadcast_shapes(*[c.shape[:-2] for c in each])
    each = [np.broadcast_to(c, (*shape, *c.shape[-2:])) for c in each]
    r: Array = np.sqrt(sum([np.square(part.r) for part in parts]))
    return Enclosed(np.concatenate(each, axis=-2), r)


def largest_of(bounds: list[Bound], floor: float = -np.inf) -> Bound:
    """Return, on each span, the largest of several bounds and of ``floor``."""
    value, x = bounds[0].value, bounds[0].x
    for bound in bounds[1:]:
        x = np.where(bound.value > value, bound.x, x)
        value = np.maximum(value, bound.value)
    return Bound(np.maximum(value, floor), x)
