"""What is asked of a leg sharing, and what one is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch.team import Team
from hitchopt.requirements import Requirements

Array = NDArray[np.float64]

SPREAD_MARGIN = 1.5
"""How many times its limit each distance is kept at by the sharing called ``spread``."""

LIMIT_MARGIN = 1.001
"""How far inside its limits a sharing is put, so that a plan's small errors do not break them."""

CROSSING_MARGIN = 1.005
"""At most that for cables that cross no clasp: ``spread`` is about drones."""


@dataclass(frozen=True, eq=False)
class LegTask:
    """Sharings of one team on J polygons (one, or the knots of a path) at once.

    Attributes
    ----------
    team: whose cables.
    requirements: distances that are kept, and the arena.
    polygons: (J, points, 2) [m]
    reference: (J, n) [m], the ``d`` to stay near to.
    shortest_leg: [m], for both legs of every cable.
    margin: each distance is to be at least this many times its limit; one, or one per knot (J,).
    roughness: [m²], weight of the fractions' second differences along the knots; 0 for none.
    fixed: (J,), knots that keep their reference.
    """

    team: Team
    requirements: Requirements
    polygons: Array
    reference: Array
    shortest_leg: float
    margin: float | Array
    roughness: float = 0.0
    fixed: NDArray[np.bool_] | None = None

    @property
    def margins(self) -> Array:
        """(J,): the margin of every knot."""
        return np.broadcast_to(np.asarray(self.margin, dtype=np.float64), len(self.reference))

    @property
    def crossing_margins(self) -> Array:
        """(J,): how many times its limit the distance of two cables is kept at."""
        return np.minimum(self.margins, CROSSING_MARGIN)

    @property
    def wanted(self) -> float:
        """The largest of the margins, which a sharing that keeps them all is said to have."""
        return float(np.max(self.margins))

    @property
    def slack(self) -> Array:
        """(J, n) [m]: what each cable has left for its two legs."""
        edges = self.team.layout.edges(self.polygons)
        slack: Array = self.team.cable_length - np.linalg.norm(edges, axis=-1)
        return slack


@dataclass(frozen=True, eq=False)
class LegLengths:
    """A sharing that was found.

    Attributes
    ----------
    q_legs: (J, n) [m], ``d``.
    margin: the smallest distance over its limit, measured on the sharing itself; where margins
        differ from knot to knot, in proportion to the largest of them.
    deviation: sum of ``(d - reference)²`` [m²].
    """

    q_legs: Array
    margin: float
    deviation: float
