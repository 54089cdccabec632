"""Checks of the limits that a show sets itself, as Skybrush's validation panel makes them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.rounding_margins import derivative_margin
from hitchopt.checks.certificate import Check
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.extremum import Cells, Estimate, largest

Array = NDArray[np.float64]

Size = Callable[[Array], Array]
"""Convex function of vectors (cells, 3, points): it is largest at a control point."""


def _across(vectors: Array) -> Array:
    sizes: Array = np.linalg.norm(vectors[:, :2], axis=1)
    return sizes


def _up(vectors: Array) -> Array:
    return vectors[:, 2]


def _down(vectors: Array) -> Array:
    return -vectors[:, 2]


KINDS: dict[str, tuple[int, str, tuple[Size, ...]]] = {
    "maxAltitude": (0, "m", (_up,)),
    "maxVelocityXY": (1, "m/s", (_across,)),
    "maxVelocityZ": (1, "m/s", (_up, _down)),
    "maxVelocityZUp": (1, "m/s", (_up,)),
    "maxAccelerationXY": (2, "m/s²", (_across,)),
    "maxAccelerationZ": (2, "m/s²", (_up, _down)),
    "maxAccelerationZUp": (2, "m/s²", (_up,)),
}
"""Derivative by time, unit, and sizes of each limit's quantity; z is up, as in every show."""

DISTANCE = "minDistance"


@dataclass(frozen=True)
class ShowLimits:
    """The limits of one show.

    Attributes
    ----------
    bounds: by the show's own keys; ``minDistance`` [m] among them where it is given.
    """

    bounds: Mapping[str, float]

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
            order, unit, sizes = KINDS[key]
            if f"{key}Up" in self.bounds:
                sizes = (_down,)  # upwards, the other key takes precedence
            value, item, time = max(_largest(window, order, size) for size in sizes)
            found[key] = Check.of(key, value, limit, "max", unit, time, (names[item],))
        return found


def limits_of(validation: Mapping[str, Any]) -> tuple[ShowLimits, tuple[str, ...]]:
    """Return what a show's ``settings.validation`` limits, and the keys that limit nothing."""
    given = {key: validation[key] for key in (*KINDS, DISTANCE) if validation.get(key) is not None}
    bounds = {
        key: value
        for key, value in given.items()
        if isinstance(value, float) and math.isfinite(value) and value > 0.0
    }
    return ShowLimits(bounds), tuple(key for key in given if key not in bounds)


def _largest(window: PiecewisePolynomial, order: int, size: Size) -> tuple[float, int, float]:
    """Return the largest size of a derivative over all drones and times, whose, and when."""
    derivative = window.differentiated(order)
    margin = derivative_margin(window, order) if order else np.zeros(1)

    def bound(blocks: tuple[Array, ...]) -> Estimate:
        (vectors,) = blocks
        sizes = size(vectors)
        x = np.argmax(sizes, axis=-1) / max(1, bernstein.degree(vectors))
        value = size(bernstein.evaluate(vectors, x[:, None])[..., None])[:, 0]
        return Estimate(np.max(sizes, axis=-1), value, x)

    found = largest(Cells.over(window.breaks, [derivative.coefficients], margin), bound)
    return found.worst, found.item, found.time
