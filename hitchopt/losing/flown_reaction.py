"""The setpoints of a plan that goes on with a reaction, for the simulation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np

from hitchopt.losing.reaction_records import Reaction
from hitchopt.motion.states import States, sample_times, states_at
from hitchopt.simulation.flight_cargo import Cargo
from hitchopt.simulation.flight_task import SAME_TIME, Setpoints, Task
from hitchopt.values import Array

RATE = 100.0
"""[Hz] Rate of the setpoints of a reaction."""

LETTING_GO = 0.3
"""[s] Time in which survivors let tension go. Cables that stay level are pulled hardest by what
falls, slack ones let it gather speed: in simulated flights peaks of tension were larger where all
was let go at once, in twice the time, or only after the fall."""


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
    after = Setpoints(
        *(
            np.concatenate([getattr(part, field.name) for part in parts])
            for field in fields(Setpoints)
        )
    )
    after = replace(after, cable_forces=_forces(times, after.cable_forces, reaction))
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


def _forces(times: Array, planned: Array, reaction: Reaction) -> Array:
    """Return (k, 2n, 3) [N] what is fed forward at times [s], of what is planned to be."""
    gone = np.clip((times - reaction.course.begins) / LETTING_GO, 0.0, 1.0)
    keeps = 1.0 - gone**2 * (3.0 - 2.0 * gone)
    forces: Array = keeps[:, None, None] * planned
    if reaction.held is not None:
        forces = reaction.held.added(times, forces)
    if reaction.inward is not None:
        forces = forces - reaction.inward.pushes(times)
    return forces
