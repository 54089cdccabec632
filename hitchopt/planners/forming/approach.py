"""Approaches to the pre-hitch: up from the ground, then all drones at once, cables hanging.

Two are planned, the simpler one first; the certificate judges them. *Direct*: all drones fly
at once through the separation planner, the two of a cable tethered. *Gathered*: every robot first
draws its two drones together, so that its cable hangs within a disc seen from above; discs avoid
each other and turn meanwhile, and open at the other end. Chords within discs that never meet cannot
tangle.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from hitchopt.hitch import Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.planners.forming.prehitch import SPAN
from hitchopt.planners.forming.reserve import SHARE, accelerations
from hitchopt.planners.forming.stage import Stage
from hitchopt.planners.forming.straight import STILL, straight
from hitchopt.planners.forming.wheels import Wheels, turned
from hitchopt.planners.separation import SeparationTask, Tether, separate
from hitchopt.requirements import Limits, Requirements
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
class ApproachTask:
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

    @property
    def limits(self) -> Limits:
        """Limits of motion."""
        return self.requirements.limits


def approaches(task: ApproachTask) -> Iterator[Callable[[], list[Stage]]]:
    """Yield approaches as functions that plan them, which may raise HitchoptError."""
    yield lambda: _direct(task)
    yield lambda: _gathered(task)


def hover_altitude(team: Team, places: Array, ground: float, clearance: float) -> float:
    """Return how high drones at ``places`` (2n, 3) [m] must be for their cables to hang free [m].

    Parameters
    ----------
    places: their heights are not used.
    clearance: smallest distance of the cables to the ground [m].
    """
    level = places * np.array([1.0, 1.0, 0.0])
    return ground + clearance - float(np.min(_lowest(team, level)))


def take_off(task: ApproachTask, altitude: float) -> Stage:
    """Return the stage in which all go straight up to ``altitude`` [m]."""
    up = task.start.copy()
    up[:, 2] = np.maximum(altitude, up[:, 2])
    return Stage("take-off", straight(task.team, task.limits, task.start, up))


def _direct(task: ApproachTask) -> list[Stage]:
    stages, here = _risen(task, task.start)
    if np.max(np.abs(task.goal - here)) < STILL:
        return [*stages, Stage("approach", straight(task.team, task.limits, here, task.goal))]
    tethers = tuple(
        Tether(2 * k, 2 * k + 1, float(SPAN * length))
        for k, length in enumerate(task.team.cable_length)
    )
    both = np.stack([here, task.goal])
    found = separate(
        SeparationTask(
            here,
            task.goal,
            _reserved(task.requirements),
            tethers=tethers,
            acceleration=accelerations(task.team, task.limits, both),
            names=task.team.drone_names,
        )
    )
    return [*stages, *_lifted(task, here, found.drones)]


def _lifted(task: ApproachTask, here: Array, drones: PiecewisePolynomial) -> list[Stage]:
    """Return the stages of a flight, all of it raised where cables come too near the ground.

    Drones that come closer together let their cable hang lower than at both ends.
    """
    ends = task.requirements.floor + CLEARANCE * task.requirements.separation.cable
    at = np.linspace(drones.breaks[0], drones.breaks[-1], PROBES)
    missing = ends - min(float(np.min(_lowest(task.team, places))) for places in drones.at(at))
    if missing <= 0.0:
        return [Stage("approach", drones)]
    up = np.array([0.0, 0.0, missing + 0.1 * task.requirements.separation.cable])
    higher = PiecewisePolynomial(drones.breaks, drones.coefficients + up[:, None])
    return [
        Stage("climb", straight(task.team, task.limits, here, here + up)),
        Stage("approach", higher),
        Stage("descend", straight(task.team, task.limits, task.goal + up, task.goal)),
    ]


def _reserved(requirements: Requirements) -> Requirements:
    """Return requirements that leave a reserve for the certificate's bounds."""
    limits = requirements.limits
    reserved = replace(
        limits,
        speed=SHARE * limits.speed,
        acceleration=SHARE * limits.acceleration,
        jerk=SHARE * limits.jerk,
    )
    return replace(requirements, limits=reserved)


def _gathered(task: ApproachTask) -> list[Stage]:
    team, n = task.team, task.team.robots
    span = DRAWN * 2.0 * task.requirements.separation.radius
    pairs = Wheels.between(task.start, task.goal, 0.5 * span)
    disc = 0.5 * span + task.requirements.separation.radius
    start, goal = pairs.centres, _spaced(pairs.goals, 2.0 * ROOM * disc)
    gathered = pairs.drones(start, np.zeros(n))
    stages, here = _risen(task, task.start, gathered, task.goal)
    altitude = float(np.max(here[:, 2]))
    start[:, 2] = goal[:, 2] = altitude
    gathered[:, 2] = altitude
    # No robot may pass over another one: their cables hang below them.
    discs = replace(
        task.requirements.separation, radius=disc, height=float(np.max(team.cable_length))
    )
    found = separate(
        SeparationTask(
            start,
            goal,
            replace(_reserved(task.requirements), separation=discs),
            acceleration=np.min(
                accelerations(team, task.limits, np.stack([here, gathered])).reshape(n, 2), axis=1
            ),
            names=tuple(f"cable {k}" for k in range(n)),
        )
    )
    wheels = replace(pairs, centres=start)
    rolled = wheels.drones(goal, wheels.angles)
    opened = task.goal.copy()
    opened[:, 2] = np.maximum(opened[:, 2], altitude)
    return [
        *stages,
        Stage("gather", straight(team, task.limits, here, gathered)),
        Stage("turn", turned(team, wheels, task.limits)),
        Stage("approach", wheels.carried(found.drones)),
        Stage("open", straight(team, task.limits, rolled, opened)),
        *_descended(task, opened),
    ]


def _descended(task: ApproachTask, here: Array) -> list[Stage]:
    """Return the stage straight down to the goal, or none for drones that are there."""
    if np.max(np.abs(task.goal - here)) < STILL:
        return []
    return [Stage("descend", straight(task.team, task.limits, here, task.goal))]


def _risen(task: ApproachTask, *others: Array) -> tuple[list[Stage], Array]:
    """Return the take-off, if one is needed, and where the drones are after it.

    Its altitude lets cables hang free there, and at all ``others`` (2n, 3) as well.
    """
    clearance = CLEARANCE * task.requirements.separation.cable
    needed = [
        hover_altitude(task.team, p, task.requirements.floor, clearance)
        for p in (task.start, *others)
    ]
    if np.min(task.start[:, 2]) >= max(needed):
        return [], task.start
    altitude = max(*needed, float(np.max(task.goal[:, 2])))
    stage = take_off(task, altitude)
    return [stage], stage.drones.coefficients[-1, ..., -1]


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
