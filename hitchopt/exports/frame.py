"""The room that a file speaks of: its axes, and where the plan lies in it.

A plan's world is read as east-north-up: x east, y north, z up. In the room its origin lies at
``origin`` and it is turned by ``yaw``; a file then names its own axes:

    enu: (x, y, z)      east, north, up        heading yaw
    nwu: (y, -x, z)     north, west, up        heading yaw - π/2
    ned: (y, x, -z)     north, east, down      heading π/2 - yaw

where ``(x, y, z) = Rz(yaw) p + origin`` for a point p of the plan.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InputError
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import finite

Array = NDArray[np.float64]

AXES = {
    "enu": np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    "nwu": np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "ned": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
}
"""Rows are the axes of a frame, in east, north and up."""

HEADINGS = {"enu": (0.0, 1.0), "nwu": (-0.5 * math.pi, 1.0), "ned": (0.5 * math.pi, -1.0)}
"""Of a heading counter-clockwise from east: what is added, and by what it is multiplied before."""


@dataclass(frozen=True, eq=False)
class Room:
    """Where a plan lies in the room, and in which axes that is told.

    Parameters
    ----------
    frame: enu, nwu or ned.
    origin: (3,) [m] where the plan's origin lies: east, north and up of the room's.
    yaw: by how much the plan is turned, counter-clockwise seen from above [rad].

    Raises
    ------
    InputError: an unknown frame, or numbers that are not finite.
    """

    frame: str
    origin: Array
    yaw: float

    def __init__(
        self,
        frame: str = "enu",
        origin: Sequence[float] | ArrayLike = (0.0, 0.0, 0.0),
        yaw: float = 0.0,
    ) -> None:
        if frame not in AXES:
            raise InputError("frame", frame, f"one of {', '.join(AXES)}", "enu is the plan's own")
        point = np.asarray(origin, dtype=np.float64)
        if point.shape != (3,) or not np.all(np.isfinite(point)):
            raise InputError("origin", origin, "three finite numbers", "give x y z in metres")
        point = point.copy()
        point.setflags(write=False)
        object.__setattr__(self, "frame", frame)
        object.__setattr__(self, "origin", point)
        object.__setattr__(self, "yaw", finite("yaw", yaw))

    @property
    def rotation(self) -> Array:
        """(3, 3): from vectors of the plan to vectors of the file."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        if self.yaw == 0.0:  # exact: a file in the plan's own frame repeats its numbers
            return AXES[self.frame]
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        rotation: Array = AXES[self.frame] @ turn
        return rotation

    @property
    def shift(self) -> Array:
        """(3,) [m]: where the plan's origin lies in the file's axes."""
        shift: Array = AXES[self.frame] @ self.origin
        return shift

    @property
    def heading(self) -> float:
        """Yaw of the drones in the file's axes [rad], in (-π, π]; in the plan it is 0."""
        offset, sign = HEADINGS[self.frame]
        heading = math.remainder(offset + sign * self.yaw, 2.0 * math.pi)
        return math.pi if heading == -math.pi else heading

    def vectors(self, values: Array) -> Array:
        """Return vectors (…, 3) of the plan in the file's axes."""
        turned: Array = values @ self.rotation.T
        return turned

    def points(self, values: Array) -> Array:
        """Return points (…, 3) of the plan in the file's axes [m]."""
        placed: Array = values @ self.rotation.T + self.shift
        return placed

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
            "frame": self.frame,
            "origin_enu": self.origin.tolist(),
            "yaw_deg": math.degrees(self.yaw),
        }
