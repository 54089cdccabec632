"""Polygons of hitches around an object, and where they hold it, in the object's own frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.geometry import ConvexPolygon
from hitchopt.objects import Section
from hitchopt.values import Array


@dataclass(frozen=True, eq=False)
class HoldPolygons:
    """Where clasps are around an object, and where they hold it, as seen from it.

    Attributes
    ----------
    around: (n, 2) [m], outside of all of the object.
    closed: (n, 2) [m], below its rim, or where edges grip it; of the same shape.
    """

    around: Array
    closed: Array

    @classmethod
    def about(
        cls, closed: Array, centre: Array, sections: tuple[Section, ...], gap: float
    ) -> HoldPolygons:
        """Return a polygon and the one of its shape about a centre that keeps off sections.

        Parameters
        ----------
        closed: (n, 2) [m], clockwise, the centre (2,) [m] inside of it.
        gap: between edges and sections [m].
        """
        onward = np.roll(closed, -1, axis=0) - closed
        outward = np.stack([-onward[:, 1], onward[:, 0]], axis=-1)
        outward /= np.linalg.norm(outward, axis=-1, keepdims=True)  # of clockwise edges
        reach = np.sum(outward * (closed - centre), axis=-1)
        needed = [each.support(outward) + gap - outward @ centre for each in sections]
        factor = float(np.max(np.max(needed, axis=0) / reach))
        around = centre + factor * (closed - centre)
        return cls(ConvexPolygon(around).vertices, ConvexPolygon(closed).vertices)
