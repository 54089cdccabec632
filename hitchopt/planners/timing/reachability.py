"""toppra's time-optimal speeds under polygonal bounds of (s̈, ṡ²).

Importing toppra imports matplotlib.pyplot and scipy.interpolate, which takes half a second.
Functions that time a path import this module when they are called.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from toppra import PolynomialPath
from toppra.algorithm import TOPPRA
from toppra.constraint import LinearConstraint, canlinear_colloc_to_interpolate

from hitchopt.values import Array


class HalfPlanes(LinearConstraint):  # type: ignore[misc]  # toppra has no types
    """Half planes ``normal · (s̈, ṡ²) ≤ bound`` at both ends of every step of the grid."""

    def __init__(self, normals: Array, bounds: Array) -> None:
        """Store outward normals (2, J, m) and bounds (J, m) at the J grid points."""
        super().__init__()
        self.normals = normals
        self.bounds = bounds
        self.identical = True  # toppra's F and g are the same at all grid points

    @classmethod
    def of_polygons(cls, corners: Array) -> HalfPlanes:
        """Return the half planes of convex polygons with corners (2, J, m + 1) from s̈ > 0 on."""
        edges = np.diff(corners)  # counter-clockwise
        normals = np.stack([edges[1], -edges[0]])
        lengths = np.hypot(*normals)  # without overflow where the path stops and ṡ is unbounded
        degenerate = lengths == 0.0
        upward = np.array([0.0, 1.0])[:, None, None]
        normals = np.where(degenerate, upward, normals / np.where(degenerate, 1.0, lengths))
        return cls(normals, np.sum(normals * corners[..., :-1], axis=0))

    def compute_constraint_params(
        self,
        path: PolynomialPath,  # noqa: ARG002, the rows already hold what the path demands
        gridpoints: Array,
    ) -> tuple[Any, ...]:
        """Return toppra's parameters of the constraint."""
        rows = self.bounds.shape[1]
        return canlinear_colloc_to_interpolate(  # type: ignore[no-any-return]
            a=self.normals[0],
            b=self.normals[1],
            c=-self.bounds,
            F=np.eye(rows),
            g=np.zeros(rows),
            xbound=None,
            ubound=None,
            gridpoints=gridpoints,
            identical=True,
        )


def fastest_speeds(s: Array, corners: Array) -> Array | None:
    """Return the time-optimal ṡ (J,) from rest to rest on a grid s (J,); None if toppra fails.

    Parameters
    ----------
    s: grid of the path's parameter. toppra's tolerances are absolute: s, s̈ and ṡ² have to be of
        order 1 to 100.
    corners: (2, J, m + 1), counter-clockwise, of the convex polygons of feasible (s̈, ṡ²).
    """
    line = PolynomialPath([0.0, 1.0], s_start=s[0], s_end=s[-1])
    problem = TOPPRA([HalfPlanes.of_polygons(corners)], line, s, solver_wrapper="seidel")
    _, speeds, _ = problem.compute_parameterization(0.0, 0.0)
    if speeds is None or not np.all(speeds[1:-1] > 0.0):
        return None
    return np.asarray(speeds)
