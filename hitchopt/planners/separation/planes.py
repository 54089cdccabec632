"""Separating planes: between pieces of drones that come close, and before prisms.

Lengths are scaled so that an ellipsoid pair's separation is a distance. The difference of two
pieces lies in the hull of its Bernstein coefficients; the point of that hull nearest to the origin
is the normal of the plane with the widest gap that holds on the whole piece.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.broadphase import Boxes, close_pairs
from hitchopt.geometry.vectors import EAST, first_smallest, unit
from hitchopt.hitch.requirements import Prism
from hitchopt.trajectory import bernstein
from hitchopt.values import Array, Indices

FLAT = 1e-10
"""Squared sine of the angle below which two edges of a triangle count as parallel: all of it is
then as near to its edges."""

LEVEL = 1e-6
"""Largest upward component of a normal that counts as level."""

LEAN, LEAN_UNTIL = 1e-2, 2.0
"""Upward slope of level normals, for every unit by which the separation falls short of this."""

CURVE_SAMPLES = 17
"""Number of samples of a piece that locate its nearest point."""


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

    def taken(self, which: NDArray[np.bool_]) -> ClosePieces:
        """Return some of them."""
        return ClosePieces(self.piece[which], self.first[which], self.second[which])

    def united(self, other: ClosePieces, drones: int) -> ClosePieces:
        """Return what is in either, in order."""
        key = np.union1d(self._key(drones), other._key(drones))
        rest, second = np.divmod(key, drones)
        piece, first = np.divmod(rest, drones)
        return ClosePieces(piece, first, second)

    def _key(self, drones: int) -> Indices:
        return (self.piece * drones + self.first) * drones + self.second


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
    lean = LEAN * np.maximum(LEAN_UNTIL - np.linalg.norm(nearest, axis=-1), 0.0)
    # Hulls that hold the origin have no plane yet: the curve's own nearest point gives a first one.
    inside = np.linalg.norm(nearest, axis=-1) < 1e-6
    nearest[inside] = _nearest_of_curves(differences[inside])
    normals = unit(nearest, EAST, 1e-9)
    # Level pairs could pass above each other as well as below. The first one goes up: else
    # rounding would choose, as the programs move out of a plane as soon as anything is out of it.
    normals[:, 2] += np.where(np.abs(normals[:, 2]) < LEVEL, lean, 0.0)
    normals = unit(normals)
    return Planes(pairs, normals, np.einsum("md,mdk->mk", normals, differences))


def hull_points(differences: Array) -> Array:
    """Return the points nearest to the origin of the hulls of (m, 3, k) points, as (m, 3).

    The nearest point is a point, on an edge or on a triangle of them, or it is the origin. All of
    these are solved in closed form. Where several are equally near they are the same point, as a
    hull is convex, so a tie changes nothing.
    """
    points = np.ascontiguousarray(differences.transpose(1, 2, 0))  # (3, k, m)
    nearest, least = points[:, 0], _dot(points[:, 0], points[:, 0])
    for size in (1, 2, 3):
        for corners in combinations(range(points.shape[1]), size):
            start, *others = (points[:, corner] for corner in corners)
            candidate, inside = _of_simplex(start, [other - start for other in others])
            squared = _dot(candidate, candidate)
            nearer = inside & (squared < least)
            nearest, least = np.where(nearer, candidate, nearest), np.where(nearer, squared, least)
    # A plane through the nearest point bounds the hull unless the origin is within.
    products = np.min(np.einsum("dm,dkm->km", nearest, points), axis=0)
    return np.where(products > 0.5 * least, nearest, 0.0).T


def _of_simplex(start: Array, edges: list[Array]) -> tuple[Array, NDArray[np.bool_]]:
    """Return the points (3, m) nearest to the origin of lines or planes, and which are inside."""
    if not edges:
        return start, np.ones(start.shape[1], dtype=np.bool_)
    a, b, c = (_dot(edges[i], edges[j]) for i, j in ((0, 0), (0, -1), (-1, -1)))
    u, v = -_dot(edges[0], start), -_dot(edges[-1], start)
    size, parts = (a, [u]) if len(edges) == 1 else (a * c - b * b, [u * c - v * b, v * a - u * b])
    solid = size > (0.0 if len(edges) == 1 else FLAT * a * c)
    weights = [np.divide(part, size, out=np.zeros_like(size), where=solid) for part in parts]
    inside = solid & np.all([weight > 0.0 for weight in weights], axis=0)
    found = start + sum(weight * edge for weight, edge in zip(weights, edges, strict=True))
    return found, inside & (sum(weights) < 1.0)


def _dot(a: Array, b: Array) -> Array:
    """Return products of vectors along the first axis."""
    product: Array = np.einsum("d...,d...->...", a, b)
    return product


def _nearest_of_curves(differences: Array) -> Array:
    """Return about the points (m, 3) nearest to the origin of curves (m, 3, degree + 1)."""
    weights = bernstein.basis(np.linspace(0.0, 1.0, CURVE_SAMPLES), differences.shape[-1] - 1)
    points = differences @ weights.T
    squared = np.sum(points * points, axis=1)
    best = first_smallest(squared, np.max(squared, axis=1))
    return points[np.arange(len(points)), :, best]


@dataclass(frozen=True, eq=False)
class Walls:
    """Planes in front of prisms.

    Attributes
    ----------
    piece, drone: (m,): which piece of which drone is to stay before it.
    normals: (m, 3), unit vectors away from the prism.
    gaps: (m, degree + 1): the coefficients' distances before the prism, in radii.
    """

    piece: Indices
    drone: Indices
    normals: Array
    gaps: Array

    def __len__(self) -> int:
        return len(self.piece)


def walls_before(curves: Array, prisms: tuple[Prism, ...], radius: float, cutoff: float) -> Walls:
    """Return a plane for every piece that may come closer to a prism than ``cutoff``.

    Parameters
    ----------
    curves: (pieces, N, 3, degree + 1) [m], Bernstein coefficients.
    prisms: obstacles.
    radius: smallest distance to them [m]
    cutoff: [m]
    """
    weights = bernstein.basis(np.linspace(0.0, 1.0, CURVE_SAMPLES), curves.shape[-1] - 1)
    lower, upper = np.min(curves, axis=-1), np.max(curves, axis=-1)
    found = []
    for prism in prisms:  # few: they are drawn by hand
        corners = prism.corners
        near = np.all(
            (lower <= np.max(corners, axis=0) + cutoff)
            & (upper >= np.min(corners, axis=0) - cutoff),
            axis=-1,
        )
        piece, drone = np.nonzero(near)
        coefficients = curves[piece, drone]  # (m, 3, degree + 1)
        points = np.swapaxes(coefficients @ weights.T, 1, 2)
        clearance = prism.clearance(points)
        worst = first_smallest(clearance.distance, radius)
        normals = clearance.normals[np.arange(len(worst)), worst]
        reach = np.max(normals @ corners.T, axis=1)
        gaps = (np.einsum("md,mdk->mk", normals, coefficients) - reach[:, None]) / radius
        close = np.min(gaps, axis=1) * radius < cutoff
        found.append((piece[close], drone[close], normals[close], gaps[close]))
    if not found:
        none = np.zeros(0, dtype=np.intp)
        return Walls(none, none, np.zeros((0, 3)), np.zeros((0, curves.shape[-1])))
    return Walls(*(np.concatenate(part) for part in zip(*found, strict=True)))
