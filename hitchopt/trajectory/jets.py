"""Enclosed values with their time derivatives: a formula of values gives a rate, too."""

from __future__ import annotations

from dataclasses import dataclass

from hitchopt.trajectory.enclosed import Enclosed
from hitchopt.values import Array, lazy

ORDER = 6  # Degree of the factors of products: they err by 1e-9 on the spans that matter


@dataclass(eq=False)
class Jet:
    """An enclosed value and its time derivative.

    Sums, products, norms and directions follow from the rules of differentiation. Factors are
    reduced to a low degree, and the error of that is added to their balls.
    """

    value: Enclosed  # The value
    rate: Enclosed  # Its time derivative [1/s]
    __array_ufunc__ = None  # so that numpy's arrays leave sums and products to this class

    def __neg__(self) -> Jet:
        return Jet(-self.value, -self.rate)

    def __add__(self, other: Jet | Array | float) -> Jet:
        if isinstance(other, Jet):
            return Jet(self.value + other.value, self.rate + other.rate)
        return Jet(self.value + other, self.rate)

    def __sub__(self, other: Jet | Array | float) -> Jet:
        return self + -other

    def __rsub__(self, other: Array | float) -> Jet:
        return -self + other

    def __mul__(self, other: Jet | Array | float) -> Jet:
        """Return the product with a scalar or constant, or component by component."""
        if not isinstance(other, Jet):
            return Jet(self.value * other, self.rate * other)
        a, b = self.low, other.low
        return Jet(a.value * b.value, a.rate * b.value + a.value * b.rate)

    __radd__, __rmul__ = __add__, __mul__

    def dot(self, other: Jet) -> Jet:
        """Return the scalar product."""
        a, b = self.low, other.low
        return Jet(a.value.dot(b.value), a.rate.dot(b.value) + a.value.dot(b.rate))

    def __getitem__(self, component: int) -> Jet:
        """Return one component."""
        return Jet(self.value[component], self.rate[component])

    @property
    def xy(self) -> Jet:
        """The first two components."""
        return Jet(self.value.xy, self.rate.xy)

    def with_z(self, height: Jet) -> Jet:
        """Return a horizontal vector with a vertical component."""
        return Jet(self.value.with_z(height.value), self.rate.with_z(height.rate))

    def along_z(self) -> Jet:
        """Return a scalar as a vector along z."""
        return Jet(self.value.along_z(), self.rate.along_z())

    @property
    def norm(self) -> Jet:
        """Euclidean norm."""
        return Jet(self.value.norm, self.direction.value.dot(self.low.rate))

    @lazy
    def direction(self) -> Jet:
        """Unit vector y / |y|, whose derivative is the part of ẏ / |y| across it."""
        along = self.value.direction.reduced(ORDER)
        swept = (self.low.rate * self.value.norm.inverse).reduced(ORDER)
        return Jet(along, swept - along * along.dot(swept).reduced(ORDER))

    @property
    def inverse(self) -> Jet:
        """Inverse of a positive scalar."""
        inverse = self.value.inverse
        return Jet(inverse, -(inverse * inverse * self.low.rate))

    @property
    def root(self) -> Jet:
        """Square root of a positive scalar."""
        root = self.value.root
        return Jet(root, self.low.rate * root.inverse * 0.5)

    @lazy
    def low(self) -> Jet:
        """Both in a low degree, as factors of products."""
        return self.reduced(ORDER)

    def reduced(self, order: int) -> Jet:
        """Return both in at most degree ``order``."""
        return Jet(self.value.reduced(order), self.rate.reduced(order))
