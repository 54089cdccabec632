"""Hitches tied by laying: taut cables come down on one another, then every pair rolls half a turn.

At a roll of ±180° both cables of a clasp run straight through and lie on one another; every roll
from there to the clasp is in balance, and no vertex moves. The cable on top decides the sense: its
drone goes down. Robots begin where their cables do not cross, outside of their edges' lines, draw
them taut, slide in over the lines at heights by the order of laying, and come down together: a
cable comes to lie on those that are below it in the order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from hitchopt.errors import check_time
from hitchopt.geometry import shortest_offset
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.model import FlatJets
from hitchopt.hitch.requirements import Requirements, Separation
from hitchopt.hitch.series import JET
from hitchopt.hitch.team import Layout
from hitchopt.motion.motion import CableState, Motion, Phase
from hitchopt.planners.forming.prehitch import APART, PLACES, SPAN, smallest_separation
from hitchopt.planners.forming.stages import SMOOTH, stage, straight_lines
from hitchopt.planners.morph.morph import check_loads
from hitchopt.planners.morph.path import drones_along
from hitchopt.planners.timing.flight import fly
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, Indices

SHARES = tuple(0.5 + sign * off for off in np.linspace(0.0, 0.2, 11) for sign in (1.0, -1.0))
"""Slack splits in the order in which they are tried."""

ANGLES = 61
"""Number of angles of the roll that are measured; the certificate bounds all of them."""

MARGIN, ROOM = 1.2, 0.03
"""Distances of cables that are planned, over their limits, and [m] in addition to them."""

SPACINGS = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0)
"""Distances between levels that are tried, over the smallest one."""

SLANTS = (0.0, 0.3, -0.3, 0.6, -0.6, 1.0, -1.0)
"""Displacements along edges that are tried, over those away from them."""

STEP, STEPS = 0.05, 60
"""Step of the distance from edges over the mean cable, and number of those that are tried."""

TENSION_SECONDS = 0.3
"""[s] Time in which cables that lie taut pass from pulling alone to the hitch's tensions."""


def planned_distance(separation: Separation) -> float:
    """Return the distance of cables to all else [m] that is planned: a margin over its limit."""
    return MARGIN * max(separation.cable, separation.crossing) + ROOM


@dataclass(frozen=True, eq=False)
class RollPath:
    """Legs that turn about their clasps while vertices stay: the roll (clasps,) is linear in s."""

    hitch: Hitch
    start: Array  # (clasps,) [rad]
    end: Array  # (clasps,) [rad]

    @property
    def team(self) -> Team:
        """The team whose cables form the hitch."""
        return self.hitch.team

    def flat(self, s: Array, count: int = JET) -> FlatJets:
        """Return the flat outputs' jets by s at s (J,), of ``count`` numbers each."""
        still = self.hitch.vertices, self.hitch.q_legs, self.team.tension
        vertices, q_legs, tensions, roll = (
            np.zeros((len(s), *np.shape(value), count)) for value in (*still, self.start)
        )
        for jets, value in zip((vertices, q_legs, tensions), still, strict=True):
            jets[..., 0] = value
        roll[..., 0] = self.start + s[:, None] * (self.end - self.start)
        roll[..., 1:2] = (self.end - self.start)[:, None]
        return FlatJets(vertices, q_legs, tensions, roll)

    def drones(self, s: Array) -> Array:
        """Return the drones (J, 2n, 3) [m] at s (J,)."""
        places: Array = drones_along(self, s).positions[..., 0]
        return places


def levels_of(layout: Layout, order: Sequence[int] | None) -> Indices:
    """Return the levels (n,) of cables of a ring, 0 the lowest: neighbours differ.

    ``order`` has the cables from bottom to top; None to alternate.
    """
    n = layout.robots
    levels = np.full(n, -1)
    if order is None:
        levels = np.arange(n) % 2
        levels[-1] += 2 * (n % 2) * (levels[-1] == levels[0])
        return levels
    for k in order:
        levels[k] = 1 + max(levels[k - 1], levels[(k + 1) % n])
    return levels


def senses_of(layout: Layout, levels: Indices) -> Array:
    """Return (clasps,) 1 where cable k is above cable k-1 at its clasp, else -1."""
    senses: Array = np.sign(levels[layout.ahead] - levels[layout.behind]).astype(np.float64)
    return senses


@dataclass(frozen=True, eq=False)
class Laying:
    """A hitch and how it is laid: by ``levels`` (n,), from ``away`` (n, 2) [m] of its lines."""

    hitch: Hitch
    levels: Indices
    spacing: float = 0.0  # [m] between levels
    away: Array | None = None

    @property
    def senses(self) -> Array:
        """(clasps,) 1 where cable k lies on cable k-1."""
        return senses_of(self.hitch.team.layout, self.levels)

    @property
    def path(self) -> RollPath:
        """The roll from cables that lie on one another to the hitch."""
        return RollPath(self.hitch, -np.pi * self.senses, self.hitch.roll)

    @cached_property
    def laid(self) -> Array:
        """(2n, 3) [m]: the drones with all cables on one another."""
        return np.asarray(self.path.drones(np.zeros(1))[0])

    @property
    def above(self) -> Array:
        """(2n, 3) [m]: the drones over these places, by level."""
        rise = np.repeat(self.spacing * self.levels, 2)
        return np.asarray(self.laid + rise[:, None] * [0.0, 0.0, 1.0])

    @property
    def outside(self) -> Array:
        """(2n, 3) [m]: the drones where no cable crosses another, taut."""
        assert self.away is not None
        shift = np.column_stack([self.away, np.zeros(len(self.away))])
        places: Array = self.above + np.repeat(shift, 2, axis=0)
        return places

    @property
    def slack(self) -> Array:
        """(2n, 3) [m]: the drones there, nearer to each other: cables hang."""
        pairs, length = self.outside.reshape(-1, 2, 3), self.hitch.team.cable_length
        middle = np.mean(pairs, axis=1, keepdims=True)
        share = SPAN * length / np.linalg.norm(pairs[:, 1] - pairs[:, 0], axis=-1)
        nearer: Array = middle + share[:, None, None] * (pairs - middle)
        return np.asarray(nearer.reshape(-1, 3))

    def at_altitude(self, altitude: float) -> Laying:
        """Return it at another altitude."""
        own = self.hitch
        return replace(self, hitch=Hitch(own.team, own.polygon, altitude, own.q_legs, own.roll))


def split_for_rolling(hitch: Hitch, senses: Array, requirements: Requirements) -> Hitch:
    """Return the hitch if its drones clear as they roll, else with the split nearest to one half.

    The one with drones farthest apart, if none does.
    """
    best, apart = None, -np.inf
    for q_legs in (hitch.q_legs, *(share * hitch.slack for share in SHARES)):
        check_time()
        hitch = Hitch(hitch.team, hitch.polygon, hitch.altitude, q_legs, hitch.roll)
        path = RollPath(hitch, -np.pi * senses, hitch.roll)
        places = path.drones(np.linspace(0.0, 1.0, ANGLES))
        here = smallest_separation(places, requirements.separation)
        if here > apart:
            best, apart = hitch, here
        if apart >= APART:
            break
    assert best is not None
    return best


def find_laying(hitch: Hitch, levels: Indices, requirements: Requirements) -> Laying:
    """Return how a hitch is laid: the first candidate whose drones keep apart, else the best one.

    Levels are as far apart as cables sag and distances need; robots begin as near as cables can
    without crossing.
    """
    team, separation = hitch.team, requirements.separation
    layout, bare = team.layout, Laying(hitch, levels)
    q, r = bare.laid[0::2], bare.laid[1::2]
    sag = float(np.max(Catenary.between(q, r, team.cable_length).depth(0.0) + np.abs(r - q)[:, 2]))
    keep = planned_distance(separation)
    u = hitch.polygon.edge_directions
    out, step = np.column_stack([-u[:, 1], u[:, 0]]), STEP * float(np.mean(team.cable_length))
    candidates = list[tuple[float, Laying]]()
    for slant in SLANTS:
        direction = out + slant * u
        for i in range(STEPS):
            away = (i * step) * direction
            if _cables_apart(layout, bare.laid[:, :2] + np.repeat(away, 2, axis=0)) < keep:
                continue
            level = replace(bare, away=away).slack * [1.0, 1.0, 0.0]  # where they land
            if smallest_separation(level[None], separation) >= APART:
                break
        for factor in SPACINGS:
            check_time()
            laying = Laying(hitch, levels, factor * (sag + keep), away)
            inward = laying.outside + PLACES[:, None, None] * (laying.above - laying.outside)
            down = laying.above + PLACES[:, None, None] * (laying.laid - laying.above)
            apart = smallest_separation(np.concatenate([inward, down]), separation)
            if apart >= APART:
                return laying
            candidates.append((apart, laying))
    return max(candidates, key=lambda each: each[0])[1]


def _cables_apart(layout: Layout, drones: Array) -> float:
    """Return the smallest distance of cables of a ring to the next two, drones (2n, 2) [m]."""
    ends = np.concatenate([drones, np.zeros((len(drones), 1))], axis=1).reshape(-1, 2, 3)
    k, apart = np.arange(layout.robots), np.inf
    for other in (k - 1, k - 2):
        differences = ends[:, [0, 0, 1, 1]] - ends[other][:, [0, 1, 0, 1]]
        apart = min(apart, float(np.min(np.linalg.norm(shortest_offset(differences), axis=-1))))
    return apart


def laying_stages(laying: Laying, requirements: Requirements, index: int = 0) -> list[Motion]:
    """Return the motions from hanging cables outside of the edges' lines to the hitch.

    Parameters
    ----------
    index: of the step in its mission.
    """
    team, hitch = laying.hitch.team, laying.hitch
    limits, own = requirements.limits, (team, requirements, index)
    roll = rolling(laying.path, requirements, Phase("roll", index, 0.0, 0.0))
    rest = np.array([0.0, TENSION_SECONDS])
    still: dict[str, Any] = {
        "vertices": PiecewisePolynomial.constant(rest, hitch.vertices),
        "legs": PiecewisePolynomial.constant(rest, roll.legs.coefficients[0, ..., 0]),
        "tensions": PiecewisePolynomial(rest, (team.tension[:, None] * SMOOTH)[None]),
    }
    lines = (
        ("draw taut", laying.slack, laying.outside, CableState.FREE),
        ("slide in", laying.outside, laying.above, CableState.LAYING),
        ("lay", laying.above, laying.laid, CableState.LAYING),
    )
    resting = PiecewisePolynomial.constant(rest, laying.laid)
    return [
        *(
            stage(name, straight_lines(team, limits, start, end), *own, state)
            for name, start, end, state in lines
        ),
        stage("tension", resting, *own, CableState.ROLLING, **still),
        roll,
    ]


def rolling(path: RollPath, requirements: Requirements, phase: Phase) -> Motion:
    """Return the motion of a roll, as fast as limits allow, in a phase whose end is set.

    Raises InfeasibleError where cables pull drones up or down more than limits allow.
    """
    check_loads(path, requirements.limits)
    motion = fly(path, requirements)
    own = replace(phase, end=motion.duration, state=CableState.ROLLING)
    return motion.replaced(phases=(own,))
