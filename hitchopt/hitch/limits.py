"""What a plan must keep: limits of motion, distances, and the arena."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InputError
from hitchopt.hitch.values import acute, finite, not_negative, positive


@dataclass(frozen=True)
class Limits:
    """Limits of motion; all norms are Euclidean.

    Parameters
    ----------
    speed: of every drone [m/s]
    acceleration: of every drone [m/s²]
    jerk: of every drone [m/s³]
    tilt: largest angle of the thrust from vertical [rad], below π/2
    vertex_speed: how fast a vertex of the hitch may go [m/s]
    leg: shortest leg, vertex to drone, while the hitch holds [m]
    duration: of the whole plan [s], or None
    """

    speed: float = 1.0
    acceleration: float = 2.0
    jerk: float = 20.0
    tilt: float = math.radians(45.0)
    vertex_speed: float = 0.5
    leg: float = 0.15
    duration: float | None = None

    def __post_init__(self) -> None:
        for name in ("speed", "acceleration", "jerk", "tilt", "vertex_speed", "leg"):
            object.__setattr__(self, name, positive(name, getattr(self, name)))
        acute("tilt", self.tilt)
        if self.duration is not None:
            object.__setattr__(self, "duration", positive("duration", self.duration))


@dataclass(frozen=True)
class Separation:
    """Distances to keep.

    Parameters
    ----------
    radius, height: semi-axes of a drone's ellipsoid [m] (Preiss et al. 2017)
    cable: drone to any cable but its own, and to its own edge [m]
    crossing: cable to cable where they share no clasp, taut parts [m]
    """

    radius: float = 0.12
    height: float = 0.30
    cable: float = 0.10
    crossing: float = 0.05

    def __post_init__(self) -> None:
        for name in ("radius", "height"):
            object.__setattr__(self, name, positive(name, getattr(self, name)))
        for name in ("cable", "crossing"):
            object.__setattr__(self, name, not_negative(name, getattr(self, name)))

    @property
    def scale(self) -> NDArray[np.float64]:
        """(3,) [1/m]: ``separation`` of two drones is the norm of their offset times this."""
        across, upward = 0.5 / self.radius, 0.5 / self.height
        return np.array([across, across, upward])


@dataclass(frozen=True, eq=False)
class Arena:
    """The box that the drones stay in.

    Parameters
    ----------
    lower, upper: opposite corners (3,) [m]
    """

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]

    def __init__(
        self, lower: Sequence[float] | ArrayLike, upper: Sequence[float] | ArrayLike
    ) -> None:
        for name, corner in (("lower", lower), ("upper", upper)):
            try:
                given = list(corner)  # type: ignore[arg-type]
            except TypeError:
                given = []
            if len(given) != 3:
                raise InputError(name, corner, "a point [x, y, z]", "give three numbers in metres")
            point = np.array([finite(f"{name}[{i}]", x) for i, x in enumerate(given)])
            point.setflags(write=False)
            object.__setattr__(self, name, point)
        if not np.all(self.lower < self.upper):
            raise InputError(
                "upper",
                self.upper.tolist(),
                f"greater than lower {self.lower.tolist()} on every axis",
                "exchange the corners or move them apart",
            )


def floor_of(arena: Arena | None) -> float:
    """Return the height of the ground [m]: the arena's floor, or 0 where there is none."""
    return 0.0 if arena is None else float(arena.lower[2])
