"""Approaches to the pre-hitch, cables hanging, and which robot takes which edge.

Two are planned, the simpler one first; the certificate judges them. *Direct*: all drones fly
at once through the separation planner, the two of a cable tethered. *Gathered*: every robot first
draws its two drones together, turned as at the goal, so that its cable hangs within a disc seen
from above; discs avoid each other, and open at the other end. Chords within discs that never meet
cannot tangle.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial.distance import pdist

from hitchopt.geometry import Outline
from hitchopt.geometry.vectors import GOLDEN, TIE
from hitchopt.hitch import Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.requirements import Requirements, Separation
from hitchopt.hitch.team import Assignment
from hitchopt.motion.motion import CableState, Motion
from hitchopt.planners.forming.prehitch import SPAN
from hitchopt.planners.forming.stages import MIN_FLIGHT, PAUSE, stage, straight_lines
from hitchopt.planners.separation import SeparatedFlight, SeparationTask
from hitchopt.planners.timing.profile import LIMIT_SHARE, usable_accelerations
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

PAIR_SEPARATION = 1.6
"""Separation [1] of a gathered robot's two drones."""

CLEARANCE = 1.1
"""Clearance of hanging cables over the ground, over ``Separation.cable``."""

PROBES = 101
"""Number of times at which the cables' heights are computed."""

DISC_SEPARATION = 1.15
"""Separation [1] of the discs at both ends of their routes."""


@dataclass(frozen=True, eq=False)
class Approach(ABC):
    """The planner of a flight of drones that carry free cables.

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

    @property
    @abstractmethod
    def problem(self) -> SeparationTask:
        """The task of the separation planner."""

    @abstractmethod
    def solve(self) -> list[Motion]:
        """Return the motions of the flight; raises InfeasibleError where there is none."""

    def _stage(
        self, name: str, drones: PiecewisePolynomial, state: CableState = CableState.FREE
    ) -> Motion:
        return stage(name, drones, self.team, self.requirements, self.index, state)

    def _line(
        self, name: str, start: Array, end: Array, state: CableState = CableState.FREE
    ) -> list[Motion]:
        """Return the motion of all drones on straight lines; none where they are there."""
        if np.max(np.abs(end - start)) < MIN_FLIGHT:
            return []
        flight = straight_lines(self.team, self.requirements.limits, start, end)
        return [self._stage(name, flight, state)]

    def _after_take_off(self, *others: Array) -> Array:
        """Return where the drones (2n, 3) [m] are after a take-off, if one is needed.

        Its altitude lets cables hang free there, and at all ``others`` (2n, 3) as well.
        """
        requirements, here = self.requirements, self.start.copy()
        needed = max(
            hover_altitude(self.team, each, requirements) for each in (self.start, *others)
        )
        if np.min(here[:, 2]) < needed:
            here[:, 2] = np.maximum(here[:, 2], max(needed, float(np.max(self.goal[:, 2]))))
        return here

    def _task(
        self, places: Array, start: Array, goal: Array, separation: Separation, **bodies: Any
    ) -> SeparationTask:
        """Return the task of bodies apart, with a reserve for the certificate's bounds.

        ``places`` (J, 2n, 3) [m] of drones tell how much bodies may accelerate; ``bodies`` are
        their names and tethers.
        """
        limits = self.requirements.limits
        own = usable_accelerations(self.team, limits, places).reshape(len(start), -1).min(axis=1)
        rates = {
            name: LIMIT_SHARE * getattr(limits, name) for name in ("speed", "acceleration", "jerk")
        }
        requirements = replace(
            self.requirements, limits=replace(limits, **rates), separation=separation
        )
        return SeparationTask(start, goal, requirements, acceleration=own, **bodies)


class DirectApproach(Approach):
    """All drones fly at once, higher where cables would come near the ground.

    Drones that come closer together let their cable hang lower than at both ends.
    """

    @cached_property
    def problem(self) -> SeparationTask:
        """The flight of all drones, the two of a cable tethered."""
        spans = enumerate((SPAN * self.team.cable_length).tolist())
        tethers = tuple((2 * k, 2 * k + 1, span) for k, span in spans)
        here, bodies = self._after_take_off(), {"names": self.team.drone_names, "tethers": tethers}
        places, separation = np.stack([here, self.goal]), self.requirements.separation
        return self._task(places, here, self.goal, separation, **bodies)

    def solve(self) -> list[Motion]:
        """Return the motions of the flight, all of it raised where cables come near the ground."""
        here, goal, requirements = self.problem.start, self.goal, self.requirements
        rise = self._line("take-off", self.start, here, CableState.GROUND)
        if np.max(np.abs(goal - here)) < MIN_FLIGHT:
            still = PiecewisePolynomial.constant([0.0, PAUSE], goal)
            return [*rise, self._stage("approach", still)]
        drones = SeparatedFlight(self.problem).solve().drones
        at = np.linspace(drones.breaks[0], drones.breaks[-1], PROBES)
        lowest = min(float(np.min(_lowest(self.team, x, requirements.off))) for x in drones.at(at))
        missing = requirements.floor + CLEARANCE * requirements.separation.cable - lowest
        if missing <= 0.0:
            return [*rise, self._stage("approach", drones)]
        up = np.array([0.0, 0.0, missing + 0.1 * requirements.separation.cable])
        higher = PiecewisePolynomial(drones.breaks, drones.coefficients + up[:, None])
        if rise and requirements.off:  # higher at once: cables that may sag more are often so low
            rise = self._line("take-off", self.start, here + up, CableState.GROUND)
        else:
            rise += self._line("climb", here, here + up)
        return [
            *rise,
            self._stage("approach", higher),
            *self._line("descend", goal + up, goal),
        ]


class GatheredApproach(Approach):
    """Robots gather their drones, turn, fly as discs, and open.

    No robot may pass over another's hanging cable. On straight lines pairs turn by 90° at most and
    keep apart: half of the turn is flown as they gather.
    """

    @cached_property
    def problem(self) -> SeparationTask:
        """The flight of the discs' middles, (n, 3) [m]."""
        own, (halfway, last) = self.requirements.separation, self._headings
        height = float(np.max(self.team.cable_length))
        discs = replace(own, radius=(1.0 + PAIR_SEPARATION) * own.radius, height=height)
        start, goal = (0.5 * (each[0::2] + each[1::2]) for each in (self.start, self.goal))
        here = self._before_gathering(start, halfway)
        closest = max(float(np.min(pdist(goal[:, :2]))), 1e-9)
        wider = max(1.0, 2.0 * DISC_SEPARATION * discs.radius / closest)
        goal = np.mean(goal, axis=0) + wider * (goal - np.mean(goal, axis=0))
        start[:, 2] = goal[:, 2] = np.max(here[:, 2])
        names = tuple(f"cable {k}" for k in range(self.team.robots))
        places = np.stack([here, self._across(start, last)])
        return self._task(places, start, goal, discs, names=names)

    def solve(self) -> list[Motion]:
        """Return the motions: gathering, turning, flying as discs, and opening."""
        task, (halfway, last) = self.problem, self._headings
        here = self._before_gathering(task.start, halfway)
        gathered, turned = (self._across(task.start, heading) for heading in (halfway, last))
        opened = self.goal.copy()
        opened[:, 2] = np.maximum(opened[:, 2], task.goal[0, 2])
        flight = SeparatedFlight(task).solve().drones
        middles = np.moveaxis(flight.coefficients, -1, 1)
        carried = np.moveaxis(self._across(middles, last), 1, -1)
        return [
            *self._line("take-off", self.start, here, CableState.GROUND),
            *self._line("gather", here, gathered),
            *self._line("turn", gathered, turned),
            self._stage("approach", PiecewisePolynomial(flight.breaks, carried)),
            *self._line("open", self._across(task.goal, last), opened),
            *self._line("descend", opened, self.goal),
        ]

    @property
    def _headings(self) -> tuple[Array, Array]:
        """Return headings of robots (n,) [rad] half way through their turn, and at the goal."""
        ends = self.start, self.goal
        first, last = (np.arctan2(*(each[1::2] - each[0::2]).T[[1, 0]]) for each in ends)
        return first + 0.5 * ((last - first + math.pi) % (2.0 * math.pi) - math.pi), last

    def _before_gathering(self, middles: Array, headings: Array) -> Array:
        """Return where the drones (2n, 3) [m] are when they start to gather about middles."""
        return self._after_take_off(self._across(middles, headings), self.goal)

    def _across(self, middles: Array, headings: Array) -> Array:
        """Return the drones (…, 2n, 3) [m] across circles about middles (…, n, 3) [m]."""
        arms = np.column_stack([np.cos(headings), np.sin(headings), 0.0 * headings])
        arms *= PAIR_SEPARATION * self.requirements.separation.radius
        pairs = np.stack([middles - arms, middles + arms], axis=-2)
        return pairs.reshape(*pairs.shape[:-3], -1, 3)


def hover_altitude(team: Team, places: Array, requirements: Requirements) -> float:
    """Return how high drones at ``places`` (2n, 3) [m] must be for their cables to hang free [m].

    The heights of these are not used.
    """
    level = places * np.array([1.0, 1.0, 0.0])
    lowest = float(np.min(_lowest(team, level, requirements.off)))
    return requirements.floor + CLEARANCE * requirements.separation.cable - lowest


def _lowest(team: Team, drones: Array, off: float) -> Array:
    """Return the height of every hanging cable's lowest point (n,) [m].

    If drones may be ``off`` [m], less what cables sag more by than distances are wider.
    """
    q, r = drones[0::2], drones[1::2]
    cables = Catenary.between(q, r, team.cable_length)
    return q[:, 2] + cables.lowest - cables.extra_displacement(off)


def assign_robots(team: Team, drones: Array, outline: Outline, leg: float) -> Assignment:
    """Return the assignment of robots to edges, and of their drones to the edges' ends.

    A cable that leaves less than two legs on an edge does not take it while others do. Costs are
    squared distances to the edges' ends: straight lines of the least sum do not cross.

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
