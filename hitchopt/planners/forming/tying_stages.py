"""Stages of forming and releasing: swap, swap, tighten, pull; and backward."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hitchopt.hitch import Hitch, Team
from hitchopt.motion.phases import CableState
from hitchopt.planners.forming.prehitch import PreHitch
from hitchopt.planners.forming.straight import tightened
from hitchopt.planners.forming.turns import SwapSettings, swap
from hitchopt.requirements import Limits
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

PULL_SECONDS = 1.0
"""[s] Shortest rise of the tensions, against which drones tilt."""

PULL_PERIODS = 3.0
"""Shortest rise of the tensions over the longest period of a cable (see ``rise_seconds``)."""

SMOOTH = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])
"""Bernstein coefficients of the rise from 0 to 1 with three derivatives zero at both ends."""

SHARES = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
"""Shares of the line from pre-hitch to hitch that are tried as places of the clasps."""

BACKWARD = {"swap 1": "unswap 2", "swap 2": "unswap 1", "tighten": "loosen", "tension": "relax"}
"""Names of the stages of forming when they are undone."""


def tied(pre: PreHitch, hitch: Hitch, limits: Limits, settings: SwapSettings) -> list[Stage]:
    """Return the stages from the pre-hitch to the hitch, pulled by the team's tension."""
    team = hitch.team
    legs = float(np.max(hitch.legs))
    shorter = (1.0 - pre.share) * legs  # no drone goes farther, whatever the polygon
    flights = tightened(team, limits, pre.separation, pre.drones, hitch.drones, shorter)
    rest = PiecewisePolynomial.constant([0.0, rise_seconds(team)], hitch.drones)
    return [
        Stage("swap 1", swap(pre.turns, limits, 0, settings.seconds), CableState.CLASPING),
        Stage("swap 2", swap(pre.turns, limits, 1, settings.seconds), CableState.CLASPING),
        *(
            Stage("tighten", flight, CableState.TIGHTENING, points=points)
            for flight, points in zip(flights, _clasps(pre, hitch, flights), strict=True)
        ),
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


def _clasps(
    pre: PreHitch, hitch: Hitch, flights: Sequence[PiecewisePolynomial]
) -> list[PiecewisePolynomial]:
    """Return where the clasps may lie (points, 3) [m] while the drones fly out.

    They move along with the drones, between places that all cables reach around at the ends of
    every flight. Lengths are convex: cables that reach at both ends of a straight flight reach in
    between.
    """
    here, found = _places(pre, hitch, pre.drones), []
    for i, flight in enumerate(flights):
        start, end = flight.coefficients[0, ..., 0], flight.coefficients[-1, ..., -1]
        last = i == len(flights) - 1
        there = hitch.vertices if last else _places(pre, hitch, end)
        gone = flight.coefficients - start[..., None]
        farthest = int(np.argmax(np.linalg.norm(end - start, axis=1)))
        whole = (end - start)[farthest]
        size = float(whole @ whole)
        s = np.einsum("d,pdm->pm", whole, gone[:, farthest]) / size if size > 0.0 else np.ones(1)
        s = np.clip(s, 0.0, 1.0)[..., None, None, :]
        points = here[..., None] * (1.0 - s) + there[..., None] * s
        shape = (flight.pieces, *points.shape[-3:])
        found.append(PiecewisePolynomial(flight.breaks, np.broadcast_to(points, shape)))
        here = there
    return found


def _places(pre: PreHitch, hitch: Hitch, drones: Array) -> Array:
    """Return the places (points, 3) [m] of the clasps that cables reach around most easily.

    Candidates are the middles of the pairs, the pre-hitch's vertices, and places between them and
    the hitch's; the ends of chains are where their drones are.
    """
    layout = hitch.team.layout
    centre = np.append(hitch.polygon.centroid, hitch.altitude)
    middles = hitch.vertices.copy()
    middles[layout.clasps] = pre.turns.centres
    alone = np.flatnonzero(~layout.has_leg.ravel())
    best, least = hitch.vertices, np.inf
    for first in (centre + pre.scale * (hitch.vertices - centre), middles):
        for share in SHARES:
            points = first + share * (hitch.vertices - first)
            points[layout.anchors[alone]] = drones[alone]
            reach = _reach(hitch.team, drones, points)
            if reach < least:
                best, least = points, reach
    return best


def _reach(team: Team, drones: Array, points: Array) -> float:
    """Return the largest share of a cable that its route around the points takes."""
    layout = team.layout
    legs = np.linalg.norm(drones - points[layout.anchors], axis=1).reshape(-1, 2)
    edges = np.linalg.norm(points[layout.ends] - points[layout.starts], axis=1)
    return float(np.max((np.sum(legs, axis=1) + edges) / team.cable_length))


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
