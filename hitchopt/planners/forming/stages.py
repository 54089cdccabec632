"""Stages of forming and releasing: swap, swap, tighten, pull; and backward."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Limits
from hitchopt.motion.motion import CableState
from hitchopt.planners.forming import SwapSettings
from hitchopt.planners.forming.prehitch import PreHitch, clasps_drawn_out
from hitchopt.planners.forming.turns import straight, swap
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

PULL_SECONDS = 1.0
"""[s] Shortest rise of the tensions, against which drones tilt."""

PULL_PERIODS = 3.0
"""Shortest rise of the tensions over the longest period of a cable (see ``rise_seconds``)."""

SMOOTH = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])
"""Bernstein coefficients of the rise from 0 to 1 with three derivatives zero at both ends."""

BACKWARD = {"swap 1": "unswap 2", "swap 2": "unswap 1", "tighten": "loosen", "tension": "relax"}
"""Names of the stages of forming when they are undone."""


def tied(pre: PreHitch, hitch: Hitch, limits: Limits, settings: SwapSettings) -> list[Stage]:
    """Return the stages from the pre-hitch to the hitch, pulled by the team's tension."""
    team = hitch.team
    legs = float(np.max(hitch.legs))
    shorter = (1.0 - pre.share) * legs  # no drone goes farther, whatever the polygon
    out = straight(team, limits, pre.drones, hitch.drones, shorter)
    points = clasps_drawn_out(pre.turns, pre.scale, hitch, out)
    rest = PiecewisePolynomial.constant([0.0, rise_seconds(team)], hitch.drones)
    return [
        Stage("swap 1", swap(pre.turns, limits, 0, settings.seconds), CableState.CLASPING),
        Stage("swap 2", swap(pre.turns, limits, 1, settings.seconds), CableState.CLASPING),
        Stage("tighten", out, CableState.TIGHTENING, points=points),
        Stage("tension", rest, CableState.HITCHED, SMOOTH[None]),
    ]


def rise_seconds(team: Team) -> float:
    """Return how long the tensions rise, so that vertices hang still at the end [s].

    Cables sag until tension comes, and what lifts them fast leaves them swinging. The slowest swing
    of a regular hitch is that of its cables as strings, ends at rest: a wave runs to and fro in
    ``2 √(L m / T)``, m being the mass of the cable and of half the load at each of its clasps.
    After a rise along ``SMOOTH`` an oscillator of that period keeps 19 % of the lift if the rise
    lasts 1.6 periods, nothing at 2.2, and 2.2 % at most from there on; three periods allow for the
    tensions that are still low, at which it is slower.
    """
    layout = team.layout
    meet, halves = np.append(layout.ahead, layout.behind), np.tile(0.5 * team.load, 2)
    loads = np.bincount(meet, halves, team.robots)
    masses = team.cable_density * team.cable_length + loads
    periods = 2.0 * np.sqrt(team.cable_length * masses / team.tension)
    return max(PULL_SECONDS, PULL_PERIODS * float(np.max(periods)))


def undone(stages: Sequence[Stage]) -> list[Stage]:
    """Return the stages of forming backward in time: the hitch is taken apart."""
    return [stage.reversed(BACKWARD[stage.name]) for stage in reversed(stages)]


@dataclass(frozen=True, eq=False)
class Stage:
    """One stage of forming or releasing.

    Attributes
    ----------
    name: the plan's phase.
    drones: of shape (2n, 3) [m], in the order q0, r0, q1, …, from t = 0, at rest at both ends.
    state: that cables are meant to be in.
    pull: (pieces, m + 1): Bernstein coefficients of the factor of the team's tensions over the
        drones' pieces; None while there is no hitch.
    points: of shape (points, 3) [m]: where the clasps may lie while the drones draw them out; None
        for the hitch's vertices.
    """

    name: str
    drones: PiecewisePolynomial
    state: CableState = CableState.FREE
    pull: Array | None = None
    points: PiecewisePolynomial | None = None

    def reversed(self, name: str) -> Stage:
        """Return the stage backward in time, exactly, under another name."""
        pull = None if self.pull is None else self.pull[::-1, ::-1]
        points = None if self.points is None else self.points.reversed()
        return Stage(name, self.drones.reversed(), self.state, pull, points)

    def vertices(self, hitch: Hitch) -> PiecewisePolynomial:
        """Return the vertices (points, 3) [m]: present, future or past ones."""
        if self.points is not None:
            return self.points
        return PiecewisePolynomial.constant(self.drones.breaks, hitch.vertices)

    def legs(self, hitch: Hitch) -> PiecewisePolynomial:
        """Return the legs (n, 2) [m]; zero while there is no hitch."""
        there = float(self.state is CableState.HITCHED)
        return PiecewisePolynomial.constant(self.drones.breaks, there * hitch.legs)

    def tensions(self, hitch: Hitch) -> PiecewisePolynomial:
        """Return the tensions (n,) [N]: the team's by the pull."""
        pull = np.zeros((self.drones.pieces, 1)) if self.pull is None else self.pull
        each = hitch.team.tension[:, None] * pull[:, None, :]
        return PiecewisePolynomial(self.drones.breaks, each)
