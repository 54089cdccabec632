"""The largest mass that lies on the edges of a hitch, by a rim or a tray.

Its weight is on the clasps, alike, and raises their legs.
"""

from __future__ import annotations

import numpy as np

from hitchopt.geometry import Outline
from hitchopt.geometry.vectors import length
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.leg_lengths import reference_margin
from hitchopt.hitch.leg_task import LIMIT_MARGIN, LegTask
from hitchopt.hitch.team import GRAVITY, Quadrotor
from hitchopt.holding.capacity import Capacity, largest_mass
from hitchopt.requirements import Requirements
from hitchopt.values import Array

CARRIED_AT = 1.0
"""[m/s²] Acceleration at which loads are carried at most."""


def rest_capacity(
    polygon: Outline,
    cable_length: float,
    tension: float,
    kind: Quadrotor,
    requirements: Requirements,
    height: float,
) -> Capacity:
    """Return the largest mass [kg] that rests on a polygon's edges within all limits.

    Parameters
    ----------
    polygon: of the hitch, its centroid under the centre of mass.
    cable_length: of all cables [m].
    tension: of all cables [N].
    height: of the centre of mass above the edges [m].
    """
    n = len(polygon)
    stands = _support(polygon, height)
    unloaded = Team(n, cable_length, tension=tension, quadrotor=kind)
    legs = Hitch.spread(
        unloaded, polygon, limits=requirements.limits, separation=requirements.separation
    ).q_legs

    def margins(mass: float) -> dict[str, float]:
        team = Team(n, cable_length, tension=tension, quadrotor=kind, load=mass / n)
        hitch = Hitch(team, polygon, 1.0, legs)
        thrusts = -hitch.cable_forces + [0.0, 0.0, GRAVITY * kind.mass]
        tilt = np.arctan2(length(thrusts[:, :2]), thrusts[:, 2])
        short = float(np.min(hitch.legs)) / requirements.limits.leg
        found = {
            "thrust": 2.0 - float(np.max(length(thrusts))) / kind.max_thrust,
            "tilt": 2.0 - float(np.max(tilt)) / requirements.limits.tilt,
            "legs": short,
            "separation": _distance_margin(team, polygon, legs, requirements),
        }
        return {name: ratio - 1.0 for name, ratio in found.items()} | {"support": stands}

    return largest_mass(margins, 2.5 * n * tension / GRAVITY)


def _support(polygon: Outline, height: float) -> float:
    """Return how far inside of its edges the force line stays while carried [m]."""
    away = polygon.vertices - polygon.centroid
    u = polygon.edge_directions
    inside: Array = away[:, 1] * u[:, 0] - away[:, 0] * u[:, 1]
    return float(np.min(inside)) - height * CARRIED_AT / GRAVITY


def _distance_margin(
    team: Team, polygon: Outline, legs: Array, requirements: Requirements
) -> float:
    """Return the smallest distance among drones and cables over its limit."""
    task = LegTask(
        team, requirements, polygon.vertices[None], legs[None], requirements.limits.leg,
        LIMIT_MARGIN,
    )  # fmt: skip
    return reference_margin(task)
