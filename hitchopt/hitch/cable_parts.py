"""Straight parts of measured cables: legs and edges, their directions, and the cables' lengths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.geometry.vectors import unit
from hitchopt.hitch.team import GRAVITY, Team
from hitchopt.values import Array


@dataclass(frozen=True, eq=False)
class CableParts:
    """Straight parts of the cables between measured points.

    Attributes
    ----------
    legs: lengths (windows, 2n) [m]; zero at a chain's ends.
    edges: lengths (windows, n) [m].
    outward: (windows, 2n, 3), directions from the point that a drone's cable leads to.
    along: (windows, n, 3), directions of the edges.
    """

    legs: Array
    edges: Array
    outward: Array
    along: Array

    @classmethod
    def of(cls, team: Team, drones: Array, vertices: Array) -> CableParts:
        """Return the parts between drones (windows, 2n, 3) and vertices (windows, points, 3)."""
        layout = team.layout
        legs = np.linalg.norm(drones - vertices[:, layout.anchors], axis=-1)
        legs = np.where(layout.has_leg.ravel(), legs, 0.0)
        edges = layout.edges(vertices)
        outward = unit(drones - vertices[:, layout.pulled_to])
        return cls(legs, np.linalg.norm(edges, axis=-1), outward, unit(edges))

    def lengths(self, density: float, tensions: Array) -> Array:
        """Return the cables' lengths (windows, n) [m]: their parts, longer by the sag of each.

        A span of chord s sags to an arc longer by ``(ρ g/T)² s³/24``, s being level.

        Parameters
        ----------
        density: [kg/m]
        tensions: (windows, n) [N]
        """
        parts = np.stack([self.legs[:, 0::2], self.edges, self.legs[:, 1::2]], axis=-1)
        slope = np.stack(
            [self.outward[:, 0::2, 2], self.along[..., 2], self.outward[:, 1::2, 2]], -1
        )
        level = 1.0 - slope**2
        bent = (GRAVITY * density / tensions[..., None]) ** 2 * parts**3 * level / 24.0
        return np.asarray(np.sum(parts + bent, axis=-1))
