"""The frame of a file: its axes, and where the plan lies in it.

A plan's world is read as east-north-up: x east, y north, z up. In the frame its origin lies at
``origin`` and it is turned by ``yaw``; a file then names its own axes:

    enu: (x, y, z)      east, north, up        heading yaw
    nwu: (y, -x, z)     north, west, up        heading yaw - π/2
    ned: (y, x, -z)     north, east, down      heading π/2 - yaw

where ``(x, y, z) = Rz(yaw) p + origin`` for a point p of the plan.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InputError
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, finite

AXES = {
    "enu": np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    "nwu": np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "ned": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
}
"""Axes of every frame as rows, in east, north and up."""


@dataclass(frozen=True, eq=False)
class ReferenceFrame:
    """A file's axes, and where the plan lies in them.

    Parameters
    ----------
    name: enu, nwu or ned.
    origin: (3,) [m] where the plan's origin lies, east, north and up of the frame's.
    yaw: angle by which the plan is turned, counter-clockwise seen from above [rad].

    Raises
    ------
    InputError: an unknown frame, or numbers that are not finite.
    """

    name: str = "enu"
    origin: ArrayLike = (0.0, 0.0, 0.0)
    yaw: float = 0.0

    def __post_init__(self) -> None:
        if self.name not in AXES:
            known = f"one of {', '.join(AXES)}"
            raise InputError("frame", self.name, known, "enu is the plan's own")
        point = np.array(self.origin, dtype=np.float64)
        if point.shape != (3,) or not np.all(np.isfinite(point)):
            raise InputError("origin", self.origin, "three finite numbers", "give x y z in metres")
        point.setflags(write=False)
        object.__setattr__(self, "origin", point)
        object.__setattr__(self, "yaw", finite("yaw", self.yaw))

    @property
    def rotation(self) -> Array:
        """Rotation (3, 3) from vectors of the plan to vectors of the file."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        if self.yaw == 0.0:  # exact: a file in the plan's own frame repeats its numbers
            return AXES[self.name]
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        rotation: Array = AXES[self.name] @ turn
        return rotation

    @property
    def shift(self) -> Array:
        """Place (3,) [m] of the plan's origin in the file's axes."""
        return AXES[self.name] @ np.asarray(self.origin, dtype=np.float64)

    @property
    def heading(self) -> float:
        """Yaw of the drones in the file's axes [rad], in (-π, π]; in the plan it is 0."""
        x, y, _ = AXES[self.name] @ np.array([math.cos(self.yaw), math.sin(self.yaw), 0.0])
        heading = math.atan2(y, x)
        return math.pi if heading == -math.pi else heading

    def vectors(self, values: Array) -> Array:
        """Return vectors (…, 3) of the plan in the file's axes."""
        return values @ self.rotation.T

    def points(self, values: Array) -> Array:
        """Return points (…, 3) of the plan in the file's axes [m]."""
        return values @ self.rotation.T + self.shift

    def planned(self, points: Array) -> Array:
        """Return points (…, 3) of the file in the plan's axes [m]."""
        return (points - self.shift) @ self.rotation

    def placed(self, part: PiecewisePolynomial) -> PiecewisePolynomial:
        """Return points (items, 3) of the plan in the file's axes [m]."""
        c = np.einsum("ij,pdjn->pdin", self.rotation, part.coefficients) + self.shift[:, None]
        return PiecewisePolynomial(part.breaks, c)

    def in_plan(self, part: PiecewisePolynomial) -> PiecewisePolynomial:
        """Return points (items, 3) of the file in the plan's axes [m]."""
        c = np.einsum("ji,pdjn->pdin", self.rotation, part.coefficients - self.shift[:, None])
        return PiecewisePolynomial(part.breaks, c)

    def to_dict(self) -> dict[str, object]:
        """Return what a file says of its frame."""
        return {
            "frame": self.name,
            "origin_enu": np.asarray(self.origin).tolist(),
            "yaw_deg": math.degrees(self.yaw),
        }
