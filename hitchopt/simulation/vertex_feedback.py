"""Feedback in a simulated flight: vertices measured with noise and delay, setpoints corrected."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from hitchopt.errors import InputError
from hitchopt.feedback.feedback import Feedback
from hitchopt.simulation.clasp_contacts import ClaspContacts
from hitchopt.simulation.disturbances import Disturbances
from hitchopt.simulation.flight_task import Setpoints, Task
from hitchopt.simulation.mujoco_world import World
from hitchopt.simulation.simulation_settings import Settings
from hitchopt.values import Array

MEASURED = 0.01
"""[s] Period of the measurements."""

ROUNDING = 1e-9
"""[s] Rounding of sums of periods."""


class VertexFeedback:
    """The feedback of a flight, with the vertices that it is told.

    Parameters
    ----------
    task, settings, world, disturbances: of the flight.
    stiffness: (2n,) of the drones' position loops [N/m].

    Raises
    ------
    InputError: a task without its plan.
    """

    def __init__(
        self,
        task: Task,
        settings: Settings,
        world: World,
        disturbances: Disturbances,
        stiffness: Array,
    ) -> None:
        if task.motion is None:
            raise InputError("feedback", True, "with a plan", "give the plan's directory")
        self._delay = settings.perturbations.vertex_delay
        self._feedback = Feedback(task.motion, delay=self._delay, stiffness=stiffness)
        self._start = float(task.t[0])
        self._contacts = ClaspContacts(world, task.team)
        self._disturbances = disturbances
        self._waiting: deque[tuple[float, Array]] = deque()
        self._measured = 0.0

    @property
    def offsets(self) -> Array:
        """(2n, 3) [m]: corrections of the setpoints in force."""
        return self._feedback.offsets

    def corrected(
        self, setpoints: Setpoints, time: float, seconds: float, drones: Array
    ) -> Setpoints:
        """Return the setpoints with the corrections at a time [s] of the flight.

        Parameters
        ----------
        seconds: since the last call.
        drones: as they are measured (2n, 3) [m].
        """
        told = None
        while self._waiting and self._waiting[0][0] <= time - self._delay + ROUNDING:
            told = self._waiting.popleft()
        given = (None, None) if told is None else (told[1], self._start + told[0])
        plan_time = self._start + time
        self._feedback.step(plan_time, seconds, given[0], drones, measured=given[1])
        return replace(
            setpoints,
            positions=setpoints.positions + self._feedback.offsets,
            velocities=setpoints.velocities + self._feedback.velocities,
        )

    def observe(self, time: float, least_bearing: Array) -> None:
        """Measure the vertices, where it is time to, after a step until a time [s]."""
        self._contacts.gather()
        if time - self._measured < MEASURED - ROUNDING:
            return
        self._measured = time
        vertices, _ = self._contacts.collect(least_bearing)
        self._waiting.append((time, self._disturbances.measured(vertices)))
