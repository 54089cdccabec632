"""Hitches tied by laying: taut cables descend onto one another, then every pair rolls half a turn.

At a roll of ±180° both cables of a clasp are straight, and one lies on the other. Every roll from
there to the clasp is in balance, and no vertex moves. The upper cable determines the sense: its
drone goes down. Robots start outside of their edges' lines, where cables do not cross, draw their
cables taut, slide in over the lines at heights given by the order of laying, and descend together.
Each cable then lies on those below it in the order.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from hitchopt.geometry import differences, shortest_offset
from hitchopt.geometry.vectors import left_of, length
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.hitch import ALTITUDE_TOLERANCE
from hitchopt.hitch.model import FlatJets
from hitchopt.hitch.requirements import Requirements, Separation
from hitchopt.hitch.series import JET
from hitchopt.hitch.team import Layout
from hitchopt.motion.motion import CableState, Motion, Phase
from hitchopt.planners.forming.prehitch import (
    MIN_SEPARATION,
    SAMPLES,
    longest_spans,
    smallest_separation,
)
from hitchopt.planners.forming.stages import (
    Keyframe,
    best,
    hover_altitude,
    straight_stages,
    tension_stage,
)
from hitchopt.planners.morph.morph import check_loads
from hitchopt.planners.path import drones_along
from hitchopt.planners.timing.timed_motion import motion_along
from hitchopt.values import Array, Indices

SHARES = tuple(0.5 + sign * off for off in np.linspace(0.0, 0.2, 11) for sign in (1.0, -1.0))
"""Slack splits in the order of the search."""

ANGLES = 61  # Number of sampled angles of the roll; the certificate bounds all of them
DISTANCE_FACTOR = 1.2  # Factor on distance limits of cables in planning
EXTRA_DISTANCE = 0.03  # [m] Distance added to these limits

SPACINGS = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0)
"""Candidate distances between levels, over the smallest one."""

SLANTS = (0.0, 0.3, -0.3, 0.6, -0.6, 1.0, -1.0)
"""Candidate displacements along edges, over those normal to them."""

OFFSET_STEP = 0.05  # Step of the distance from edges' lines, over the mean cable length
MAX_OFFSET_STEPS = 60  # Maximum number of these steps

TENSION_SECONDS = 0.3
"""[s] Transition time from the tensions of taut cables on their own to those of the hitch."""


def planned_distance(separation: Separation) -> float:
    """Return the planned distance of cables [m], with a margin over its limit."""
    return DISTANCE_FACTOR * max(separation.cable, separation.crossing) + EXTRA_DISTANCE


@dataclass(frozen=True, eq=False)
class RollPath:
    """A path on which legs turn about fixed clasps: the roll (clasps,) is linear in s."""

    hitch: Hitch  # The hitch, whose clasps, slack split and tensions are constant
    start: Array  # (clasps,) [rad], roll at s = 0
    end: Array  # (clasps,) [rad], roll at s = 1

    @property
    def team(self) -> Team:
        """The team of the hitch."""
        return self.hitch.team

    def flat(self, s: Array, count: int = JET) -> FlatJets:
        """Return the flat outputs' jets in s, with ``count`` coefficients, at s (J,)."""
        vertices = _constant_jets(self.hitch.vertices, len(s), count)
        q_legs = _constant_jets(self.hitch.q_legs, len(s), count)
        tensions = _constant_jets(self.team.tension, len(s), count)
        change = self.end - self.start
        roll = np.zeros((len(s), *self.start.shape, count))
        roll[..., 0] = self.start + s[:, None] * change
        roll[..., 1:2] = change[:, None]
        return FlatJets(vertices, q_legs, tensions, roll)

    def drones(self, s: Array) -> Array:
        """Return the drones (J, 2n, 3) [m] at s (J,)."""
        drones: Array = drones_along(self, s).positions[..., 0]
        return drones


def _constant_jets(value: Array, knots: int, count: int) -> Array:
    """Return the jets (knots, …, count) of a constant (…)."""
    jets = np.zeros((knots, *value.shape, count))
    jets[..., 0] = value
    return jets


def levels_of(layout: Layout, order: Iterable[int] | None) -> Indices:
    """Return the levels (n,) of a ring's cables, 0 the lowest; those of neighbours differ.

    ``order`` lists the cables from bottom to top; None for alternating levels.
    """
    n = layout.robots
    if order is None:
        levels = np.arange(n) % 2
        if levels[-1] == levels[0]:  # of an odd number of cables
            levels[-1] = 2
        return levels
    levels = np.full(n, -1)
    for cable in order:
        level_behind = levels[cable - 1]
        level_ahead = levels[(cable + 1) % n]
        levels[cable] = 1 + max(level_behind, level_ahead)
    return levels


def senses_of(layout: Layout, levels: Indices) -> Array:
    """Return the senses (clasps,): 1 if cable k is above cable k-1 at its clasp, else -1."""
    senses: Array = np.sign(levels[layout.ahead] - levels[layout.behind]).astype(np.float64)
    return senses


@dataclass(frozen=True, eq=False)
class Laying:
    """A hitch with its laying order and start positions."""

    hitch: Hitch  # The hitch to be tied
    levels: Indices  # (n,), order of the cables, 0 the lowest
    spacing: float = 0.0  # [m], between levels
    offsets: Array | float = 0.0  # (n, 2) [m], of the start from the edges' lines
    spans: Array | float = 0.0  # (n,) [m], distances of drones with hanging cables
    errors: bool = False  # True if drones have position errors, which may pull hanging cables taut
    # True if a requirement may be violated: samples are of drones alone
    doubtful: ClassVar[bool] = True

    @property
    def senses(self) -> Array:
        """(clasps,): 1 if cable k lies on cable k-1, else -1."""
        return senses_of(self.hitch.team.layout, self.levels)

    @property
    def path(self) -> RollPath:
        """The roll from cables that lie on one another to the hitch."""
        return RollPath(self.hitch, -np.pi * self.senses, self.hitch.roll)

    @cached_property
    def drones_laid(self) -> Array:
        """(2n, 3) [m]: the drones when all cables lie on one another."""
        return np.asarray(self.path.drones(np.zeros(1))[0])

    @property
    def drones_above(self) -> Array:
        """(2n, 3) [m]: the drones above ``drones_laid``, by level."""
        rise = np.repeat(self.spacing * self.levels, 2)
        return np.asarray(self.drones_laid + rise[:, None] * [0.0, 0.0, 1.0])

    @property
    def drones_outside(self) -> Array:
        """(2n, 3) [m]: the drones outside of the edges' lines, where taut cables do not cross."""
        shift = np.zeros((len(self.levels), 3))
        shift[:, :2] = self.offsets
        drones: Array = self.drones_above + np.repeat(shift, 2, axis=0)
        return drones

    @property
    def drones_hanging(self) -> Array:
        """(2n, 3) [m]: the drones outside of the edges' lines, with hanging cables."""
        pairs = self.drones_outside.reshape(-1, 2, 3)
        middles = np.mean(pairs, axis=1, keepdims=True)
        chords = pairs[:, 1] - pairs[:, 0]
        scale = np.repeat((self.spans / length(chords))[:, None, None], 3, axis=-1)
        if self.errors:  # drones that draw cables taut keep their heights
            rises = chords[:, 2]
            level_share = np.sqrt((self.spans**2 - rises**2) / (length(chords) ** 2 - rises**2))
            scale = level_share[:, None, None] * [1.0, 1.0, 0.0] + [0.0, 0.0, 1.0]
        drones: Array = middles + scale * (pairs - middles)
        return np.asarray(drones.reshape(-1, 3))

    def clear_of_ground(self, requirements: Requirements) -> Laying:
        """Return the laying at the altitude that its hanging cables need."""
        hitch = self.hitch
        hanging = self.drones_hanging
        altitude = hover_altitude(hitch.team, hanging, requirements)
        rise = altitude - float(np.min(hanging[:, 2]))
        if rise <= ALTITUDE_TOLERANCE:
            return self
        return replace(self, hitch=hitch.at_altitude(hitch.altitude + rise))

    def stages(self, requirements: Requirements, index: int = 0) -> list[Motion]:
        """Return the motions from hanging cables to the hitch, in phases of step ``index``."""
        roll = roll_motion(self.path, requirements, Phase("roll", index, 0.0, 0.0))
        # Errors may pull cables taut: their drones are slow, at distances that hold for any slack
        drawn = CableState.DRAWN if self.errors else CableState.FREE
        keyframes = (
            Keyframe("draw taut", self.drones_outside, drawn),
            Keyframe("slide in", self.drones_above, CableState.LAYING),
            Keyframe("lay", self.drones_laid, CableState.LAYING),
        )
        laid = straight_stages(self.drones_hanging, keyframes, self.hitch.team, requirements, index)
        tension = tension_stage(
            self.hitch,
            self.drones_laid,
            roll.legs.coefficients[0, ..., 0],
            TENSION_SECONDS,
            requirements,
            index,
            CableState.ROLLING,
        )
        return [*laid, tension, roll]


def split_for_rolling(hitch: Hitch, senses: Array, requirements: Requirements) -> Hitch:
    """Return the hitch with the first slack split that separates drones as they roll.

    The search starts from the hitch's own split and continues from one half outward. If no split
    suffices, return the one with the largest separation.
    """

    def candidates() -> Iterator[tuple[float, Hitch]]:
        splits = [hitch.q_legs, *(share * hitch.slack for share in SHARES)]
        for q_legs in splits:
            split = Hitch(hitch.team, hitch.polygon, hitch.altitude, q_legs, hitch.roll)
            path = RollPath(split, -np.pi * senses, split.roll)
            drones = path.drones(np.linspace(0.0, 1.0, ANGLES))
            yield smallest_separation(drones, requirements.separation), split

    return best(candidates(), MIN_SEPARATION)


def find_laying(hitch: Hitch, levels: Indices, requirements: Requirements) -> Laying:
    """Return the first laying that separates the drones, or the one with the largest separation.

    Levels are spaced by the sag of cables and the planned distance. Robots start as near to their
    edges as cables permit without crossing.
    """
    separation = requirements.separation
    distance = planned_distance(separation)
    spans = longest_spans(hitch.team, requirements)
    unplaced = Laying(hitch, levels, spans=spans, errors=requirements.position_error > 0.0)
    laid = unplaced.drones_laid
    q, r = laid[0::2], laid[1::2]
    sags = Catenary.between(q, r, hitch.team.cable_length).depth(0.0)
    rises = np.abs(r - q)[:, 2]
    spacing = float(np.max(sags + rises)) + requirements.height_ratio * distance
    along = hitch.polygon.edge_directions
    outward = left_of(along)

    def candidates() -> Iterator[tuple[float, Laying]]:
        for slant in SLANTS:
            start = _nearest_start(unplaced, outward + slant * along, distance, separation)
            for factor in SPACINGS:
                laying = replace(start, spacing=factor * spacing)
                outside = laying.drones_outside
                above = laying.drones_above
                inward = outside + SAMPLES[:, None, None] * (above - outside)
                down = above + SAMPLES[:, None, None] * (laid - above)
                drones = np.concatenate([inward, down])
                yield smallest_separation(drones, separation), laying

    return best(candidates(), MIN_SEPARATION)


def _nearest_start(
    laying: Laying, direction: Array, min_cable_distance: float, separation: Separation
) -> Laying:
    """Return the laying with the smallest offsets along directions (n, 2) that keep distances.

    Taut cables are at least at a distance [m], and landed drones separated. If no offset keeps
    them, it is the laying with the largest one.
    """
    team = laying.hitch.team
    laid = laying.drones_laid[:, :2]
    step = OFFSET_STEP * float(np.mean(team.cable_length))
    start = laying
    for i in range(MAX_OFFSET_STEPS):
        offsets = (i * step) * direction
        start = replace(laying, offsets=offsets)
        taut_ends = laid + np.repeat(offsets, 2, axis=0)
        if _cable_distance(team.layout, taut_ends) < min_cable_distance:
            continue
        landed = start.drones_hanging * [1.0, 1.0, 0.0]
        if smallest_separation(landed[None], separation) >= MIN_SEPARATION:
            break
    return start


def _cable_distance(layout: Layout, drones: Array) -> float:
    """Return the minimum distance [m] of cables of a ring to the two behind, drones (2n, 2) [m]."""
    heights = np.zeros((len(drones), 1))
    cable_ends = np.concatenate([drones, heights], axis=1).reshape(-1, 2, 3)
    cables = np.arange(layout.robots)
    smallest = np.inf
    for neighbours in (cables - 1, cables - 2):
        offsets = shortest_offset(differences(cable_ends, cable_ends[neighbours]))
        distances = np.linalg.norm(offsets, axis=-1)
        smallest = min(smallest, float(np.min(distances)))
    return smallest


def roll_motion(path: RollPath, requirements: Requirements, phase: Phase) -> Motion:
    """Return the fastest motion of a roll within limits, in a phase whose end it sets.

    Raises InfeasibleError if the cables' vertical forces exceed the limits of drones.
    """
    check_loads(path, requirements.limits)
    motion = motion_along(path, requirements)
    phase = replace(phase, end=motion.duration, state=CableState.ROLLING)
    return motion.replaced(phases=(phase,))
