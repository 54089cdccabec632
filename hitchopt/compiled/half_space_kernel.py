"""Compiled projection of offsets into a covered set; see ``HalfSpaces.within``."""

from __future__ import annotations

import numpy as np

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.values import Array, Indices

Spaces = tuple[Indices, Array, Array]
"""Half-spaces: two drones each (m, 2), their parts of the rows (m, 2, 3), and bounds (m,)."""

Box = tuple[Array, Array]
"""Least and largest common shift, (3,) each."""


@kernel
def _broken(pairs: Indices, rows: Array, bounds: Array, own: Array, out: Array) -> bool:
    """Fill in by how much half-spaces are broken, and return whether any is."""
    found = False
    for i in range(len(bounds)):
        value = -bounds[i]
        for side in range(2):
            each, row = own[pairs[i, side]], rows[i, side]
            value += row[0] * each[0] + row[1] * each[1] + row[2] * each[2]
        out[i] = value
        found |= value > 0.0
    return found


@kernel
def _mean(offsets: Array) -> Array:
    """Return the mean of offsets (drones, 3)."""
    out = np.zeros(3)
    for each in offsets:
        out += each
    return out / len(offsets)


@kernel
def within(spaces: Spaces, box: Box, offsets: Array, passes: int, size: float) -> Array:
    """Return offsets (drones, 3) of the set near the given ones.

    Parameters
    ----------
    spaces, box: see Spaces and Box.
    passes: rounds of projection.
    size: largest offset besides the common shift.
    """
    pairs, rows, bounds = spaces
    common = _mean(offsets)
    own, beyond = offsets - common, np.empty(len(bounds))
    common = np.minimum(np.maximum(common, box[0]), box[1])
    if _broken(pairs, rows, bounds, own, beyond):
        for _ in range(passes):
            for i in range(len(beyond)):
                if beyond[i] > 0.0:
                    for side in range(2):
                        own[pairs[i, side]] -= beyond[i] * rows[i, side]
            _broken(pairs, rows, bounds, own, beyond)
        own -= _mean(own)
        if _broken(pairs, rows, bounds, own, beyond):
            share = 1.0
            for i in range(len(beyond)):
                if beyond[i] > 0.0:
                    share = min(share, bounds[i] / (bounds[i] + beyond[i]))
            own *= share
    largest = 0.0
    for each in own:
        largest = max(largest, each[0] * each[0] + each[1] * each[1] + each[2] * each[2])
    if largest > size * size:
        own *= size / np.sqrt(largest)
    own += common
    return own
