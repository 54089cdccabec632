"""Distances of points, segments, hulls and convex bodies, along their closest points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations, pairwise, product
from typing import Any

import numpy as np

from .arithmetic import TINY, Array, Line, maximum, minimum, norm, normalize

GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
SECTIONS = 50  # golden sections: the last one is 4e-11 of the first


def closest(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Return the shortest vectors (m, d) from segments c d to segments a b."""
    u, v, w = b - a, d - c, a - c
    uu, vv, uv, uw, vw = (np.sum(x * y, -1) for x, y in ((u, u), (v, v), (u, v), (u, w), (v, w)))

    def share(x: Array, y: Array) -> Array:
        return np.clip(x / np.where(y > 0.0, y, 1.0), 0.0, 1.0)

    j = share(vw + share(uv * vw - vv * uw, uu * vv - uv**2) * uv, vv)
    return w + share(j * uv - uw, uu)[:, None] * u - j[:, None] * v


def distance(a: Sequence[Line], b: Sequence[Line], ratio: float = 1.0) -> Line:
    """Return the distance of points or segments, heights divided by a ratio."""
    a, b = ([x.flat(ratio) for x in corners] for corners in (a, b))
    w = normalize(closest(a[0].v, a[-1].v, b[0].v, b[-1].v))
    return minimum(*((x - y).dot(w) for x in a for y in b))


def hull_distance(a: Sequence[Line], b: Sequence[Line]) -> Line:
    """Return the distance of convex hulls in the plane, along that of their nearest sides."""
    sides = [[*combinations(x if x[1:] else [*x, *x], 2)] for x in (a, b)]
    gaps = [closest(*(y.v for y in (*p, *q))) for p, q in product(*sides)]
    nearest = np.argmin([norm(x) for x in gaps], axis=0)
    w = normalize(np.stack(gaps)[nearest, np.arange(len(nearest))])
    return minimum(*((x - y).dot(w) for x in a for y in b))


def prism_gap(a: Sequence[Line], b: Sequence[Line], ratio: float = 1.0) -> Line:
    """Return horizontal distances, or vertical ones of all corners, divided by a ratio.

    In plan view, bodies are on their first two corners, or in the hull of all but the last of more
    than four corners.
    """
    z_coordinates = [[x.flat(ratio)[2] for x in corners] for corners in (a, b)]
    (low, floor), (high, top) = ([f(*z) for z in z_coordinates] for f in (minimum, maximum))
    outlines = [[x[:2] for x in (c[:2] if len(c) < 5 else c[:-1])] for c in (a, b)]
    horizontal = (distance if max(map(len, outlines)) < 3 else hull_distance)(*outlines)
    return maximum(horizontal, low - top, floor - high)


class Slab:
    """A convex section between two heights: clockwise corners and a radius around them."""

    def __init__(self, outline: Any, radius: Any, lower: float, upper: float) -> None:
        self.round = outline is None
        self.radius = radius or 0.0
        self.lower, self.upper = lower, upper
        self.core = np.array([[0.0, 0.0]] if outline is None else outline, dtype=float)
        self.sides = np.roll(self.core, -1, 0) - self.core
        self.normals = normalize(np.stack([-self.sides[:, 1], self.sides[:, 0]], -1))
        turn, area = (np.sum(self.normals * np.roll(x, -1, 0), -1) for x in (self.sides, self.core))
        if lower > upper:
            raise ValueError("a body's lower height is above its upper height")
        if self.radius <= 0.0 if self.round else self.radius < 0.0 or np.any(turn >= 0.0):
            raise ValueError("a section is neither a convex, clockwise outline nor a circle")
        area = (area * norm(self.sides))[:, None]
        middle = (self.core + np.roll(self.core, -1, 0)) / 3.0
        self.centroid = np.sum(middle * area, 0) / np.maximum(np.sum(area), TINY)
        equal = self.radius if self.round else math.sqrt(0.5 * float(np.sum(area)) / math.pi)
        self.mean_radius = 2.0 / 3.0 * equal  # of a disc of the same area

    def depth(self, x: Array) -> Array:
        """Return a lower bound of the depth of points (…, 2) inside; negative outside."""
        to = x[..., None, :] - self.core
        inside = -np.max(np.einsum("...ki,ki->...k", to, self.normals), -1)
        return -norm(to[..., 0, :]) + self.radius if self.round else inside

    def gap_vectors(self, x: Array) -> Array:
        """Return the shortest vectors to points (m, 3)."""
        to = x[:, None, :2] - self.core
        along = np.einsum("mki,ki->mk", to, self.sides)
        share = along / np.maximum(np.sum(self.sides**2, -1), TINY)
        gaps = to - np.clip(share, 0.0, 1.0)[..., None] * self.sides
        gap = gaps[np.arange(len(x)), np.argmin(norm(gaps), axis=1)]
        beyond = np.maximum(norm(gap) - self.radius, 0.0) * (self.depth(x[:, :2]) < 0.0)
        above = x[:, 2] - np.clip(x[:, 2], self.lower, self.upper)
        return np.column_stack([normalize(gap) * beyond[:, None], above])

    def enlarged(self, radius: float, lower: float, upper: float) -> Slab:
        """Return a slab with a larger radius, between the given heights."""
        return Slab(None if self.round else self.core, self.radius + radius, lower, upper)

    def scaled(self, by: Array) -> Slab:
        """Return the slab in coordinates scaled by (3,), the first two alike."""
        core = None if self.round else self.core * by[:2]
        return Slab(core, self.radius * by[0], self.lower * by[2], self.upper * by[2])

    def below(self, x: Line, lead: float) -> Line:
        """Return the distance to a point, large where the slab is above it by a ``lead``."""
        return self.gap(x).unless(-x[2] + self.lower - lead)

    def _nearest_share(self, a: Array, b: Array) -> Array:
        """Return where segments from a to b (m, 3) are nearest, from 0 to 1 (m, 1).

        Distances from a convex body are convex: golden sections find the smallest one.
        """
        low = np.zeros((len(a), 1))
        high = np.ones((len(a), 1))

        def size(x: Array) -> Array:
            return norm(self.gap_vectors(a + x * (b - a)))[:, None]

        x = high - GOLDEN * (high - low)
        y = low + GOLDEN * (high - low)
        at_x = size(x)
        at_y = size(y)
        for _ in range(SECTIONS):
            later = at_x > at_y
            low = np.where(later, x, low)
            high = np.where(later, high, y)
            step = GOLDEN * (high - low)
            other = np.where(later, low + step, high - step)
            at_other = size(other)
            x, y = np.where(later, y, other), np.where(later, other, x)
            at_x, at_y = np.where(later, at_y, at_other), np.where(later, at_other, at_x)
        return low

    def gap(self, *points: Line, ratio: float = 1.0) -> Line:
        """Return the distance to the convex hull of points, by its edges.

        Heights are divided by a ratio.
        """
        if ratio != 1.0:
            flat = self.scaled(np.array([1.0, 1.0, 1.0 / ratio]))
            return flat.gap(*(x.flat(ratio) for x in points))
        gaps = []
        for a, b in pairwise(points if points[1:] else points * 2):
            share = self._nearest_share(a.v, b.v) if a is not b else np.zeros((len(a.v), 1))
            w = normalize(self.gap_vectors(a.v + share * (b.v - a.v)))
            most = np.max(w[:, :2] @ self.core.T, -1) + self.radius * norm(w[:, :2])
            most += np.maximum(self.lower * w[:, 2], self.upper * w[:, 2])
            gaps.append(minimum(*(p.dot(w) for p in points)) - most[:, None])
        return maximum(*gaps)


def to_frame(pose: Array, x: Array) -> Array:
    """Return points x (…, 3) in the frames of bodies with poses (…, 5)."""
    o = x - pose[..., :3]
    c = pose[..., 3]
    r = pose[..., 4]
    return np.stack([c * o[..., 0] + r * o[..., 1], c * o[..., 1] - r * o[..., 0], o[..., 2]], -1)
