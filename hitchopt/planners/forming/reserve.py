"""The acceleration that thrust and tilt leave to drones that carry hanging cables."""

from __future__ import annotations

import math

import numpy as np

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.statics import hanging_forces
from hitchopt.requirements import Limits
from hitchopt.values import Array

SHARE = 0.999
"""Share of every limit that plans use."""


def accelerations(team: Team, limits: Limits, drones: Array) -> Array:
    """Return how much every drone may accelerate in any direction (2n,) [m/s²].

    Parameters
    ----------
    drones: (J, 2n, 3) [m], places along the flight.

    Raises
    ------
    InfeasibleError: hovering alone takes more thrust or tilt than there is, or a cable with weight
        is too short for its drones' places.
    """
    _check_reach(team, drones)
    mass = team.mass
    loads = np.zeros(drones.shape)
    loads[..., 2] = mass * GRAVITY
    loads -= hanging_forces(team, drones)
    size = np.linalg.norm(loads, axis=-1)
    tilt = np.arctan2(np.hypot(loads[..., 0], loads[..., 1]), loads[..., 2])
    thrust_left = SHARE * team.max_thrust - size
    tilt_left = SHARE * limits.tilt - tilt
    for name, left, used, limit, unit in (
        ("thrust", thrust_left, size, team.max_thrust, "N"),
        ("tilt", tilt_left, np.degrees(tilt), np.full(len(mass), math.degrees(limits.tilt)), "deg"),
    ):
        j, i = np.unravel_index(int(np.argmin(left)), left.shape)
        if left[j, i] <= 0.0:
            where, when = (team.drone_names[i],), "hovering with a hanging cable"
            remedy = "use lighter cables, or stronger drones that may tilt more"
            value, most = float(used[j, i]), float(limit[i])
            raise InfeasibleError([Violation(name, value, most, "max", unit, where, when, remedy)])
    free = np.minimum(thrust_left, size * np.sin(tilt_left)) / mass
    reserve: Array = np.minimum(np.min(free, axis=0), SHARE * limits.acceleration)
    return reserve


def _check_reach(team: Team, drones: Array) -> None:
    """Raise InfeasibleError where a cable with weight is shorter than its drones are apart.

    Its pull has no bound there, and would hide the reason.
    """
    spans = np.linalg.norm(drones[:, 1::2] - drones[:, 0::2], axis=-1) / team.cable_length
    cable = int(np.argmax(np.max(spans, axis=0)))
    worst = float(np.max(spans))
    if team.cable_density > 0.0 and worst >= 1.0:
        where, when = (f"cable {cable}",), "between its drones' places"
        remedy = "use a longer cable, a smaller polygon, or place the drones closer together"
        raise InfeasibleError([Violation("span", worst, 1.0, "max", "1", where, when, remedy)])
