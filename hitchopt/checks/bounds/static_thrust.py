"""What drones need to hover anywhere on their paths: the thrust without acceleration, enclosed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from hitchopt.checks.bounds.rounding_margins import position_margin
from hitchopt.checks.bounds.thrust_enclosure import (
    known_directions,
    thrust_cells,
    thrust_enclosure,
)
from hitchopt.checks.bounds.thrust_turning import load_rate, rate_margin, turning_cells
from hitchopt.checks.thrust import thrust_bound
from hitchopt.checks.tilt import tilt_bound
from hitchopt.motion.motion import Motion
from hitchopt.trajectory.enclosed_products import largest_norm, reduced
from hitchopt.trajectory.enclosure import Enclosure
from hitchopt.trajectory.extremum import largest
from hitchopt.values import Array

ORDER = 8
"""Degree in which static thrusts are written; what that loses is in their radius."""


@dataclass(frozen=True, eq=False)
class StaticThrust:
    """Thrust at rest of every drone, on every piece.

    Attributes
    ----------
    thrust: coefficients (pieces, drones, 3, degree + 1) [N] with radii (pieces, drones).
    rate: its derivative by plan time [N/s], in the same shape; None unless turning is limited.
    """

    thrust: Enclosure
    rate: Enclosure | None = None

    @classmethod
    def of(cls, motion: Motion) -> StaticThrust:
        """Return the static thrusts of a motion."""
        noise = position_margin(motion)

        def shaped(found: Enclosure) -> Enclosure:
            low = reduced(found, ORDER)
            shape = (motion.drones.pieces, len(motion.team.mass))
            coefficients = low.coefficients.reshape(*shape, *low.coefficients.shape[1:])
            return Enclosure(coefficients, low.radius.reshape(shape))

        cells = thrust_cells(motion, moving=False)
        along = known_directions(motion)
        known = None if along is None else along.taken()
        thrust = shaped(thrust_enclosure(cells.blocks, noise, known))
        if motion.requirements.limits.body_rate is None:
            return cls(thrust)
        rate = load_rate(turning_cells(motion).blocks, noise, rate_margin(motion))
        return cls(thrust, shaped(rate))

    @property
    def largest(self) -> Array:
        """(pieces, drones) [N]: bound of the norm from above."""
        most: Array = largest_norm(self.thrust.coefficients) + self.thrust.radius
        return most

    def beyond_cone(self, tilt: float) -> Array:
        """Return (pieces, drones) [N]: bound of the distance beyond the cone of ``tilt`` [rad].

        The distance ``|level part| cos - vertical part · sin`` is convex in the thrust, and
        negative inside of the cone.
        """
        c = self.thrust.coefficients
        distance = np.hypot(c[..., 0, :], c[..., 1, :]) * np.cos(tilt) - c[..., 2, :] * np.sin(tilt)
        most: Array = np.max(distance, axis=-1) + self.thrust.radius
        return most


def largest_static_thrust(motion: Motion) -> float:
    """Return the largest thrust at rest over ``max_thrust``, for all t."""
    cells = thrust_cells(motion, motion.team.max_thrust, moving=False)
    return largest(cells, partial(thrust_bound, noise=position_margin(motion))).worst


def largest_static_tilt(motion: Motion) -> float:
    """Return the largest tilt at rest [deg], for all t."""
    cells = thrust_cells(motion, moving=False)
    return largest(cells, partial(tilt_bound, noise=position_margin(motion))).worst
