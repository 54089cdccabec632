"""Products, lengths and directions of many vectors, and choices among values that tie."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.values import Array

TIE = 1e-9
"""Relative difference of values that tie: far above rounding, far below what matters."""

GOLDEN = 0.6180339887498949
"""Fractional part of the golden ratio: sums of a few multiples and powers do not tie again."""


EAST = np.array([1.0, 0.0, 0.0])
"""Direction that stands for that of vectors that have none."""


def dot(a: Array, b: Array) -> Array:
    """Return the scalar products (…) of vectors (…, d); leading axes broadcast."""
    products: Array = np.einsum("...i,...i->...", a, b)
    return products


def length(a: Array) -> Array:
    """Return the lengths (…) of vectors (…, d)."""
    lengths: Array = np.sqrt(dot(a, a))
    return lengths


def column_lengths(a: Array) -> Array:
    """Return the lengths (…, k) of vectors in columns (…, d, k)."""
    lengths: Array = np.sqrt(np.einsum("...dk,...dk->...k", a, a))
    return lengths


def unit(a: Array, fallback: ArrayLike = 0.0, least: ArrayLike = 0.0) -> Array:
    """Return the directions (…, d) of vectors (…, d), or ``fallback`` where they have none.

    That is where they are no longer than ``least``, one or (…, 1).
    """
    size = length(a)[..., None]
    long = size > np.asarray(least)
    directions: Array = np.where(long, a / np.where(long, size, 1.0), fallback)
    return directions


def first_smallest(values: Array, scale: Array | float) -> NDArray[np.intp]:
    """Return the indices (…) of the smallest of values (…, k), the first one in a tie.

    Values tie that differ by less than rounding makes of equal ones computed of numbers of a size
    ``scale`` (…).
    """
    smallest = np.min(values, axis=-1, keepdims=True)
    near = values <= smallest + TIE * np.asarray(scale)[..., None]
    first: NDArray[np.intp] = np.argmax(near, axis=-1)
    return first


def tied_order(values: Array, scale: float) -> NDArray[np.intp]:
    """Return the order (k,) that sorts values (k,); those that tie, as above, stay in theirs."""
    order = np.argsort(values, kind="stable")
    steps = np.diff(values[order]) > TIE * scale
    groups = np.empty(len(values), dtype=np.intp)
    groups[order] = np.append(0, np.cumsum(steps))
    return np.argsort(groups, kind="stable")
