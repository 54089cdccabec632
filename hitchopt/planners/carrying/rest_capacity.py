"""The largest mass that rests on a hitch at given tensions, and what bounds it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hitchopt.errors import HitchoptError, InfeasibleError
from hitchopt.hitch import Team
from hitchopt.hitch.statics import cable_forces
from hitchopt.motion.states import thrusts_of
from hitchopt.planners.carrying.held_motion import HeldHitch
from hitchopt.planners.carrying.rest_polygon import rest_polygons
from hitchopt.requirements import Limits
from hitchopt.values import Array

LARGEST = 100.0
"""[kg] No mass is looked for beyond."""

HALVINGS = 40
"""Halvings of the range of masses: to 1e-10 kg."""

TENSIONS = np.geomspace(0.2, 5.0, 40)
"""[N] Tensions that are tried for a suggestion."""

ROUNDED = 0.995
"""Share of the largest mass that is suggested: rounded to three digits it is no larger."""

EMPTY = 1.1
"""So many times a suggested tension is kept without a load: tilt is largest before legs bear it,
while they are not yet where they are with it."""

MORE_ROBOTS = 5
"""So many more robots are tried for a suggestion."""


@dataclass(frozen=True)
class RestCapacity:
    """What a hitch holds by a rim.

    Attributes
    ----------
    mass: the largest [kg]; 0 where not even nothing is held.
    binding: what bounds it: ``thrust``, ``tilt``, or ``load``, the angle at which legs rise.
    """

    mass: float
    binding: str


def rest_capacity(held: HeldHitch, tension: Array, limits: Limits) -> RestCapacity:
    """Return the largest mass that is held at rest, by thrust, tilt and the legs' balance."""
    lower, upper, binding = 0.0, LARGEST, broken_at(held, 0.0, tension, limits)
    if binding:
        return RestCapacity(0.0, binding)
    for _ in range(HALVINGS):
        middle = 0.5 * (lower + upper)
        found = broken_at(held, middle, tension, limits)
        binding = found or binding
        lower, upper = (lower, middle) if found else (middle, upper)
    return RestCapacity(lower, binding)


def broken_at(held: HeldHitch, mass: float, tension: Array, limits: Limits) -> str:
    """Return what a mass [kg] breaks at rest, or an empty word."""
    team = held.team
    try:
        drones = held.at_rest(tension, mass)
    except InfeasibleError:
        return "load"
    pulls = cable_forces(team, drones, held.places, np.repeat(tension, 2), np.ones(team.robots))
    thrusts = thrusts_of(team, np.zeros(drones.shape), pulls)
    size = np.linalg.norm(thrusts, axis=-1)
    if np.any(size > team.max_thrust):
        return "thrust"
    return "tilt" if np.any(thrusts[:, 2] < size * math.cos(limits.tilt)) else ""


def suggestion(
    name: str, held: HeldHitch, tension: Array, limits: Limits, gap: float
) -> tuple[RestCapacity, str]:
    """Return what is held, and in words what to change so that the object is.

    Parameters
    ----------
    name: of the object.
    held, tension: as asked for.
    limits: of motion.
    gap: as of ``rest_polygons`` [m].
    """
    capacity = rest_capacity(held, tension, limits)
    ways = []
    if capacity.mass > 0.0:
        ways.append(f"lower objects.{name}.mass to {ROUNDED * capacity.mass:.3g} kg")
    team, mass = held.team, held.body.mass
    fitting = [
        value
        for value in TENSIONS
        if not broken_at(held, mass, np.full(team.robots, value), limits)
        and not broken_at(held, 0.0, np.full(team.robots, EMPTY * value), limits)
    ]
    if fitting:
        asked = float(np.mean(tension))
        ways.append(f"ask for a tension of {min(fitting, key=lambda T: abs(T - asked)):.3g} N")
    one_kind = len(set(team.quadrotor)) == 1 and np.ptp(team.cable_length) == 0.0
    for robots in range(team.robots + 1, team.robots + 1 + MORE_ROBOTS) if one_kind else ():
        other = Team(
            robots,
            float(team.cable_length[0]),
            cable_density=team.cable_density,
            tension=float(np.mean(tension)),
            quadrotor=team.quadrotor[0],
        )
        try:
            below = rest_polygons(name, held.body, robots, gap).closed
        except HitchoptError:
            continue
        places = np.column_stack([below, np.full(robots, held.places[0, 2])])
        larger = HeldHitch(other, held.body, places, np.full(robots, 0.5), np.zeros(robots))
        if not broken_at(larger, mass, other.tension, limits):
            ways.append(f"use {robots} robots")
            break
    return capacity, ", or ".join(ways) or "use stronger quadrotors or a lighter object"
