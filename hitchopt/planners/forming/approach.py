"""Approaches to the pre-hitch, cables hanging, and which robot takes which edge.

Two are planned, the simpler one first; the certificate judges them. *Direct*: all drones fly
at once through the separation planner, the two of a cable tethered. *Gathered*: every robot first
draws its two drones together, so that its cable hangs within a disc seen from above; discs avoid
each other and turn meanwhile, and open at the other end. Chords within discs that never meet cannot
tangle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial.distance import pdist

from hitchopt.geometry import Outline
from hitchopt.geometry.vectors import GOLDEN, TIE
from hitchopt.hitch import Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import Assignment
from hitchopt.motion.motion import CableState, Motion
from hitchopt.planners.forming.prehitch import SPAN
from hitchopt.planners.forming.stages import stage
from hitchopt.planners.forming.turns import PAUSE, PIECE, STILL, straight
from hitchopt.planners.separation import SeparationTask, separate
from hitchopt.planners.timing.profile import LIMIT_SHARE
from hitchopt.planners.timing.ramps import accelerations, fastest_clock, flown
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

DRAWN = 1.6
"""Separation [1] of a gathered robot's two drones."""

CLEARANCE = 1.1
"""Clearance of hanging cables over the ground, over ``Separation.cable``."""

PROBES = 101
"""Number of times at which the cables' heights are computed."""

ROOM = 1.15
"""Separation [1] of the discs at both ends of their routes."""


@dataclass(frozen=True, eq=False)
class Approach:
    """A flight of drones that carry free cables.

    Attributes
    ----------
    team: whose drones, on free cables.
    start, goal: (2n, 3) [m]
    requirements: satisfied all along.
    index: of the step in its mission.
    """

    team: Team
    start: Array
    goal: Array
    requirements: Requirements
    index: int = 0

    def stage(
        self, name: str, drones: PiecewisePolynomial, state: CableState = CableState.FREE
    ) -> Motion:
        """Return the motion of drones (2n, 3) [m] as a phase."""
        return stage(name, drones, self.team, self.requirements, self.index, state)

    def line(
        self, name: str, start: Array, end: Array, state: CableState = CableState.FREE
    ) -> list[Motion]:
        """Return the motion of all drones on straight lines; none where they are there."""
        if np.max(np.abs(end - start)) < STILL:
            return []
        return [self.stage(name, straight(self.team, self.requirements.limits, start, end), state)]

    def risen(self, *others: Array) -> Array:
        """Return where the drones (2n, 3) [m] are after a take-off, if one is needed.

        Its altitude lets cables hang free there, and at all ``others`` (2n, 3) as well.
        """
        clearance = CLEARANCE * self.requirements.separation.cable
        floor, here = self.requirements.floor, self.start.copy()
        places = (self.start, *others)
        needed = max(hover_altitude(self.team, each, floor, clearance) for each in places)
        if np.min(here[:, 2]) < needed:
            here[:, 2] = np.maximum(here[:, 2], max(needed, float(np.max(self.goal[:, 2]))))
        return here

    def separated(self, places: Array, **task: Any) -> SeparationTask:
        """Return the task of bodies that fly apart, with a reserve for the certificate's bounds.

        Parameters
        ----------
        places: (J, 2n, 3) [m], of the drones, which tell how much bodies may accelerate.
        task: start, goal, names, tethers and separation of the bodies.
        """
        limits, separation = self.requirements.limits, task.pop("separation")
        rates = {
            name: LIMIT_SHARE * getattr(limits, name) for name in ("speed", "acceleration", "jerk")
        }
        own = accelerations(self.team, limits, places).reshape(len(task["names"]), -1).min(axis=1)
        limited = replace(limits, **rates)
        requirements = replace(self.requirements, limits=limited, separation=separation)
        return SeparationTask(requirements=requirements, acceleration=own, **task)


@dataclass(frozen=True, eq=False)
class DirectApproach(Approach):
    """The planner of an approach in which all drones fly at once, those of a cable tethered."""

    @property
    def problem(self) -> SeparationTask:
        """The flight after the take-off."""
        here, lengths = self.risen(), (SPAN * self.team.cable_length).tolist()
        return self.separated(
            np.stack([here, self.goal]),
            start=here,
            goal=self.goal,
            separation=self.requirements.separation,
            names=self.team.drone_names,
            tethers=tuple((2 * k, 2 * k + 1, length) for k, length in enumerate(lengths)),
        )

    def solve(self) -> list[Motion]:
        """Return the motions of the flight, all of it raised where cables come near the ground.

        Drones that come closer together let their cable hang lower than at both ends.
        """
        here, goal = self.risen(), self.goal
        rise = self.line("take-off", self.start, here, CableState.GROUND)
        if np.max(np.abs(goal - here)) < STILL:
            return [*rise, self.stage("approach", PiecewisePolynomial.constant([0.0, PAUSE], goal))]
        drones = separate(self.problem).drones
        clearance = self.requirements.separation.cable
        at = np.linspace(drones.breaks[0], drones.breaks[-1], PROBES)
        lowest = min(float(np.min(_lowest(self.team, places))) for places in drones.at(at))
        missing = self.requirements.floor + CLEARANCE * clearance - lowest
        if missing <= 0.0:
            return [*rise, self.stage("approach", drones)]
        up = np.array([0.0, 0.0, missing + 0.1 * clearance])
        higher = PiecewisePolynomial(drones.breaks, drones.coefficients + up[:, None])
        climb, descend = self.line("climb", here, here + up), self.line("descend", goal + up, goal)
        return [*rise, *climb, self.stage("approach", higher), *descend]


@dataclass(frozen=True, eq=False)
class GatheredApproach(Approach):
    """The planner of an approach in which every robot draws its drones together to fly as one.

    They are across a circle then, from which they do not depart until the goal.
    """

    @cached_property
    def headings(self) -> tuple[Array, Array]:
        """(n,) [rad] each: from q to r seen from above, at the start, and turned to the goal's."""
        offsets = (places[1::2] - places[0::2] for places in (self.start, self.goal))
        first, last = (np.arctan2(offset[:, 1], offset[:, 0]) for offset in offsets)
        return first, first + (last - first + math.pi) % (2.0 * math.pi) - math.pi

    @cached_property
    def gathered(self) -> Array:
        """(2n, 3) [m]: the drones after gathering, level, so high that cables hang free."""
        gathered = self.across(_middles(self.start), self.headings[0])
        gathered[:, 2] = np.max(self.risen(gathered, self.goal)[:, 2])
        return gathered

    def across(self, centres: Array, headings: Array, size: Array | float = 1.0) -> Array:
        """Return the drones (…, 2n, 3) [m] across circles about centres (…, n, 3) [m].

        Parameters
        ----------
        headings: (…, n) [rad]
        size: (n,), of the circles over their radius.
        """
        radius = DRAWN * self.requirements.separation.radius * np.asarray(size)[..., None]
        arms = radius * np.stack([np.cos(headings), np.sin(headings), 0.0 * headings], axis=-1)
        pairs = np.stack([centres - arms, centres + arms], axis=-2)
        return pairs.reshape(*pairs.shape[:-3], -1, 3)

    @property
    def problem(self) -> SeparationTask:
        """The flight of the robots as discs: no one may pass over another's hanging cable."""
        own, height = self.requirements.separation, float(np.max(self.team.cable_length))
        discs = replace(own, radius=(1.0 + DRAWN) * own.radius, height=height)
        start, goal = _middles(self.start), _middles(self.goal)
        apart = pdist(goal[:, :2])
        wider = max(1.0, 2.0 * ROOM * discs.radius / max(float(np.min(apart)), 1e-9))
        goal = np.mean(goal, axis=0) + wider * (goal - np.mean(goal, axis=0))
        start[:, 2] = goal[:, 2] = self.gathered[0, 2]
        places = np.stack([self.risen(self.gathered, self.goal), self.gathered])
        names = tuple(f"cable {k}" for k in range(self.team.robots))
        return self.separated(places, start=start, goal=goal, separation=discs, names=names)

    def solve(self) -> list[Motion]:
        """Return the motions: gathering, turning, flying and opening."""
        task, (_, headings) = self.problem, self.headings
        here, opened = self.risen(self.gathered, self.goal), self.goal.copy()
        opened[:, 2] = np.maximum(opened[:, 2], task.goal[:1, 2])
        flight = separate(task).drones
        pairs = self.across(np.moveaxis(flight.coefficients, -1, 1), headings)
        carried = PiecewisePolynomial(flight.breaks, np.moveaxis(pairs, 1, -1))
        return [
            *self.line("take-off", self.start, here, CableState.GROUND),
            *self.line("gather", here, self.gathered),
            self.stage("turn", self._turned(task.start)),
            self.stage("approach", carried),
            *self.line("open", self.across(task.goal, headings), opened),
            *self.line("descend", opened, self.goal),
        ]

    def _turned(self, centres: Array) -> PiecewisePolynomial:
        """Return the drones (2n, 3) [m] that turn in place to their headings, all on one clock."""
        first, last = self.headings
        largest, start = float(np.max(np.abs(last - first))), self.across(centres, first)
        if largest < LEAST_TURN:
            return PiecewisePolynomial.constant([0.0, PAUSE], start)
        share, limits = (last - first) / largest, self.requirements.limits
        size = DRAWN * self.requirements.separation.radius

        def curve(angle: Array, order: int) -> Array:
            headings = first + angle[:, None] * share + 0.5 * math.pi * order
            return self.across(centres if order == 0 else 0.0 * centres, headings, share**order)

        reserve = float(np.min(accelerations(self.team, limits, start[None])))
        speed = min(limits.speed / size, math.sqrt(0.5 * reserve / size))
        clock = fastest_clock(largest, speed, 0.8 * reserve / size, 0.7 * limits.jerk / size)
        return flown(curve, clock, PIECE, limits, reserve)


LEAST_TURN = 1e-6
"""[rad] Smallest angle that is turned."""


def _middles(drones: Array) -> Array:
    """Return the middles (n, 3) [m] of cables' drones."""
    middles: Array = 0.5 * (drones[0::2] + drones[1::2])
    return middles


def hover_altitude(team: Team, places: Array, ground: float, clearance: float) -> float:
    """Return how high drones at ``places`` (2n, 3) [m] must be for their cables to hang free [m].

    Parameters
    ----------
    places: their heights are not used.
    clearance: smallest distance of the cables to the ground [m].
    """
    level = places * np.array([1.0, 1.0, 0.0])
    return ground + clearance - float(np.min(_lowest(team, level)))


def _lowest(team: Team, drones: Array) -> Array:
    """Return the height of every hanging cable's lowest point (n,) [m]."""
    q, r = drones[0::2], drones[1::2]
    return q[:, 2] + Catenary.between(q, r, team.cable_length).lowest


def assigned(team: Team, drones: Array, outline: Outline, leg: float) -> Assignment:
    """Return the assignment of robots to edges, and of their drones to the edges' ends.

    A cable that leaves less than two legs on an edge does not take it while others do. The
    costs are squared distances to the edges' ends: straight lines of the least sum do not cross.
    Quadratic in n in memory, cubic at worst in time (seconds for a thousand robots).

    Parameters
    ----------
    team: as the robots are given.
    drones: (2n, 3) [m], their places.
    outline: its edges are assigned.
    leg: shortest leg [m].
    """
    from scipy.optimize import linear_sum_assignment

    layout, points = team.layout, outline.vertices
    first, last = points[layout.starts], points[layout.ends]
    q, r = drones[0::2, None, :2], drones[1::2, None, :2]
    straight = np.sum((q - first) ** 2, axis=-1) + np.sum((r - last) ** 2, axis=-1)
    crossed = np.sum((q - last) ** 2, axis=-1) + np.sum((r - first) ** 2, axis=-1)
    cost = np.minimum(straight, crossed)
    short = team.cable_length[:, None] - outline.edge_lengths < 2.0 * leg
    size = float(np.max(cost))
    k = np.arange(team.robots)
    # Robots prefer edges of their own number; multiples of the golden ratio, modulo 1, tell apart
    # assignments that would tie again.
    apart = np.mod(GOLDEN * np.arange(1.0, cost.size + 1.0), 1.0).reshape(cost.shape)
    preference = np.abs(k[:, None] - k) / len(k) + 0.1 * apart
    cost = cost + TIE * size * preference + short * (1.0 + size) * len(cost)
    robots, roles = linear_sum_assignment(cost)
    order = robots[np.argsort(roles)]
    shorter = straight[order, k] - crossed[order, k]
    cables, edges = drones[1::2, :2][order] - drones[0::2, :2][order], last - first
    turns = cables[:, 0] * edges[:, 1] - cables[:, 1] * edges[:, 0]
    # Where both are as short, cables turn counter-clockwise.
    flipped = np.where(np.abs(shorter) > TIE * size, shorter > 0.0, turns < -TIE * size)
    return Assignment(tuple(order.tolist()), tuple(flipped.tolist()))
