"""Schedules of drones that queue or wait aside: laws of their points, and flights from them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.hitch.requirements import Arena, Prism, Requirements, Separation
from hitchopt.planners.timing.ramps import fastest_ramps
from hitchopt.swarms.prioritized import (
    CLEARANCES,
    Lattice,
    Reservations,
    fastest_path,
    prioritized,
)
from hitchopt.swarms.task import SeparationTask
from problems.swarm import random_corridor, random_door

SEPARATION = Separation(0.11, 0.25)
CORNER = np.array([3.1, -2.3, 1.7])  # off the origin


def block(x: tuple[float, float], y: tuple[float, float]) -> Prism:
    return Prism([[x[0], y[0]], [x[0], y[1]], [x[1], y[1]], [x[1], y[0]]], 0.0, 4.0)


def corridor(half_width: float) -> SeparationTask:
    """Two drones that trade the ends of a corridor with a bay in its middle."""
    x, y, _ = CORNER
    outer, bay = (x - 3.0, x + 3.0), (x - 0.3, x + 0.3)
    walls = [
        block(outer, (y - 2.0, y - half_width)),
        block((outer[0], bay[0]), (y + half_width, y + 2.0)),
        block((bay[1], outer[1]), (y + half_width, y + 2.0)),
        block(bay, (y + half_width + 0.3, y + 2.0)),
    ]
    ends = CORNER + np.array([[-1.2, 0.0, 0.0], [1.2, 0.0, 0.0]])
    arena = Arena(CORNER - [1.4, 1.0, 0.05], CORNER + [1.4, 1.0, 0.05])
    required = Requirements(separation=SEPARATION, arena=arena, keep_out=tuple(walls))
    return SeparationTask(ends, ends[::-1], required)


def test_drones_of_a_schedule_keep_their_clearance_from_start_to_goal() -> None:
    task = corridor(0.15)
    schedules = list(prioritized(task))
    assert len(schedules) >= 2
    for schedule, clearance in zip(schedules, CLEARANCES[-len(schedules) :], strict=True):
        first, second = schedule.points * SEPARATION.scale
        assert np.min(np.linalg.norm(first - second, axis=1)) > clearance - 0.1
        steps = np.abs(np.diff(schedule.points, axis=1)) * SEPARATION.scale
        assert np.max(steps) < 0.6  # neighbours of the lattice, moved away from walls
        for points, ends in (
            (schedule.points[:, 0], task.start),
            (schedule.points[:, -1], task.goal),
        ):
            assert np.max(np.linalg.norm((points - ends) * SEPARATION.scale, axis=1)) < 0.3
        for prism in task.requirements.keep_out:
            assert np.min(prism.clearance(schedule.points).distance) > 0.99 * SEPARATION.radius


def test_one_drone_waits_in_the_bay_while_the_other_one_passes() -> None:
    schedule = next(iter(prioritized(corridor(0.15))))
    aside = np.max(schedule.points[:, :, 1] - CORNER[1], axis=1)
    assert max(aside) > 0.2
    assert min(aside) < 0.1


def test_a_corridor_without_room_to_pass_has_no_schedule() -> None:
    task = corridor(0.15)
    shut = (
        *task.requirements.keep_out,
        block((CORNER[0] - 0.3, CORNER[0] + 0.3), (CORNER[1] + 0.15, 1.0)),
    )
    walls = Requirements(separation=SEPARATION, arena=task.requirements.arena, keep_out=shut)
    assert not list(prioritized(SeparationTask(task.start, task.goal, walls)))


def test_flights_within_a_step_of_the_lattice_have_no_schedule() -> None:
    start = CORNER + np.array([[-1.0, 0.0, 0.0], [1.0, 0.5, 0.3]])
    goal = start + 1e-4
    task = SeparationTask(start, goal, Requirements(separation=SEPARATION))
    assert not list(prioritized(task))
    shortest = ho.separate(ho.Problem(ho.Swarm(2), start, [ho.Fly(goal)])).duration
    hurried = ho.Problem(ho.Swarm(2), start, [ho.Fly(goal, duration=0.95 * shortest)])
    with pytest.raises(ho.InfeasibleError, match="allow"):
        ho.separate(hurried)


def test_paths_are_fastest_and_keep_out_of_reserved_points() -> None:
    task = corridor(0.15)
    lattice = Lattice.of(task)
    assert lattice is not None
    start, goal = lattice.nearest(task.start[0]), lattice.nearest(task.goal[0])
    free = Reservations(lattice, 1.0)
    path = fastest_path(free, start, goal, 1000)
    assert path is not None
    assert len(path) == goal[0] - start[0] + 1  # one step along the corridor at each time
    taken = Reservations(lattice, 1.0)
    taken.add(path)
    for time, point in enumerate(path):
        assert not taken.free(time)[tuple(point)]
    assert fastest_path(taken, goal, start, 1000) is not None  # by the bay
    assert fastest_path(taken, goal, goal, 1000) is None  # where the first one comes to rest
    assert fastest_path(free, start, goal, len(path) - 2) is None


@pytest.mark.parametrize(
    "data", [random_corridor(7), pytest.param(random_door(6), marks=pytest.mark.slow)]
)
def test_flights_from_schedules_are_certified(data: dict[str, Any]) -> None:
    plan = ho.separate(ho.problem_from_dict(data))
    plan.certificate.raise_if_violated()
    assert plan.phases[0].remark == "some wait for others to pass"
    drones, times = plan.motion.drones, np.linspace(0.0, plan.duration, 2001)
    scaled = drones.at(times) * plan.motion.requirements.separation.scale
    first, second = np.triu_indices(scaled.shape[1], 1)
    closest = np.min(np.linalg.norm(scaled[:, first] - scaled[:, second], axis=-1))
    assert closest >= plan.certificate["separation"].worst >= 1.0 - 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("seed", [21, 38])
def test_those_that_wait_do_not_slow_down_everybody(seed: int) -> None:
    """Through a door, drones are faster at once than one after the other."""
    data = random_door(seed)
    plan = ho.separate(ho.problem_from_dict(data))
    distances = np.linalg.norm(np.subtract(data["goal"], data["start"]), axis=-1)
    limits = plan.motion.requirements.limits
    alone, _ = fastest_ramps(distances, limits.speed, limits.acceleration, limits.jerk)
    assert plan.duration < np.sum(alone)
