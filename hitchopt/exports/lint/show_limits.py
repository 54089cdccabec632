"""Checks of the limits that a show sets itself, as Skybrush's validation panel makes them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hitchopt.checks.bounds.rounding_margins import derivative_margin
from hitchopt.checks.certificate import Check
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.extremum import Cells, Estimate, largest
from hitchopt.values import Array

ACROSS, UP, DOWN = 0, 1, -1
"""Directions in which vectors count; z is up, as in every show."""

KINDS = {
    "maxAltitude": (0, "m", (UP,)),
    "maxVelocityXY": (1, "m/s", (ACROSS,)),
    "maxVelocityZ": (1, "m/s", (UP, DOWN)),
    "maxVelocityZUp": (1, "m/s", (UP,)),
    "maxAccelerationXY": (2, "m/s²", (ACROSS,)),
    "maxAccelerationZ": (2, "m/s²", (UP, DOWN)),
    "maxAccelerationZUp": (2, "m/s²", (UP,)),
}
"""Derivative by time, unit, and directions in which each limit's quantity counts."""

DISTANCE = "minDistance"
"""Key of the smallest distance between two drones [m]."""


@dataclass(frozen=True)
class ShowLimits:
    """Limits that one show sets itself.

    Attributes
    ----------
    bounds: by the show's own keys; ``minDistance`` [m] among them where it is given.
    """

    bounds: Mapping[str, float] = field(default_factory=dict)

    def limits(self, order: int) -> bool:
        """Return whether a derivative by time is bounded across and up and down."""
        words = {1: "Velocity", 2: "Acceleration"}[order]
        return {f"max{words}XY", f"max{words}Z"} <= set(self.bounds)

    def checks(
        self, window: PiecewisePolynomial, smooth: int, names: Sequence[str]
    ) -> dict[str, Check]:
        """Return the checks of the limits of single drones on the curves (D, 3) of a window.

        Parameters
        ----------
        window: in axes of which the third is up.
        smooth: the highest derivative that does not jump; from the second one after it on,
            derivatives mean nothing.
        names: (D,)
        """
        found = {}
        for key, limit in self.bounds.items():
            if key == DISTANCE or KINDS[key][0] > smooth + 1:
                continue
            order, unit, directions = KINDS[key]
            if f"{key}Up" in self.bounds:
                directions = (DOWN,)  # upwards, the other key takes precedence
            value, item, time = max(_largest(window, order, each) for each in directions)
            found[key] = Check.of(key, value, limit, "max", unit, time, (names[item],))
        return found


def limits_of(validation: Mapping[str, Any]) -> tuple[ShowLimits, tuple[str, ...]]:
    """Return the limits in a show's ``settings.validation``, and keys that are no limits."""
    given = {key: validation[key] for key in (*KINDS, DISTANCE) if validation.get(key) is not None}
    bounds = {
        key: value
        for key, value in given.items()
        if isinstance(value, float) and math.isfinite(value) and value > 0.0
    }
    return ShowLimits(bounds), tuple(key for key in given if key not in bounds)


def _sizes(vectors: Array, direction: int) -> Array:
    """Return how far vectors (cells, 3, points) go in a direction: a convex function of them."""
    if direction == ACROSS:
        across: Array = np.linalg.norm(vectors[:, :2], axis=1)
        return across
    return direction * vectors[:, 2]


def _largest(window: PiecewisePolynomial, order: int, direction: int) -> tuple[float, int, float]:
    """Return the largest size of a derivative over all drones and times, whose, and when."""
    derivative = window.differentiated(order)
    margin = derivative_margin(window, order) if order else np.zeros(1)

    def bound(blocks: tuple[Array, ...]) -> Estimate:
        (vectors,) = blocks
        sizes = _sizes(vectors, direction)  # largest at a control point
        x = np.argmax(sizes, axis=-1) / max(1, bernstein.degree(vectors))
        value = _sizes(bernstein.evaluate(vectors, x[:, None])[..., None], direction)[:, 0]
        return Estimate(np.max(sizes, axis=-1), value, x)

    found = largest(Cells.over(window.breaks, [derivative.coefficients], margin), bound)
    return found.worst, found.item, found.time
