"""The task of finding leg lengths, and its result."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch.cable_spans import cable_slack_of
from hitchopt.hitch.team import Team
from hitchopt.requirements import Requirements
from hitchopt.values import Array

SPREAD_MARGIN = 1.5
"""Distance over its limit that the leg lengths called ``spread`` keep."""

LIMIT_MARGIN = 1.001
"""Distance over its limit of all other leg lengths: a plan's small errors stay within limits."""

CROSSING_MARGIN = 1.005
"""Largest margin of cables without a common clasp: ``spread`` concerns drones."""


@dataclass(frozen=True, eq=False)
class LegTask:
    """Leg lengths of one team to be found on J polygons (one, or the knots of a path) at once.

    Attributes
    ----------
    team: its cables are split.
    requirements: distances, and the arena.
    polygons: (J, points, 2) [m]
    reference: (J, n) [m], ``d`` to deviate least from.
    shortest_leg: [m], for both legs of every cable.
    margin: each distance is to be at least this many times its limit; one, or one per knot (J,).
    roughness: [m²], weight of the fractions' second differences along the knots; 0 for none.
    fixed: (J,), knots that keep their reference.
    roll: (J, clasps) [rad], of the legs out of their plane; None for none.
    """

    team: Team
    requirements: Requirements
    polygons: Array
    reference: Array
    shortest_leg: float
    margin: float | Array
    roughness: float = 0.0
    fixed: NDArray[np.bool_] | None = None
    roll: Array | None = None

    @property
    def level(self) -> bool:
        """Whether all legs are level: they carry no weight and are not rolled."""
        return not self.team.loaded and (self.roll is None or not np.any(self.roll))

    @cached_property
    def margins(self) -> Array:
        """(J,): the margin of every knot."""
        return np.broadcast_to(np.asarray(self.margin, dtype=np.float64), len(self.reference))

    @cached_property
    def crossing_margins(self) -> Array:
        """(J,): margin of the distances of two cables."""
        return np.minimum(self.margins, CROSSING_MARGIN)

    @cached_property
    def wanted(self) -> float:
        """The largest of the margins: the margin of leg lengths that keep them all."""
        return float(np.max(self.margins))

    @cached_property
    def slack(self) -> Array:
        """(J, n) [m], read-only: slack of each cable for its two legs."""
        slack = cable_slack_of(self.team, self.team.layout.edges(self.polygons))
        slack.setflags(write=False)
        return slack

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """The smallest and largest ``d`` (J, n) that leave both legs long enough, read-only.

        The same one at the ends of a chain, where a cable has one leg only.
        """
        slack, layout = self.slack, self.team.layout
        shortest = np.minimum(self.shortest_leg, 0.5 * slack)
        lower = layout.q_legs_of(shortest, slack)
        upper = layout.q_legs_of(slack - shortest, slack)
        if self.fixed is not None:
            lower[self.fixed] = upper[self.fixed] = self.reference[self.fixed]
        for each in (lower, upper):
            each.setflags(write=False)
        return lower, upper


@dataclass(frozen=True, eq=False)
class LegLengths:
    """Leg lengths that were found.

    Attributes
    ----------
    q_legs: (J, n) [m], ``d``.
    margin: the smallest distance over its limit, measured on these lengths; where margins
        differ from knot to knot, in proportion to the largest of them.
    deviation: sum of ``(d - reference)²`` [m²].
    """

    q_legs: Array
    margin: float
    deviation: float
