"""Convex arcs: the outlines of open chains. They have no cables."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from hitchopt.geometry.outline import Outline
from hitchopt.values import Array


class ConvexArc(Outline):
    """Points joined in a row that turn right at every inner one, less than once around in all.

    Parameters
    ----------
    vertices: (n + 1, 2) [m], n ≥ 2: the ends of n edges. Copied and set read-only.

    Raises
    ------
    InputError: wrong shape, not finite, coincident points, not clockwise or not convex.
    """

    closed: ClassVar[bool] = False

    @property
    def centroid(self) -> Array:
        """(2,) [m]: centre of the arc's length."""
        middles = 0.5 * (self.vertices[1:] + self.vertices[:-1])
        centroid: Array = np.average(middles, axis=0, weights=self.edge_lengths)
        return centroid

    def _check_turns(self) -> None:
        super()._check_turns()
        total = float(np.sum(self.exterior_angles))
        if total >= 2.0 * math.pi:
            turned = f"it turns by {math.degrees(total):.6g}°"
            remedy = "open the chain, or close it and write topology: closed"
            raise self._refused(f"an arc that turns by less than 360° in all ({turned})", remedy)
