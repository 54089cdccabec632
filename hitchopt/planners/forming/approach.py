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
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from hitchopt.geometry import Outline
from hitchopt.geometry.vectors import GOLDEN, TIE, cross
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Requirements, Separation
from hitchopt.hitch.team import Assignment
from hitchopt.motion.motion import TAKE_OFF, CableState, Motion
from hitchopt.planners.forming.prehitch import MAX_SPAN_RATIO
from hitchopt.planners.forming.stages import (
    MIN_FLIGHT,
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
    from hitchopt.planners.separation import SeparationTask

PAIR_SEPARATION = 1.6  # Separation [1] of a gathered robot's two drones
HEIGHT_SAMPLES = 101  # Number of times at which the cables' heights are sampled
DISC_SEPARATION = 1.15  # Minimum separation [1] of the discs at the goal


@dataclass(frozen=True, eq=False)
class Approach(ABC):
    """A planner of flights with free cables."""

    team: Team  # of the drones
    start: Array  # (2n, 3) [m]
    goal: Array  # (2n, 3) [m]
    requirements: Requirements  # enforced at all times
    index: int = 0  # of the step in its mission

    @property
    @abstractmethod
    def problem(self) -> SeparationTask:
        """The task of the separation planner."""

    @abstractmethod
    def solve(self) -> list[Motion]:
        """Return the motions of the flight, or raise InfeasibleError."""

    def _stage(self, name: str, drones: PiecewisePolynomial) -> Motion:
        return stage(name, drones, self.team, self.requirements, self.index)

    def _lines(self, start: Array, *keyframes: Keyframe) -> list[Motion]:
        """Return the motions of all drones on straight lines from a start to keyframes."""
        return straight_stages(start, keyframes, self.team, self.requirements, self.index)

    def _after_take_off(self, *others: Array) -> Array:
        """Return the drones (2n, 3) [m] after a take-off, or at the start if they are high enough.

        Cables hang free at that altitude, also with drones over ``others`` (2n, 3).
        """
        requirements, drones = self.requirements, self.start.copy()
        altitude = max(
            hover_altitude(self.team, each, requirements) for each in (self.start, *others)
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
        from hitchopt.planners.separation import SeparationTask

        limits = self.requirements.limits
        accelerations = usable_accelerations(self.team, limits, drones)
        accelerations = accelerations.reshape(len(start), -1).min(axis=1)
        rates = {
            name: LIMIT_SHARE * getattr(limits, name) for name in ("speed", "acceleration", "jerk")
        }
        requirements = replace(
            self.requirements, limits=with_fields(limits, **rates), separation=separation
        )
        return SeparationTask(start, goal, requirements, acceleration=accelerations, **bodies)


def separated(task: SeparationTask) -> PiecewisePolynomial:
    """Return the flight of bodies; the planner and scipy's matrices are imported here."""
    from hitchopt.planners.separation import SeparatedCurves

    return SeparatedCurves(task).solve().drones


class DirectApproach(Approach):
    """All drones fly at once, and higher if cables would come near the ground.

    A cable hangs lower while its drones are closer together than at both ends of the flight.
    """

    @property
    def obstacle_height(self) -> float:
        """Height over the ground of what cables fly over [m]."""
        return 0.0

    @cached_property
    def problem(self) -> SeparationTask:
        """The flight of all drones, with the two drones of a cable tethered."""
        spans = enumerate((MAX_SPAN_RATIO * self.team.cable_length).tolist())
        tethers = tuple((2 * k, 2 * k + 1, span) for k, span in spans)
        start, bodies = self._after_take_off(), {"names": self.team.drone_names, "tethers": tethers}
        drones, separation = np.stack([start, self.goal]), self.requirements.separation
        return self._task(drones, start, self.goal, separation, **bodies)

    def solve(self) -> list[Motion]:
        """Return the motions of the flight, raised as a whole if cables come near the ground."""
        start, goal, requirements = self.problem.start, self.goal, self.requirements
        rise = self._lines(self.start, Keyframe(TAKE_OFF, start, CableState.GROUND))
        if np.max(np.abs(goal - start)) < MIN_FLIGHT:
            pause = PiecewisePolynomial.constant([0.0, PAUSE], goal)
            return [*rise, self._stage("approach", pause)]
        drones = separated(self.problem)
        at = np.linspace(drones.breaks[0], drones.breaks[-1], HEIGHT_SAMPLES)
        deficit = missing_height(self.team, drones.at(at), requirements) + self.obstacle_height
        if deficit <= 0.0:
            return [*rise, self._stage("approach", drones)]
        up = np.array([0.0, 0.0, deficit + 0.1 * requirements.separation.cable])
        higher = PiecewisePolynomial(drones.breaks, drones.coefficients + up[:, None])
        if rise and requirements.position_error:  # a single climb: position errors often require it
            rise = self._lines(self.start, Keyframe(TAKE_OFF, start + up, CableState.GROUND))
        else:
            rise += self._lines(start, Keyframe("climb", start + up))
        down = self._lines(goal + up, Keyframe("descend", goal))
        return [*rise, self._stage("approach", higher), *down]


class OverApproach(DirectApproach):
    """All drones fly at once, with their cables above all objects."""

    @property
    def obstacle_height(self) -> float:
        """Height of the highest object over the ground [m]."""
        objects = self.requirements.objects.values()
        return max(float(x.at[2]) + x.upper for x in objects) - self.requirements.floor


class GatheredApproach(Approach):
    """Robots gather their drones, turn, fly as discs, and open.

    No robot may pass over another's hanging cable. The turn is split into halves, gathering and
    turning, since straight lines keep the two drones of a robot separated for up to 90°.
    """

    @cached_property
    def problem(self) -> SeparationTask:
        """The flight of the discs' centres, (n, 3) [m]."""
        from scipy.spatial.distance import pdist

        separation, (_, last) = self.requirements.separation, self._headings
        radius, height = separation.radius, float(np.max(self.team.cable_length))
        discs = with_fields(separation, radius=(1.0 + PAIR_SEPARATION) * radius, height=height)
        start, goal = (0.5 * (each[0::2] + each[1::2]) for each in (self.start, self.goal))
        drones = self._before_gathering(start)
        closest = max(float(np.min(pdist(goal[:, :2]))), 1e-9)
        scale = max(1.0, 2.0 * DISC_SEPARATION * discs.radius / closest)
        goal = np.mean(goal, axis=0) + scale * (goal - np.mean(goal, axis=0))
        start[:, 2] = goal[:, 2] = np.max(drones[:, 2])
        names = self.team.cable_names
        drones = np.stack([drones, self._pairs(start, last)])
        return self._task(drones, start, goal, discs, names=names)

    def solve(self) -> list[Motion]:
        """Return the motions: gathering, turning, flying as discs, and opening."""
        task, (halfway, last) = self.problem, self._headings
        start = self._before_gathering(task.start)
        gathered, turned = (self._pairs(task.start, heading) for heading in (halfway, last))
        over_goal = self.goal.copy()
        over_goal[:, 2] = np.maximum(over_goal[:, 2], task.goal[0, 2])
        flight = separated(task)
        centres = np.moveaxis(flight.coefficients, -1, 1)
        drones = np.moveaxis(self._pairs(centres, last), 1, -1)
        return [
            *self._lines(
                self.start,
                Keyframe(TAKE_OFF, start, CableState.GROUND),
                Keyframe("gather", gathered),
                Keyframe("turn", turned),
            ),
            self._stage("approach", PiecewisePolynomial(flight.breaks, drones)),
            *self._lines(
                self._pairs(task.goal, last),
                Keyframe("open", over_goal),
                Keyframe("descend", self.goal),
            ),
        ]

    @property
    def _headings(self) -> tuple[Array, Array]:
        """Headings of robots (n,) [rad] halfway through their turn, and at the goal."""
        ends = self.start, self.goal
        first, last = (np.arctan2(*(each[1::2] - each[0::2]).T[[1, 0]]) for each in ends)
        return first + 0.5 * ((last - first + math.pi) % (2.0 * math.pi) - math.pi), last

    def _before_gathering(self, centres: Array) -> Array:
        """Return the drones (2n, 3) [m] before they gather about disc centres (n, 3) [m].

        Pairs are closest in the middle of their turn, where their cables hang lowest.
        """
        gathered, turned = (self._pairs(centres, heading) for heading in self._headings)
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
    from scipy.optimize import linear_sum_assignment

    layout, points = team.layout, outline.vertices
    first, last = points[layout.starts], points[layout.ends]
    q, r = drones[0::2, None, :2], drones[1::2, None, :2]
    straight = np.sum((q - first) ** 2, axis=-1) + np.sum((r - last) ** 2, axis=-1)
    crossed = np.sum((q - last) ** 2, axis=-1) + np.sum((r - first) ** 2, axis=-1)
    slack = team.cable_length[:, None] - outline.edge_lengths
    cost = np.minimum(straight, crossed)
    if evenness:
        cost += evenness * (slack - np.mean(slack)) ** 2
    short = slack < 2.0 * leg
    size = float(np.max(cost))
    k = np.arange(team.robots)
    # Ties: robots prefer edges of their own number; multiples of the golden ratio modulo 1 resolve
    # the rest.
    distinct = np.mod(GOLDEN * np.arange(1.0, cost.size + 1.0), 1.0).reshape(cost.shape)
    preference = np.abs(k[:, None] - k) / len(k) + 0.1 * distinct
    cost = cost + TIE * size * preference + short * (1.0 + size) * len(cost)
    robots, roles = linear_sum_assignment(cost)
    order = robots[np.argsort(roles)]
    gain = straight[order, k] - crossed[order, k]
    cables, edges = drones[1::2, :2][order] - drones[0::2, :2][order], last - first
    # For equal costs cables turn counter-clockwise.
    flipped = np.where(np.abs(gain) > TIE * size, gain > 0.0, cross(cables, edges) < -TIE * size)
    return Assignment(tuple(order.tolist()), tuple(flipped.tolist()))
