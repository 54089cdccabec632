"""Moving points and segments, how near they are, and the boxes that they stay in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.broadphase import Indices
from hitchopt.geometry.vectors import length
from hitchopt.trajectory.distance import distance_bound
from hitchopt.trajectory.extremum import Bound
from hitchopt.values import Array

Allowed = Callable[[Indices, Indices], NDArray[np.bool_]]
"""Which pairs (first, second) count."""

SLACK = 1e-9
"""Relative: boxes are rounded, and so is the distance that they are compared with."""


@dataclass(frozen=True, eq=False)
class Bodies:
    """Points or segments.

    Attributes
    ----------
    corners: (pieces, bodies, 1 or 2, 3, degree + 1) [m]: their ends.
    """

    corners: Array

    def __len__(self) -> int:
        return int(self.corners.shape[1])


@dataclass(frozen=True, eq=False)
class Metric:
    """A measure of how near bodies are that grows with their distance.

    Attributes
    ----------
    bound: lower bounds on cells, as ``distance_bound`` gives them.
    measured: returns the measure (…) of shortest offsets (…, 3).
    reach: returns the distance from which on the measure is at least the given one.
    """

    bound: Bound
    measured: Callable[[Array], Array]
    reach: Callable[[float], float]


DISTANCE = Metric(distance_bound, length, lambda measure: measure)


def every_pair(first: Indices, _: Indices) -> NDArray[np.bool_]:
    """Allow all pairs."""
    return np.ones(len(first), dtype=np.bool_)


def body_boxes(corners: Array) -> Array:
    """Return the boxes (2, 3, pieces, bodies), lower and upper, of bodies (pieces, bodies, …)."""
    each = corners.transpose(2, 4, 3, 0, 1).reshape(-1, 3, *corners.shape[:2])  # of points
    return np.stack([each.min(axis=0), each.max(axis=0)])
