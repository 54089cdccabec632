"""The largest mass that a hold carries, and the limit that binds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from hitchopt.errors import InfeasibleError, OneLine
from hitchopt.geometry import Outline
from hitchopt.geometry.vectors import length
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.leg_program import LIMIT_MARGIN, LegTask
from hitchopt.hitch.legs import reference_margin
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import GRAVITY, Quadrotor
from hitchopt.values import Array

RESOLUTION = 1e-7
"""[kg] Resolution of masses."""

ROUNDING = 1e-9
"""Margin below zero at which a limit is kept, as by the certificate: pulls may be at a limit."""

EASED = 0.95
"""Share of the largest mass at rest that is suggested: lifting and carrying pull at it too."""

SUGGESTED = {
    "grip": "raise the tension, or use rougher cables",
    "tilt": "raise limits.tilt_deg",
    "thrust": "use stronger drones, or lower the tension",
    "separation": "use cables of another length",
    "cable_clearance": "use longer cables",
    "crossing": "use shorter cables",
    "keep_out": "use longer cables",
    "legs": "use longer cables",
    "equilibrium": "raise the tension",
    "support": "use a wider rim, or lower the centre of mass",
}
"""Changes that let a hold carry more, by the limit that binds."""


@dataclass(frozen=True)
class Capacity(OneLine):
    """What a hold carries at most.

    Attributes
    ----------
    mass: [kg]; 0 where it breaks a limit without a load.
    binding: the limit that binds, named as the certificate's check.
    """

    mass: float
    binding: str

    @property
    def suggested(self) -> str:
        """A change that raises it."""
        if self.mass == 0.0 and self.binding not in SUGGESTED:
            return "use another number of robots, or cables of another length"
        return SUGGESTED.get(self.binding, "use longer cables")


def largest_mass(margins: Callable[[float], Mapping[str, float]], most: float) -> Capacity:
    """Return the largest mass at which no margin is negative, and whose margin ends it.

    Parameters
    ----------
    margins: of a mass [kg], by limits; falling with the mass, as far as they bind. It may raise
        InfeasibleError where the hold has no balance.
    most: a mass [kg] that is too large.
    """

    def worst(mass: float) -> tuple[float, str]:
        try:
            found = margins(mass)
        except InfeasibleError as error:
            return -1.0, error.violations[0].constraint
        name = min(found, key=lambda key: found[key])
        return found[name], name

    margin, name = worst(0.0)
    if margin < -ROUNDING:
        return Capacity(0.0, name)
    if worst(most)[0] >= -ROUNDING:
        raise ValueError(f"{most} kg are held, and were to be too much")
    low, high = 0.0, most
    while high - low > RESOLUTION:
        middle = 0.5 * (low + high)
        margin, reason = worst(middle)
        if margin >= -ROUNDING:
            low = middle
        else:
            high, name = middle, reason
    return Capacity(low, name)


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
