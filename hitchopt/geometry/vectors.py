"""Products, lengths and directions of vectors, shortest connections, and reproducible minima."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.values import Array

TIE = 1e-9  # Relative difference below which values tie: far above rounding, far below what matters

GOLDEN = 0.6180339887498949
"""Fractional part of the golden ratio: sums of a few of its multiples and powers do not tie."""

EAST = np.array([1.0, 0.0, 0.0])  # Default direction of vectors without one
NEXT = np.array([1, 2, 0])  # Axis after each axis
LAST = np.array([2, 0, 1])  # Axis before each axis
LOWER = 3 * LAST + NEXT  # Entries of flat 3x3 matrices
UPPER = 3 * NEXT + LAST  # Their mirror images
SKEW = np.eye(9)[LOWER] - np.eye(9)[UPPER]  # Flat skew matrices of the three axes


def dot(a: Array, b: Array) -> Array:
    """Return the scalar products (…) of vectors (…, d); leading axes broadcast."""
    products: Array = np.einsum("...i,...i->...", a, b)
    return products


def length(a: Array) -> Array:
    """Return the lengths (…) of vectors (…, d)."""
    lengths: Array = np.sqrt(dot(a, a))
    return lengths


def in_space(a: Array) -> Array:
    """Return vectors (…, 3): those of two components at the height 0."""
    return a if a.shape[-1] == 3 else np.concatenate([a, np.zeros_like(a[..., :1])], axis=-1)


def cross(a: Array, b: Array) -> Array:
    """Return the products a₀ b₁ - a₁ b₀ (…) of vectors (…, d), positive if b is left of a."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def cross_product(a: Array, b: Array) -> Array:
    """Return the cross products (…, 3) of vectors (…, 3), much faster than ``np.cross`` for few."""
    products: Array = a.take(NEXT, -1) * b.take(LAST, -1) - a.take(LAST, -1) * b.take(NEXT, -1)
    return products


def skew_matrix(a: Array) -> Array:
    """Return the matrices (…, 3, 3) of cross products with vectors (…, 3)."""
    flat: Array = a @ SKEW
    return flat.reshape(*a.shape, 3)


def axial_vector(matrices: Array) -> Array:
    """Return the vectors (…, 3) whose skew matrices are antisymmetric parts of (…, 3, 3)."""
    flat = matrices.reshape(*matrices.shape[:-2], 9)
    return np.asarray(0.5 * (flat.take(LOWER, -1) - flat.take(UPPER, -1)))


def left_of(a: Array) -> Array:
    """Return horizontal parts of vectors (…, 2 or 3) turned left by a right angle; z is 0."""
    turned = np.zeros_like(a)
    turned[..., 0], turned[..., 1] = -a[..., 1], a[..., 0]
    return turned


def turn(first: Array, second: Array) -> Array:
    """Return the angles (…) [rad] from the first to the second vectors (…, 2), positive left."""
    return np.asarray(np.arctan2(cross(first, second), np.add.reduce(first * second, axis=-1)))


def column_lengths(a: Array) -> Array:
    """Return the lengths (…, k) of vectors in columns (…, d, k)."""
    lengths: Array = np.sqrt(_ones(a.shape[-2]) @ (a * a))  # einsum takes twice the time
    return lengths


@lru_cache
def _ones(count: int) -> Array:
    return np.ones(count)


def unit(a: Array, fallback: ArrayLike = 0.0, min_length: ArrayLike = 0.0) -> Array:
    """Return the directions (…, d) of vectors (…, d).

    Vectors no longer than ``min_length``, one or (…, 1), have the direction ``fallback``.
    """
    size = length(a)[..., None]
    is_longer = np.greater(size, min_length)
    directions: Array = np.where(is_longer, a / np.where(is_longer, size, 1.0), fallback)
    return directions


def rotated(a: Array, angle: float) -> Array:
    """Return vectors (…, 2) rotated counter-clockwise by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    turned: Array = a @ np.array([[c, s], [-s, c]])
    return turned


def shortest_offset(differences: Array) -> Array:
    """Return the shortest vector (…, d) [m] from the second body to the first.

    Bodies are points or segments, given by the ``differences`` (…, 1, 2 or 4, d) [m] of their ends,
    d = 2 or 3. The vectors between two bodies fill the hull of these differences, so the shortest
    is the hull's point nearest to the origin. Bodies may touch, cross, be parallel or be points.

    The closest points of two segments are both inside, or one of them is an end. Choosing the
    nearest of the five candidates needs no case for parallel or zero-length segments. After C.
    Ericson, Real-Time Collision Detection (2005), section 5.1.9.
    """
    count = differences.shape[-2]
    if count == 1:
        return differences[..., 0, :]
    if count == 2:
        return _nearest(differences[..., 0, :], differences[..., 1, :])
    # The differences of segments are corners of a parallelogram, whose sides are 0-1, 2-3, 0-2, 1-3
    side_starts = differences.take([0, 2, 0, 1], axis=-2)
    side_ends = differences.take([1, 3, 2, 3], axis=-2)
    start = differences[..., 0, :]
    along_first = differences[..., 2, :] - start
    along_second = start - differences[..., 1, :]
    inner = _inner(start, along_first, along_second)
    on_sides = _nearest(side_starts, side_ends)
    return _shortest(np.concatenate([on_sides, inner[..., None, :]], axis=-2))


def _shortest(offsets: Array) -> Array:
    """Return the shortest of vectors (…, k, d) as (…, d)."""
    flat = offsets.reshape(-1, *offsets.shape[-2:])
    best = dot(flat, flat).argmin(axis=-1)
    chosen: Array = flat[np.arange(best.size), best]
    return chosen.reshape(*offsets.shape[:-2], offsets.shape[-1])


def hull_offset(differences: Array) -> Array:
    """Return the shortest vector (…, 2) from the second convex hull in the plane to the first.

    Hulls are given by the ``differences`` (…, k, m, 2) [m] of their corners, in any order. These
    fill a polygon whose sides join differences from one corner of either hull. If hulls overlap,
    the vector has no meaning.
    """
    k, m, d = differences.shape[-3:]
    shape = differences.shape[:-3]
    ends = []
    for one, other in zip(np.triu_indices(k, 1), np.triu_indices(m, 1), strict=True):
        own, others = differences[..., one, :, :], differences[..., other, :]
        own, others = (
            own.reshape(*shape, len(one) * m, d),
            others.reshape(*shape, k * len(other), d),
        )
        ends.append(np.concatenate([own, others], axis=-2))
    if k == m == 1:
        return differences[..., 0, 0, :]
    return _shortest(_nearest(*ends))


def hull_distance(a: Array, b: Array) -> Array:
    """Return the distances (…) of convex hulls in the plane; zero if they overlap.

    Hulls are given by corners (…, k, 2) and (…, m, 2) [m], in any order.
    """
    each = a[..., :, None, :] - b[..., None, :, :]
    offset = hull_offset(each)
    along = np.min(np.einsum("...kld,...d->...kl", each, offset), axis=(-1, -2))
    return np.where(along > 0.0, length(offset), 0.0)


def differences(a: Array, b: Array) -> Array:
    """Return all differences (…, k · m, d) of ends a (…, k, d) and b (…, m, d), in a's order."""
    each = a[..., :, None, :] - b[..., None, :, :]
    return each.reshape(*each.shape[:-3], a.shape[-2] * b.shape[-2], each.shape[-1])


def _nearest(first: Array, second: Array) -> Array:
    """Return the point nearest to the origin of the segment from ``first`` to ``second``."""
    along = first - second
    squared = dot(along, along)
    fraction = dot(first, along) / np.where(squared > 0.0, squared, 1.0)
    nearest: Array = first - np.minimum(np.maximum(fraction, 0.0), 1.0)[..., None] * along
    return nearest


def _inner(w: Array, u: Array, v: Array) -> Array:
    """Return the offset ``w + s u - t v`` of the lines' closest points, or infinity.

    It is infinite if a closest point is outside its segment. ``w`` joins the segments' first ends;
    u and v lead from first to last ends.
    """
    uu, uv, vv = (dot(x, y) for x, y in ((u, u), (u, v), (v, v)))
    uw, vw = dot(u, w), dot(v, w)
    det = uu * vv - uv * uv
    skew = det > 1e-14 * uu * vv
    safe = np.where(skew, det, 1.0)
    s, t = (uv * vw - vv * uw) / safe, (uu * vw - uv * uw) / safe
    inside = skew & (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    offset = w + s[..., None] * u - t[..., None] * v
    return np.where(inside[..., None], offset, np.inf)


def first_smallest(values: Array, scale: Array | float) -> NDArray[np.intp]:
    """Return the indices (…) of the smallest of values (…, k), the first one in a tie.

    Values tie within TIE times ``scale`` (…), the size of the numbers that enter them.
    """
    smallest = np.min(values, axis=-1, keepdims=True)
    ties = values <= smallest + TIE * np.asarray(scale)[..., None]
    first: NDArray[np.intp] = np.argmax(ties, axis=-1)
    return first
