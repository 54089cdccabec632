"""Approaches to the pre-hitch: up from the ground, then all drones at once, cables hanging.

Two are planned, the simpler one first; the certificate judges them. *Direct*: all drones fly
at once through the separation planner, the two of a cable tethered. *Gathered*: every robot first
draws its two drones together, so that its cable hangs within a disc seen from above; discs avoid
each other and turn meanwhile, and open at the other end. Chords within discs that never meet cannot
tangle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from hitchopt.hitch import Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.motion.phases import CableState
from hitchopt.planners.forming.clock import SHARE, accelerations
from hitchopt.planners.forming.prehitch import SPAN
from hitchopt.planners.forming.straight import STILL, straight
from hitchopt.planners.forming.tying_stages import Stage
from hitchopt.planners.forming.wheels import Wheels, turned
from hitchopt.planners.separation import SeparationTask, Tether, separate
from hitchopt.requirements import Requirements, Separation
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
    """

    team: Team
    start: Array
    goal: Array
    requirements: Requirements

    def line(
        self, name: str, start: Array, end: Array, state: CableState = CableState.FREE
    ) -> Stage:
        """Return the stage of all drones on straight lines."""
        return Stage(name, straight(self.team, self.requirements.limits, start, end), state)

    def needed(
        self, name: str, start: Array, end: Array, state: CableState = CableState.FREE
    ) -> list[Stage]:
        """Return the stage of all drones on straight lines; none where they are there."""
        return [] if np.max(np.abs(end - start)) < STILL else [self.line(name, start, end, state)]

    def risen(self, *others: Array) -> Array:
        """Return where the drones (2n, 3) [m] are after a take-off, if one is needed.

        Its altitude lets cables hang free there, and at all ``others`` (2n, 3) as well.
        """
        clearance = CLEARANCE * self.requirements.separation.cable
        needed = max(
            hover_altitude(self.team, places, self.requirements.floor, clearance)
            for places in (self.start, *others)
        )
        here = self.start.copy()
        if np.min(here[:, 2]) < needed:
            here[:, 2] = np.maximum(here[:, 2], max(needed, float(np.max(self.goal[:, 2]))))
        return here

    def separated(
        self,
        ends: tuple[Array, Array],
        places: Array,
        separation: Separation,
        names: tuple[str, ...],
        tethers: tuple[Tether, ...] = (),
    ) -> SeparationTask:
        """Return the task of bodies that fly apart, with a reserve for the certificate's bounds.

        Parameters
        ----------
        ends: where they start, and their goals (bodies, 3) [m].
        places: (J, 2n, 3) [m], of the drones, which tell how much bodies may accelerate.
        separation, names, tethers: of the bodies.
        """
        limits = self.requirements.limits
        rates = {name: SHARE * getattr(limits, name) for name in ("speed", "acceleration", "jerk")}
        reserved = replace(limits, **rates)
        least = accelerations(self.team, limits, places).reshape(len(names), -1).min(axis=1)
        requirements = replace(self.requirements, limits=reserved, separation=separation)
        return SeparationTask(*ends, requirements, tethers=tethers, acceleration=least, names=names)


@dataclass(frozen=True, eq=False)
class DirectApproach(Approach):
    """The planner of an approach in which all drones fly at once, those of a cable tethered."""

    @property
    def problem(self) -> SeparationTask:
        """The flight after the take-off."""
        here = self.risen()
        tethers = tuple(
            Tether(2 * k, 2 * k + 1, float(SPAN * length))
            for k, length in enumerate(self.team.cable_length)
        )
        both, separation = (here, self.goal), self.requirements.separation
        return self.separated(both, np.stack(both), separation, self.team.drone_names, tethers)

    def solve(self) -> list[Stage]:
        """Return the stages of the flight, all of it raised where cables come near the ground.

        Drones that come closer together let their cable hang lower than at both ends.
        """
        here, goal = self.risen(), self.goal
        rise = self.needed("take-off", self.start, here, CableState.GROUND)
        if np.max(np.abs(goal - here)) < STILL:
            return [*rise, self.line("approach", here, goal)]
        drones = separate(self.problem).drones
        clearance = self.requirements.separation.cable
        at = np.linspace(drones.breaks[0], drones.breaks[-1], PROBES)
        lowest = min(float(np.min(_lowest(self.team, places))) for places in drones.at(at))
        missing = self.requirements.floor + CLEARANCE * clearance - lowest
        if missing <= 0.0:
            return [*rise, Stage("approach", drones)]
        up = np.array([0.0, 0.0, missing + 0.1 * clearance])
        higher = PiecewisePolynomial(drones.breaks, drones.coefficients + up[:, None])
        return [
            *rise,
            self.line("climb", here, here + up),
            Stage("approach", higher),
            self.line("descend", goal + up, goal),
        ]


@dataclass(frozen=True, eq=False)
class GatheredApproach(Approach):
    """The planner of an approach in which every robot draws its drones together to fly as one."""

    @cached_property
    def pairs(self) -> Wheels:
        """The robots with their drones gathered."""
        return Wheels.between(self.start, self.goal, DRAWN * self.requirements.separation.radius)

    @cached_property
    def gathered(self) -> Array:
        """(2n, 3) [m]: the drones after gathering, level, so high that cables hang free."""
        gathered = self.pairs.drones(self.pairs.centres, np.zeros(self.team.robots))
        gathered[:, 2] = np.max(self.risen(gathered, self.goal)[:, 2])
        return gathered

    @property
    def problem(self) -> SeparationTask:
        """The flight of the robots as discs: no one may pass over another's hanging cable."""
        own, height = self.requirements.separation, float(np.max(self.team.cable_length))
        discs = replace(own, radius=self.pairs.radius + own.radius, height=height)
        start = self.pairs.centres.copy()
        goal = _spaced(self.pairs.goals, 2.0 * ROOM * discs.radius)
        start[:, 2] = goal[:, 2] = self.gathered[0, 2]
        places = np.stack([self.risen(self.gathered, self.goal), self.gathered])
        names = tuple(f"cable {k}" for k in range(self.team.robots))
        return self.separated((start, goal), places, discs, names)

    def solve(self) -> list[Stage]:
        """Return the stages: gathering, turning, flying and opening."""
        task, limits = self.problem, self.requirements.limits
        here = self.risen(self.gathered, self.goal)
        wheels = replace(self.pairs, centres=task.start)
        opened = self.goal.copy()
        opened[:, 2] = np.maximum(opened[:, 2], task.goal[:1, 2])
        return [
            *self.needed("take-off", self.start, here, CableState.GROUND),
            self.line("gather", here, self.gathered),
            Stage("turn", turned(self.team, wheels, limits)),
            Stage("approach", wheels.carried(separate(task).drones)),
            self.line("open", wheels.drones(task.goal, wheels.angles), opened),
            *self.needed("descend", opened, self.goal),
        ]


def hover_altitude(team: Team, places: Array, ground: float, clearance: float) -> float:
    """Return how high drones at ``places`` (2n, 3) [m] must be for their cables to hang free [m].

    Parameters
    ----------
    places: their heights are not used.
    clearance: smallest distance of the cables to the ground [m].
    """
    level = places * np.array([1.0, 1.0, 0.0])
    return ground + clearance - float(np.min(_lowest(team, level)))


def _spaced(points: Array, least: float) -> Array:
    """Return points (n, 3) [m] moved from their middle until ``least`` [m] apart from above."""
    flat = points[:, :2]
    nearest = np.asarray(cKDTree(flat).query(flat, k=[2])[0])
    factor = max(1.0, least / max(float(np.min(nearest)), 1e-9))
    middle = np.mean(flat, axis=0)
    spaced = points.copy()
    spaced[:, :2] = middle + factor * (flat - middle)
    return spaced


def _lowest(team: Team, drones: Array) -> Array:
    """Return the height of every hanging cable's lowest point (n,) [m]."""
    q, r = drones[0::2], drones[1::2]
    return q[:, 2] + Catenary.between(q, r, team.cable_length).lowest
