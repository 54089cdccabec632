"""Planes between pieces of drones and the prisms that they stay out of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.geometry.vectors import first_smallest
from hitchopt.planners.separation.planes import CURVE_SAMPLES
from hitchopt.requirements import Prism
from hitchopt.trajectory import bernstein
from hitchopt.values import Array, Indices


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
