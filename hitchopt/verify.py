"""A second opinion on a plan: all of its limits, proven from ``plan.npz`` by sampling and rates.

``python verify.py DIR`` needs numpy alone. The file format is that of docs/reference/files.md; no
line here is shared with hitchopt, and no method: the certificate encloses quantities by Bernstein
coefficients; here a quantity is *computed at the middle of a span* of time, and only how fast it
may change is bounded. With half of the span's length r, a quantity of value f, slope f' at the
middle and second derivative of at most s stays within ``|f'| r + s r² / 2`` of f, and within
``a r`` of it for a rate of at most a. Bounds s and a come from the largest coefficients of a
polynomial's derivatives (a Bernstein polynomial's derivative is within the hull of its
coefficients' differences), and go through sums, products, norms and directions by the chain rule:
class ``Jet``. Spans are halved until the limit is proven on all of them (``proven``), a sample
breaks it (``violated``), or the budget is spent (``not proven``).

Rounding: ``2**-46`` of the coordinates, and for a k-th derivative of degree N on a piece of h
seconds ``2**-50 2^k N!/(N-k)! / h^k`` of the largest difference of neighbouring coefficients, go
with every value as an error of its own. As in the certificate a limit holds within 1e-9 of the
largest of itself and the coordinates. Not looked at: ``tracking_radius``, ``stoppable`` and
``survivable``, which are only reported.
"""

from __future__ import annotations

import json
import math
import sys
import zipfile
from collections import namedtuple
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

G = 9.81
UP = np.array([0.0, 0.0, 1.0])
BIG = 1e30  # a second derivative that nothing is known of
JOINT = 1e-6  # [s] phases and breaks that are this close meet
TOLERANCE, CLOSE = 1e-9, 1e-3  # of limits; how closely the worst is looked for
STILL, TOUCH, CONTACT, WRAPPED = 1e-9, 1e-6, 1e-4, 2e-5  # [m], as the page of the format has them
FAR = 0.02  # [m] drones this far off the sheets of cables are off by far
WEAK = 1e-3  # [N] less tension than this counts as this where forces are divided by it
BUDGET, CHUNK, DEPTH = 3_000_000, 8192, 46  # samples a limit, in one go, halvings
FREE = ("on the ground", "hanging free", "clasping", "being tightened")
STATES = (*FREE, "hitched", "none")


Row = namedtuple("Row", "name unit verdict worst limit sense time where samples")


class UnreadableError(Exception):
    """The file is not a plan."""


class Jet:
    """Quantities (m,) or vectors (m, d) on m spans: all that is known of each.

    ``v`` its value and ``d`` its derivative at mid span; ``a`` and ``s`` (m,), the largest norms of
    its first and second derivative within the span; ``e`` (m,), what rounding adds; ``r`` (m,), half
    of the span's length [s].
    """

    def __init__(self, v, d, a, s, e, r):
        self.v, self.d, self.e, self.r = v, d, e, r
        self.s = np.minimum(s, BIG)
        self.a = np.minimum(np.minimum(a, _size(d) + self.s * r), BIG)

    @property
    def spread(self):
        """The most that it may differ from its value at mid span (m,)."""
        return (
            np.minimum(_size(self.d) * self.r + 0.5 * self.s * self.r**2, self.a * self.r) + self.e
        )

    @property
    def most(self):
        """Its largest norm (m,)."""
        return _size(self.v) + self.spread

    low = property(lambda self: self.v - self.spread)
    high = property(lambda self: self.v + self.spread)

    def __add__(self, other):
        if not isinstance(other, Jet):
            return Jet(self.v + other, self.d, self.a, self.s, self.e, self.r)
        parts = (getattr(self, k) + getattr(other, k) for k in "vdase")
        return Jet(*parts, self.r)

    def __neg__(self):
        return self * -1.0

    def __sub__(self, other):
        return self + (other * -1.0)

    def __mul__(self, c):
        """Times a constant, or a scalar Jet: ``(f g)'' = f'' g + 2 f' g' + f g''``."""
        if not isinstance(c, Jet):
            k = np.abs(c)
            c = _beside(c, self.v)
            return Jet(self.v * c, self.d * c, self.a * k, self.s * k, self.e * k, self.r)
        v, d = _beside(c.v, self.v), _beside(c.d, self.v)
        return self._product(c, self.v * v, self.d * v + self.v * d)

    __radd__, __rmul__ = __add__, __mul__

    def _product(self, o, v, d):
        f, g = self.most, o.most
        s = self.s * g + 2.0 * self.a * o.a + f * o.s
        return Jet(v, d, self.a * g + f * o.a, s, self.e * g + f * o.e, self.r)

    def dot(self, o):
        v, d = np.sum(self.v * o.v, -1), np.sum(self.d * o.v + self.v * o.d, -1)
        return self._product(o, v, d)

    def cross(self, o):
        return self._product(
            o, np.cross(self.v, o.v), np.cross(self.d, o.v) + np.cross(self.v, o.d)
        )

    def along(self, w):
        """Its product with constant vectors (m, d), of length 1 at most."""
        return Jet(np.sum(self.v * w, -1), np.sum(self.d * w, -1), self.a, self.s, self.e, self.r)

    def part(self, i):
        """One coordinate, or the first two as a vector."""
        return Jet(self.v[:, i], self.d[:, i], self.a, self.s, self.e, self.r)

    def norm(self):
        """``|y|' = û·y'``, ``|y|'' ≤ |y''| + |y'|² / |y|``."""
        n = _size(self.v)
        least = n - self.spread
        d = np.sum(self.v * self.d, -1) / np.maximum(n, 1e-300)
        return Jet(n, d, self.a, self.s + _over(self.a**2, least), self.e, self.r)

    def unit(self):
        """``û' = (y' - û û·y') / |y|``, ``|û''| ≤ |y''| / |y| + 3 |y'|² / |y|²``."""
        n = _size(self.v)
        least = n - self.spread
        u = self.v / np.maximum(n, 1e-300)[:, None]
        d = (self.d - u * np.sum(u * self.d, -1)[:, None]) / np.maximum(n, 1e-300)[:, None]
        s = _over(self.s, least) + 3.0 * _over(self.a, least) ** 2
        return Jet(u, d, _over(self.a, least), s, 2.0 * _over(self.e, least), self.r)

    def inverse(self):
        """``(1/f)' = -f'/f²``, ``(1/f)'' = 2 f'²/f³ - f''/f²``; of what is positive."""
        i = 1.0 / np.where(self.v == 0.0, 1e-300, self.v)
        m = _over(1.0, self.low)
        s = 2.0 * self.a**2 * m**3 + self.s * m**2
        return Jet(i, -self.d * i * i, self.a * m**2, s, self.e * m**2, self.r)


def _size(v):
    return np.abs(v) if v.ndim == 1 else np.sqrt(np.sum(v * v, -1))


def _beside(c, v):
    c = np.asarray(c, dtype=float)
    return c[:, None] if c.ndim == 1 and v.ndim == 2 else c


def _over(x, least):
    return np.where(least > 0.0, np.minimum(x / np.where(least > 0.0, least, 1.0), BIG), BIG)


def _constant(v, r):
    zero = np.zeros(len(r))
    return Jet(v, np.zeros_like(v), zero, zero, zero, r)


def _stacked(x, y, z=None):
    """A vector of two or three scalar jets."""
    parts = (x, y) if z is None else (x, y, z)
    size = [np.sqrt(sum(getattr(p, k) ** 2 for p in parts)) for k in "ase"]
    return Jet(np.stack([p.v for p in parts], -1), np.stack([p.d for p in parts], -1), *size, x.r)


def _total(parts):
    found = parts[0]
    for part in parts[1:]:
        found = found + part
    return found


class Rows:
    """m spans of time with an item each: piece p, middle x and half width w in it, item i."""

    def __init__(self, plan, p, x, w, i):
        self.plan, self.p, self.x, self.w, self.i = plan, p, x, w, i
        self.r = w * plan.h[p]
        self.t = plan.breaks[p] + x * plan.h[p]

    def __len__(self):
        return len(self.p)

    def take(self, k):
        return Rows(self.plan, self.p[k], self.x[k], self.w[k], self.i[k])

    def halves(self):
        w = np.tile(0.5 * self.w, 2)
        x = np.concatenate([self.x - 0.5 * self.w, self.x + 0.5 * self.w])
        return Rows(self.plan, np.tile(self.p, 2), x, w, np.tile(self.i, 2))


class Poly:
    """Bernstein polynomials c (pieces, items, d, N + 1) on pieces of h seconds."""

    def __init__(self, c, h):
        self.c, self.h, self.degree = [c], h, c.shape[-1] - 1
        step = np.max(np.abs(np.diff(c, axis=-1)), axis=(2, 3), initial=0.0)
        self.sizes, self.noise = (
            [np.max(np.abs(c), axis=(2, 3))],
            [2.0**-46 * np.max(np.abs(c), initial=0.0)],
        )
        for k in range(1, 8):
            n = self.c[-1].shape[-1] - 1
            if n > 0:
                self.c.append(np.diff(self.c[-1], axis=-1) * (n / h)[:, None, None, None])
            else:
                self.c.append(np.zeros_like(self.c[-1]))
            self.sizes.append(np.max(np.sqrt(np.sum(self.c[-1] ** 2, axis=2)), axis=-1))
            gain = 2.0**k * math.perm(self.degree, k) / h**k if k <= self.degree else 0.0 * h
            self.noise.append(2.0**-50 * gain[:, None] * step + 2.0**-46 * self.sizes[-1])

    def at(self, rows, i, k=0):
        """Values (m, d) of k-th derivatives of items i (m,)."""
        c = self.c[k]
        n = c.shape[-1] - 1
        x, j = rows.x[:, None], np.arange(n + 1)
        weights = np.array([math.comb(n, q) for q in j]) * x**j * (1.0 - x) ** (n - j)
        return np.einsum("mdj,mj->md", c[rows.p, i], weights)

    def jet(self, rows, i, k=0):
        """The k-th derivatives of items i (m,) as jets of vectors."""
        p, r = rows.p, rows.r
        v, d, s = self.at(rows, i, k), self.at(rows, i, k + 1), _size(self.at(rows, i, k + 2))
        s = np.minimum(self.sizes[k + 2][p, i], s + self.sizes[k + 3][p, i] * r)
        e = self.noise[k] if k == 0 else self.noise[k][p, i]
        return Jet(v, d, self.sizes[k + 1][p, i], s, np.broadcast_to(e, r.shape), r)

    def scalar(self, rows, i, k=0):
        return self.jet(rows, i, k).part(0)


def _elevated(c, degree):
    while c.shape[-1] - 1 < degree:
        n = c.shape[-1]
        share = np.arange(1, n) / n
        inner = share * c[..., :-1] + (1.0 - share) * c[..., 1:]
        c = np.concatenate([c[..., :1], inner, c[..., -1:]], axis=-1)
    return c


def search(rows, make, limit, sense, size):
    """Prove a limit on spans by halving, and look for the worst value.

    ``make(rows)`` returns bounds (m,) on the spans and values (m,) at their middles. Returns the
    worst value, its time and item, the samples spent, and what is left to prove: None, or its time
    and item.
    """
    sign = 1.0 if sense == "min" else -1.0
    goal = sign * limit - TOLERANCE * max(abs(limit), size)
    best, place, spent, left = math.inf, (0.0, -1), 0, None
    for depth in range(DEPTH):
        if len(rows) == 0:
            break
        more, low = [], []
        for first in range(0, len(rows), CHUNK):
            part = rows.take(slice(first, first + CHUNK))
            with np.errstate(all="ignore"):
                bound, value = (sign * np.nan_to_num(x, nan=-sign * BIG) for x in make(part))
            k = int(np.argmin(value))
            if value[k] < best:
                best, place = float(value[k]), (float(part.t[k]), int(part.i[k]))
            more.append(part)
            low.append(bound)
        spent, bound = spent + len(rows), np.concatenate(low)
        rows = Rows(rows.plan, *(np.concatenate([getattr(m, k) for m in more]) for k in "pxwi"))
        if best < goal:
            return sign * best, place, spent, None
        close = max(CLOSE * max(abs(limit), 1e-3), 0.02 * (best - goal))
        unproven = bound < goal
        if spent > BUDGET or depth == DEPTH - 1:
            if np.any(unproven):
                k = int(np.argmin(bound))
                left = float(rows.t[k]), int(rows.i[k])
            break
        wanted = unproven if spent > BUDGET // 3 else unproven | (bound < best - close)
        rows = rows.take(wanted).halves()
    return sign * best, place, spent, left


# Geometry of single moments.


def closest(a, b, c, d):
    """The shortest vectors (m, 3) from segments c d to segments a b."""
    u, v, w = b - a, d - c, a - c

    def dot(x, y):
        return np.sum(x * y, -1)

    def share(x, y):
        return np.clip(x / np.where(y > 0.0, y, 1.0), 0.0, 1.0)

    uu, vv, uv = dot(u, u), dot(v, v), dot(u, v)
    cross = uu * vv - uv**2
    inner = np.clip((uv * dot(v, w) - vv * dot(u, w)) / np.where(cross > 0.0, cross, 1.0), 0.0, 1.0)
    found = []
    for s in (inner, 0.0 * uu, 0.0 * uu + 1.0, share(-dot(u, w), uu), share(dot(u, v - w), uu)):
        t = share(dot(v, w + s[:, None] * u), vv)
        s = share(dot(u, t[:, None] * v - w), uu)
        found.append(w + s[:, None] * u - t[:, None] * v)
    offsets = np.stack(found)
    k = np.argmin(_size(offsets.reshape(-1, 3)).reshape(offsets.shape[:2]), axis=0)
    return offsets[k, np.arange(len(a))]


def to_links(x, chain):
    """Distances (m,) of points x (m, 3) to chains of segments (m, k, 3)."""
    a, u = chain[:, :-1], np.diff(chain, axis=1)
    share = np.sum((x[:, None] - a) * u, -1) / np.maximum(np.sum(u * u, -1), 1e-300)
    off = x[:, None] - a - np.clip(share, 0.0, 1.0)[..., None] * u
    return np.sqrt(np.min(np.sum(off * off, -1), axis=1))


class Section:
    """A convex section seen from above: clockwise corners, and a radius about them."""

    def __init__(self, outline=None, radius=None):
        self.core = np.zeros((1, 2)) if outline is None else np.array(outline, dtype=float)
        self.radius, self.round = 0.0 if radius is None else float(radius), outline is None
        if (
            self.core.ndim != 2
            or self.core.shape[1] != 2
            or not (len(self.core) > 2 or self.radius > 0)
        ):
            raise UnreadableError("a section is an outline or a circle's radius")
        sides = np.roll(self.core, -1, 0) - self.core
        x, y = self.core.T
        cross = x * np.roll(y, -1) - np.roll(x, -1) * y
        if not self.round:
            turn = sides[:, 0] * np.roll(sides[:, 1], -1) - sides[:, 1] * np.roll(sides[:, 0], -1)
            if np.any(turn >= 0.0):
                raise UnreadableError("an outline is convex and clockwise")
            size = _size(sides)[:, None]
            self.sides, self.out = sides, np.stack([-sides[:, 1], sides[:, 0]], -1) / size
        middle = (self.core + np.roll(self.core, -1, 0)) * cross[:, None]
        self.centroid = np.zeros(2) if self.round else np.sum(middle, 0) / (3.0 * np.sum(cross))

    def support(self, w):
        return np.max(w @ self.core.T, -1) + self.radius * np.sqrt(np.sum(w * w, -1))

    def apart(self, x):
        """Signed distances (m,) of points (m, 2), negative inside, and ways out (m, 2)."""
        if self.round:
            n = _size(x)
            return n - self.radius, np.where(
                n[:, None] > 0, x / np.maximum(n, 1e-300)[:, None], [1.0, 0]
            )
        away = x[:, None] - self.core
        share = np.clip(np.sum(away * self.sides, -1) / np.sum(self.sides**2, -1), 0.0, 1.0)
        off = away - share[..., None] * self.sides
        k = np.argmin(np.sum(off**2, -1), axis=1)
        off = off[np.arange(len(x)), k]
        depth = np.sum(away * self.out, -1)
        face = np.argmax(depth, axis=1)
        inside, n = np.max(depth, axis=1) <= 0.0, _size(off)
        way = np.where(inside[:, None], self.out[face], off / np.maximum(n, 1e-300)[:, None])
        return np.where(inside, np.max(depth, axis=1), n), way


class Slab:
    """A section between two heights, of a body or a keep-out prism."""

    def __init__(self, section, lower, upper):
        self.section, self.lower, self.upper = section, lower, upper

    def apart(self, x):
        """Distances (m,) of points (m, 3), 0 inside, and the ways to them from the slab (m, 3)."""
        flat, way = self.section.apart(x[:, :2])
        over = np.maximum(x[:, 2] - self.upper, self.lower - x[:, 2])
        up = np.where(x[:, 2] - self.upper >= self.lower - x[:, 2], 1.0, -1.0) * np.maximum(
            over, 0.0
        )
        off = np.concatenate([np.maximum(flat, 0.0)[:, None] * way, up[:, None]], axis=1)
        n = _size(off)
        inside = np.where(
            (flat > over)[:, None], np.pad(way, ((0, 0), (0, 1))), UP * np.sign(up + 0.5)[:, None]
        )
        return n, np.where(n[:, None] > 0.0, off / np.maximum(n, 1e-300)[:, None], inside)

    def support(self, w):
        return self.section.support(w[:, :2]) + np.maximum(
            self.lower * w[:, 2], self.upper * w[:, 2]
        )

    def from_segment(self, a, b):
        """Distances of segments and the ways to them, by a search of the convex distance along."""
        low, high = np.zeros(len(a)), np.ones(len(a))
        for _ in range(60):
            x, y = low + (high - low) / 3.0, high - (high - low) / 3.0
            nearer = (
                self.apart(a + x[:, None] * (b - a))[0] <= self.apart(a + y[:, None] * (b - a))[0]
            )
            low, high = np.where(nearer, low, x), np.where(nearer, y, high)
        return self.apart(a + 0.5 * (low + high)[:, None] * (b - a))


def steepness(ratio):
    """σ with ``sinh σ / σ = ratio``, by bisection of its logarithm."""
    target = np.log(np.maximum(ratio, 1.0))
    low, high = np.zeros_like(target), 2.0 * target + 6.0
    for _ in range(60):
        x = 0.5 * (low + high)
        y = np.maximum(x, 1e-9)
        value = np.where(
            y > 1e-2, y + np.log(-np.expm1(-2.0 * y) / (2.0 * y)), y * y / 6.0 - y**4 / 180.0
        )
        low, high = np.where(value < target, x, low), np.where(value < target, high, x)
    return np.maximum(0.5 * (low + high), 1e-3)


class Hanging:
    """Catenaries of given lengths L between moving ends: their shape at mid span, and its change.

    With s the ends' distance from above, h their rise and ``Λ² = L² - h²``: ``sinh σ / σ = Λ / s``;
    at μ in [-1, 1] the cable is ``L (cosh σ - cosh μσ) / 2 sinh σ + h (μ - sinh μσ / sinh σ) / 2``
    below its chord, which changes by (L + |h|) / 4 per unit of σ at most; for one σ a place moves by
    shares of what the ends do.
    """

    def __init__(self, q, r, length):
        off = r - q
        s, h = off.part(slice(0, 2)).norm(), off.part(2)
        rise = np.abs(h.v) + h.spread
        least = np.maximum(np.abs(h.v) - h.spread, 0.0)
        self.low = steepness(_whole(rise, length) / np.maximum(s.high, 1e-6 * length))
        self.high = steepness(_whole(least, length) / np.maximum(s.low, 1e-6 * length))
        self.sigma = steepness(_whole(h.v, length) / np.maximum(s.v, 1e-6 * length))
        ends = [np.maximum(q.part(k).spread, r.part(k).spread) for k in (slice(0, 2), 2)]
        drift = np.maximum(self.high - self.sigma, self.sigma - self.low)
        self.moved = np.hypot(*ends) + 0.25 * (length + rise) * drift
        slower = rise * h.a / _whole(rise, length) ** 2 + _over(s.a, s.low)
        self.rate = np.minimum(slower / (1.0 / np.tanh(self.low) - 1.0 / self.low), BIG)
        self.q, self.off, self.length, self.s, self.h, self.jet = q.v, off.v, length, s.v, h.v, off

    def points(self, along=24, across=16):
        """Points (m, k, 3) of the cables, and how far these are off the links between them (m,)."""
        g, tilt = self.sigma[:, None], np.arcsinh(self.h / _whole(self.h, self.length))[:, None]
        first, last = np.sinh(tilt - g), np.sinh(tilt + g)
        even = (np.arcsinh(first + (last - first) * np.linspace(0, 1, along + 1)) - tilt) / g
        mu = np.clip(
            np.sort(np.concatenate([even, 0 * g + np.linspace(-1, 1, across + 2)[1:-1]], 1), 1),
            -1,
            1,
        )
        depth = (
            self.length[:, None]
            * np.sinh(0.5 * (1 + mu) * g)
            * np.sinh(0.5 * (1 - mu) * g)
            / np.sinh(g)
        )
        depth = depth + self.h[:, None] * 0.5 * (mu - np.sinh(mu * g) / np.sinh(g))
        points = (
            self.q[:, None] + 0.5 * (1 + mu)[..., None] * self.off[:, None] - depth[..., None] * UP
        )
        # An arc stays within the ellipse of its length about its ends.
        arc = np.diff(np.sinh(mu * g + tilt), axis=1) / (last - first) * self.length[:, None]
        chord = np.sqrt(np.sum(np.diff(points, axis=1) ** 2, -1))
        return points, np.max(0.5 * np.sqrt(np.maximum(arc**2 - chord**2, 0.0)), axis=1) + 1e-9

    def lowest(self):
        """Height of the lowest points (m,)."""
        tilt = np.arcsinh(self.h / _whole(self.h, self.length))
        mu, g = np.clip(-tilt / self.sigma, -1.0, 1.0), self.sigma
        depth = self.length * np.sinh(0.5 * (1 + mu) * g) * np.sinh(0.5 * (1 - mu) * g) / np.sinh(g)
        depth = depth + self.h * 0.5 * (mu - np.sinh(mu * g) / np.sinh(g))
        return self.q[:, 2] + 0.5 * (1.0 + mu) * self.h - depth

    def pull(self):
        """Force of a cable of unit weight per length on its first end: ``(s/2σ, -L/2 + h coth σ/2)``."""
        zero = np.zeros_like(self.s)
        inward = Jet(1.0 / self.sigma, zero, self.rate / self.low**2, zero + BIG, zero, self.jet.r)
        turned = Jet(
            1.0 / np.tanh(self.sigma),
            zero,
            self.rate / np.sinh(self.low) ** 2,
            zero + BIG,
            zero,
            self.jet.r,
        )
        x, y, z = (self.jet.part(k) for k in range(3))
        return _stacked(x * inward * 0.5, y * inward * 0.5, z * turned * 0.5 + (-0.5 * self.length))


def _whole(rise, length):
    return np.sqrt(np.maximum((length - rise) * (length + rise), (1e-6 * length) ** 2))


class Plan:
    """A plan file: polynomials, and the settings that say what they are held to."""

    def __init__(self, path):
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = {k: file[k] for k in file.files}
            if str(arrays.pop("format")) != "hitchopt-plan/1":
                raise UnreadableError("its format is not hitchopt-plan/1")
            self.settings = s = json.loads(str(arrays.pop("settings")))
            self.arrays = arrays
            for name, array in arrays.items():
                if array.dtype != np.float64:
                    raise UnreadableError(f"{name} is not of double precision")
                if name != "stiffness" and not np.all(np.abs(array) <= 1e6):
                    raise UnreadableError(f"{name} has numbers that are not finite, or beyond 1e6")
            self._read(s, arrays)
        except (
            OSError,
            KeyError,
            ValueError,
            TypeError,
            IndexError,
            AttributeError,
            zipfile.BadZipFile,
        ) as error:
            raise UnreadableError(f"{type(error).__name__}: {error}") from error

    def _read(self, s, arrays):
        team, self.cabled = s["team"], "robots" in s["team"]
        self.n = n = int(team["robots"]) if self.cabled else 0
        self.closed = team.get("topology", "closed") == "closed"
        self.N = N = 2 * n if self.cabled else int(team["drones"])
        self.P = P = (n if self.closed else n + 1) if self.cabled else 0
        self.names = [f"{'qr'[i % 2]}{i // 2}" if self.cabled else f"d{i}" for i in range(N)]
        k = np.arange(n)
        self.begin, self.end = k, (k + 1) % max(P, 1)
        self.clasps = k if self.closed else k[1:]
        self.behind = (self.clasps - 1) % max(n, 1)
        leg = np.ones((n, 2), dtype=bool)
        if n and not self.closed:
            leg[0, 0] = leg[-1, 1] = False
        own = np.stack([self.begin, self.end], -1)
        self.leg, self.anchor = leg.ravel(), own.ravel()
        self.toward = np.where(leg, own, own[:, ::-1]).ravel()
        self.rho = float(team.get("cable_density", 0.0))
        self.mu = float(team.get("cable_friction", 0.0))
        self.load = np.broadcast_to(np.array(team.get("load", 0.0), float), (len(self.clasps),))
        self.breaks, self.h = arrays["breaks"], np.diff(arrays["breaks"])
        m, objects = len(self.h), s.get("objects", {})
        if m < 1 or self.breaks[0] != 0.0 or not np.all(self.h > 0.0):
            raise UnreadableError("breaks do not rise from 0")
        self.bodies = {name: Body(**entry) for name, entry in objects.items()}
        shapes = {"drones": (N, 3), "mass": n or N, "max_thrust": n or N}
        if self.cabled:
            shapes |= {
                "vertices": (P, 3),
                "legs": (n, 2),
                "tensions": (n,),
                "cable_length": n,
                "tension": n,
            }
        further = {
            "leg_tensions": (n, 2),
            "poses": (len(objects), 5),
            "borne": (len(objects),),
            "contacts": (n, 2, 3),
        }
        shapes |= {name: shape for name, shape in further.items() if s.get(name) is True}
        for name, shape in shapes.items():
            given = arrays[name].shape
            if (
                (given[:1] != (m,) or given[1:-1] != shape)
                if isinstance(shape, tuple)
                else given != (shape,)
            ):
                raise UnreadableError(f"{name} has the shape {given}")
        two = 2 if self.cabled else 1
        self.mass, self.max_thrust = (np.repeat(arrays[k], two) for k in ("mass", "max_thrust"))
        self.length, self.team = arrays.get("cable_length"), arrays.get("tension")
        self.limits, self.sep, self.arena = s["limits"], s["separation"], s["arena"]
        self.floor = 0.0 if self.arena is None else float(self.arena["lower"][2])
        self.prisms = [Slab(Section(e["polygon"]), e["lower"], e["upper"]) for e in s["keep_out"]]
        self.phases = s["phases"]
        ends = np.array([float(p["end"]) for p in self.phases[:-1]])
        middles = 0.5 * (self.breaks[1:] + self.breaks[:-1])
        self.phase = np.searchsorted(ends, middles)
        self.state = np.array([p["state"] for p in self.phases])[self.phase]
        self.formed = self.state == "hitched"
        self.hold = [self.phases[p]["hold"] for p in self.phase]
        held = [h for h in (p["hold"] for p in self.phases) if h is not None]
        if not set(self.state) <= set(STATES) or not all(
            h["object"] in objects
            and h["by"] in ("rest", "grip")
            and set(h["cables"]) <= set(range(n))
            for h in held
        ):
            raise UnreadableError("phases have states or hold objects that there are not")
        self.drones = Poly(arrays["drones"], self.h)
        parts, self.bent = [arrays["drones"]], "contacts" in shapes
        if self.cabled:
            parts.append(arrays["vertices"])
            if self.bent:
                parts.append(arrays["contacts"].reshape(m, 2 * n, 3, -1))
            self.tensions = Poly(arrays["tensions"][:, :, None], self.h)
            self.legs = Poly(arrays["legs"].reshape(m, 2 * n, 1, -1), self.h)
            self.vertices = Poly(arrays["vertices"], self.h)
            pulls = (
                arrays["leg_tensions"].reshape(m, 2 * n, 1, -1)
                if "leg_tensions" in shapes
                else None
            )
            self.slid = pulls is not None
            self.pulls = Poly(
                np.repeat(self.tensions.c[0], 2, axis=1) if pulls is None else pulls, self.h
            )
            self._ranges()
        order = max(c.shape[-1] for c in parts) - 1
        self.points = Poly(np.concatenate([_elevated(c, order) for c in parts], axis=1), self.h)
        self.size = float(max(np.max(np.abs(c), initial=0.0) for c in parts))
        poses = np.array([b.pose for b in self.bodies.values()]).reshape(-1, 5)
        still = np.broadcast_to(poses[None, :, :, None], (m, *poses.shape, 1))
        self.poses = Poly(arrays["poses"] if "poses" in shapes else still, self.h)
        borne = arrays["borne"] if "borne" in shapes else np.zeros((m, len(poses), 1))
        near = np.round(borne)
        self.borne = Poly(
            np.where(np.abs(borne - near) <= 2.0**-40, near, borne)[:, :, None], self.h
        )
        self.moving = np.any(np.ptp(self.poses.c[0], axis=-1) > STILL, axis=-1)

    def _ranges(self):
        """Stated ranges of tensions (pieces, n, 2) [N], and their phases (pieces,), -1 of none."""
        m, self.ranged = len(self.h), np.full(len(self.h), -1)
        self.range = np.tile(np.repeat(self.team[:, None], 2, 1), (m, 1, 1))
        for i, phase in enumerate(self.phases):
            if phase["tension"] is not None:
                inside = (self.breaks[:-1] >= phase["start"] - JOINT) & (
                    self.breaks[1:] <= phase["end"] + JOINT
                )
                self.ranged[inside], self.range[inside] = i, phase["tension"]
        self.least = np.minimum(self.range[..., 0], self.team)

    # Parts of the formulas, as jets.

    def rows(self, pieces, items):
        pieces, items = np.asarray(pieces), np.asarray(items)
        p, i = np.repeat(pieces, len(items)), np.tile(items, len(pieces))
        return Rows(self, p, np.full(len(p), 0.5), np.full(len(p), 0.5), i)

    def point(self, rows, i):
        return self.points.jet(rows, i)

    def vertex(self, rows, i):
        return self.points.jet(rows, self.N + i)

    def edge(self, rows, k):
        """Edge k where it leaves ``p_k`` and where it arrives at ``p_{k+1}``."""
        first, last = self.vertex(rows, self.begin[k]), self.vertex(rows, self.end[k])
        if not self.bent:
            return last - first, last - first
        contact = self.N + self.P + 2 * k
        return self.point(rows, contact) - first, last - self.point(rows, contact + 1)

    def leg_to(self, rows, i):
        """The way to drone i from where its cable leads; at a chain's end along its edge."""
        return self.point(rows, i) - self.vertex(rows, self.toward[i])

    def taut(self, rows, k):
        """The share to which cable k is taut: ``T / T_stated``, 1 at most."""
        x = self.tensions.scalar(rows, k) * (1.0 / self.least[rows.p, k])
        full, over = x.low >= 1.0 - 1e-6, x.high > 1.0
        zero = np.zeros(len(rows))
        d, a = np.where(full | (x.v > 1.0), 0.0, x.d), np.where(full, 0.0, x.a)
        s = np.where(full, 0.0, np.where(over, BIG, x.s))
        v = np.where(full, 1.0, np.minimum(x.v, 1.0))
        there = self.formed[rows.p]
        return Jet(*(np.where(there, y, zero) for y in (v, d, a, s, zero)), rows.r)

    def pull(self, rows, i):
        """What leg i pulls with along its chord: its tension and half of what grows with height."""
        found = self.pulls.scalar(rows, i)
        if self.rho > 0.0:
            half = self.taut(rows, i // 2) * (0.5 * self.rho * G)
            found = found + self.leg_to(rows, i).part(2) * half
        return found

    def hanging(self, rows, k):
        return Hanging(self.point(rows, 2 * k), self.point(rows, 2 * k + 1), self.length[k])

    def thrust(self, rows, i):
        """``m (a + g ẑ) + P û + ½ ρ g d τ ẑ - (1 - τ) w`` (w: what the hanging cable pulls with)."""
        found = self.drones.jet(rows, i, 2) + G * UP
        found = found * self.mass[i]
        if not self.cabled:
            return found
        taut = self.taut(rows, i // 2)
        if np.any(self.formed[rows.p]):
            leg = self.leg_to(rows, i)
            pull = self.pull(rows, i) * self.formed[rows.p].astype(float)
            found = found + leg.unit() * pull
            found = found + _upward(leg.norm() * taut * (0.5 * self.rho * G))
        if self.rho > 0.0 and np.any(taut.low < 1.0):
            other = i + 1 - 2 * (i % 2)
            hung = Hanging(self.point(rows, i), self.point(rows, other), self.length[i // 2]).pull()
            found = found - hung * ((taut * -1.0 + 1.0) * (self.rho * G))
        return found

    def thrust_rate(self, rows, i):
        """Its derivative by time, of what hangs free only how large it may be, as an error."""
        found = self.drones.jet(rows, i, 3) * self.mass[i]
        if not self.cabled:
            return found
        formed = self.formed[rows.p].astype(float)
        leg, to = self.leg_to(rows, i), self.toward[i]
        moved = self.points.jet(rows, i, 1) - self.points.jet(rows, self.N + to, 1)
        pull, u, inverse = self.pull(rows, i), leg.unit(), leg.norm().inverse()
        turned = (moved - u * u.dot(moved)) * inverse
        gained = self.pulls.jet(rows, i, 1).part(0)
        if self.rho > 0.0:
            taut, half = self.taut(rows, i // 2), 0.5 * self.rho * G
            rate = _constant(taut.d, rows.r)  # at its middle; what is left of it is an error
            rate.e = rate.e + np.minimum(taut.s * rows.r, 2.0 * taut.a)
            gained = gained + (moved.part(2) * taut + leg.part(2) * rate) * half
            found = found + _upward((u.dot(moved) * taut + leg.norm() * rate) * (half * formed))
            other = i + 1 - 2 * (i % 2)
            hung = Hanging(self.point(rows, i), self.point(rows, other), self.length[i // 2]).pull()
            hung = hung * ((taut * -1.0 + 1.0) * (self.rho * G))
            found.e = found.e + np.where(taut.low < 1.0, hung.a, 0.0)
        return found + (u * gained + turned * pull) * formed

    def seen(self, rows, index, x):
        """Points x as body ``index`` sees them: turned back by its heading, from its base."""
        pose = self.poses.jet(rows, np.full(len(rows), index))
        if not np.any(self.moving[rows.p, index]):
            c, o = pose.v[:, 3:], x - _constant(pose.v[:, :3], rows.r)
            c = c / _size(c)[:, None]
            return _stacked(o.part(0) * c[:, 0] + o.part(1) * c[:, 1],
                            o.part(1) * c[:, 0] - o.part(0) * c[:, 1], o.part(2))  # fmt: skip
        o, head = x - pose.part(slice(0, 3)), pose.part(slice(3, 5)).unit()
        c, s = head.part(0), head.part(1)
        return _stacked(o.part(0) * c + o.part(1) * s, o.part(1) * c - o.part(0) * s, o.part(2))

    def centre(self, rows, index, k=0):
        """The k-th derivative of where a body's centre of mass is."""
        pose, (x, y, z) = (
            self.poses.jet(rows, np.full(len(rows), index), k),
            self.body(index).centre,
        )
        c, s = pose.part(3), pose.part(4)
        off = _stacked(c * x + s * -y, s * x + c * y, c * 0.0)
        return pose.part(slice(0, 3)) + off + (UP * z if k == 0 else 0.0 * UP)

    def body(self, index):
        return list(self.bodies.values())[index]

    def held(self, name, by=None):
        """(pieces,): whether phases hold a body."""
        return np.array(
            [bool(h) and h["object"] == name and by in (None, h["by"]) for h in self.hold]
        )


class Body:
    """An object: section between two heights, mass spread evenly, a rim if it has one."""

    def __init__(self, section, lower, upper, mass, friction, at, yaw, rim, fixed):
        self.section, self.lower, self.upper = Section(**section), float(lower), float(upper)
        self.mass, self.friction, self.fixed = float(mass), float(friction), bool(fixed)
        self.pose = np.array([*at, math.cos(yaw), math.sin(yaw)])
        self.rim = None if rim is None else Section(**rim["section"])
        self.height = 0.0 if rim is None else float(rim["height"])
        self.slabs = [Slab(self.section, self.lower, self.upper)]
        if rim is not None:
            self.slabs.append(Slab(self.rim, self.height, self.height))
        self.centre = np.append(self.section.centroid, 0.5 * (self.lower + self.upper))
        self.stem = None if rim is not None and self.height == self.lower else self.section


def _upward(x):
    return Jet(x.v[:, None] * UP, x.d[:, None] * UP, x.a, x.s, x.e, x.r)


def _in_frame(pose, x):
    """Points x (…, 3) as seen from bodies with poses (…, 5)."""
    o, c, s = x - pose[..., :3], pose[..., 3], pose[..., 4]
    return np.stack([c * o[..., 0] + s * o[..., 1], c * o[..., 1] - s * o[..., 0], o[..., 2]], -1)


# The limits: each yields rows, what bounds a quantity on them, and who is concerned.


def near(plan, pieces, first, second, allowed, limit):
    """Rows of pairs of bodies that may come near each other, an item ``i * count + j`` each.

    Bodies are hulls of points: indices (bodies, corners) of a Poly, which is given with them.
    """
    found = []
    (poly, a), (_, b) = first, second
    for p in pieces:
        rows = plan.rows([p], np.arange(poly.c[0].shape[1]))
        x = poly.jet(rows, rows.i)
        at, moved = x.v, x.spread
        centre = [np.mean(at[c], axis=1) for c in (a, b)]
        reach = [
            np.max(np.sqrt(np.sum((at[c] - m[:, None]) ** 2, -1)) + moved[c], 1)
            for c, m in zip((a, b), centre)
        ]
        apart = np.sqrt(np.sum((centre[0][:, None] - centre[1]) ** 2, -1))
        apart[~allowed] = np.inf
        found.append((apart, apart - reach[0][:, None] - reach[1]))
    least = max(min((np.min(f[0], initial=np.inf) for f in found), default=np.inf), 1.1 * limit)
    places = [np.nonzero(low.ravel() <= least)[0] for _, low in found]
    p = np.repeat(np.asarray(pieces, dtype=int), [len(i) for i in places])
    half = np.full(len(p), 0.5)
    return Rows(plan, p, half, half, np.concatenate([*places, np.zeros(0, int)]))


def distance(poly, a, b, count):
    """Bounds and values of distances of pairs: along the shortest way at mid span."""

    def make(rows):
        i, j = np.divmod(rows.i, count)
        one, two = ([poly.jet(rows, c) for c in body.T] for body in (a[i], b[j]))
        way = closest(one[0].v, one[-1].v, two[0].v, two[-1].v)
        n = _size(way)
        w = way / np.maximum(n, 1e-300)[:, None]
        return np.min([(x - y).along(w).low for x in one for y in two], axis=0), n

    return make


def norms(poly, k, scale=None):
    """Bounds and values of the norms of k-th derivatives."""

    def make(rows):
        x = poly.jet(rows, rows.i, k)
        n = _size(x.v)
        w = x.v / np.maximum(n, 1e-300)[:, None]
        across = np.minimum(x.a * rows.r, _size(x.d) * rows.r + 0.5 * x.s * rows.r**2)
        # |x| is at most its part along the middle's direction, and what leaves it: |x|² = p² + q².
        return np.hypot(x.along(w).high, across) + x.e if scale is None else scale, n

    return make


def limits_of(plan):
    """Yield (name, unit, sense, limit, rows, make, namer) of all limits in continuous time."""
    every, drones, lim, sep = np.arange(len(plan.h)), np.arange(plan.N), plan.limits, plan.sep
    formed, free = np.flatnonzero(plan.formed), np.flatnonzero(~plan.formed)
    ground = np.flatnonzero(plan.state == "on the ground")
    name = plan.names.__getitem__

    def cable(k):
        return f"cable {k}"

    scale = 0.5 / np.array([sep["radius"], sep["radius"], sep["height"]])
    scaled = Poly(plan.drones.c[0] * scale[:, None], plan.h)
    one = drones[:, None]
    pairs = drones[:, None] < drones
    if plan.N > 1:
        rows = near(plan, every, (scaled, one), (scaled, one), pairs, 1.0)
        two = lambda i: f"{name(i // plan.N)} {name(i % plan.N)}"
        yield "separation", "ratio", "min", 1.0, rows, distance(scaled, one, one, plan.N), two
    for k, key, unit in ((1, "speed", "m/s"), (2, "acceleration", "m/s²"), (3, "jerk", "m/s³")):
        most = lim[key] * (lim["reserve"] if k > 1 else 1.0)  # the rest is left for stops
        yield key, unit, "max", most, plan.rows(every, drones), norms(plan.drones, k), name

    def thrust(rows):
        f = plan.thrust(rows, rows.i)
        share = plan.max_thrust[rows.i]
        return f.most / share, _size(f.v) / share

    def tilt(rows):
        u = plan.thrust(rows, rows.i).unit().part(2)
        return tuple(np.degrees(np.arccos(np.clip(x, -1.0, 1.0))) for x in (u.low, u.v))

    def turning(rows):
        f, rate = plan.thrust(rows, rows.i), plan.thrust_rate(rows, rows.i)
        over = f.cross(rate) * f.dot(f).inverse()
        return np.degrees(over.most), np.degrees(_size(over.v))

    yield "thrust", "share", "max", 1.0, plan.rows(every, drones), thrust, name
    yield "tilt", "deg", "max", math.degrees(lim["tilt"]), plan.rows(every, drones), tilt, name
    if lim["body_rate"] is not None:
        most = math.degrees(lim["body_rate"])
        yield "body_rate", "deg/s", "max", most, plan.rows(every, drones), turning, name
    if plan.arena is not None:

        def walls(rows):
            x = plan.drones.jet(rows, rows.i)
            lower, upper = (np.array(plan.arena[k]) for k in ("lower", "upper"))
            inside = [x.part(k) - lower[k] for k in range(3)] + [
                -x.part(k) + upper[k] for k in range(3)
            ]
            return tuple(np.min([getattr(y, k) for y in inside], axis=0) for k in ("low", "v"))

        yield "arena", "m", "min", 0.0, plan.rows(every, drones), walls, name

    def out_of(slab, index=None):
        """A drone and a slab: level and upright distances, each along one way."""

        def make(rows):
            x = plan.point(rows, rows.i)
            x = x if index is None else plan.seen(rows, index, x)
            flat, way = slab.section.apart(x.v[:, :2])
            level = x.part(slice(0, 2)).along(way).low - slab.section.support(way)
            over = np.maximum(x.part(2).low - slab.upper, slab.lower - x.part(2).high)
            there = np.maximum(x.v[:, 2] - slab.upper, slab.lower - x.v[:, 2])
            return tuple(
                np.hypot(np.maximum(a, 0), np.maximum(b, 0))
                for a, b in ((level, over), (flat, there))
            )

        return make

    slabs = [(slab, None) for slab in plan.prisms]
    slabs += [(slab, k) for k, body in enumerate(plan.bodies.values()) for slab in body.slabs]
    for slab, index in slabs:
        yield (
            "keep_out",
            "m",
            "min",
            sep["radius"],
            plan.rows(every, drones),
            out_of(slab, index),
            name,
        )
    if not plan.cabled:
        return
    cables, n, N, P = np.arange(plan.n), plan.n, plan.N, plan.P
    first, last = N + plan.begin, N + plan.end
    parts = [(first, 2 * cables, 0), (first, last, 1), (last, 2 * cables + 1, 2)]
    if plan.bent:
        c = N + P + 2 * cables
        parts[1:2] = [(first, c, 1), (c, c + 1, 1), (c + 1, last, 1)]
    body = np.concatenate([np.stack([a, b], -1) for a, b, _ in parts])
    kind, owner = np.repeat([k for *_, k in parts], n), np.tile(cables, len(parts))
    exists = (kind == 1) | np.where(kind == 0, plan.leg[2 * owner], plan.leg[2 * owner + 1])
    body, kind, owner = body[exists], kind[exists], owner[exists]
    ends = [
        np.where(kind == 2, plan.end[owner], plan.begin[owner]),
        np.where(kind == 0, plan.begin[owner], plan.end[owner]),
    ]
    part = lambda j: f"{('q-leg', 'edge', 'r-leg')[kind[j]]} {owner[j]}"
    if len(formed):
        points, B = plan.points, len(body)
        allowed = (drones[:, None] // 2 != owner) | ((kind == 1) & plan.leg[:, None])
        rows = near(plan, formed, (points, one), (points, body), allowed, sep["cable"])
        both = lambda i: f"{name(i // B)} {cable(owner[i % B])}"
        yield (
            "cable_clearance",
            "m",
            "min",
            sep["cable"],
            rows,
            distance(points, one, body, B),
            both,
        )
        shared = (ends[0][:, None] == ends[0]) | (ends[0][:, None] == ends[1])
        shared |= (ends[1][:, None] == ends[0]) | (ends[1][:, None] == ends[1])
        allowed = ~shared & (np.arange(B)[:, None] < np.arange(B))
        rows = near(plan, formed, (points, body), (points, body), allowed, sep["crossing"])
        both = lambda i: f"{part(i // B)} {part(i % B)}"
        if np.any(allowed):
            yield (
                "crossing",
                "m",
                "min",
                sep["crossing"],
                rows,
                distance(points, body, body, B),
                both,
            )
        yield (
            "vertex_speed",
            "m/s",
            "max",
            lim["vertex_speed"],
            plan.rows(formed, np.arange(P)),
            norms(plan.vertices, 1),
            lambda i: f"p{i}",
        )
        hung = np.flatnonzero(plan.leg)

        def leg(rows):
            leg = plan.point(rows, rows.i) - plan.vertex(rows, plan.anchor[rows.i])
            n = _size(leg.v)
            return leg.along(leg.v / np.maximum(n, 1e-300)[:, None]).low, n

        yield (
            "legs",
            "m",
            "min",
            lim["leg"],
            plan.rows(formed, hung),
            leg,
            lambda i: f"leg of {name(i)}",
        )
        yield "cable_length", "1", "max", 1e-4, plan.rows(formed, cables), lengths(plan), cable
        yield from balance(plan, formed)
        yield from convexity(plan, formed)
    ramps = _ramps(plan)

    def tension(rows):
        x, (least, most) = plan.tensions.scalar(rows, rows.i), plan.range[rows.p, rows.i].T
        least = np.where(ramps[rows.p, rows.i], 0.0, least)
        return np.maximum(x.high - most, least - x.low), np.maximum(x.v - most, least - x.v)

    def pulls(rows):
        x, theta = plan.pulls.scalar(rows, rows.i), _wrap(plan, rows, rows.i)
        least, most = plan.range[rows.p, rows.i // 2].T
        least = np.where(ramps[rows.p, rows.i // 2], 0.0, least)
        low, here = (np.exp(plan.mu * np.maximum(y, 0.0)) for y in (theta.low, theta.v))
        return tuple(
            np.maximum(a - most * k, least / k - b)
            for a, b, k in ((x.high, x.low, low), (x.v, x.v, here))
        )

    if len(formed):
        yield "tension", "N", "max", 1e-4, plan.rows(formed, cables), tension, cable
        if plan.slid:
            yield "tension", "N", "max", 1e-4, plan.rows(formed, drones), pulls, name
    hanging = np.flatnonzero(~plan.formed & (plan.state != "on the ground"))
    flat = Poly(plan.drones.c[0][:, :, :2].copy(), plan.h)
    flat = Poly(np.concatenate([flat.c[0], 0.0 * flat.c[0][:, :, :1]], axis=2), plan.h)
    chord = np.stack([2 * cables, 2 * cables + 1], -1)
    spans = Poly(plan.drones.c[0][:, 1::2] - plan.drones.c[0][:, 0::2], plan.h)
    strange = drones[:, None] // 2 != cables
    if len(free):

        def span(rows):
            bound, n = norms(spans, 0)(rows)
            return bound / plan.length[rows.i], n / plan.length[rows.i]

        yield "span", "1", "max", 1.0, plan.rows(free, cables), span, cable
        clasped = np.zeros((n, n), bool)
        clasped[plan.clasps, plan.behind] = clasped[plan.behind, plan.clasps] = True
        loose = np.isin(plan.state, ("on the ground", "hanging free"))
        for pieces, allowed in ((np.flatnonzero(loose), cables[:, None] < cables),
                                (np.flatnonzero(~loose & ~plan.formed), (cables[:, None] < cables) & ~clasped)):  # fmt: skip
            if len(pieces) and np.any(allowed):
                rows = near(plan, pieces, (flat, chord), (flat, chord), allowed, sep["crossing"])
                both = lambda i: f"{cable(i // n)} {cable(i % n)}"
                yield (
                    "crossing",
                    "m",
                    "min",
                    sep["crossing"],
                    rows,
                    distance(flat, chord, chord, n),
                    both,
                )
    both = lambda i: f"{name(i // n)} {cable(i % n)}"
    if len(ground):
        rows = near(plan, ground, (flat, one), (flat, chord), strange, sep["cable"])
        yield (
            "cable_clearance",
            "m",
            "min",
            sep["cable"],
            rows,
            distance(flat, one, chord, n),
            both,
        )
    if len(hanging):

        def drop(rows):
            hung = plan.hanging(rows, rows.i)
            low = hung.lowest() - plan.floor
            return low - hung.moved, low

        def to_hanging(rows):
            i, k = np.divmod(rows.i, n)
            hung, x = plan.hanging(rows, k), plan.point(rows, i)
            at, off = hung.points()
            apart = to_links(x.v, at)
            return apart - off - hung.moved - x.spread, apart

        rows = _about(plan, hanging, strange, sep["cable"])
        yield "cable_clearance", "m", "min", sep["cable"], rows, to_hanging, both
        yield (
            "cable_clearance",
            "m",
            "min",
            sep["cable"],
            plan.rows(hanging, cables),
            drop,
            lambda k: f"ground {cable(k)}",
        )
        yield "strands", "m", "min", 1e-6, _about(plan, hanging, strange, 0.0), sheets(plan), both
        tight = np.flatnonzero(plan.state == "being tightened")
        if len(tight):
            yield (
                "cable_length",
                "1",
                "max",
                1e-4,
                plan.rows(tight, cables),
                lengths(plan, stored=False),
                cable,
            )
    if plan.bodies:
        yield from carried(plan, body, owner, kind)


def _about(plan, pieces, allowed, limit):
    """Rows of drones and foreign cables that hang within reach: a cable stays L / 2 about its middle."""
    found = []
    for p in pieces:
        x = plan.drones.jet(rows := plan.rows([p], np.arange(plan.N)), rows.i)
        middle, moved = 0.5 * (x.v[0::2] + x.v[1::2]), x.spread
        low = np.sqrt(np.sum((x.v[:, None] - middle) ** 2, -1)) - 0.5 * plan.length
        low -= moved[:, None] + np.maximum(moved[0::2], moved[1::2])
        found.append(np.nonzero((allowed & (low <= 2.0 * limit + 1e-3)).ravel())[0])
    p = np.repeat(np.asarray(pieces, dtype=int), [len(i) for i in found])
    half = np.full(len(p), 0.5)
    return Rows(plan, p, half, half, np.concatenate(found))


def sheets(plan):
    """Distances of drones to the upright sheets between foreign hanging cables and their chords."""

    def make(rows):
        i, k = np.divmod(rows.i, plan.n)
        hung, x = plan.hanging(rows, k), plan.point(rows, i)
        at, off = hung.points()
        ring = np.concatenate([at, at[:, :1]], axis=1)
        edge = to_links(x.v, ring)
        along = hung.off[:, :2] / np.maximum(_size(hung.off[:, :2]), 1e-9)[:, None]
        to = (x.v - hung.q)[:, :2]
        aside, u = along[:, 0] * to[:, 1] - along[:, 1] * to[:, 0], np.sum(to * along, -1)
        places = np.sum((at[..., :2] - hung.q[:, None, :2]) * along[:, None], -1)
        share = np.clip(u / np.maximum(hung.s, 1e-9), 0.0, 1.0)
        top = hung.q[:, 2] + share * hung.off[:, 2]
        low = np.array([np.interp(*y) for y in zip(u, places, at[..., 2])])
        within = (u > 0.0) & (u < hung.s) & (x.v[:, 2] < top) & (x.v[:, 2] > low)
        apart = np.where(within, np.abs(aside), edge)
        low = apart - off - hung.moved - x.spread  # told up to FAR only: nothing asks for more
        return np.minimum(low, FAR), np.clip(apart, 2e-6, FAR)

    return make


def lengths(plan, stored=True):
    """``|d + l + e - L| / L``, spans longer by ``(ρ g τ / T)² s³ cos² α / 24``; and stored legs."""
    saved = _rims(plan)[0]
    section = dict(enumerate(plan.bodies.values()))

    def make(rows):
        k = rows.i
        legs = [
            plan.point(rows, 2 * k + j) - plan.vertex(rows, plan.anchor[2 * k + j]) for j in (0, 1)
        ]
        spans = [*legs, plan.vertex(rows, plan.end[k]) - plan.vertex(rows, plan.begin[k])]
        straight = spans if not plan.bent else [*legs, *plan.edge(rows, k)]
        total = _total([x.norm() for x in straight]) + -plan.length[k]
        if plan.bent:
            c = plan.N + plan.P + 2 * k
            total = total + _arc(plan, rows, plan.point(rows, c), plan.point(rows, c + 1), section)
        if plan.rho > 0.0 and stored:
            x = plan.tensions.scalar(rows, k)
            least = plan.least[
                rows.p, k
            ]  # τ / T is 1 / T_stated up to that tension, 1 / T from there
            moves = np.where(x.high <= least, 0.0, 1.0)
            over = np.where(x.low >= least, 0.0, BIG * moves)
            zero, m = 0.0 * least, 1.0 / np.maximum(x.low, least)
            slope = np.where(x.v >= least, -x.d * m**2, 0.0) * moves
            s = (2.0 * x.a**2 * m**3 + x.s * m**2) * moves + over
            factor = Jet(
                1.0 / np.maximum(x.v, least), slope, x.a * m**2 * moves, s, zero, rows.r
            ) * (plan.rho * G)
            factor = factor * factor * (1.0 / 24.0)
            chords = [*legs, _total(straight[2:])] if plan.bent else spans
            sizes = [x.norm() for x in chords[:2]] + [_total([x.norm() for x in straight[2:]])]
            level = [y.part(slice(0, 2)) for y in chords]
            total = total + _total([y.dot(y) * size for y, size in zip(level, sizes)]) * factor
        if saved is not None:
            share = _total([plan.borne.scalar(rows, np.full(len(k), j)) * saved[j][rows.p, k] ** 0.5
                            for j in range(len(plan.bodies))])  # fmt: skip
            total = total - share * share
        if not stored:
            return total.high / plan.length[k], np.maximum(total.v, 0.0) / plan.length[k]
        errors = [total]
        for j in (0, 1):
            errors.append(legs[j].norm() - plan.legs.scalar(rows, 2 * k + j))
        bound = np.max([np.maximum(x.high, -x.low) for x in errors], axis=0)
        return bound / plan.length[k], np.max([np.abs(x.v) for x in errors], axis=0) / plan.length[
            k
        ]

    return make


def _arc(plan, rows, first, last, bodies):
    """Lengths of edges on what they are wrapped around: ``2 R asin(s / 2 R)``, or sides of polygons."""
    chord = (last - first).norm()
    found = _constant(np.zeros(len(rows)), rows.r)
    for index, body in bodies.items():
        on = plan.held(list(plan.bodies)[index], "grip")[rows.p]
        if not np.any(on):
            continue
        if body.section.round:
            R = body.section.radius
            x, most = np.minimum(chord.v / (2 * R), 1.0), np.minimum(chord.high / (2 * R), 1.0)
            slope = 1.0 / np.sqrt(np.maximum(1.0 - most**2, 1e-12))
            s = slope * chord.s + most * slope**3 * chord.a**2 / (2 * R)
            here = 1.0 / np.sqrt(np.maximum(1.0 - x**2, 1e-12))
            arc = Jet(
                2 * R * np.arcsin(x), here * chord.d, slope * chord.a, s, slope * chord.e, rows.r
            )
        else:
            core = body.section.core
            ring = np.append(0.0, np.cumsum(_size(np.roll(core, -1, 0) - core)))
            places = [plan.seen(rows, index, x).v[:, :2] for x in (first, last)]
            at = [np.argmin(np.sum((x[:, None] - core) ** 2, -1), axis=1) for x in places]
            sides = np.where(chord.v < 1e-9, 0.0, (ring[at[1]] - ring[at[0]]) % ring[-1])
            arc = _constant(sides, rows.r)
        found = found + arc * on.astype(float)
    return found


class Least:
    """A quantity of which only bounds and the value at mid span are known."""

    def __init__(self, low, v, high=None):
        self.low, self.v, self.high = low, v, high


def _angle(a, b):
    """Angle between vectors [rad], by the cosine of their directions."""
    c = a.unit().dot(b.unit())
    return Least(*(np.arccos(np.clip(x, -1.0, 1.0)) for x in (c.high, c.v, c.low)))


def _wrap(plan, rows, i):
    """Angle by which cables turn at the clasp of drone i, from its leg to its edge [rad]."""
    leaving, arriving = plan.edge(rows, i // 2)
    q = (i % 2 == 0)[:, None]
    v, d = np.where(q, leaving.v, -arriving.v), np.where(q, leaving.d, -arriving.d)
    away = Jet(
        v, d, *(np.where(q[:, 0], getattr(leaving, k), getattr(arriving, k)) for k in "ase"), rows.r
    )
    return _angle(-plan.leg_to(rows, i), away)


def _ramps(plan):
    """(pieces, n): where tensions rise from 0 or fall to it, at rest next to a span without a hitch."""
    still = plan.formed.copy()
    for part in (plan.drones, plan.vertices):
        still &= np.max(np.ptp(part.c[0], axis=-1), axis=(1, 2)) <= STILL
    c, ramps = plan.tensions.c[0][:, :, 0], np.zeros((len(plan.h), plan.n), bool)
    for order, end in ((range(len(still)), -1), (range(len(still))[::-1], 0)):
        for k in range(plan.n):
            inside, run = False, []
            for p in order:
                before = p - 1 if end else p + 1
                if not still[p]:
                    inside, run = False, []
                    continue
                if 0 <= before < len(still) and not plan.formed[before]:
                    inside, run = True, []
                if inside:
                    run.append(p)
                    if plan.team[k] - c[p, k, end] <= 1e-4:
                        ramps[run, k], inside = True, False
    return ramps


def _rims(plan):
    """What rims save cables of their legs (bodies, pieces, n) [m], and take of edges' pulls, and drops.

    A rim on the clasps of mass m bends legs: below it they run level, beyond it they rise with
    ``sin α = W / (2 Σ T)``, W the weight of body and edges. Level parts, ``l`` of each leg, save
    ``l (1 / cos α - 1)``, and the rim takes ``1 - cos α`` of the edges' pulls; vertices are
    ``tan α`` times the mean l below it. All of it is that of a piece's beginning, times the square
    of the share that is borne (the drop: at its whole weight).
    """
    m, n = len(plan.h), plan.n
    saved, taken, drop = (
        np.zeros((len(plan.bodies), m, n)),
        np.zeros((len(plan.bodies), m)),
        np.zeros((len(plan.bodies), m)),
    )
    if not plan.closed or not plan.bodies:
        return None, taken, drop
    x, T = plan.vertices.c[0][..., 0], plan.tensions.c[0][:, :, 0, 0]
    size = np.sqrt(np.sum((np.roll(x, -1, 1) - x) ** 2, -1))
    for j, (name, body) in enumerate(plan.bodies.items()):
        on = plan.held(name, "rest") & np.any(plan.borne.c[0][:, j, 0] != 0.0, -1)
        for p in np.flatnonzero(on):
            lean = min(G * (body.mass + plan.rho * np.sum(size[p])) / (2.0 * np.sum(T[p])), 1.0)
            taken[j, p] = 1.0 - math.sqrt(1.0 - lean**2)
            if body.rim is None:
                continue
            at = _in_frame(plan.poses.c[0][p, j, :, 0], x[p])[:, :2]
            u = np.roll(at, -1, 0) - at
            u /= _size(u)[:, None]
            onward, back = _reach(body.rim, np.roll(at, -1, 0), u), _reach(body.rim, at, -u)
            saved[j, p] = (np.roll(onward, 1) + np.roll(back, -1)) * (
                1.0 / math.sqrt(max(1.0 - lean**2, 1e-12)) - 1.0
            )
            drop[j, p] = np.mean(onward + back) * 0.5 * math.tan(math.asin(lean))
    return (saved if np.any(saved) else None), taken, drop


def _reach(section, x, u):
    """How far it is from points inside of a section to its edge along unit vectors."""
    if section.round:
        along = np.sum(x * u, -1)
        return np.sqrt(np.maximum(section.radius**2 - np.sum(x * x, -1) + along**2, 0.0)) - along
    depth, speed = np.sum(section.out * section.core, -1) - x @ section.out.T, u @ section.out.T
    return np.min(np.where(speed > 0.0, depth / np.where(speed > 0.0, speed, 1.0), np.inf), -1)


def balance(plan, formed):
    """``P q̂_k + T_k u_k + P' r̂_{k-1} - T_{k-1} u_{k-1} - W_k ẑ + w_k = 0`` at every clasp.

    ``W_k = τ (½ g load + ½ ρ g (L - other leg))`` of both cables; ``w_k = -m μ_k (a_k + g b ẑ) + m h
    (G_k·a) ẑ`` of what rests on clasps, b the share that is borne, μ and G the least squares' shares
    of its mass and of moments. Clasps bear: ``C = W^k ẑ - (P q̂_k + T_k u_k) - ½ w_k`` has ``C·q̂_k <
    0``, ``C·u_k < 0``, ``C·r̂_{k-1} > 0``, ``C·u_{k-1} < 0``. Legs pull with e^{±μθ} T at most and least.
    """
    taken = _rims(plan)[1]
    resting = []
    for j, (name, body) in enumerate(plan.bodies.items()):
        on = plan.held(name, "rest") & np.any(plan.borne.c[0][:, j, 0] != 0.0, -1)
        gains = np.zeros((len(plan.h), len(plan.clasps), 3))
        for p in np.flatnonzero(on):
            at = _in_frame(plan.poses.c[0][p, j, :, 0], plan.vertices.c[0][p, plan.clasps, :, 0])
            gains[p] = np.linalg.pinv(
                np.column_stack([np.ones(len(at)), at[:, :2] - body.centre[:2]])
            ).T
        resting.append((on, gains))
    bearing = plan.rho > 0.0 or np.any(plan.load) or any(np.any(on) for on, _ in resting)

    def forces(rows):
        c = rows.i
        k, b = plan.clasps[c], plan.behind[c]
        edge, arriving = plan.edge(rows, k)[0], plan.edge(rows, b)[1]
        units = [
            plan.leg_to(rows, 2 * k).unit(),
            edge.unit(),
            plan.leg_to(rows, 2 * b + 1).unit(),
            arriving.unit(),
        ]
        less = _constant(np.ones(len(c)), rows.r)
        for j, (on, _) in enumerate(resting):
            if np.any(on[rows.p]):
                share = plan.borne.scalar(rows, 0 * c + j)
                less = less - share * share * taken[j][rows.p]
        T, T_b = (plan.tensions.scalar(rows, i) for i in (k, b))
        pulls = [plan.pull(rows, 2 * k), T * less, plan.pull(rows, 2 * b + 1), T_b * less]
        weights, pressed = [], None
        for cable, other in ((k, 2 * k + 1), (b, 2 * b)):
            if plan.rho == 0.0 and not np.any(plan.load):
                break
            leg = (plan.point(rows, other) - plan.vertex(rows, plan.anchor[other])).norm()
            used = leg * -plan.leg[other].astype(float) + plan.length[cable]
            weights.append(
                plan.taut(rows, cable) * (used * (0.5 * plan.rho * G) + 0.5 * G * plan.load[c])
            )
        for j, ((on, gains), body) in enumerate(zip(resting, plan.bodies.values())):
            if not np.any(on[rows.p]):
                continue
            gain, moves = gains[rows.p, c], (on & plan.moving[:, j])[rows.p].astype(float)
            share = plan.borne.scalar(rows, 0 * c + j)
            w = plan.vertices.jet(rows, k, 2) * moves + _upward(share * (G * on[rows.p]))
            w = w * (-body.mass * gain[:, 0])
            a, pose = plan.centre(rows, j, 2), plan.poses.jet(rows, 0 * c + j)
            co, si = pose.part(3), pose.part(4)
            x, y = a.part(0) * co + a.part(1) * si, a.part(1) * co - a.part(0) * si
            h = (body.centre[2] - body.height) * body.mass * moves
            w = w + _upward((x * gain[:, 1] + y * gain[:, 2]) * h)
            pressed = w if pressed is None else pressed + w
        return units, pulls, weights, pressed

    def residual(rows):
        units, pulls, weights, pressed = forces(rows)
        lacking = _total(
            [u * p if i < 3 else u * (-p) for i, (u, p) in enumerate(zip(units, pulls))]
        )
        for w in weights:
            lacking = lacking - _upward(w)
        lacking = lacking if pressed is None else lacking + pressed
        weakest = [np.minimum(getattr(pulls[1], s), getattr(pulls[3], s)) for s in ("low", "v")]
        over = [np.maximum(x, WEAK) for x in weakest]
        return lacking.most / over[0], _size(lacking.v) / over[1]

    def contact(rows):
        units, pulls, weights, pressed = forces(rows)
        C = -(units[0] * pulls[0] + units[1] * pulls[1])
        C = C + _upward(weights[0]) if weights else C
        C = C if pressed is None else C - pressed * 0.5
        products = [C.dot(units[i]) * sign for i, sign in enumerate((1.0, 1.0, -1.0, 1.0))]
        low, v, high = (
            np.minimum(getattr(pulls[1], s), getattr(pulls[3], s)) for s in ("low", "v", "high")
        )
        bound, value = (np.max([getattr(p, s) for p in products], axis=0) for s in ("high", "v"))
        bound = bound / np.maximum(np.where(bound < 0.0, high, low), WEAK) ** 2
        return np.where(high < WEAK, -1.0, bound), np.where(
            v < WEAK, -1.0, value / np.maximum(v, WEAK) ** 2
        )

    def friction(rows):
        theta, x = _wrap(plan, rows, rows.i), plan.pulls.scalar(rows, rows.i)
        T = plan.tensions.scalar(rows, rows.i // 2)
        wraps = plan.leg[rows.i]
        found = []
        for s, high, low in (("low", "high", "low"), ("v", "v", "v")):
            k = np.exp(plan.mu * np.where(wraps, np.maximum(getattr(theta, s), 0.0), 0.0))
            over = np.maximum(
                (x + T * -k).__getattribute__(high), (T * (1.0 / k) - x).__getattribute__(high)
            )
            found.append(over / np.maximum(getattr(T, low), WEAK))
        return tuple(found)

    clasps = np.arange(len(plan.clasps))
    at = lambda c: f"p{plan.clasps[c]}"
    yield "equilibrium", "1", "max", 5e-3, plan.rows(formed, clasps), residual, at
    if bearing:
        yield "contact", "1", "max", 0.0, plan.rows(formed, clasps), contact, at
    if plan.slid:
        yield (
            "equilibrium",
            "1",
            "max",
            5e-3,
            plan.rows(formed, np.arange(2 * plan.n)),
            friction,
            lambda i: f"leg of {plan.names[i]}",
        )


def convexity(plan, formed):
    """Exterior angles seen from above are positive; a closed outline turns once around, a chain less."""

    def sides(rows, c):
        a = plan.vertex(rows, plan.clasps[c]) - plan.vertex(rows, plan.begin[plan.behind[c]])
        b = plan.vertex(rows, plan.end[plan.clasps[c]]) - plan.vertex(rows, plan.clasps[c])
        return (x.part(slice(0, 2)).unit() for x in (a, b))

    def angle(rows, c=None):
        a, b = sides(rows, rows.i if c is None else c)
        sine = a.part(1) * b.part(0) - a.part(0) * b.part(1)
        cosine = a.dot(b)
        lows = [np.degrees(np.arctan2(s, cosine.high)) for s in (sine.low, sine.high)]
        low = np.where(
            sine.low > 0.0, np.minimum(*lows), np.where(cosine.low > 0.0, lows[0], -180.0)
        )
        return low, np.degrees(np.arctan2(sine.v, cosine.v))

    def room(rows):
        found, turn = 360.0 + 0.0 * rows.x, 0.0 * rows.x
        for c in range(len(plan.clasps)):
            a, b = sides(rows, c + 0 * rows.i)
            found -= angle(rows, c + 0 * rows.i)[1]
            turn += np.degrees(a.a + b.a) * rows.r
        if plan.closed:  # the number of turns cannot change while all angles are between 0 and 180
            found = -np.abs(found)
            return np.where(found > -1.0, 0.0, found), np.where(found > -1.0, 0.0, found)
        return found - turn, found

    clasps = np.arange(len(plan.clasps))
    yield (
        "convexity",
        "deg",
        "min",
        0.0,
        plan.rows(formed, clasps),
        angle,
        lambda c: f"p{plan.clasps[c]}",
    )
    yield "convexity", "turn", "min", 0.0, plan.rows(formed, [0]), room, lambda _: "whole outline"


def carried(plan, body, owner, kind):
    """Limits of objects: cables and held objects keep off, grips hold, rims are on their clasps."""
    names, sep = list(plan.bodies), plan.sep["object"]
    every, drops = np.arange(len(plan.h)), _rims(plan)[2]
    formed, free = np.flatnonzero(plan.formed), np.flatnonzero(~plan.formed)
    bodies = list(plan.bodies.values())
    for j, each in enumerate(bodies):
        gripped, resting = plan.held(names[j], "grip"), plan.held(names[j], "rest")
        holding = np.zeros((len(every), plan.n), bool)
        for p in np.flatnonzero(gripped | resting):
            holding[p, plan.hold[p]["cables"]] = True

        def apart(slab, shift, j=j):
            def make(rows):
                ends = [plan.seen(rows, j, plan.point(rows, i)) for i in body[rows.i].T]
                n, way = slab.from_segment(ends[0].v, ends[1].v)
                # The direction is the middle's; what the nearest place misses of it is no rate.
                return np.min([x.along(way).low for x in ends], axis=0) - slab.support(
                    way
                ) - shift, n - shift

            return make

        who = lambda i, j=j: f"cable {owner[i]} {names[j]}"
        if len(formed):
            for slab in each.slabs:
                rows = plan.rows(formed, np.arange(len(body)))
                yield (
                    "object_clearance",
                    "m",
                    "min",
                    sep,
                    rows.take(~holding[rows.p, owner[rows.i]]),
                    apart(slab, 0.0),
                    who,
                )
            rows = plan.rows(formed, np.arange(len(body)))
            outside = holding[rows.p, owner[rows.i]] & (~gripped[rows.p] | (kind[rows.i] != 1))
            if each.stem is not None and np.any(outside):
                yield "enters", "m", "min", 2e-5, rows.take(outside), apart(each.slabs[0], 0.0), who

        def below(rows, j=j, each=each):
            hung = plan.hanging(rows, rows.i)
            ends = [plan.seen(rows, j, plan.point(rows, 2 * rows.i + k)) for k in (0, 1)]
            flat = [x.v * [1.0, 1.0, 0.0] for x in ends]
            best = []
            for slab in each.slabs:
                n, way = Slab(slab.section, -1e3, 1e3).from_segment(*flat)
                aside = np.min([x.along(way).low for x in ends], axis=0) - slab.section.support(
                    way[:, :2]
                )
                over = hung.lowest() - plan.poses.c[0][rows.p, j, 2, 0] - slab.upper
                over = np.where(plan.state[rows.p] == "on the ground", -1.0, over)
                best.append([np.maximum(aside, over - hung.moved), np.maximum(n, over)])
            return tuple(np.min([b[i] for b in best], axis=0) for i in (0, 1))

        if len(free):
            who_free = lambda k, j=j: f"cable {k} {names[j]}"
            yield (
                "object_clearance",
                "m",
                "min",
                sep,
                plan.rows(free, np.arange(plan.n)),
                below,
                who_free,
            )
        if np.any(plan.moving[:, j]):
            yield from _off_others(plan, j)
        on = np.flatnonzero(
            resting & (plan.moving[:, j] | np.any(plan.borne.c[0][:, j, 0] != 0.0, -1))
        )
        if len(on) and plan.closed and each.rim is not None:
            yield from _resting(plan, j, on, drops[j])
        if np.any(gripped) and plan.bent:
            yield from _gripped(plan, j, np.flatnonzero(gripped))
    held = np.flatnonzero([h is not None for h in plan.hold])
    if len(held):

        def height(rows):
            z = plan.point(rows, rows.i).part(2)
            return z.low - plan.floor, z.v - plan.floor

        yield (
            "enters",
            "m",
            "min",
            -2e-5,
            plan.rows(held, np.arange(plan.points.c[0].shape[1])),
            height,
            lambda i: f"point {i} ground",
        )
    if plan.bent:
        grips = np.any([plan.held(name, "grip") for name in names], axis=0)

        def straight(rows):
            a, b = (x.unit() for x in plan.edge(rows, rows.i))
            chord = plan.point(rows, plan.N + plan.P + 2 * rows.i) - plan.point(
                rows, plan.N + plan.P + 2 * rows.i + 1
            )
            return np.maximum(a.cross(b).most, chord.most), np.maximum(
                _size(np.cross(a.v, b.v)), _size(chord.v)
            )

        yield (
            "grip",
            "bend",
            "max",
            2 * WRAPPED,
            plan.rows(np.flatnonzero(plan.formed & ~grips), np.arange(plan.n)),
            straight,
            lambda k: f"edge {k}",
        )


def _off_others(plan, j):
    """What is carried keeps off all else, and the ground, but what it rises from or goes down to."""
    each, names = plan.body(j), list(plan.bodies)
    c = plan.poses.c[0]
    upright = np.max(np.ptp(c[:, j], axis=-1)[:, [0, 1, 3, 4]], axis=-1) <= TOUCH
    runs = np.cumsum(~upright)
    allowed = np.zeros((len(plan.h), len(names) + 1), bool)
    for run in np.unique(runs):
        pieces = np.flatnonzero((runs == run) & upright)
        for p, k in ((p, k) for p in pieces for k in (0, -1)):
            under, top = _below(plan, j, c[p, :, :, k])
            if abs(c[p, j, 2, k] + each.lower - top) <= TOUCH or (k == 0 and p == 0):
                allowed[pieces, under] = True
    ground = np.flatnonzero(plan.moving[:, j])

    def height(rows):
        z = plan.poses.jet(rows, 0 * rows.i + j).part(2) + (each.lower - plan.floor)
        return _touching(allowed[rows.p, -1], z.low, z.v, z.low, z.v)

    yield (
        "object_clearance",
        "m",
        "min",
        plan.sep["object"],
        plan.rows(ground, [0]),
        height,
        lambda _: f"{names[j]} ground",
    )
    for o, (name, other) in enumerate(plan.bodies.items()):
        for slab in each.slabs if o != j else ():
            for block in other.slabs:

                def gap(rows, o=o, slab=slab, block=block):
                    pose = plan.poses.jet(rows, 0 * rows.i + j)
                    head, base = pose.part(slice(3, 5)).unit(), pose.part(slice(0, 3))
                    corners = []
                    for x, y in slab.section.core:
                        at = _stacked(
                            head.part(0) * x + head.part(1) * -y,
                            head.part(1) * x + head.part(0) * y,
                            head.part(0) * 0.0,
                        )
                        corners.append(plan.seen(rows, o, base + at))
                    flat = [x.part(slice(0, 2)) for x in corners]
                    ways = [block.section.apart(x.v)[1] for x in flat]
                    ring = np.stack([x.v for x in flat], 1)
                    sides = np.roll(ring, -1, 1) - ring
                    ways += [
                        np.stack([sides[:, k, 1], -sides[:, k, 0]], -1)
                        / np.maximum(_size(sides[:, k]), 1e-12)[:, None]
                        for k in range(len(flat))
                    ]
                    room = [
                        np.min([np.sum(x.v * w, -1) for x in flat], 0)
                        - block.section.support(w)
                        - slab.section.radius
                        for w in ways
                    ]
                    best = np.argmax(room, axis=0)
                    w, there = np.stack(ways)[best, np.arange(len(rows))], np.max(room, axis=0)
                    aside = (
                        np.min([x.along(w).low for x in flat], 0)
                        - block.section.support(w)
                        - slab.section.radius
                    )
                    z, tall = corners[0].part(2), slab.upper - slab.lower
                    z = z + slab.lower
                    over = [
                        np.maximum(a - block.upper, block.lower - tall - b)
                        for a, b in ((z.low, z.high), (z.v, z.v))
                    ]
                    gaps = (
                        np.hypot(np.maximum(a, 0), np.maximum(b, 0))
                        for a, b in ((aside, over[0]), (there, over[1]))
                    )
                    return _touching(
                        allowed[rows.p, o], z.low - block.upper, z.v - block.upper, *gaps
                    )

                yield (
                    "object_clearance",
                    "m",
                    "min",
                    plan.sep["object"],
                    plan.rows(ground, [0]),
                    gap,
                    lambda _, name=name: f"{names[j]} {name}",
                )


def _touching(may, low, here, bound, value):
    """Bounds and values of distances, far where bodies may touch and do not enter each other."""
    free = may & (low >= -2.0 * TOUCH)
    return np.where(free, 1e3, bound), np.where(free | (may & (here >= -TOUCH)), 1e3, value)


def _below(plan, j, poses):
    """The index of what is under a body's centre of mass (-1: the ground), and how high that is."""
    c = poses[j]
    x, y, z = plan.body(j).centre
    centre = c[:3] + [c[3] * x - c[4] * y, c[4] * x + c[3] * y, z]
    found = -1, plan.floor
    for o, body in enumerate(plan.bodies.values()):
        top = poses[o, 2] + body.upper
        if o != j and found[1] < top <= centre[2] + TOUCH:
            if body.section.apart(_in_frame(poses[o], centre)[None, :2])[0][0] <= 0.0:
                found = o, top
    return found


def _resting(plan, j, on, drops):
    """The rim's clasps keep their places, friction carries it along, its force line is between them."""
    body, clasps = plan.body(j), np.arange(plan.n)
    place = _in_frame(plan.poses.c[0][:, j, None, :, 0], plan.vertices.c[0][..., 0])
    whole = np.all(plan.borne.c[0][:, j, 0] == 1.0, axis=-1)
    name = lambda k: f"p{k} {list(plan.bodies)[j]}"

    def off(rows):
        x = plan.seen(rows, j, plan.vertex(rows, rows.i))
        at = place[rows.p, rows.i]
        flat = x.part(slice(0, 2)) + -at[:, :2]
        drop = drops[rows.p]
        deep = (x.part(2) * -1.0) + (body.height - drop)
        high = x.part(2) + (np.where(whole[rows.p], drop, 0.0) - body.height)
        inside = np.where(body.rim.apart(at[:, :2])[0] < -CONTACT, 0.0, 1.0)
        return tuple(
            np.max([a, b, c, inside], axis=0)
            for a, b, c in ((flat.most, deep.high, high.high), (_size(flat.v), deep.v, high.v))
        )

    def slides(rows):
        a = plan.vertices.jet(rows, rows.i, 2)
        flat, up = a.part(slice(0, 2)), a.part(2)
        return body.friction * (G + up.low) - flat.most, body.friction * (G + up.v) - _size(flat.v)

    def line(rows):
        k = rows.i
        side = place[rows.p, (k + 1) % plan.n, :2] - place[rows.p, k, :2]
        w = np.stack([side[:, 1], -side[:, 0]], -1) / _size(side)[:, None]
        x = plan.seen(rows, j, plan.vertex(rows, k)).part(slice(0, 2))
        a, head = plan.centre(rows, j, 2), plan.poses.jet(rows, 0 * k + j)
        c, s = head.part(3), head.part(4)
        turned = _stacked(a.part(0) * c + a.part(1) * s, a.part(1) * c - a.part(0) * s).along(w)
        lean = turned * (a.part(2) + G).inverse() * (body.centre[2] - body.height)
        found = x.along(w) * -1.0 + np.sum(w * body.centre[:2], -1) - lean
        return found.low - 2 * CONTACT, found.v - 2 * CONTACT

    yield "rim", "m", "max", CONTACT, plan.rows(on, clasps), off, name
    yield "rim", "m/s²", "min", 0.0, plan.rows(on, clasps), slides, name
    lifted = on[whole[on]]
    if len(lifted):
        yield "support", "m", "min", 0.0, plan.rows(lifted, clasps), line, name


def _gripped(plan, j, pieces):
    """Slip load over load, ``μ Σ T_k e^{-μ' β} θ_k`` to ``m (b (g + a_z) + α R² / r)``; forces balance."""
    body, n, name = plan.body(j), plan.n, list(plan.bodies)[j]
    borne = plan.borne.c[0][:, j, 0]
    lifted = np.all(borne == 1.0, axis=-1)
    away = _size(body.section.core - body.section.centroid)
    arm = body.section.radius or float(np.min(away))
    reach = (float(np.max(away)) + body.section.radius) ** 2 / arm
    around = float(np.max(_size(body.section.core))) + body.section.radius

    def ratio(rows):
        slip = [0.0 * rows.x, 0.0 * rows.x]
        for k in range(n):
            i = k + 0 * rows.i
            leaving, arriving = plan.edge(rows, i)
            theta = _angle(leaving.part(slice(0, 2)), arriving.part(slice(0, 2)))
            beta = [_wrap(plan, rows, 2 * i), _wrap(plan, rows, 2 * i + 1)]
            T = [plan.pulls.scalar(rows, 2 * i), plan.pulls.scalar(rows, 2 * i + 1)]
            for s, way, most in ((0, "low", "high"), (1, "v", "v")):
                least = np.minimum(*(getattr(x, way) for x in T))
                worst = np.maximum(*(getattr(x, most) for x in beta))
                slip[s] = slip[s] + body.friction * least * np.exp(-plan.mu * worst) * getattr(
                    theta, way
                )
        pose = plan.poses.jet(rows, 0 * rows.i + j, 2)
        share = plan.borne.scalar(rows, 0 * rows.i + j)
        up, turn = pose.part(2), pose.part(slice(3, 5))
        load = [body.mass * (b * np.maximum(G + a, 0.0) + t * reach) for b, a, t in
                ((share.high, up.high, turn.most), (share.v, up.v, _size(turn.v)))]  # fmt: skip
        return tuple(np.where(w > 1e-9, s / np.maximum(w, 1e-9), 1e6) for s, w in zip(slip, load))

    def lacking(rows):
        zero = 0 * rows.i
        up = lifted[rows.p].astype(float)
        share, centre = plan.borne.scalar(rows, zero + j), plan.centre(rows, j)
        force = plan.centre(rows, j, 2) * (-body.mass * up) - _upward(share * (body.mass * G))
        moment, weakest = None, [BIG, BIG]
        for k in range(n):
            i = zero + k
            leaving, arriving = plan.edge(rows, i)
            T = plan.tensions.scalar(rows, i)
            weakest = [np.minimum(weakest[0], T.low), np.minimum(weakest[1], T.v)]
            for s, u in ((0, -(leaving.unit() * T)), (1, arriving.unit() * T)):
                arm = plan.point(rows, plan.N + plan.P + 2 * i + s) - centre
                force = force + u
                moment = arm.cross(u) if moment is None else moment + arm.cross(u)
        found = []
        for way, size in (("high", lambda x: x.most), ("v", lambda x: _size(x.v))):
            held = (
                body.friction
                * body.mass
                * G
                * (1.0 - getattr(share, "high" if way == "high" else "v"))
            )
            level = np.maximum(
                np.maximum(size(force.part(slice(0, 2))) - held, 0.0), size(force.part(2))
            )
            found.append(np.where(up > 0.0, np.maximum(size(force), size(moment) / around), level))
        return found[0] / np.maximum(weakest[0], WEAK), found[1] / np.maximum(weakest[1], WEAK)

    def wrapped(rows):
        ends, bound, value = [], [], []
        start, last = (
            plan.seen(rows, j, plan.vertex(rows, x[rows.i])) for x in (plan.begin, plan.end)
        )
        ends = [
            plan.seen(rows, j, plan.point(rows, plan.N + plan.P + 2 * rows.i + s)) for s in (0, 1)
        ]
        leaving, arriving = plan.edge(rows, rows.i)
        bend = _size(np.cross(leaving.v, arriving.v)) / np.maximum(
            _size(leaving.v) * _size(arriving.v), 1e-12
        )
        straight = (_size(ends[1].v - ends[0].v) <= WRAPPED) & (bend <= 2 * WRAPPED)
        for x in ends:
            core = x.part(slice(0, 2))
            if body.section.round:
                r = core.norm() + -body.section.radius
                pair = np.maximum(r.high, -r.low), np.abs(r.v)
            else:
                k = np.argmin(np.sum((x.v[:, None, :2] - body.section.core) ** 2, -1), axis=1)
                r = core + -body.section.core[k]
                pair = r.most, _size(r.v)
            outside = np.maximum(body.lower - x.part(2).low, x.part(2).high - body.upper)
            bound.append(np.where(straight, 0.0, np.maximum(pair[0], outside)))
            value.append(np.where(straight, 0.0, pair[1]))
        for a, b in ((start, ends[0]), (ends[1], last)):
            way = (b - a).part(slice(0, 2))
            u = way.unit()
            for corner in body.section.core:
                to = a.part(slice(0, 2)) * -1.0 + corner
                left = u.part(0) * to.part(1) - u.part(1) * to.part(0) + body.section.radius
                gone = way.most <= WRAPPED
                bound.append(np.where(gone, 0.0, left.high))
                value.append(np.where(gone, 0.0, left.v))
        return np.max(bound, axis=0), np.max(value, axis=0)

    some = pieces[np.any(borne[pieces] > 0.0, axis=-1)]
    if len(some):
        yield "grip", "1", "min", 1.5, plan.rows(some, [0]), ratio, lambda _: name
    yield "equilibrium", "1", "max", 5e-3, plan.rows(pieces, [0]), lacking, lambda _: name
    yield (
        "grip",
        "wrap",
        "max",
        3 * WRAPPED,
        plan.rows(pieces, np.arange(n)),
        wrapped,
        lambda k: f"edge {k} {name}",
    )


# What is told of single times, of joints, and of the story: (name, unit, sense, limit, value, time, where).


def joints(plan):
    """Jumps where pieces meet: positions, velocities, accelerations; tensions, pulls, thrusts."""
    parts = [(plan.drones, plan.names, None), (plan.poses, list(plan.bodies), None)]
    if plan.cabled:
        parts += [(plan.vertices, [f"p{i}" for i in range(plan.P)], plan.formed)]
        parts += [(plan.legs, [f"leg of {x}" for x in plan.names], plan.formed)]
    worst = (0.0, 0.0, "")
    for part, names, on in parts:
        for k in range(3):
            c = part.c[k]
            if len(c) < 2 or not c.shape[1]:
                continue
            jump = np.sqrt(np.sum((c[1:, ..., 0] - c[:-1, ..., -1]) ** 2, -1))
            if on is not None:
                jump[~(on[1:] & on[:-1])] = 0.0
            p, i = np.unravel_index(np.argmax(jump), jump.shape)
            worst = max(worst, (float(jump[p, i]), float(plan.breaks[p + 1]), names[i]))
    yield ("continuity", "m", "max", 1e-6, *worst)
    if not plan.cabled:
        return
    inner = np.arange(1, len(plan.h))
    worst = (0.0, 0.0, "")
    for part, names in (
        (plan.tensions, [f"cable {k}" for k in range(plan.n)]),
        (plan.pulls, plan.names),
    ):
        c = np.where(plan.formed[:, None, None], part.c[0][:, :, 0], 0.0)
        jump = np.abs(c[1:, :, 0] - c[:-1, :, -1])
        if jump.size:
            p, i = np.unravel_index(np.argmax(jump), jump.shape)
            worst = max(worst, (float(jump[p, i]), float(plan.breaks[p + 1]), names[i]))
    if len(inner):
        both = []
        for x, p in ((0.0, inner), (1.0, inner - 1)):
            rows = plan.rows(p, np.arange(plan.N))
            rows = Rows(plan, rows.p, 0.0 * rows.x + x, 0.0 * rows.x, rows.i)
            both.append(np.concatenate([plan.thrust(rows.take(slice(s, s + CHUNK)), rows.i[s : s + CHUNK]).v
                                        for s in range(0, len(rows), CHUNK)]))  # fmt: skip
        jump = _size(both[0] - both[1])
        i = int(np.argmax(jump))
        worst = max(
            worst, (float(jump[i]), float(plan.breaks[inner[i // plan.N]]), plan.names[i % plan.N])
        )
    held = np.array([h is not None for h in plan.hold])
    index, off = np.concatenate([[-1], plan.ranged, [-1]]), 0.0
    held = np.concatenate([held[:1], held, held[-1:]])
    for p in np.flatnonzero((plan.ranged >= 0) & plan.formed):
        for other, end in ((p, 0), (p + 2, -1)):
            if index[p + 1] != index[other] and not (held[p + 1] and held[other]):
                off = float(np.max(np.abs(plan.tensions.c[0][p, :, 0, end] - plan.team)))
                worst = max(worst, (off, float(plan.breaks[p + (end != 0)]), "range"))
    yield ("tension", "N", "max", 1e-4, *worst)


def crossings(plan):
    """Pairs of cables whose chords pass through each other otherwise than the states of phases say.

    On spans on which chords may touch each must cross the other, seen along their common normal, for
    certain; then the sign of ``(q_j - q_i)·((r_i - q_i) × (r_j - q_j))`` changes once a passage.
    """
    if not plan.cabled or np.all(plan.formed):
        return
    n, wrong, when = plan.n, set(), 0.0
    chord = np.stack([2 * np.arange(n), 2 * np.arange(n) + 1], -1)
    known = {tuple(sorted(x)) for x in zip(plan.clasps.tolist(), plan.behind.tolist())}
    passed = {}
    for p in np.flatnonzero(~plan.formed):
        pairs = np.arange(n)[:, None] < np.arange(n)
        rows, across = near(plan, [p], (plan.drones, chord), (plan.drones, chord), pairs, 1e-3), []
        for depth in range(30):
            if not len(rows):
                break
            i, j = np.divmod(rows.i, n)
            ends = [plan.drones.jet(rows, x) for x in (2 * i, 2 * i + 1, 2 * j, 2 * j + 1)]
            way = closest(*(x.v for x in ends))
            w = way / np.maximum(_size(way), 1e-300)[:, None]
            apart = (
                np.min([(x - y).along(w).low for x in ends[:2] for y in ends[2:]], axis=0) > TOUCH
            )
            a, b = ends[1] - ends[0], ends[3] - ends[2]
            normal = np.cross(a.v, b.v)
            normal = _constant(normal / np.maximum(_size(normal), 1e-300)[:, None], rows.r)
            signs = []
            for one, base, others in ((a, ends[0], ends[2:]), (b, ends[2], ends[:2])):
                side = [normal.dot(one.cross(x - base)) for x in others]
                signs.append(
                    ((side[0].low > 0) & (side[1].high < 0))
                    | ((side[0].high < 0) & (side[1].low > 0))
                )
            sure = signs[0] & signs[1] & ~apart
            across += [
                (int(q), x - w, x + w) for q, x, w in zip(rows.i[sure], rows.x[sure], rows.w[sure])
            ]
            rows = rows.take(~apart & ~sure)
            if depth == 29 or len(rows) > 2000:
                wrong |= {tuple(map(int, divmod(q, n))) for q in rows.i}
                when = float(plan.breaks[p]) if len(rows) else when
                break
            rows = rows.halves()
        for q, first, last in across:
            passed.setdefault(divmod(q, n), []).append((p + first, p + last))
    counts = {pair: [] for pair in known}
    for pair, spans in passed.items():
        runs = []
        for first, last in sorted(spans):
            if runs and first <= runs[-1][1] + 1e-9:
                runs[-1][1] = max(last, runs[-1][1])
            else:
                runs.append([first, last])
        for first, last in runs:
            signs = []
            for at in (first, last):
                p = min(int(at), len(plan.h) - 1)
                rows = Rows(plan, np.array([p]), np.array([at - p]), np.zeros(1), np.zeros(1, int))
                q, r, s, t = (
                    plan.drones.at(rows, np.array([i]))[0] for k in pair for i in (2 * k, 2 * k + 1)
                )
                signs.append(float(np.sign((s - q) @ np.cross(r - q, t - s))))
            if tuple(pair) in known:
                counts[pair].append((last, (signs[1] - signs[0]) / 2.0))
            elif signs[0] != signs[1]:
                wrong.add(pair)
    start = 1.0 if plan.formed[0] else 0.0
    for pair in known:
        for p, state in enumerate(plan.state):
            want = {
                "on the ground": 0.0,
                "hanging free": 0.0,
                "being tightened": 1.0,
                "hitched": 1.0,
            }.get(state)
            now = abs(start + sum(c for at, c in counts[pair] if at <= p + 0.5))
            if want is not None and now != want:
                wrong.add(pair)
                when = when or float(plan.breaks[p])
        if not plan.formed[-1] and start + sum(c for _, c in counts[pair]) != 0.0:
            wrong.add(pair)
    yield (
        "interlacing",
        "1",
        "max",
        0.0,
        float(len(wrong)),
        when,
        " ".join(f"{i}-{j}" for i, j in sorted(wrong)[:6]),
    )


def story(plan):
    """What contradicts the phases, the objects or what was asked: one line each."""
    found, s = [], plan.settings
    asked = s.get("asked")

    def wrong(words, at=0.0):
        found.append((float(at), words))

    if (
        not plan.phases
        or abs(plan.phases[0]["start"]) > JOINT
        or abs(plan.phases[-1]["end"] - plan.breaks[-1]) > JOINT
    ):
        wrong("phases do not cover the plan")
    for a, b in zip(plan.phases, plan.phases[1:]):
        if abs(b["start"] - a["end"]) > JOINT:
            wrong("phases do not follow each other", b["start"])
        if a["state"] != b["state"] and np.min(np.abs(plan.breaks - b["start"])) > JOINT:
            wrong("a state changes within a piece", b["start"])
    for phase in plan.phases:
        if not phase["start"] < phase["end"]:
            wrong("a phase ends before it starts", phase["start"])
        if (phase["state"] == "none") is plan.cabled:
            wrong(f"state {phase['state']}", phase["start"])
        low = phase["tension"]
        if low is not None and not (len(low) == 2 and 0.0 < low[0] <= low[1]):
            wrong("a range of tensions", phase["start"])
    if plan.cabled:
        _states(plan, wrong)
    _objects(plan, wrong)
    if not isinstance(asked, dict):
        wrong("the file does not say what was asked")
    else:
        try:
            _asked(plan, asked, wrong)
        except (KeyError, TypeError, ValueError, IndexError) as error:
            wrong(f"asked cannot be read: {error!r}")
    at, words = min(found, default=(0.0, ""))
    yield (
        "story",
        "1",
        "max",
        0.0,
        float(len(found)),
        at,
        words + (f" (and {len(found) - 1} more)" if found[1:] else ""),
    )
    if plan.limits["duration"] is not None:
        yield (
            "duration",
            "s",
            "max",
            plan.limits["duration"],
            float(plan.breaks[-1]),
            float(plan.breaks[-1]),
            "",
        )


def _states(plan, wrong):
    """Cables are in the states that phases state, as far as polynomials tell."""
    for i, phase in enumerate(plan.phases):
        pieces = np.flatnonzero((plan.phase == i) & ~plan.formed)
        if not len(pieces):
            continue
        at = float(plan.breaks[pieces[0]])
        for part in (plan.legs, plan.tensions, plan.pulls):
            if np.any(part.c[0][pieces]):
                wrong("tensions or legs without a hitch", at)
        c = plan.drones.c[0][pieces]
        if phase["state"] == "on the ground":
            if np.any(np.ptp(c[:, :, :2], axis=(0, -1)) > TOUCH):
                wrong("a drone moves sideways while cables are on the ground", at)
            low = [plan.hanging(rows := plan.rows(pieces, np.arange(plan.n)), rows.i).lowest()]
            ends = (
                Rows(plan, rows.p, 0.0 * rows.x, 0.0 * rows.x, rows.i),
                Rows(plan, rows.p, 0.0 * rows.x + 1.0, 0.0 * rows.x, rows.i),
            )
            low += [plan.hanging(r, r.i).lowest() for r in ends]
            if np.min(low) - plan.floor > plan.sep["cable"] + CLOSE:
                wrong("cables said to be on the ground hang above it", at)
        if phase["state"] == "clasping":
            middle = 0.5 * (c[:, 2 * plan.clasps] + c[:, 2 * plan.behind + 1])
            if np.any(np.ptp(middle, axis=(0, -1)) > CLOSE):
                wrong("drones that clasp do not turn about each other", at)
        if phase["state"] == "being tightened":
            rows, slack = plan.rows(pieces, np.arange(plan.n)), []
            k = rows.i
            chains = [
                (2 * k, plan.N + plan.anchor[2 * k]),
                (2 * k + 1, plan.N + plan.anchor[2 * k + 1]),
            ]
            chains.append((plan.N + plan.begin[k], plan.N + plan.end[k]))
            for x in np.linspace(0.0, 1.0, 5):
                there = Rows(plan, rows.p, 0.0 * rows.x + x, 0.0 * rows.x, k)
                size = sum(
                    _size(plan.points.at(there, i) - plan.points.at(there, j)) for i, j in chains
                )
                slack.append(
                    1.0 - size.reshape(len(pieces), -1) @ plan.team / (plan.length @ plan.team)
                )
            taut = np.max(slack, axis=0) <= 1e-4
            if np.sum(plan.h[pieces][taut]) > 0.5 * np.sum(plan.h[pieces]):
                wrong("cables said to be slack are at their full length", at)


def _objects(plan, wrong):
    """Objects stand on something, or are held where they move; what is borne is held."""
    heading = plan.poses.c[0][:, :, 3:]
    for j, (name, body) in enumerate(plan.bodies.items()):
        c, b = plan.poses.c[0][:, j], plan.borne.c[0][:, j, 0]
        for x in (0.0, 0.25, 0.5, 0.75, 1.0):
            rows = plan.rows(np.arange(len(plan.h)), [j])
            head = plan.poses.at(Rows(plan, rows.p, 0 * rows.x + x, 0 * rows.x, rows.i), rows.i)[
                :, 3:
            ]
            if np.max(np.abs(_size(head) - 1.0)) > TOUCH:
                wrong(f"the heading of {name} is no direction")
                break
        if np.max(np.abs(c[0, :, 0] - body.pose)) > STILL:
            wrong(f"{name} does not begin where it stands")
        moving, whole = plan.moving[:, j], np.all(b == 1.0, axis=-1)
        held = plan.held(name) & plan.formed
        busy = moving | np.any(b != 0.0, axis=-1)
        for lost, words in ((busy & ~held, "moves or is borne unheld"), (moving & ~whole, "moves but is not borne"),
                            (np.any((b < 0.0) | (b > 1.0), axis=-1), "is borne by a share beyond 0 to 1"),
                            (busy & body.fixed, "is fixed, and moves")):  # fmt: skip
            if np.any(lost):
                wrong(f"{name} {words}", plan.breaks[int(np.argmax(lost))])
        if not body.fixed:
            for p in np.flatnonzero(~whole & ~moving):
                if p and np.array_equal(plan.poses.c[0][p], plan.poses.c[0][p - 1]):
                    continue
                if (
                    abs(c[p, 2, 0] + body.lower - _below(plan, j, plan.poses.c[0][p, :, :, 0])[1])
                    > TOUCH
                ):
                    wrong(f"{name} stands on nothing", plan.breaks[p])
                    break
        if np.any(plan.held(name, "grip")) and not plan.bent:
            wrong(f"{name} is gripped by straight edges")
        rest = plan.held(name, "rest")
        if np.any(rest):
            seen = _in_frame(plan.poses.c[0][:, j, None, :, 0], plan.vertices.c[0][..., 0])
            side, to = (np.roll(seen, -1, 1) - seen)[..., :2], body.section.centroid - seen[..., :2]
            right = side[..., 1] * to[..., 0] - side[..., 0] * to[..., 1]
            high = np.max(seen[..., 2], axis=1) > body.height + CONTACT
            bad = rest & (
                high | np.any(right <= 0.0, axis=1) | (body.rim is None) | (not plan.closed)
            )
            if np.any(bad):
                wrong(
                    f"clasps are not around {name}, below its rim", plan.breaks[int(np.argmax(bad))]
                )
    return heading


def _asked(plan, asked, wrong):
    """Arrays and settings are those that were asked for; robots begin where they do, end by end."""
    s, team = plan.settings, asked["team"]

    def same(key, a, b, slack=0.0):
        if isinstance(a, dict) and isinstance(b, dict):
            for name in a.keys() | b.keys():
                same(f"{key}.{name}", a.get(name), b.get(name), slack)
        elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
            for i, (x, y) in enumerate(zip(a, b)):
                same(f"{key}[{i}]", x, y, slack)
        elif (
            isinstance(a, bool)
            or isinstance(b, bool)
            or not all(isinstance(x, (int, float)) for x in (a, b))
        ):
            if a != b:
                wrong(f"{key} is {b}, asked {a}")
        elif not abs(a - b) <= slack + TOLERANCE * max(abs(a), abs(b)):
            wrong(f"{key} is {b}, asked {a}")

    given = s.get("assignment") or {"robots": list(range(plan.n)), "flipped": [False] * plan.n}
    robots, flipped = given["robots"], given["flipped"]
    limits = dict(s["limits"])
    for name in ("tilt", "body_rate"):
        angle = limits.pop(name)
        limits[f"{name}_deg"] = None if angle is None else math.degrees(angle)
    same("limits", asked["limits"], limits)
    for name in ("separation", "arena", "keep_out", "objects"):
        same(name, asked[name], s.get(name, {}))
    kinds = team["quadrotor"]
    first, start = plan.drones.c[0][0, ..., 0], asked["start"]["drones"]
    order = range(plan.N)
    if plan.cabled:
        order = robots
        if sorted(robots) != list(range(plan.n)) or len(flipped) != plan.n:
            return wrong("assignment is no assignment")
        for name in ("robots", "topology", "cable_density", "cable_friction", "load"):
            same(name, team[name], s["team"][name])
        for name in ("cable_length", "tension"):
            same(name, [team[name][i] for i in robots], plan.arrays[name].tolist())
        places = [[start["qr"[j ^ bool(f)]][i] for j in (0, 1)] for i, f in zip(robots, flipped)]
        same("start of role", places, first.reshape(-1, 2, 3).tolist(), TOUCH)
        if plan.formed[0]:
            x = plan.vertices.c[0][0, ..., 0]
            same("start.polygon", asked["start"]["hitch"]["polygon"], x[:, :2].tolist(), TOUCH)
            same(
                "start.altitude",
                asked["start"]["hitch"]["altitude"],
                float(np.mean(x[:, 2])),
                TOUCH,
            )
        elif "hitch" in asked["start"]:
            wrong("it was to begin with a hitch")
    else:
        same("drones", team["drones"], plan.N)
        same("start of drone", start, first.tolist(), TOUCH)
    for name, plain in (
        ("mass", None),
        ("max_thrust", None),
        ("stiffness", math.inf),
        ("integral", 0.0),
        ("feed_forward", 1.0),
    ):
        want = [math.inf if kinds[i][name] is None else float(kinds[i][name]) for i in order]
        there = plan.arrays[name].tolist() if name in plan.arrays else [plain] * len(want)
        if len(want) != len(there) or any(
            x != y and not abs(x - y) <= TOLERANCE * abs(x) for x, y in zip(want, there)
        ):
            wrong(f"{name} is {there}, asked {want}")


def verify(path: str | Path) -> Iterator[Row]:
    """Yield a row for every limit: name, verdict, worst, limit, unit, sense, time, where, samples."""
    path = Path(path)
    plan = Plan(path / "plan.npz" if path.is_dir() else path)
    rows = {}
    for name, unit, sense, limit, value, at, where in (
        *story(plan),
        *joints(plan),
        *crossings(plan),
    ):
        good = value <= limit + TOLERANCE * max(abs(limit), 1.0)
        rows.setdefault((name, unit), []).append(
            ("proven" if good else "violated", value, limit, sense, at, where, 1)
        )
    for name, unit, sense, limit, spans, make, who in limits_of(plan):
        if not len(spans):
            continue
        value, (at, item), spent, left = search(
            spans, make, limit, sense, plan.size if unit == "m" else 0.0
        )
        slack = TOLERANCE * max(abs(limit), plan.size if unit == "m" else 0.0)
        good = value >= limit - slack if sense == "min" else value <= limit + slack
        verdict = "violated" if not good else "not proven" if left else "proven"
        at, item = left or (at, item)
        rows.setdefault((name, unit), []).append(
            (verdict, value, limit, sense, at, who(item), spent)
        )
    for (name, unit), found in rows.items():
        sense, rank = found[0][3], ("violated", "not proven", "proven")
        worst = min(found, key=lambda f: (rank.index(f[0]), f[1] if sense == "min" else -f[1]))
        yield Row(name, unit, *worst[:-1], sum(f[-1] for f in found))


def line(row: Row) -> str:
    """A row in words."""
    sign = "≥" if row.sense == "min" else "≤"
    worst = f"{row.worst:12.6g} {sign} {row.limit:<9.6g} {row.unit:6}"
    place = f"t = {row.time:<9.4f} {row.where:24}"
    return f"{row.name:17} {row.verdict:10} {worst} {place} {row.samples} samples"


def verdict(rows: Sequence[Row]) -> str:
    """What all rows say together."""
    bad = [row.name for row in rows if row.verdict != "proven"]
    if bad:
        return f"not proven: {', '.join(dict.fromkeys(bad))}"
    return "proven: every limit holds at all times"


def main(arguments):
    """Print what is found of the plan in a directory; 0 proven, 3 not, 2 unreadable."""
    if len(arguments) != 1:
        print("usage: python verify.py DIR", file=sys.stderr)
        return 2
    rows = []
    try:
        for row in verify(arguments[0]):
            rows.append(row)
            print(line(row), flush=True)
    except UnreadableError as error:
        print(f"{arguments[0]}: not a plan, or a damaged one: {error}", file=sys.stderr)
        return 2
    print(verdict(rows))
    return 3 if any(row.verdict != "proven" for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
