"""Stages of forming and releasing: drones' curves under one name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.hitch import Hitch
from hitchopt.motion.phases import CableState
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array


@dataclass(frozen=True, eq=False)
class Stage:
    """One stage of forming or releasing.

    Attributes
    ----------
    name: the plan's phase.
    drones: of shape (2n, 3) [m], in the order q0, r0, q1, …, from t = 0, at rest at both ends.
    pull: (pieces, m + 1): Bernstein coefficients of the factor of the team's tensions over the
        drones' pieces; None while there is no hitch.
    remark: the phase's remark.
    points: of shape (points, 3) [m]: where the clasps may lie while the drones draw them out; None
        for the hitch's vertices.
    """

    name: str
    drones: PiecewisePolynomial
    pull: Array | None = None
    remark: str = ""
    points: PiecewisePolynomial | None = None

    @property
    def formed(self) -> bool:
        """Whether the hitch exists."""
        return self.pull is not None

    @property
    def state(self) -> CableState:
        """The state that cables are meant to be in."""
        return CableState.of_label(self.name, formed=self.formed)

    def reversed(self, name: str) -> Stage:
        """Return the stage backward in time, exactly, under another name."""
        pull = None if self.pull is None else self.pull[::-1, ::-1]
        points = None if self.points is None else self.points.reversed()
        return Stage(name, self.drones.reversed(), pull, self.remark, points)

    def vertices(self, hitch: Hitch) -> PiecewisePolynomial:
        """Return the vertices (points, 3) [m]: present, future or past ones."""
        if self.points is not None:
            return self.points
        return PiecewisePolynomial.constant(self.drones.breaks, hitch.vertices)

    def legs(self, hitch: Hitch) -> PiecewisePolynomial:
        """Return the legs (n, 2) [m]; zero while there is no hitch."""
        return PiecewisePolynomial.constant(self.drones.breaks, hitch.legs * float(self.formed))

    def tensions(self, hitch: Hitch) -> PiecewisePolynomial:
        """Return the tensions (n,) [N]: the team's by the pull."""
        pull = np.zeros((self.drones.pieces, 1)) if self.pull is None else self.pull
        each = hitch.team.tension[:, None] * pull[:, None, :]
        return PiecewisePolynomial(self.drones.breaks, each)
