"""Rows of a sparse program, gathered block by block."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


class Rows:
    """Rows lower <= A x <= upper over a given number of unknowns."""

    def __init__(self, unknowns: int) -> None:
        self.count = 0
        self._unknowns = unknowns
        self._entries: list[tuple[Indices, Indices, Array]] = []
        self._bounds: list[tuple[Array, Array]] = []

    def add(
        self, rows: Indices, columns: Indices, values: Array, lower: Array, upper: Array
    ) -> int:
        """Add rows, ``rows`` counting from the first of them; return the index of that one."""
        first = self.count
        self._entries.append((first + rows, columns, values))
        self._bounds.append((lower, upper))
        self.count += len(lower)
        return first

    def extend(self, rows: Indices, columns: Indices, value: float) -> None:
        """Add the same entry to rows that are there."""
        self._entries.append((rows, columns, np.full(len(rows), value)))

    def add_bounds(self, columns: Indices, lower: Array | float, upper: Array | float) -> None:
        """Bound single unknowns."""
        m = len(columns)
        bounds = np.broadcast_to(lower, m), np.broadcast_to(upper, m)
        self.add(np.arange(m), columns, np.ones(m), *bounds)

    def compressed(self) -> tuple[sp.csc_array[np.float64], Array, Array]:
        """Return A, lower and upper; entries that happen to be zero are stored too."""
        rows, columns, values = (np.concatenate(part) for part in zip(*self._entries, strict=True))
        lower, upper = (np.concatenate(part) for part in zip(*self._bounds, strict=True))
        shape = (self.count, self._unknowns)
        return sp.csc_array((values, (rows, columns)), shape=shape), lower, upper
