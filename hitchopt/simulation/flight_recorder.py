"""Recording of samples, cable shapes and contacts during a flight."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.simulation.clasp_contacts import ClaspContacts
from hitchopt.simulation.drone_contacts import touching
from hitchopt.simulation.drone_motors import Motors
from hitchopt.simulation.flight_records import Film, Record, Touch
from hitchopt.simulation.flight_task import Task
from hitchopt.simulation.mujoco_world import World
from hitchopt.simulation.object_contacts import ObjectContacts
from hitchopt.simulation.object_wires import wires
from hitchopt.simulation.validity import tensions
from hitchopt.values import Array

FRAME_PERIOD = 0.04
"""Time between two recorded shapes of the cables [s]."""

TOUCH_PERIOD = 0.02
"""Time between two searches for contacts of drones [s]."""

ROUNDING = 1e-9
"""Rounding of sums of periods [s]."""


class Recorder:
    """Recorder of samples on request, and of shapes, peaks and contacts in between.

    Parameters
    ----------
    world: simulated world.
    task: drones, cables and objects.
    motors: motors of the drones.
    """

    def __init__(self, world: World, task: Task, motors: Motors) -> None:
        self._world, self._motors, team = world, motors, task.team
        self._contacts = ClaspContacts(world, team)
        self._objects = ObjectContacts(world, task.cargo)
        self._starts = np.searchsorted(world.edge_cables, np.arange(team.robots))
        self._peaks: Array = np.zeros(team.robots)
        self._searched = self._framed = -np.inf
        self._rows: list[tuple[NDArray[np.float64] | NDArray[np.bool_], ...]] = []
        self._frames: list[tuple[float, NDArray[np.float32], NDArray[np.float32]]] = []
        self._touches: dict[tuple[str, str], Touch] = {}

    def observe(self, time: float, index: int) -> None:
        """Update peaks, contacts and shapes after a step.

        Parameters
        ----------
        time: [s]
        index: sample of the task that applies.
        """
        world = self._world
        self._contacts.gather()
        largest = np.maximum.reduceat(tensions(world), self._starts)
        np.maximum(self._peaks, largest, out=self._peaks)
        if time >= 0.0 and time - self._searched >= TOUCH_PERIOD - ROUNDING:
            self._searched = time
            for pair in (*touching(world), *self._objects.wrong(index)):
                self._touches.setdefault(pair, Touch(time, *pair))
        if time - self._framed >= FRAME_PERIOD - ROUNDING:
            self._framed = time
            state = (world.nodes.astype(np.float32), world.poses.astype(np.float32))
            self._frames.append((time, *state))

    def clear(self) -> None:
        """Discard what was gathered since the last sample."""
        self._contacts.collect()
        self._peaks[:] = 0.0

    def sample(self, time: float, commanded: Array, least_bearing: Array) -> None:
        """Add a row: the present state, and what was gathered since the last sample.

        Parameters
        ----------
        time: [s]
        commanded: commanded positions of the drones (2n, 3) [m].
        least_bearing: (clasps,) [N], the contact force from which on a clasp bears.
        """
        world, motors = self._world, self._motors
        contacts = self._contacts.collect(least_bearing)
        means = np.add.reduceat(tensions(world), self._starts) / world.ropes.segments
        state = (means, self._peaks.copy(), motors.thrusts.copy(), motors.saturated.copy())
        things = (world.poses, self._objects.cables)
        self._rows.append((np.array(time), world.drones, commanded, *contacts, *state, *things))
        self._peaks[:] = 0.0

    @property
    def record(self) -> Record:
        """Record of all samples so far, at least one."""
        columns = [np.array(column) for column in zip(*self._rows, strict=True)]
        return Record(*columns)

    @property
    def empty(self) -> bool:
        """Whether there is no sample yet."""
        return not self._rows

    @property
    def film(self) -> Film:
        """Film of all shapes so far."""
        return Film(
            np.array([frame[0] for frame in self._frames]),
            np.array([frame[1] for frame in self._frames], dtype=np.float32),
            self._world.cable_vertices,
            np.array([frame[2] for frame in self._frames], dtype=np.float32),
            wires(self._world.objects),
        )

    @property
    def touches(self) -> tuple[Touch, ...]:
        """First contacts so far, by time."""
        return tuple(self._touches.values())
