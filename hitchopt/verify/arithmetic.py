"""Bounds of quantities and their rates on spans of time, and Bernstein polynomials."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cached_property
from itertools import groupby
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Items = NDArray[np.intp]
Index = Items | int
Mask = NDArray[np.bool_]
Lazy = cached_property[Array]

G = 9.81  # [m/s²]
UP = np.array([0.0, 0.0, 1.0])
DEGREES = math.degrees(1.0)
BIG = 1e30
TINY = 1e-300
TOLERANCE = 1e-9  # relative tolerance of limits
FAR = 1e3  # ratio of bodies above a drone, which its downwash does not meet
POS_TOL = 1e-6  # [m] of the file format
SAME = 1e-9  # [m], [N] largest difference of contacts from midpoints, of pulls from tensions


class Line:
    """Vectors (m, d) on m spans of time, scalars as (m, 1), with bounds.

    ``v`` and ``g`` are value and slope at midpoints; ``q`` (m,) bounds the deviation of slopes from
    g on a span, and ``t`` (m,) is half of its duration [s]. Derived bounds: ``rate`` (m,) of
    slopes, ``deviation`` (m,) from v, ``low`` and ``high`` (m,) of scalars. Operands
    may also be constants: numbers, vectors (d,), or columns (m, d).
    """

    def __init__(self, v: Array, g: Array, q: Array, t: Array) -> None:
        self.v, self.g, self.q, self.t = v, g, q, t

    size: Lazy = cached_property(lambda self: norm(self.v))
    slope: Lazy = cached_property(lambda self: norm(self.g))
    rate: Lazy = cached_property(lambda self: self.slope + self.q)
    deviation: Lazy = cached_property(lambda self: self.rate * self.t)
    low: Lazy = cached_property(lambda self: self.v[:, 0] - self.deviation)
    high: Lazy = cached_property(lambda self: self.v[:, 0] + self.deviation)

    def __getitem__(self, k: int | slice) -> Line:
        k = slice(k, k + 1) if isinstance(k, int) else k
        return Line(self.v[:, k], self.g[:, k], self.q, self.t)

    def as_line(self, o: Line | Array | float) -> Line:
        """Return a constant as a Line."""
        if isinstance(o, Line):
            return o
        v = np.atleast_2d(o) + np.zeros((len(self.t), 1))
        return Line(v, 0.0 * v, np.zeros(len(v)), self.t)

    def __add__(self, o: Line | Array | float) -> Line:
        o = self.as_line(o)
        return Line(self.v + o.v, self.g + o.g, self.q + o.q, self.t)

    def __neg__(self) -> Line:
        return Line(-self.v, -self.g, self.q, self.t)

    def __sub__(self, o: Line | Array | float) -> Line:
        return self + -o

    def __mul__(self, o: Line | Array | float) -> Line:
        return self._product(np.multiply, self.as_line(o))

    def dot(self, o: Line | Array) -> Line:
        """Return the scalar product."""
        return self._product(lambda x, y: np.sum(x * y, -1, keepdims=True), self.as_line(o))

    def cross(self, o: Line) -> Line:
        """Return the vector product."""
        return self._product(np.cross, o)

    def _product(self, f: Callable[[Array, Array], Array], o: Line) -> Line:
        """``(x y)' = x' y + x y'``, with deviations of slopes and factors from midpoints."""
        q = self.q * (o.size + o.deviation) + self.slope * o.deviation
        q = q + o.q * (self.size + self.deviation) + o.slope * self.deviation
        return Line(f(self.v, o.v), f(self.g, o.v) + f(self.v, o.g), q, self.t)

    def norm(self) -> Line:
        """Return the norm: ``|y|' = û·y'``; û deviates by at most ``deviation / min |y|``."""
        n = self.size
        u = normalize(self.v)
        positive = n > self.deviation
        turn = self.slope * self.deviation / (n - self.deviation)
        g = np.sum(u * self.g, -1, keepdims=True) * positive[:, None]
        q = np.where(positive, self.q + turn, self.rate)
        return Line(n[:, None], g, q, self.t)

    def unit(self) -> Line:
        """Return directions; nan if vectors may vanish."""
        return self * self.norm().inverse()

    def map(self, f: Callable[[Array], Array], df: Callable[[Array], Array]) -> Line:
        """Apply a function with a monotone derivative to a non-negative scalar."""
        slope = df(self.v)
        ends = df(np.stack([np.maximum(self.low, 0.0), self.high]))
        q = np.max(np.abs(ends - slope[:, 0]), 0) * self.slope
        q = np.max(np.abs(ends), 0) * self.q + q
        return Line(f(self.v), slope * self.g, q, self.t)

    def inverse(self) -> Line:
        """Return ``1 / f`` of a positive scalar."""
        return self.map(lambda x: 1.0 / x, lambda x: -1.0 / x**2)

    def where(self, on: Mask) -> Line:
        """Return zero outside a mask (m,)."""
        v, g = (np.where(on[:, None], x, 0.0) for x in (self.v, self.g))
        return Line(v, g, np.where(on, self.q, 0.0), self.t)

    def flat(self, ratio: float) -> Line:
        """Return points with heights divided by a ratio of at least 1."""
        by = np.array([1.0, 1.0, 1.0 / ratio])
        return self if ratio == 1.0 else Line(self.v * by, self.g * by, self.q, self.t)

    def unless(self, over: Line) -> Line:
        """Return FAR where a scalar is positive; this scalar bounds it where that is unsure."""
        far = over.v > 0.0
        low = np.where(over.low > 0.0, FAR, np.minimum(self.low, FAR))
        v = np.where(far, FAR, self.v)
        g = np.where(far, 0.0, self.g)
        return Line(v, g, np.where(far[:, 0], (FAR - low) / self.t, self.q), self.t)


def norm(v: Array) -> Array:
    """Return lengths of vectors."""
    return np.abs(v[..., 0]) if v.shape[-1] == 1 else np.sqrt(np.einsum("...i,...i->...", v, v))


def normalize(v: Array) -> Array:
    """Return unit vectors; zero for zero vectors."""
    return v / np.maximum(norm(v), TINY)[..., None]


def varies(c: Array, tolerance: Array | float = POS_TOL) -> bool:
    """Return whether any polynomial (pieces, ..., N + 1) varies by more than a tolerance."""
    return c.size > 0 and bool(np.any(np.ptp(c, axis=(0, -1)) > tolerance))


def concatenate(*parts: Line) -> Line:
    """Return a vector from components."""
    v, g = (np.concatenate([getattr(p, k) for p in parts], axis=1) for k in "vg")
    return Line(v, g, np.sqrt(sum(p.q**2 for p in parts)), parts[0].t)


def minimum(first: Line, *others: Line | Array | float) -> Line:
    """Return the minimum of scalars; its slope is 0 where several may be the smallest."""
    lines = [first, *map(first.as_line, others)]
    keys = "v", "g", "q", "rate", "low", "high"
    v, g, q, rate, low, high = (np.stack([getattr(x, k) for x in lines]) for k in keys)
    at = np.argmin(v[..., 0], axis=0), np.arange(len(first.t))
    candidate = ~(low > high[at])
    unique = np.sum(candidate, axis=0) == 1
    q = np.where(unique, q[at], np.max(np.where(candidate, rate, 0.0), axis=0))
    return Line(v[at], g[at] * unique[:, None], q, first.t)


def maximum(first: Line, *others: Line | Array | float) -> Line:
    """Return the maximum of scalars."""
    return -minimum(-first, *(-x for x in others))


def angle(a: Line, b: Line) -> Line:
    """Return the angle between vectors [rad]: ``2 arcsin(|â - b̂| / 2)``."""
    chord = (a.unit() - b.unit()).norm()
    return chord.map(lambda x: 2.0 * np.arcsin(x / 2.0), lambda x: 1.0 / np.sqrt(1.0 - x**2 / 4.0))


class Effort:
    """Work of all proofs of a file, spent and allowed, in values of curves that they read.

    It bounds their duration: a quantity is computed from the values that it reads.
    """

    def __init__(self, allowed: int) -> None:
        self.spent = 0
        self.allowed = allowed


class Times(Protocol):
    """Spans of a plan's pieces, on which curves are evaluated."""

    effort: Effort
    piece: Items  # (m,)
    t: Array  # (m,) [s] half of the durations
    moving: Array  # (m,) 0 before and after a plan, else 1

    def weights(self, n: int) -> Array:
        """Return Bernstein polynomials of degree n at midpoints (m, n + 1)."""


class Curve:
    """Bernstein polynomials (pieces, items, d, N + 1) on pieces of h seconds, and derivatives."""

    def __init__(self, c: Array, h: Array) -> None:
        max_step = np.max(np.abs(np.diff(c, axis=-1)), axis=(2, 3), initial=0.0)
        noise = 2.0**-48 * np.max(np.abs(c), axis=(2, 3), initial=0.0)
        self.c = [c]
        self.noise = [noise]
        N = c.shape[-1] - 1
        for k in range(1, 6):
            n = N + 1 - k
            difference = np.diff(self.c[-1], axis=-1) if n > 0 else 0.0 * self.c[-1]
            self.c.append(difference * (n / h)[:, None, None, None])
            self.noise.append(2.0 ** (k - 48) * math.perm(N, k) / h[:, None] ** k * max_step)
        self.bounds = [np.max(np.linalg.norm(x, axis=2), axis=-1, initial=0.0) for x in self.c]

    def at(self, s: Times, i: Index, k: int = 0) -> Array:
        """Return k-th derivatives (m, d) of items i (m,) at midpoints."""
        s.effort.spent += len(s.piece)
        c = self.c[k][s.piece, i]
        return np.asarray(np.einsum("mdj,mj->md", c, s.weights(c.shape[-1] - 1)))

    def on(self, s: Times, i: Index, k: int = 0) -> Line:
        """Return k-th derivatives of items i (m,) on spans."""
        q = self.bounds[k + 2][s.piece, i] * s.t * s.moving + self.noise[k][s.piece, i] / s.t
        return Line(self.at(s, i, k), self.at(s, i, k + 1) * s.moving[:, None], q, s.t)


def differ(c: Array, d: Array) -> bool:
    """Return whether polynomials differ by more than SAME."""
    count = max(c.shape[-1], d.shape[-1])
    return bool(np.any(np.abs(elevate(c, count) - elevate(d, count)) > SAME))


def elevate(c: Array, count: int) -> Array:
    """Return polynomials of a higher degree, with ``count`` coefficients."""
    while c.shape[-1] < count:
        share = np.arange(c.shape[-1] + 1) / c.shape[-1]
        zero = np.zeros_like(c[..., :1])
        c = share * np.concatenate([zero, c], -1) + (1 - share) * np.concatenate([c, zero], -1)
    return c


def runs_of(on: Mask) -> Iterator[Items]:
    """Yield the runs of pieces in a mask."""
    runs = groupby(range(len(on)), lambda q: bool(on[q]))
    yield from (np.array([*pieces]) for valid, pieces in runs if valid)
