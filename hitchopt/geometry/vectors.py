"""Products, lengths and directions of many vectors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def dot(a: Array, b: Array) -> Array:
    """Return the scalar products (…) of vectors (…, d); leading axes broadcast."""
    products: Array = np.einsum("...i,...i->...", a, b)
    return products


def length(a: Array) -> Array:
    """Return the lengths (…) of vectors (…, d)."""
    lengths: Array = np.sqrt(dot(a, a))
    return lengths


def unit(a: Array) -> Array:
    """Return the directions (…, d) of vectors (…, d); zero for a vector without length."""
    sizes = np.linalg.norm(a, axis=-1, keepdims=True)
    directions: Array = np.divide(a, sizes, out=np.zeros_like(a), where=sizes > 0.0)
    return directions
