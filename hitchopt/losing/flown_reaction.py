"""The setpoints of a plan that goes on with a reaction, for the simulation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np

from hitchopt.losing.reaction import Reaction
from hitchopt.motion.states import States, sample_times, states_at
from hitchopt.simulation.flight_cargo import Cargo
from hitchopt.simulation.flight_task import SAME_TIME, Setpoints, Task
from hitchopt.values import Array

RATE = 100.0
"""[Hz] Of the setpoints of a reaction."""

CAUGHT = (0.5, 1.0)
"""[s] From the loss: while the lost drone swings down survivors pull as before, such that its cable
may run; in this span they come to pull as it needs to hang."""

FADING = 0.1
"""[s] In which survivors that let go late let their feed-forward fade."""


def reacting(task: Task, reaction: Reaction) -> Task:
    """Return the task until the survivors react, then what they fly, to the ground.

    Parameters
    ----------
    task: of the plan that the reaction is of.
    reaction: to the loss of a drone.
    """
    course = reaction.course
    first = task.t < task.t[0] + course.begins - SAME_TIME
    rows = list(_rows(reaction))
    parts = [_setpoints(states) for _, states in rows]
    times = np.concatenate([t for t, _ in rows])
    formed = np.concatenate([states.formed for _, states in rows])
    kept = formed[:, None]
    vertices = np.concatenate([states.vertices for _, states in rows])
    tensions = np.concatenate([states.tensions for _, states in rows])
    fed = _fed(times, reaction)
    after = Setpoints(
        *(
            np.concatenate([getattr(part, field.name) for part in parts])
            for field in fields(Setpoints)
        )
    )
    forces = after.cable_forces
    if reaction.pulls is not None:
        held = _risen(times - reaction.course.time)[:, None, None]
        forces = (1.0 - held) * forces + held * reaction.pulls
    after = replace(after, cable_forces=fed[:, None, None] * forces)
    whole = {
        field.name: np.concatenate(
            [getattr(task.setpoints, field.name)[first], getattr(after, field.name)]
        )
        for field in fields(Setpoints)
    }
    return Task(
        task.team,
        np.concatenate([task.t[first], task.t[0] + times]),
        Setpoints(**whole),
        np.concatenate([task.formed[first], formed]),
        np.concatenate([task.vertices[first], np.where(kept[..., None], vertices, 0.0)]),
        np.concatenate([task.tensions[first], np.where(kept, tensions, 0.0)]),
        task.digest,
        None,
        Cargo(),
    )


def _rows(reaction: Reaction) -> Iterator[tuple[Array, States]]:
    """Yield times from the plan's start and states, part by part of what survivors fly."""
    course = reaction.course
    times = sample_times(course.sinking.duration, RATE)
    times = np.append(course.begins, times[times > course.begins + SAME_TIME])
    yield times, states_at(course.sinking, times)
    offset = course.sinking.duration
    for part in course.landing:
        own = sample_times(part.duration, RATE)[1:]
        yield offset + own, states_at(part, own)
        offset += part.duration


def _setpoints(states: States) -> Setpoints:
    return Setpoints(
        states.positions,
        states.velocities,
        states.accelerations,
        states.jerks,
        np.zeros(states.positions.shape[:-1]),
        states.cable_forces,
    )


def _risen(since: Array) -> Array:
    """Return (k,) the share of what cables pull with the lost drone hanging, after its loss [s]."""
    risen: Array = np.clip((since - CAUGHT[0]) / (CAUGHT[1] - CAUGHT[0]), 0.0, 1.0)
    return risen


def _fed(times: Array, reaction: Reaction) -> Array:
    """Return (k,) the share of the cable forces that is fed forward at times [s]."""
    if reaction.lets_go <= reaction.course.begins:
        return np.where(times < reaction.lets_go, 1.0, 0.0)
    share: Array = 1.0 - np.clip((times - reaction.lets_go) / FADING, 0.0, 1.0)
    return share
