"""Flights of one drone after the other, with all others at rest.

They pass doors and corridors in which no two drones have room, and take long. An order is found by
a depth-first search: a drone may fly once points of a lattice lead to its goal that keep clear of
all others, which rest at their starts or goals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import label

from hitchopt.errors import check_time
from hitchopt.hitch.requirements import Prism, Requirements
from hitchopt.planners.separation.prioritized import Lattice, Reservations
from hitchopt.planners.separation.task import SeparationTask
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import joined
from hitchopt.values import Array

CORNERS = 16
"""Number of corners of the prism around a drone at rest."""

SHARES = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)
"""Sizes of that prism, over the largest one."""

MAX_ROUTES_PER_DRONE = 16
"""Maximum number of drones that are tried in the search of an order, per drone."""


def order_of(task: SeparationTask) -> list[int] | None:
    """Return an order in which drones can fly one after the other, or None if none was found.

    Those that fly farthest ahead come first, along the mean flight, if there is a choice.
    """
    lattice = Lattice.of(task)
    if lattice is None or not np.any(lattice.clear):
        return None
    starts = [lattice.nearest(point) for point in task.start]
    goals = [lattice.nearest(point) for point in task.goal]
    ahead = (task.start + task.goal) @ np.mean(task.goal - task.start, axis=0)
    preferred: list[int] = np.argsort(-ahead, kind="stable").tolist()
    flown = list[int]()
    untried = [preferred.copy()]  # after each drone that has flown
    for _ in range(MAX_ROUTES_PER_DRONE * task.drones):
        if len(flown) == task.drones:
            break
        while not untried[-1]:
            untried.pop()
            if not flown:
                return None
            flown.pop()
        drone = untried[-1].pop(0)
        check_time()
        at_rest = Reservations(lattice, 1.0)
        for other in preferred:
            if other != drone:
                at_rest.add(np.array([goals[other] if other in flown else starts[other]]))
        free = at_rest.free(0).copy()
        free[starts[drone]] = free[goals[drone]] = True
        connected, _ = label(free, structure=np.ones((3, 3, 3)))
        if connected[starts[drone]] == connected[goals[drone]]:
            flown.append(drone)
            untried.append([other for other in preferred if other not in flown])
    return flown if len(flown) == task.drones else None


def alone(task: SeparationTask, drone: int, flown: Sequence[int]) -> SeparationTask:
    """Return the task of one drone past all others, at their goals if they have flown."""
    at_rest = task.start.copy()
    at_rest[flown] = task.goal[flown]
    requirements = task.requirements
    others = [other for other in range(task.drones) if other != drone]
    ends = np.stack([task.start[drone], task.goal[drone]])
    around = tuple(_prism_around(at_rest[other], ends, requirements) for other in others)
    names = tuple(task.names[other] for other in others)
    acceleration = task.acceleration
    if acceleration is not None:
        acceleration = np.broadcast_to(acceleration, task.drones)[drone : drone + 1]
    return SeparationTask(
        task.start[drone : drone + 1],
        task.goal[drone : drone + 1],
        replace(requirements, keep_out=(*requirements.keep_out, *around)),
        acceleration=acceleration,
        names=task.names[drone : drone + 1],
        prisms=(*task.prisms, *names),
    )


def _prism_around(point: Array, ends: Array, requirements: Requirements) -> Prism:
    """Return the prism around a drone at a point (3,) [m] that another one's centre stays off.

    Prisms keep the distance ``radius``: with it, the largest prism contains twice the ellipsoid.
    It is smaller if the other one's ends (2, 3) [m] are too near; the flight is certified later.
    """
    separation = requirements.separation
    angles = -2.0 * np.pi / CORNERS * np.arange(CORNERS)
    circle = np.column_stack([np.cos(angles), np.sin(angles)]) / math.cos(math.pi / CORNERS)
    rise = 2.0 * separation.height - separation.radius
    prisms = (
        Prism(
            point[:2] + share * separation.radius * circle,
            point[2] - share * rise,
            point[2] + share * rise,
        )
        for share in SHARES
    )
    for prism in prisms:
        if np.min(prism.clearance(ends).distance) >= separation.radius:
            break
    return prism


def in_a_row(
    task: SeparationTask, flights: Sequence[tuple[int, PiecewisePolynomial]]
) -> PiecewisePolynomial:
    """Return the curves (N, 3) [m] of all drones, which fly one after the other.

    Parameters
    ----------
    flights: drones, and their curves (1, 3) [m].
    """
    at_rest = task.start.copy()
    parts = list[PiecewisePolynomial]()
    for drone, flight in flights:
        pieces, _, _, count = flight.coefficients.shape
        coefficients = np.tile(at_rest[None, :, :, None], (pieces, 1, 1, count))
        coefficients[:, drone] = flight.coefficients[:, 0]
        parts.append(flight.replaced(coefficients))
        at_rest[drone] = task.goal[drone]
    return joined(parts)
