"""A team of single quadrotors, without cables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError
from hitchopt.hitch.layout import CLOSED
from hitchopt.hitch.team import MAX_ROBOTS, Quadrotor, Team, kinds_of

MAX_DRONES = 2 * MAX_ROBOTS
"""Largest number of drones, checked before any memory is allocated."""


@dataclass(frozen=True, eq=False)
class Swarm(Team):
    """N single quadrotors: a team without cables, so that every array over robots is empty.

    Parameters
    ----------
    drones: their number N.
    quadrotor: one kind for all, or one per drone.

    Raises
    ------
    InputError: a count that is wrong in itself.
    """

    def __init__(
        self, drones: int, *, quadrotor: Quadrotor | Sequence[Quadrotor] | None = None
    ) -> None:
        if isinstance(drones, bool) or not isinstance(drones, int | np.integer):
            raise InputError("drones", drones, "a whole number", "count the drones")
        if not 1 <= drones <= MAX_DRONES:
            raise InputError("drones", drones, f"from 1 to {MAX_DRONES}", "split the swarm")
        none = np.zeros(0)
        none.setflags(write=False)
        values: dict[str, object] = {
            "robots": 0,
            "cable_length": none,
            "topology": CLOSED,
            "cable_density": 0.0,
            "cable_friction": 0.0,
            "tension": none,
            "quadrotor": kinds_of(quadrotor, int(drones), "drone"),
            "load": none,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def drones(self) -> int:
        """Number N of drones."""
        return len(self.quadrotor)

    def _per_drone(self, values: Sequence[float]) -> NDArray[np.float64]:
        """Return one value per drone; each drone has a kind of its own."""
        return np.array(values, dtype=np.float64)

    @property
    def drone_names(self) -> tuple[str, ...]:
        """(N,): d0, d1, …."""
        return tuple(f"d{i}" for i in range(self.drones))
