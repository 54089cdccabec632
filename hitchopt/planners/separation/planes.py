"""Separating planes: which pieces of which drones come close, and the planes between them.

Lengths are scaled so that an ellipsoid pair's separation is a distance. The difference of two
pieces lies in the hull of its Bernstein coefficients; the point of that hull nearest to the origin
is the normal of the plane with the widest gap that holds on the whole piece.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.broadphase import Boxes, close_pairs
from hitchopt.trajectory import bernstein

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

HULL_STEPS = 30
"""Of the search for a hull's nearest point; the normal need not be the best one to be valid."""

CURVE_SAMPLES = 17
"""Of a piece, to find about where it comes nearest."""


@dataclass(frozen=True, eq=False)
class ClosePieces:
    """Pieces of two drones that may come close.

    Attributes
    ----------
    piece, first, second: (m,): which piece of which drones, first < second.
    """

    piece: Indices
    first: Indices
    second: Indices

    def __len__(self) -> int:
        return len(self.piece)

    def united(self, other: ClosePieces, drones: int) -> ClosePieces:
        """Return what is in either, in order."""
        key = np.union1d(self._key(drones), other._key(drones))
        rest, second = np.divmod(key, drones)
        piece, first = np.divmod(rest, drones)
        return ClosePieces(piece, first, second)

    def _key(self, drones: int) -> Indices:
        key: Indices = (self.piece * drones + self.first) * drones + self.second
        return key


@dataclass(frozen=True, eq=False)
class Planes:
    """Planes between pieces of two drones.

    Attributes
    ----------
    between: (m,) what they separate.
    normals: (m, 3), unit vectors in scaled lengths, from the second drone to the first.
    gaps: (m, degree + 1): products of the normals with the differences' coefficients.
    """

    between: ClosePieces
    normals: Array
    gaps: Array


def close_pieces(scaled: Array, cutoff: float) -> ClosePieces:
    """Return all pairs of pieces whose hulls are nearer than ``cutoff``.

    Parameters
    ----------
    scaled: (pieces, N, 3, degree + 1), scaled Bernstein coefficients.
    cutoff: a separation.
    """
    found = []
    for m, piece in enumerate(scaled):  # as many as the grid has, whatever the number of drones
        pairs = close_pairs(Boxes.around(piece[:, None]), None, cutoff)
        found.append((np.full(len(pairs), m), pairs.first, pairs.second))
    piece, first, second = (np.concatenate(column) for column in zip(*found, strict=True))
    nearest = hull_points(scaled[piece, first] - scaled[piece, second])
    near = np.sum(nearest * nearest, axis=1) < cutoff * cutoff
    return ClosePieces(piece[near], first[near], second[near])


def planes_between(scaled: Array, pairs: ClosePieces) -> Planes:
    """Return the widest plane for every pair."""
    differences = scaled[pairs.piece, pairs.first] - scaled[pairs.piece, pairs.second]
    nearest = hull_points(differences)
    # Hulls that hold the origin have no plane yet: the curve's own nearest point gives a first one.
    inside = np.linalg.norm(nearest, axis=-1) < 1e-6
    nearest[inside] = _nearest_of_curves(differences[inside])
    length = np.linalg.norm(nearest, axis=-1, keepdims=True)
    east = np.array([1.0, 0.0, 0.0])
    normals = np.where(length > 1e-9, nearest / np.maximum(length, 1e-9), east)
    return Planes(pairs, normals, np.einsum("md,mdk->mk", normals, differences))


def hull_points(differences: Array) -> Array:
    """(m, 3): about the points nearest to the origin of the hulls of (m, 3, k) points.

    By the method of Mitchell, Dem'yanov and Malozemov: weight goes from the farthest point in use
    to the nearest one.
    """
    m, _, k = differences.shape
    rows = np.arange(m)
    first = np.argmin(np.sum(differences**2, axis=1), axis=1)
    weights = np.zeros((m, k))
    weights[rows, first] = 1.0
    point = differences[rows, :, first]
    for _ in range(HULL_STEPS):
        products = np.einsum("md,mdk->mk", point, differences)
        low = np.argmin(products, axis=1)
        high = np.argmax(np.where(weights > 0.0, products, -np.inf), axis=1)
        step = differences[rows, :, low] - differences[rows, :, high]
        size = np.sum(step * step, axis=1)
        gain = products[rows, high] - products[rows, low]
        share = np.divide(gain, size, out=np.zeros(m), where=size > 0.0)
        share = np.minimum(share, weights[rows, high])
        weights[rows, high] -= share
        weights[rows, low] += share
        point = point + share[:, None] * step
    return point


def _nearest_of_curves(differences: Array) -> Array:
    """(m, 3): about the points nearest to the origin of curves (m, 3, degree + 1)."""
    weights = bernstein.basis(np.linspace(0.0, 1.0, CURVE_SAMPLES), differences.shape[-1] - 1)
    points = differences @ weights.T
    best = np.argmin(np.sum(points * points, axis=1), axis=1)
    nearest: Array = points[np.arange(len(points)), :, best]
    return nearest
