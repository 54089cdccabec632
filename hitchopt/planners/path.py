"""A geometric path of a hitch: flat outputs over a parameter s from 0 to 1, not yet timed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import Hitch, Team
from hitchopt.model.evaluation import DroneJets, FlatJets, drone_jets
from hitchopt.model.robot import JET
from hitchopt.planners import jets
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class StraightPath:
    """Every vertex goes straight to its place; legs follow a law of their fractions.

    Attributes
    ----------
    team: whose cables.
    start, end: (n, 3) [m], the vertices at s = 0 and s = 1.
    fractions: of shape (n,) over s in [0, 1]: ``d_k / (d_k + e_k)``.
    """

    team: Team
    start: Array
    end: Array
    fractions: PiecewisePolynomial

    @classmethod
    def between(cls, start: Hitch, end: Hitch) -> StraightPath:
        """Return the path on which the fractions change linearly with s."""
        line = np.stack([start.fractions, end.fractions], axis=-1)
        fractions = PiecewisePolynomial(np.array([0.0, 1.0]), line[None])
        return cls(start.team, start.vertices, end.vertices, fractions)

    def flat(self, s: Array) -> FlatJets:
        """Return the flat outputs' jets by s at s (J,)."""
        count, n = len(s), self.team.robots
        vertices = np.zeros((count, n, 3, JET))
        vertices[..., 0] = self.start + s[:, None, None] * (self.end - self.start)
        vertices[..., 1] = self.end - self.start
        edges = np.roll(vertices, -1, axis=1) - vertices
        lengths = jets.square_root(np.sum(jets.product(edges, edges), axis=2))
        slack = -lengths
        slack[..., 0] += self.team.cable_length
        fractions = np.stack([self.fractions.at(s, order) for order in range(JET)], axis=-1)
        tensions = np.zeros((count, n, JET))
        tensions[..., 0] = self.team.tension
        return FlatJets(vertices, jets.product(fractions, slack), tensions)

    def drones(self, s: Array) -> DroneJets:
        """Return the drones' jets by s at s (J,)."""
        return drone_jets(self.team, self.flat(s))

    def polygons(self, s: Array) -> Array:
        """Return the vertices in plan view at s (J,), as (J, n, 2) [m]."""
        line = self.start + s[:, None, None] * (self.end - self.start)
        return line[..., :2]
