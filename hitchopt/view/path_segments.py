"""Paths as few straight segments: browsers that draw by software are slow with many."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.values import Array


def path_segments(curves: Array, tolerance: float) -> tuple[Array, NDArray[np.intp]]:
    """Return segments that stay near curves, and the curve that each belongs to.

    Points between two that remain are left out together, over and over, while all that were left
    out are known to be near the segment.

    Parameters
    ----------
    curves: samples (n, points, 3) [m], at least two of each.
    tolerance: largest distance of a sample to the segments of its curve [m].

    Returns
    -------
    Ends of the segments (m, 2, 3) [m], curve after curve, and indices of their curves (m,).
    """
    n, count, _ = curves.shape
    points = np.reshape(curves, (-1, 3))
    owners = np.repeat(np.arange(n), count)
    strays = np.zeros(n * count)  # of what is left out between a point and the next [m]
    idle, parity = 0, 0
    while idle < 2:
        inner = 1 + np.flatnonzero((owners[2:] == owners[:-2]) & (owners[1:-1] == owners[:-2]))
        inner = inner[(inner - np.searchsorted(owners, owners[inner])) % 2 == parity]
        stray = _to_chords(points, inner) + np.maximum(strays[inner - 1], strays[inner])
        out = inner[stray <= tolerance]
        strays[out - 1] = stray[stray <= tolerance]
        points, owners, strays = (
            np.delete(points, out, 0),
            np.delete(owners, out),
            np.delete(strays, out),
        )
        idle = 0 if len(out) else idle + 1
        parity = 1 - parity
    together = np.flatnonzero(owners[1:] == owners[:-1])
    return np.stack([points[together], points[together + 1]], axis=1), owners[together]


def _to_chords(points: Array, inner: NDArray[np.intp]) -> Array:
    """Return the distances of points to the segments between their neighbours (m,) [m]."""
    chords = points[inner + 1] - points[inner - 1]
    offsets = points[inner] - points[inner - 1]
    squares = np.sum(chords**2, axis=-1)
    along = np.sum(offsets * chords, axis=-1) / np.where(squares > 0.0, squares, 1.0)
    feet = np.clip(along, 0.0, 1.0)[:, None] * chords
    distances: Array = np.linalg.norm(offsets - feet, axis=-1)
    return distances
