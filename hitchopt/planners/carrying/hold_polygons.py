"""Polygons of hitches around an object, and where they hold it, in the object's own frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.geometry import ConvexPolygon
from hitchopt.objects import Section
from hitchopt.values import Array

STRETCHES = np.geomspace(0.25, 4.0, 81)
"""Proportions that are tried for a polygon around an object, over those with which it is held."""


@dataclass(frozen=True, eq=False)
class HoldPolygons:
    """Where clasps are around an object, and where they hold it, as seen from it.

    Attributes
    ----------
    around: (n, 2) [m], outside of all of the object.
    closed: (n, 2) [m], below its rim, or where edges grip it; one is the other one stretched.
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
        around = centre + _off(closed - centre, centre, sections, gap)
        return cls(ConvexPolygon(around).vertices, ConvexPolygon(closed).vertices)

    @classmethod
    def with_short_edges(
        cls, closed: Array, centre: Array, sections: tuple[Section, ...], gap: float
    ) -> HoldPolygons:
        """Return a polygon and a stretched one that keeps off sections: of short edges.

        Of the stretches along the polygon's axes the one whose longest edge is the shortest leaves
        the most cable to legs, which keeps drones apart.

        Parameters
        ----------
        closed, centre, sections, gap: as of ``about``.
        """
        away = closed - centre
        axes = np.linalg.eigh(away.T @ away)[1]
        stretch = np.stack([np.sqrt(STRETCHES), 1.0 / np.sqrt(STRETCHES)], axis=-1)
        found = [_off(away @ (axes * each) @ axes.T, centre, sections, gap) for each in stretch]
        around = min(found, key=lambda each: float(np.max(_edge_lengths(each))))
        return cls(ConvexPolygon(centre + around).vertices, ConvexPolygon(closed).vertices)


def _edge_lengths(polygon: Array) -> Array:
    """Return the lengths (n,) [m] of a polygon's edges."""
    lengths: Array = np.linalg.norm(np.roll(polygon, -1, axis=0) - polygon, axis=-1)
    return lengths


def _off(away: Array, centre: Array, sections: tuple[Section, ...], gap: float) -> Array:
    """Return vertices (n, 2) [m] about a centre, enlarged until edges keep off sections."""
    onward = np.roll(away, -1, axis=0) - away
    outward = np.stack([-onward[:, 1], onward[:, 0]], axis=-1)
    outward /= np.linalg.norm(outward, axis=-1, keepdims=True)  # of clockwise edges
    reach = np.sum(outward * away, axis=-1)
    needed = [each.support(outward) + gap - outward @ centre for each in sections]
    enlarged: Array = float(np.max(np.max(needed, axis=0) / reach)) * away
    return enlarged
