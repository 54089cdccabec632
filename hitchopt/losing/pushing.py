"""How survivors stay where a lost drone has drawn them.

They spring back to their setpoints as soon as it lies on the ground, and draw its cable taut again:
in simulated flights from 2 m and above that second pull was larger than the first one. To plan
setpoints that come closer takes too long within limits; thrust that leans inward does not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hitchopt.hitch import GRAVITY, Team
from hitchopt.losing.falling import GAIN
from hitchopt.losing.reaction_records import Course, Held, Inward, Reaction
from hitchopt.losing.spacing import apart, to_lost
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import States
from hitchopt.values import Array

FROM, RISES, UNTIL, FADES = 0.55, 0.1, 2.2, 0.4
"""[s] Times after the loss between which survivors push, and in which they begin and cease to."""

CLOSER, BESIDE = 0.21, 0.25
"""[m] Distances, on position loops, by which the outermost one comes closer to the middle, and
those that share a cable or clasp with the lost drone to that clasp."""

TRIES = ((1.0, True), (1.0, False), (0.75, False), (0.5, False))
"""Shares of that which are tried, and whether those beside go to the clasp or to the middle."""

ROOM = 1.4
"""Smallest separation of two survivors that is left: the lost drone's cable draws some together."""

ABOVE = 0.25
"""[m] Height of the lowest drone at which they no longer push: they land upright."""

SAMPLE = 0.01
"""[s] Distance of the samples of their thrusts."""


def pushing(motion: Motion, states: States, lost: int, reaction: Reaction, arcs: Array) -> Reaction:
    """Return a reaction of a hitch whose survivors push inward; the same one if they may not.

    Parameters
    ----------
    motion: the plan.
    states: of the time of the loss.
    lost: the drone.
    reaction: to its loss.
    arcs: (m, 3) [m], places through which it swings.
    """
    others = np.arange(motion.team.drones) != lost
    for share, across in TRIES:
        by = share * closer(motion.team, states, lost, across=across)
        near = (states.positions + by)[others]
        room, distance = apart(motion, near), to_lost(motion, near, arcs)
        if room < ROOM or distance < 1.0:
            continue
        found = _inward(motion, reaction.course, by, lost, reaction.held)
        if found is not None:
            return replace(reaction, inward=found, nearest=min(room, distance, reaction.nearest))
    return reaction


def _inward(
    motion: Motion, course: Course, by: Array, lost: int, held: Held | None
) -> Inward | None:
    """Return how survivors push inward; None where thrust, tilt or height do not allow it.

    Nor do they where they hold the lost drone at once. Thrust and tilt are looked at in samples;
    what cables were planned to pull has been let go by then.

    Parameters
    ----------
    course: that they fly.
    by: (2n, 3) [m], by which they come closer on their position loops; none for the lost one.
    lost: the drone.
    held: how they hold it.
    """
    team, drones = motion.team, course.sinking.drones
    begins = course.time + FROM
    t = np.arange(begins, course.sinking.duration, SAMPLE)
    low = np.min(drones.at(t)[..., 2], axis=-1) < motion.requirements.floor + ABOVE
    until = min(course.time + UNTIL, course.sinking.duration)
    ends = float(np.min(t[low], initial=until))
    at_once = held is not None and held.begins < begins  # then survivors pull outward
    if at_once or ends - FADES < begins + RISES:
        return None
    forces = GAIN * team.mass[:, None] * by
    found = Inward(forces, begins, begins + RISES, ends - FADES, ends)
    t = t[t <= ends]
    thrusts = drones.at(t, 2) + [0.0, 0.0, GRAVITY]
    thrusts = team.mass[:, None] * thrusts + found.pushes(t)
    pulls = np.zeros_like(thrusts)
    thrusts -= pulls if held is None else held.added(t, pulls)
    thrusts = np.delete(thrusts, lost, axis=1)
    sizes = np.linalg.norm(thrusts, axis=-1)
    upright = thrusts[..., 2] >= np.cos(motion.requirements.limits.tilt) * sizes
    strong = sizes <= np.delete(team.max_thrust, lost)
    return found if np.all(upright & strong) else None


def closer(team: Team, states: States, lost: int, *, across: bool) -> Array:
    """Return by how much drones come closer (2n, 3) [m], level; the lost one does not.

    Parameters
    ----------
    states: of one time, of a hitch.
    lost: the drone.
    across: whether those beside it go to its clasp, else to the middle as the others do.
    """
    points = team.layout.pulled_to
    beside = points == points[lost]
    beside[lost ^ 1] = True
    middle, clasp = (
        (place - states.positions) * [1.0, 1.0, 0.0]
        for place in (np.mean(states.positions, axis=0), states.vertices[points[lost]])
    )
    middle *= CLOSER / np.max(np.linalg.norm(middle, axis=-1))
    clasp *= BESIDE / np.maximum(np.linalg.norm(clasp, axis=-1, keepdims=True), BESIDE)
    by: Array = np.where((beside & across)[:, None], clasp, middle)
    by[lost] = 0.0
    return by
