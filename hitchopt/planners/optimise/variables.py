"""Where the optimiser's variables stand: per knot, vertices, legs, drones and tensions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch.statics import leg_directions
from hitchopt.planners.optimise.knot_path import Way

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True)
class Layout:
    """The columns of a table (knots, size), of which the inner rows are variables.

    Drones and r-legs are variables of their own, tied to the flat outputs by equalities: distances
    are then polynomials of the second degree at most, and every row involves few variables.

    Attributes
    ----------
    robots: n
    """

    robots: int

    @property
    def size(self) -> int:
        """Variables per knot."""
        return 9 * self.robots

    @property
    def vertices(self) -> Index:
        """Of the vertices, (n, 2)."""
        return np.arange(2 * self.robots).reshape(-1, 2)

    @property
    def q_legs(self) -> Index:
        """Of the q-legs, (n,)."""
        return 2 * self.robots + np.arange(self.robots)

    @property
    def r_legs(self) -> Index:
        """Of the r-legs, (n,)."""
        return 3 * self.robots + np.arange(self.robots)

    @property
    def drones(self) -> Index:
        """Of the drones, (2n, 2)."""
        return 4 * self.robots + np.arange(4 * self.robots).reshape(-1, 2)

    @property
    def tensions(self) -> Index:
        """Of the tensions, (n,)."""
        return 8 * self.robots + np.arange(self.robots)

    @property
    def nodes(self) -> Index:
        """(3n, 2): vertices, then drones, as in ``hitch.parts``."""
        return np.concatenate([self.vertices, self.drones])

    def table(self, way: Way) -> Array:
        """Return (knots, size) of a way."""
        edges = np.roll(way.polygons, -1, axis=1) - way.polygons
        u = edges / np.linalg.norm(edges, axis=-1, keepdims=True)
        q, r = leg_directions(u, way.tensions)
        r_legs = way.slack - way.q_legs
        ends = np.stack(
            [
                way.polygons + way.q_legs[..., None] * q,
                np.roll(way.polygons, -1, axis=1) + r_legs[..., None] * r,
            ],
            axis=2,
        )
        count = len(way.polygons)
        columns = [way.polygons, way.q_legs, r_legs, ends, way.tensions]
        return np.concatenate([part.reshape(count, -1) for part in columns], axis=1)

    def way(self, table: Array, like: Way) -> Way:
        """Return the way that a table (knots, size) tells."""
        return Way(
            like.name,
            like.team,
            like.altitude,
            table[:, self.vertices],
            table[:, self.q_legs],
            table[:, self.tensions],
        )
