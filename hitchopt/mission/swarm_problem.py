"""A problem of single drones: who flies from where to where, checked in shape, not yet planned."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hitchopt.errors import InputError
from hitchopt.hitch import Swarm
from hitchopt.requirements import Arena, Limits, Prism, Requirements, Separation
from hitchopt.values import MAX_COORDINATE, Array, positive


@dataclass(frozen=True, eq=False)
class SwarmProblem:
    """All that the separation planner needs to know.

    Parameters
    ----------
    team: who.
    start, goal: (N, 3) [m]
    limits, separation, arena, keep_out, title: what to keep, and what to call it.
    duration: of the flight, exactly [s], or None: as fast as is found.

    Raises
    ------
    InputError: not one point per drone, or a point that is not finite.
    """

    team: Swarm
    start: Array
    goal: Array
    limits: Limits = field(default_factory=Limits)
    separation: Separation = field(default_factory=Separation)
    arena: Arena | None = None
    keep_out: tuple[Prism, ...] = ()
    duration: float | None = None
    title: str = ""

    @property
    def requirements(self) -> Requirements:
        """What the plan must satisfy."""
        return Requirements(self.limits, self.separation, self.arena, self.keep_out)

    def __post_init__(self) -> None:
        for name in ("start", "goal"):
            object.__setattr__(self, name, _points(name, getattr(self, name), self.team.drones))
        object.__setattr__(self, "keep_out", tuple(self.keep_out))
        if self.duration is not None:
            object.__setattr__(self, "duration", positive("duration", self.duration))


def _points(name: str, value: object, drones: int) -> Array:
    try:
        points = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        points = np.zeros(0)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(name, value, "a list of points [x, y, z]", "give three numbers per drone")
    if len(points) != drones:
        raise InputError(
            name,
            f"{len(points)} points",
            f"{drones} points, one per drone",
            "add or remove points, or change team.drones",
        )
    bad = ~np.all(np.abs(points) <= MAX_COORDINATE, axis=1)  # also catches nan
    if np.any(bad):
        k = int(np.argmax(bad))
        bound = f"finite and within ±{MAX_COORDINATE:g} m"
        raise InputError(f"{name}[{k}]", points[k].tolist(), bound, "check its coordinates")
    points.setflags(write=False)
    return points
