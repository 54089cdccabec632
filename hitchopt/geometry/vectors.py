"""Products and lengths of many vectors, without arrays in between."""

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
