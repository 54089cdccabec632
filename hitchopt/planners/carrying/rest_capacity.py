"""The largest mass that rests on a hitch at given tensions, and what bounds it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hitchopt.errors import InfeasibleError
from hitchopt.hitch.statics import cable_forces
from hitchopt.motion.states import thrusts_of
from hitchopt.planners.carrying.held_motion import HeldHitch
from hitchopt.requirements import Limits
from hitchopt.values import Array

LARGEST = 100.0
"""[kg] No mass is looked for beyond."""

HALVINGS = 40
"""Halvings of the range of masses: to 1e-10 kg."""

TENSIONS = np.geomspace(0.2, 5.0, 40)
"""[N] Tensions that are tried for a suggestion."""

EASED = 0.98
"""Share of the largest mass that is suggested: the rest is left to motions."""

EMPTY = 1.1
"""So many times a suggested tension is kept without a load: tilt is largest before legs bear it,
while they are not yet where they are with it."""


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
