"""Approaches to the pre-hitch with hanging cables, and the assignment of robots to edges.

There are three, of which the first certified one applies. *Direct*: the separation planner flies
all drones at once, with the two drones of a cable tethered. *Gathered*: every robot first draws its
two drones together and turns them as at the goal, so that its cable hangs within a disc in plan
view; discs avoid each other, and open at the goal. Cables within disjoint discs cannot tangle.
*Over*: a direct flight, above all objects.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.forming.prehitch import MAX_SPAN_RATIO
from hitchopt.geometry import Outline
from hitchopt.geometry.vectors import GOLDEN, TIE, cross
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import HANGING, Requirements, Separation
from hitchopt.hitch.team import Assignment
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.motion import TAKE_OFF, Motion
from hitchopt.planners.morph.morph import POSITION_TOLERANCE
from hitchopt.planners.stages import (
    PAUSE,
    Keyframe,
    hover_altitude,
    missing_height,
    stage,
    straight_stages,
)
from hitchopt.planners.timing.profile import LIMIT_SHARE, usable_accelerations
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array
from hitchopt.values.fields import with_fields

if TYPE_CHECKING:
    from hitchopt.swarms.task import SeparationTask

PAIR_SEPARATION = 1.6  # Separation [1] of a gathered robot's two drones
DISC_SEPARATION = 1.15  # Minimum separation [1] of the discs at the goal

RISE_RESERVE = 0.1
"""Reserve of a raised flight over the height that its cables lack, over ``separation.cable``."""

PREFERENCE_OF_ORDER = 0.1
"""Weight of the terms that break ties, over that of robots on edges of other numbers."""


@dataclass(frozen=True, eq=False)
class Approach(ABC):
    """A planner of flights with free cables."""

    name: ClassVar[str]  # What it is, among the candidates of an approach
    team: Team  # The team of the drones
    start: Array  # (2n, 3) [m]
    goal: Array  # (2n, 3) [m]
    requirements: Requirements  # Requirements at all times
    index: int = 0  # Index of the step in its mission

    @property
    @abstractmethod
    def task(self) -> SeparationTask:
        """The task of the separation planner."""

    @abstractmethod
    def solve(self) -> list[Motion]:
        """Return the motions of the flight, or raise InfeasibleError."""

    def _stage(self, drones: PiecewisePolynomial) -> Motion:
        """Return the motion of drones with hanging cables as one phase."""
        return stage("approach", drones, self.team, self.requirements, self.index)

    def _lines(self, start: Array, *keyframes: Keyframe) -> list[Motion]:
        """Return the motions of all drones on straight lines from a start to keyframes."""
        return straight_stages(start, keyframes, self.team, self.requirements, self.index)

    def _after_take_off(self, *others: Array) -> Array:
        """Return the drones (2n, 3) [m] after a take-off, or at the start if they are high enough.

        Cables hang free at that altitude, also with drones over ``others`` (2n, 3).
        """
        drones = self.start.copy()
        altitude = max(
            hover_altitude(self.team, places, self.requirements) for places in (self.start, *others)
        )
        if np.min(drones[:, 2]) < altitude:
            altitude = max(altitude, float(np.max(self.goal[:, 2])))
            drones[:, 2] = np.maximum(drones[:, 2], altitude)
        return drones

    def _task(
        self, drones: Array, start: Array, goal: Array, separation: Separation, **bodies: Any
    ) -> SeparationTask:
        """Return the separation task of bodies, with a reserve for the certificate's bounds.

        ``drones`` (J, 2n, 3) [m] determine the usable accelerations; ``bodies`` are the names and
        tethers of bodies.
        """
        from hitchopt.swarms.task import SeparationTask

        limits = self.requirements.limits
        usable = usable_accelerations(self.team, limits, drones)
        reserved = with_fields(
            limits,
            speed=LIMIT_SHARE * limits.speed,
            acceleration=LIMIT_SHARE * limits.acceleration,
            jerk=LIMIT_SHARE * limits.jerk,
        )
        requirements = replace(self.requirements, limits=reserved, separation=separation)
        of_bodies = usable.reshape(len(start), -1).min(axis=1)
        return SeparationTask(start, goal, requirements, acceleration=of_bodies, **bodies)


def separated(task: SeparationTask) -> PiecewisePolynomial:
    """Return the flight of bodies; the planner and scipy's matrices are imported here."""
    from hitchopt.swarms.separate import SeparatedCurves

    return SeparatedCurves(task).solve().drones


class DirectApproach(Approach):
    """All drones fly at once, and higher if cables would come near the ground.

    A cable hangs lower while its drones are closer together than at both ends of the flight.
    """

    name: ClassVar[str] = "direct approach"

    @property
    def obstacle_height(self) -> float:
        """Height over the ground of what cables fly over [m]."""
        return 0.0

    @cached_property
    def task(self) -> SeparationTask:
        """The flight of all drones, with the two drones of a cable tethered."""
        longest_spans = (MAX_SPAN_RATIO * self.team.cable_length).tolist()
        start = self._after_take_off()
        return self._task(
            np.stack([start, self.goal]),
            start,
            self.goal,
            self.requirements.separation,
            names=self.team.drone_names,
            tethers=tuple((2 * k, 2 * k + 1, span) for k, span in enumerate(longest_spans)),
        )

    def solve(self) -> list[Motion]:
        """Return the motions of the flight, raised as a whole if cables come near the ground."""
        start = self.task.start
        goal = self.goal
        take_off = self._lines(self.start, Keyframe(TAKE_OFF, start, CableState.GROUND))
        if np.max(np.abs(goal - start)) < POSITION_TOLERANCE:
            pause = PiecewisePolynomial.constant([0.0, PAUSE], goal)
            return [*take_off, self._stage(pause)]
        flight = separated(self.task)
        times = np.linspace(flight.breaks[0], flight.breaks[-1], 101)
        missing = missing_height(self.team, flight.at(times), self.requirements)
        deficit = missing + self.obstacle_height
        if deficit <= 0.0:
            return [*take_off, self._stage(flight)]
        rise = deficit + RISE_RESERVE * self.requirements.separation.cable
        return self._raised(take_off, flight, np.array([0.0, 0.0, rise]))

    def _raised(
        self, take_off: Sequence[Motion], flight: PiecewisePolynomial, up: Array
    ) -> list[Motion]:
        """Return the motions of a flight that is raised by an offset (3,) [m]."""
        start = self.task.start
        goal = self.goal
        # Position errors often require a rise: drones climb once then
        if take_off and self.requirements.position_error:
            climb = self._lines(self.start, Keyframe(TAKE_OFF, start + up, CableState.GROUND))
        else:
            climb = [*take_off, *self._lines(start, Keyframe("climb", start + up))]
        higher = PiecewisePolynomial(flight.breaks, flight.coefficients + up[:, None])
        descent = self._lines(goal + up, Keyframe("descend", goal))
        return [*climb, self._stage(higher), *descent]


class OverApproach(DirectApproach):
    """All drones fly at once, with their cables above all objects."""

    name: ClassVar[str] = "approach over objects"

    @property
    def obstacle_height(self) -> float:
        """Height of the highest object over the ground [m]."""
        bodies = self.requirements.objects.values()
        highest = max(float(body.at[2]) + body.upper for body in bodies)
        return highest - self.requirements.ground_for(HANGING)


class Headings(NamedTuple):
    """Headings of robots, from their q- to their r-drones, while they turn."""

    halfway: Array  # (n,) [rad], halfway through the turn
    at_goal: Array  # (n,) [rad], at the goal


def _headings_of(drones: Array) -> Array:
    """Return the headings (n,) [rad] of robots from drones (2n, 3) [m]."""
    chords = drones[1::2] - drones[0::2]
    return np.asarray(np.arctan2(chords[:, 1], chords[:, 0]))


class GatheredApproach(Approach):
    """Robots gather their drones, turn, fly as discs, and open.

    No robot may pass over another's hanging cable. The turn is split into halves, gathering and
    turning, since straight lines keep the two drones of a robot separated for up to 90°.
    """

    name: ClassVar[str] = "gathered approach"

    @cached_property
    def task(self) -> SeparationTask:
        """The flight of the discs' centres, (n, 3) [m]."""
        from scipy.spatial.distance import pdist

        separation = self.requirements.separation
        discs = with_fields(
            separation,
            radius=(1.0 + PAIR_SEPARATION) * separation.radius,
            height=float(np.max(self.team.cable_length)),
        )
        start = 0.5 * (self.start[0::2] + self.start[1::2])
        middles = 0.5 * (self.goal[0::2] + self.goal[1::2])
        closest = max(float(np.min(pdist(middles[:, :2]))), 1e-9)  # not zero: it divides
        scale = max(1.0, 2.0 * DISC_SEPARATION * discs.radius / closest)
        centre = np.mean(middles, axis=0)
        goal = centre + scale * (middles - centre)

        before = self._before_gathering(start)
        altitude = np.max(before[:, 2])
        start[:, 2] = altitude
        goal[:, 2] = altitude
        gathered = self._pairs(start, self._headings.at_goal)
        drones = np.stack([before, gathered])
        return self._task(drones, start, goal, discs, names=self.team.cable_names)

    def solve(self) -> list[Motion]:
        """Return the motions: gathering, turning, flying as discs, and opening."""
        task = self.task
        headings = self._headings
        gathering = self._lines(
            self.start,
            Keyframe(TAKE_OFF, self._before_gathering(task.start), CableState.GROUND),
            Keyframe("gather", self._pairs(task.start, headings.halfway)),
            Keyframe("turn", self._pairs(task.start, headings.at_goal)),
        )
        flight = separated(task)
        centres = np.moveaxis(flight.coefficients, -1, 1)
        drones = np.moveaxis(self._pairs(centres, headings.at_goal), 1, -1)
        approach = self._stage(PiecewisePolynomial(flight.breaks, drones))
        over_goal = self.goal.copy()
        over_goal[:, 2] = np.maximum(over_goal[:, 2], task.goal[0, 2])
        opening = self._lines(
            self._pairs(task.goal, headings.at_goal),
            Keyframe("open", over_goal),
            Keyframe("descend", self.goal),
        )
        return [*gathering, approach, *opening]

    @property
    def _headings(self) -> Headings:
        """Headings of robots as they turn."""
        first = _headings_of(self.start)
        last = _headings_of(self.goal)
        shortest_turn = (last - first + math.pi) % (2.0 * math.pi) - math.pi
        return Headings(halfway=first + 0.5 * shortest_turn, at_goal=last)

    def _before_gathering(self, centres: Array) -> Array:
        """Return the drones (2n, 3) [m] before they gather about disc centres (n, 3) [m].

        Pairs are closest in the middle of their turn, where their cables hang lowest.
        """
        headings = self._headings
        gathered = self._pairs(centres, headings.halfway)
        turned = self._pairs(centres, headings.at_goal)
        return self._after_take_off(gathered, 0.5 * (gathered + turned), self.goal)

    def _pairs(self, centres: Array, headings: Array) -> Array:
        """Return drones (…, 2n, 3) [m] on opposite sides of disc centres (…, n, 3) [m]."""
        arms = np.column_stack([np.cos(headings), np.sin(headings), 0.0 * headings])
        arms *= PAIR_SEPARATION * self.requirements.separation.radius
        pairs = np.stack([centres - arms, centres + arms], axis=-2)
        return pairs.reshape(*pairs.shape[:-3], -1, 3)


def assign_robots(
    team: Team, drones: Array, outline: Outline, leg: float, evenness: float = 0.0
) -> Assignment:
    """Return the assignment of robots to edges, and of their drones to the edges' ends.

    Cables avoid edges that leave less than the length of two legs. Costs are squared distances to
    the edges' ends: straight lines of minimum total cost do not cross.

    Parameters
    ----------
    team: in the order of the robots.
    drones: (2n, 3) [m], their positions.
    outline: its edges are assigned.
    leg: shortest leg [m].
    evenness: cost of squared differences of the cables' slack from its mean.
    """
    layout = team.layout
    ends = np.stack([outline.vertices[layout.starts], outline.vertices[layout.ends]], axis=1)
    slack = team.cable_length[:, None] - outline.edge_lengths
    unevenness = evenness * (slack - np.mean(slack)) ** 2
    return assign_pairs(drones, ends, excluded=slack < 2.0 * leg, further_costs=unevenness)


def assign_pairs(
    drones: Array, places: Array, excluded: NDArray[np.bool_], further_costs: Array | float = 0.0
) -> Assignment:
    """Return the assignment of robots to pairs of places, and of their drones to the places.

    Parameters
    ----------
    drones: (2n, 3) [m], positions in the order q0, r0, q1, r1, ….
    places: (n, 2, 2) [m], pairs of places in plan view.
    excluded: (n, n), robots and pairs that are assigned only if nothing else is left.
    further_costs: (n, n) [m²], added to the squared distances.
    """
    from scipy.optimize import linear_sum_assignment

    robots = len(places)
    starts, ends = places.swapaxes(0, 1)
    q = drones[0::2, None, :2]
    r = drones[1::2, None, :2]
    direct_cost = np.sum((q - starts) ** 2, axis=-1) + np.sum((r - ends) ** 2, axis=-1)
    flipped_cost = np.sum((q - ends) ** 2, axis=-1) + np.sum((r - starts) ** 2, axis=-1)
    cost = np.minimum(direct_cost, flipped_cost) + further_costs
    largest_cost = float(np.max(cost))
    penalty = excluded * (1.0 + largest_cost) * len(cost)
    # Small costs resolve ties: robots prefer edges of their own number; multiples of the golden
    # ratio modulo 1 resolve the rest
    index = np.arange(robots)
    other_number = np.abs(index[:, None] - index) / robots
    distinct = np.mod(GOLDEN * np.arange(1.0, robots * robots + 1.0), 1.0)
    order = distinct.reshape(robots, robots)
    preference = TIE * largest_cost * (other_number + PREFERENCE_OF_ORDER * order)
    robot, pair = linear_sum_assignment(cost + preference + penalty)
    robot_of_pair = robot[np.argsort(pair)]

    every_pair = np.arange(robots)
    gain = direct_cost[robot_of_pair, every_pair] - flipped_cost[robot_of_pair, every_pair]
    chords = drones[1::2, :2][robot_of_pair] - drones[0::2, :2][robot_of_pair]
    tie = TIE * largest_cost
    turns_clockwise = cross(chords, ends - starts) < -tie
    # For equal costs cables turn counter-clockwise
    flipped = np.where(np.abs(gain) > tie, gain > 0.0, turns_clockwise)
    return Assignment(tuple(robot_of_pair.tolist()), tuple(flipped.tolist()))
