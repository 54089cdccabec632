"""Gauss's linking numbers of cables, exact for polygons.

Each cable is closed by the straight line between its drones. That is meaningful with the drones at
the hitch or before it is formed, where these lines stay clear of the other cables; in between a
line may pass through a cable, which changes the number although no cable passes another.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.values import Array


def linking_number(one: Array, other: Array) -> int:
    """Return the linking number of two closed polygons, with its sign.

    It is the sum over all pairs of edges of the solid angle that their directions span, over 4π
    (Banchoff 1976; Klenin and Langowski 2000).

    Parameters
    ----------
    one, other: (corners, 3) [m], the last joined to the first; apart from each other.
    """
    a, b = one[:, None], np.roll(one, -1, axis=0)[:, None]
    c, d = other[None], np.roll(other, -1, axis=0)[None]
    ac, ad, bc, bd = c - a, d - a, c - b, d - b
    normals = [np.cross(ac, ad), np.cross(ad, bd), np.cross(bd, bc), np.cross(bc, ac)]
    units = [n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), TINY) for n in normals]
    angles = sum(
        np.arcsin(np.clip(np.sum(units[i] * units[(i + 1) % 4], axis=-1), -1.0, 1.0))
        for i in range(4)
    )
    signs = np.sign(np.sum(np.cross(d - c, b - a) * ac, axis=-1))
    return round(float(np.sum(angles * signs)) / (4.0 * np.pi))


TINY = 1e-300
"""Least length of a normal [m²]: edges in one plane have none, and span no solid angle."""


def linking_matrix(cables: list[Array]) -> NDArray[np.int64]:
    """Return (n, n), symmetric: the linking number of every pair, zero on the diagonal.

    Pairs whose boxes do not meet are not linked. The number of the others grows with n alone where
    cables reach their neighbours only; the cost of each is quadratic in its segments.

    Parameters
    ----------
    cables: n of (nodes, 3) [m].
    """
    n = len(cables)
    lower = np.array([np.min(cable, axis=0) for cable in cables])
    upper = np.array([np.max(cable, axis=0) for cable in cables])
    meet = np.all((lower[:, None] <= upper[None]) & (lower[None] <= upper[:, None]), axis=-1)
    found = np.zeros((n, n), dtype=np.int64)
    for i, j in np.argwhere(np.triu(meet, 1)):
        found[i, j] = found[j, i] = linking_number(cables[i], cables[j])
    return found
