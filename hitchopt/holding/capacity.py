"""The largest mass that a hold carries, and the limit that binds."""

from __future__ import annotations

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

RESOLUTION = 1e-7
"""[kg] Resolution of masses."""

ROUNDING = 1e-9
"""Margin below zero at which a limit is kept, as by the certificate: pulls may be at a limit."""

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
    """The largest mass [kg] that a hold carries, and the limit that binds, as a check's name.

    It is 0 where the hold breaks a limit without a load.
    """

    mass: float
    binding: str

    @property
    def suggested(self) -> str:
        """A change that raises it."""
        if self.mass == 0.0 and self.binding not in SUGGESTED:
            return "use another number of robots, or cables of another length"
        return SUGGESTED.get(self.binding, "use longer cables")


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

    Its centroid is under the centre of mass, ``height`` [m] above the edges; all cables have one
    length [m] and one tension [N].
    """
    n, limits = len(polygon), requirements.limits
    away, u = polygon.vertices - polygon.centroid, polygon.edge_directions
    inside = np.min(away[:, 1] * u[:, 0] - away[:, 0] * u[:, 1])
    stands = float(inside) - height * CARRIED_AT / GRAVITY  # of the force line while carried [m]
    unloaded = Team(n, cable_length, tension=tension, quadrotor=kind)
    legs = Hitch.spread(unloaded, polygon, limits=limits, separation=requirements.separation).q_legs

    def worst(mass: float) -> tuple[float, str]:
        """Return the smallest margin with a mass [kg], and the limit that it is of."""
        team = Team(n, cable_length, tension=tension, quadrotor=kind, load=mass / n)
        try:
            hitch = Hitch(team, polygon, 1.0, legs)
            thrusts = -hitch.cable_forces + [0.0, 0.0, GRAVITY * kind.mass]
        except InfeasibleError as error:
            return -1.0, error.violations[0].constraint
        tilt = np.arctan2(length(thrusts[:, :2]), thrusts[:, 2])
        task = LegTask(
            team, requirements, polygon.vertices[None], legs[None], limits.leg, LIMIT_MARGIN
        )
        found = {
            "thrust": 1.0 - float(np.max(length(thrusts))) / kind.max_thrust,
            "tilt": 1.0 - float(np.max(tilt)) / limits.tilt,
            "legs": float(np.min(hitch.legs)) / limits.leg - 1.0,
            "separation": reference_margin(task) - 1.0,
            "support": stands,
        }
        return min((margin, name) for name, margin in found.items())

    margin, name = worst(0.0)
    if margin < -ROUNDING:
        return Capacity(0.0, name)
    low, high = 0.0, 2.5 * n * tension / GRAVITY  # all legs upright bear less
    while high - low > RESOLUTION:
        middle = 0.5 * (low + high)
        margin, reason = worst(middle)
        if margin >= -ROUNDING:
            low = middle
        else:
            high, name = middle, reason
    return Capacity(low, name)
