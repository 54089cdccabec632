"""The task of a flight in which a robot lets go of its cable and leaves upward.

From the loss on, nothing pulls at its drones. With a reaction, all fly on as planned at first, and
then the plan of ``hitchopt react``. Without one, the others fly on as planned while they rise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from hitchopt.errors import InputError
from hitchopt.hitch import Team
from hitchopt.lab.simulation.settings import Loss
from hitchopt.lab.simulation.task import RATE, Task, TeamTask
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import (
    DRONE_FIELDS,
    States,
    flight_states_at,
    sample_times,
    states_at,
)
from hitchopt.slices import provided
from hitchopt.support import Feature
from hitchopt.values import Indices, known

MIN_TIME = 4.0  # [s] Shortest time after a loss to which others fly on without a reaction

PATH_FIELDS = ("positions", "velocities", "accelerations", "jerks")
"""Fields of states that a path determines."""


def task_with_cut(task: Task, loss: Loss, *, react: bool) -> tuple[Task, Any]:
    """Return the task of a plan's only team with the loss of a robot, and what remains.

    Raises UnsupportedError for several teams; others as ``Plan.after_loss``.
    """
    flight = known(task.of_one_team(Feature.SIMULATED_LOSS).flight)  # files are refused before
    motion = flight.teams[0].motion
    try:
        found = provided("after_loss")(flight, loss.name, loss.time)
    except InputError as error:
        raise error.renamed(lambda _: "cut") from None
    states = (_with_reaction if react else _without)(motion, found, loss)
    team = motion.team
    leaving, late = _drones(team, loss.drones), states.t >= loss.time
    for name in ("cable_forces", "cable_force_rates"):
        getattr(states, name)[np.ix_(late, leaving)] = 0.0
    states.tensions[late, leaving[0] // 2] = 0.0
    return Task((TeamTask(team, states),)), found


def _drones(team: Team, names: Sequence[str]) -> Indices:
    """Return the indices of a team's drones by name."""
    return np.array([team.drone_names.index(name) for name in names], dtype=np.intp)


def _copied(states: States) -> States:
    """Return states whose arrays can be changed."""
    return States(*(np.array(getattr(states, field.name)) for field in fields(states)))


def _with_reaction(motion: Motion, found: Any, loss: Loss) -> States:
    """Return the states of the plan until all react, and of what follows."""
    flight = found.flight
    states = _copied(states_at(motion, sample_times(found.begin + flight.duration, RATE)))
    later = states.t >= loss.time + found.reacts
    t = states.t[later] - found.begin
    drones = _drones(motion.team, found.drones)
    after = flight_states_at(flight, t)
    for name in DRONE_FIELDS:
        getattr(states, name)[np.ix_(later, drones)] = getattr(after, name)
    chain = flight.teams[0].motion
    cables = drones[: chain.team.drones : 2] // 2
    states.tensions[np.ix_(later, cables)] = states_at(chain, t).tensions
    return states


def _without(motion: Motion, found: Any, loss: Loss) -> States:
    """Return the states of the plan, above which the drones of a lost robot rise."""
    end = max(motion.duration, loss.time + MIN_TIME)
    states = _copied(states_at(motion, sample_times(end, RATE)))
    late = states.t >= loss.time
    leaving = _drones(motion.team, loss.drones)
    since = np.minimum(states.t[late] - loss.time, found.lift.breaks[-1])
    for order, name in enumerate(PATH_FIELDS):
        heights = getattr(states, name)[..., 2]
        heights[np.ix_(late, leaving)] += found.lift.at(since, order)
    return states
