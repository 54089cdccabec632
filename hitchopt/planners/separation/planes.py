"""Separating planes: between pieces of drones that come close, and before prisms.

Lengths are scaled so that an ellipsoid pair's separation is a distance. The difference of two
pieces lies in the hull of its Bernstein coefficients; the point of that hull nearest to the origin
is the normal of the plane with the widest gap that holds on the whole piece.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.broadphase import Boxes, close_pairs
from hitchopt.geometry.vectors import EAST, first_smallest, unit
from hitchopt.hitch.requirements import Prism, Separation
from hitchopt.trajectory import bernstein
from hitchopt.values import Array, Indices

LEVEL = 1e-6
"""Largest upward component of a normal that counts as level."""

LEAN, LEAN_UNTIL = 1e-2, 2.0
"""Upward slope of level normals, for every unit by which the separation falls short of this."""

CURVE_SAMPLES = 17
"""Number of samples of a piece that locate its nearest point."""

FLAT = 1e-10
"""Squared sine of the angle below which two edges of a triangle count as parallel: all of it is
then as near to its edges."""


@dataclass(frozen=True, eq=False)
class Planes:
    """Planes that pieces of curves stay on one side of.

    Attributes
    ----------
    sides: (m, 3): a piece, its drone, and the drone on the other side; -1 for a prism.
    normals: (m, 3) [1/m], towards the first drone: how gaps grow as it moves.
    gaps: (m, degree + 1), of the coefficients; 1 where they keep their distance.
    """

    sides: Indices
    normals: Array
    gaps: Array

    @classmethod
    def joined(cls, parts: Sequence[Planes]) -> Planes:
        """Return all planes of several sets."""
        names = ("sides", "normals", "gaps")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def close_pieces(curves: Array, separation: Separation, cutoff: float) -> Indices:
    """Return all pairs (m, 3) of a piece of two drones whose hulls are nearer than ``cutoff``.

    Parameters
    ----------
    curves: (pieces, N, 3, degree + 1) [m], Bernstein coefficients.
    cutoff: a separation.
    """
    found, scaled = [], curves * separation.scale[:, None]
    for m, piece in enumerate(scaled):  # as many as the grid has, whatever the number of drones
        pairs = close_pairs(Boxes(np.min(piece, axis=-1), np.max(piece, axis=-1)), None, cutoff)
        found.append(np.column_stack([np.full(len(pairs), m), pairs.first, pairs.second]))
    sides = np.concatenate(found)
    piece, first, second = sides.T
    nearest = hull_points(scaled[piece, first] - scaled[piece, second])
    near: Indices = sides[np.sum(nearest * nearest, axis=1) < cutoff * cutoff]
    return near


def planes_between(curves: Array, separation: Separation, sides: Indices) -> Planes:
    """Return the widest plane for every pair (m, 3) of a piece of two drones."""
    piece, first, second = sides.T
    differences = (curves[piece, first] - curves[piece, second]) * separation.scale[:, None]
    nearest = hull_points(differences)
    apart = np.linalg.norm(nearest, axis=-1)
    # Hulls that hold the origin have no plane yet: the curve's own nearest point gives a first one.
    inside = apart < 1e-6
    nearest[inside] = _nearest_of_curves(differences[inside])
    normals = unit(nearest, EAST, 1e-9)
    # Level pairs could pass above each other as well as below. The first one goes up: else
    # rounding would choose, as the programs move out of a plane as soon as anything is out of it.
    lean = LEAN * np.maximum(LEAN_UNTIL - apart, 0.0)
    normals[:, 2] += np.where(np.abs(normals[:, 2]) < LEVEL, lean, 0.0)
    normals = unit(normals)
    gaps = np.einsum("md,mdk->mk", normals, differences)
    return Planes(sides, normals * separation.scale, gaps)


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


def walls_before(curves: Array, prism: Prism, radius: float, cutoff: float) -> Planes:
    """Return a plane for every piece that may come closer to a prism than ``cutoff`` [m].

    Parameters
    ----------
    curves: (pieces, N, 3, degree + 1) [m], Bernstein coefficients.
    radius: smallest distance to the prism [m]
    """
    weights = bernstein.basis(np.linspace(0.0, 1.0, CURVE_SAMPLES), curves.shape[-1] - 1)
    corners = prism.corners
    low, high = np.min(corners, axis=0) - cutoff, np.max(corners, axis=0) + cutoff
    near = np.all((np.min(curves, -1) <= high) & (np.max(curves, -1) >= low), axis=-1)
    piece, drone = np.nonzero(near)
    coefficients = curves[piece, drone]
    clearance = prism.clearance(np.swapaxes(coefficients @ weights.T, 1, 2))
    worst = first_smallest(clearance.distance, radius)
    normals = clearance.normals[np.arange(len(worst)), worst] / radius
    reach = np.max(normals @ corners.T, axis=1)
    gaps = np.einsum("md,mdk->mk", normals, coefficients) - reach[:, None]
    close = np.min(gaps, axis=1) * radius < cutoff
    sides = np.column_stack([piece, drone, np.full(len(piece), -1)])
    return Planes(sides[close], normals[close], gaps[close])
