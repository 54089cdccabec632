"""The separation planner's task, and its result."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InputError
from hitchopt.hitch.requirements import Requirements
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, per_robot, positive


@dataclass(frozen=True)
class Tether:
    """An upper bound of the distance of two drones that hold one cable.

    Parameters
    ----------
    first, second: indices of the two drones.
    longest: largest distance between them [m]
    """

    first: int
    second: int
    longest: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "longest", positive("longest", self.longest))
        if self.first == self.second:
            raise InputError("second", self.second, "another drone", "a cable has two ends")


@dataclass(frozen=True, eq=False)
class SeparationTask:
    """The task of N drones that fly from rest to rest outside of each other's downwash.

    Parameters
    ----------
    start, goal: (N, 3) [m]
    requirements: speed, acceleration and jerk of every drone, the ellipsoids, the arena and the
        prisms that drones stay out of by ``separation.radius``; the rest is not used.
    tethers: pairs of drones with a largest distance.
    duration: exact duration [s], or None for the shortest that is found.
    acceleration: (N,) [m/s²]: what each drone can do, where that is less than the limit (thrust,
        tilt), or None.
    names: of the drones, for messages; none given: d0, d1, ….
    prisms: names of the prisms, for messages; none given: prism 0, prism 1, ….

    Raises
    ------
    InputError: shapes that do not fit, numbers that are not finite, indices out of range.
    """

    start: Array
    goal: Array
    requirements: Requirements
    tethers: tuple[Tether, ...] = ()
    duration: float | None = None
    acceleration: ArrayLike | None = None
    names: tuple[str, ...] = ()
    prisms: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("start", "goal"):
            points = np.array(getattr(self, name), dtype=np.float64)
            if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
                raise InputError(name, points.shape, "(N, 3)", "give one point per drone")
            if not np.all(np.isfinite(points)):
                raise InputError(name, "nan or inf", "finite", "give metres")
            points.setflags(write=False)
            object.__setattr__(self, name, points)
        n = len(self.start)
        if len(self.goal) != n:
            raise InputError("goal", len(self.goal), f"{n} points, as start", "one per drone")
        if self.duration is not None:
            object.__setattr__(self, "duration", positive("duration", self.duration))
        if self.acceleration is not None:
            array = per_robot("acceleration", self.acceleration, n)
            object.__setattr__(self, "acceleration", array)
        object.__setattr__(self, "tethers", tuple(self.tethers))
        for k, tether in enumerate(self.tethers):
            for end in (tether.first, tether.second):
                if not 0 <= end < n:
                    raise InputError(f"tethers[{k}]", end, f"0 … {n - 1}", "name a drone")
        names = tuple(self.names) or tuple(f"d{i}" for i in range(n))
        if len(names) != n:
            raise InputError("names", names, f"{n} names", "one per drone")
        object.__setattr__(self, "names", names)
        count = len(self.requirements.keep_out)
        prisms = tuple(self.prisms) or tuple(f"prism {k}" for k in range(count))
        if len(prisms) != count:
            raise InputError("prisms", prisms, f"{count} names", "one per prism")
        object.__setattr__(self, "prisms", prisms)

    @property
    def drones(self) -> int:
        """Number N of drones."""
        return len(self.start)

    @property
    def tether_arrays(self) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
        """First drones, second drones and largest distances [m] of all tethers, (tethers,) each."""
        ends = np.array([[t.first, t.second] for t in self.tethers], np.intp).reshape(-1, 2)
        return ends[:, 0], ends[:, 1], np.array([t.longest for t in self.tethers])


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
