"""Rests in a plan: where steps end with a taut hitch, and the pull tests that judge them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.vectors import length
from hitchopt.lab.simulation.task import Task, TeamTask

REST_TIME = 1.0  # [s] Time at rest before a pull test, over which values are averaged
SHORTEST = 0.1  # [s] Shortest time over which values at rest are averaged

REST_TOLERANCE = 1e-6
"""[m] Largest step of a resting vertex between samples; also the largest change of a steady
tension, over the team's."""

STANDING_SPEED = 0.005
"""[m/s] Largest speed of a drone at rest: a step that brakes with a jerk of 100 m/s³ until it ends
has this speed 10 ms before."""


@dataclass(frozen=True)
class PlannedRest:
    """A rest at which a step of a team ends, its last step excluded."""

    phase: str  # Name of the phase that ends there
    start: float  # [s] Time from the flight's start at which averaging of values begins
    end: float  # [s] Time from the flight's start


@dataclass(frozen=True, order=True)
class PullTest:
    """A pull test where all drones stand still; times start at the flight's start."""

    # [s] Time at which the plan stops for the test; its duration for the test after the plan
    time: float
    since: float  # [s] Time after which all drones stand still


def resting_samples(task: TeamTask) -> NDArray[np.bool_]:
    """Return whether no vertex moves and no tension changes before samples of a task (samples,)."""
    steps = length(np.diff(task.states.vertices, axis=0))
    changes = np.abs(np.diff(task.states.tensions, axis=0)) / task.team.tension
    resting = np.all(np.concatenate([steps, changes], axis=-1) <= REST_TOLERANCE, axis=-1)
    return np.append(False, resting)


def standing_samples(task: Task | TeamTask) -> NDArray[np.bool_]:
    """Return whether all drones of a task stand still at its samples (samples,)."""
    standing: NDArray[np.bool_] = np.all(length(task.states.velocities) <= STANDING_SPEED, axis=-1)
    return standing


def rests_of(part: TeamTask) -> Iterator[PlannedRest]:
    """Yield the rests with a taut hitch at which steps of one team end, its last step excluded.

    Steps that are blended with the next one end without a rest.
    """
    if part.motion is None:
        return
    t, phases = part.states.t - part.states.t[0], part.motion.phases
    taut, standing = part.states.taut(part.team.tension), standing_samples(part)
    still = taut & resting_samples(part)
    for phase, following in pairwise(phases):
        if phase.step == following.step:
            continue
        end = phase.end - float(part.states.t[0])
        index = part.index(end)
        if not (taut[index] and standing[index]):
            continue
        moving = np.flatnonzero(~still[: index + 1])
        since = t[moving[-1]] if moving.size else t[0]
        start = float(min(max(since, end - REST_TIME), end - SHORTEST))
        yield PlannedRest(phase.name, start, end)


def pull_tests(task: Task) -> dict[float, PullTest]:
    """Return the pull tests that judge rests, by the ends of these [s].

    Rests between which no drone moves have one test in common, at the last of them, or after the
    plan. Rests at which another team moves have none.
    """
    t, standing = task.states.t - task.states.t[0], standing_samples(task)
    by_span = dict[int, list[float]]()
    for end in sorted(rest.end for part in task.teams for rest in rests_of(part)):
        index = task.index(end)
        if standing[index]:
            moving_before = np.flatnonzero(~standing[:index])
            first = int(moving_before[-1]) + 1 if moving_before.size else 0
            by_span.setdefault(first, []).append(end)
    tests = dict[float, PullTest]()
    for first, ends in by_span.items():
        is_last = bool(np.all(standing[first:]))
        test = PullTest(task.duration if is_last else ends[-1], float(t[first]))
        tests |= dict.fromkeys(ends, test)
    return tests
