"""An action of the paper: which vertices move, and which legs keep their lengths meanwhile."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.cable_slack import cable_slack
from hitchopt.planners.path.shape_path import LegLaw, ShapePath, roll_between
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

WHOLE = np.array([0.0, 1.0])
"""Breaks of s, of a path in one piece."""

LINEAR = (0.0, 1.0)
"""Bernstein coefficients of s: how a deviation from the kept legs grows along a path."""

AT_REST = (0.0, 0.0, 0.0, 1.0, 1.0, 1.0)
"""The same at rest at both ends, for paths that are flown by their own time."""


@dataclass(frozen=True, eq=False)
class Action:
    """A change of shape and the legs that it keeps.

    Parameters
    ----------
    start: the hitch before.
    polygon: the outline after.
    length, share: (n,) [m] and without unit; the legs kept are ``d = length + share · slack``.
    named: the drones that move by this law where tensions are equal.
    track: of shape (n, 3) over s from 0 to 1 [m], the vertices in between; None for straight lines.
    seconds: [s] how long, where s is time already; else None.
    """

    start: Hitch
    polygon: Outline
    length: Array
    share: Array
    named: tuple[str, ...]
    track: PiecewisePolynomial | None = None
    seconds: float | None = None

    @property
    def kept_legs(self) -> Array:
        """(n,) [m]: the q-legs that the law leaves after the action, of any sign."""
        slack = cable_slack(self.start.team, self.polygon)
        return self.start.team.layout.q_legs_of(self.length + self.share * slack, slack)

    @property
    def vertices(self) -> PiecewisePolynomial:
        """The vertices' path, of shape (n, 3) over s from 0 to 1 [m]."""
        if self.track is not None:
            return self.track
        start, points = self.start, self.polygon.vertices
        end = np.column_stack([points, np.full(len(points), start.altitude)])
        return PiecewisePolynomial(WHOLE, np.stack([start.vertices, end], axis=-1)[None])

    def path(self, end: Hitch | None = None) -> ShapePath:
        """Return the path that ends with a hitch's legs and roll, those kept if None.

        What they differ by from the kept ones is made up along the path.
        """
        deviation = np.zeros_like(self.length) if end is None else end.q_legs - self.kept_legs
        grown = np.asarray(LINEAR if self.seconds is None else AT_REST)
        length = (self.length[:, None] + deviation[:, None] * grown)[None]
        share = PiecewisePolynomial.constant(WHOLE, self.share)
        law = LegLaw(PiecewisePolynomial(WHOLE, length), share)
        roll = roll_between(self.start, self.start if end is None else end, tuple(grown))
        return ShapePath(self.start.team, self.vertices, law, roll=roll)


def drone_names(team: Team, q: Iterable[int], r: Iterable[int]) -> tuple[str, ...]:
    """Return the names of drones ``q_k`` and ``r_k`` in the order of the team.

    Indices are cyclic; in an open chain those beyond its ends name none.
    """
    n, closed = team.robots, team.layout.closed
    wanted = {f"q{k % n}" for k in q if closed or 0 <= k < n}
    wanted |= {f"r{k % n}" for k in r if closed or 0 <= k < n}
    return tuple(name for name in team.drone_names if name in wanted)
