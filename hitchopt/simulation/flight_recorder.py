"""Takes notes while a flight goes on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import Team
from hitchopt.simulation.clasp_contacts import Bearing
from hitchopt.simulation.drone_contacts import touches
from hitchopt.simulation.drone_motors import Drones
from hitchopt.simulation.flight_records import Film, Record, TouchEvent
from hitchopt.simulation.mujoco_world import World
from hitchopt.simulation.validity import tensions

Array = NDArray[np.float64]

FRAME_PERIOD = 0.04
"""[s] Between two pictures of the cables."""

TOUCH_PERIOD = 0.02
"""[s] Between two looks at what touches."""

ROUNDING = 1e-9
"""[s] Of sums of periods."""


class Recorder:
    """Samples when it is told to, and pictures, peaks and touches in between.

    Parameters
    ----------
    world: of the flight.
    team: who flies.
    drones: their motors.
    """

    def __init__(self, world: World, team: Team, drones: Drones) -> None:
        self._world, self._drones = world, drones
        self._bearing = Bearing(world, team)
        self._starts = np.searchsorted(world.edge_cables, np.arange(team.robots))
        self._peaks: Array = np.zeros(team.robots)
        self._looked = self._pictured = -np.inf
        self._rows: list[tuple[NDArray[np.float64] | NDArray[np.bool_], ...]] = []
        self._frames: list[tuple[float, NDArray[np.float32]]] = []
        self._touches: dict[tuple[str, str], float] = {}

    def watch(self, time: float) -> None:
        """Look at the world after a step, at ``time`` [s]."""
        world = self._world
        self._bearing.gather()
        largest = np.maximum.reduceat(tensions(world), self._starts)
        np.maximum(self._peaks, largest, out=self._peaks)
        if time >= 0.0 and time - self._looked >= TOUCH_PERIOD - ROUNDING:
            self._looked = time
            for touch in touches(world):
                self._touches.setdefault((touch.first, touch.second), time)
        if time - self._pictured >= FRAME_PERIOD - ROUNDING:
            self._pictured = time
            self._frames.append((time, world.nodes.astype(np.float32)))

    def forget(self) -> None:
        """Begin anew with what is gathered between samples."""
        self._bearing.collect()
        self._peaks[:] = 0.0

    def sample(self, time: float, told: Array, least_bearing: Array | float) -> None:
        """Add a row: what is now, and what was gathered since the last one.

        Parameters
        ----------
        time: [s]
        told: (2n, 3) [m], where the drones were told to be.
        least_bearing: (clasps,) [N], the contact force from which on a clasp bears.
        """
        world = self._world
        vertices, bearing = self._bearing.collect(least_bearing)
        means = np.add.reduceat(tensions(world), self._starts) / world.ropes.segments
        self._rows.append(
            (
                np.array(time),
                world.drones,
                told,
                vertices,
                bearing,
                means,
                self._peaks.copy(),
                self._drones.thrusts.copy(),
                self._drones.saturated.copy(),
            )
        )
        self._peaks[:] = 0.0

    @property
    def record(self) -> Record:
        """All samples so far, at least one."""
        columns = [np.array(column) for column in zip(*self._rows, strict=True)]
        return Record(*columns)

    @property
    def empty(self) -> bool:
        """Whether there is no sample yet."""
        return not self._rows

    @property
    def film(self) -> Film:
        """All pictures so far."""
        return Film(
            np.array([time for time, _ in self._frames]),
            np.array([nodes for _, nodes in self._frames], dtype=np.float32),
            self._world.cable_vertices,
        )

    @property
    def events(self) -> tuple[TouchEvent, ...]:
        """First touches so far, in order."""
        return tuple(TouchEvent(time, *names) for names, time in self._touches.items())
