"""The separation planner's task, and its result."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InputError
from hitchopt.hitch.requirements import Requirements
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, Indices, positive


@dataclass(frozen=True, eq=False)
class SeparationTask:
    """The task of N drones that fly from rest to rest outside of each other's downwash.

    Parameters
    ----------
    start, goal: (N, 3) [m]
    requirements: speed, acceleration and jerk of every drone, the ellipsoids, the arena and the
        prisms that drones stay out of by ``separation.radius``; the rest is not used.
    tethers: pairs of drones that hold one cable, and their largest distance [m].
    duration: exact duration [s], or None for the shortest that is found.
    acceleration: (N,) [m/s²]: what each drone can do, where that is less than the limit (thrust,
        tilt), or None.
    names: of the drones, for messages; none given: d0, d1, ….
    prisms: names of the prisms, for messages; none given: prism 0, prism 1, ….

    Raises
    ------
    InputError: places or counts that do not fit, numbers that are not finite.
    """

    start: Array
    goal: Array
    requirements: Requirements
    tethers: tuple[tuple[int, int, float], ...] = ()
    duration: float | None = None
    acceleration: ArrayLike | None = None
    names: tuple[str, ...] = ()
    prisms: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("start", "goal"):
            points = np.array(getattr(self, name), dtype=np.float64)
            if points.ndim != 2 or points.shape[1] != 3 or not np.all(np.isfinite(points)):
                raise InputError(name, points.shape, "(N, 3), finite", "give metres")
            points.setflags(write=False)
            object.__setattr__(self, name, points)
        n, count = len(self.start), len(self.requirements.keep_out)
        object.__setattr__(self, "names", self.names or tuple(f"d{i}" for i in range(n)))
        object.__setattr__(self, "prisms", self.prisms or tuple(f"prism {k}" for k in range(count)))
        for name, number in (("goal", n), ("names", n), ("prisms", count)):
            if len(getattr(self, name)) != number:
                raise InputError(name, len(getattr(self, name)), str(number), "one for each")
        if self.duration is not None:
            positive("duration", self.duration)

    @property
    def drones(self) -> int:
        """Number N of drones."""
        return len(self.start)

    @property
    def tether_arrays(self) -> tuple[Indices, Indices, Array]:
        """First drones, second drones and largest distances [m] of all tethers, (tethers,) each."""
        first, second, longest = np.array(self.tethers, dtype=np.float64).reshape(-1, 3).T
        return first.astype(np.intp), second.astype(np.intp), longest


@dataclass(frozen=True, eq=False)
class Separated:
    """Curves that satisfy their task at every time, by bounds in continuous time.

    Attributes
    ----------
    drones: of shape (N, 3) [m], from start to goal, at rest (velocity and acceleration zero) at
        both ends; position, velocity and acceleration are continuous to 1e-9 or better.
    closest: no two drones' separation is smaller at any time (ratio).
    bound: no flight of these drones, even alone, takes less [s].
    remark: the priority rule that led to it.
    """

    drones: PiecewisePolynomial
    closest: float
    bound: float
    remark: str
