"""The drones of simulated flights: controllers, filters, motors, delays and disturbances.

What moves them, ropes or clasps that slide, is a world with drones at the ends of its cables.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from hitchopt.drones.controllers import EstimatorParameters, FlightController
from hitchopt.errors import InfeasibleError, UnsupportedError
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import GRAVITY
from hitchopt.lab.simulation import control
from hitchopt.lab.simulation.autopilots import PERIOD, Autopilots
from hitchopt.lab.simulation.commands import flown_team, received
from hitchopt.lab.simulation.estimator import LATENCY, Estimator, frame_age
from hitchopt.lab.simulation.settings import IDEAL, Settings
from hitchopt.lab.simulation.task import RATE, Commands, Crew, Task
from hitchopt.lab.simulation.world import Airframes, RigidBodies
from hitchopt.motion.states import States
from hitchopt.values import Array

CONTROL_PERIOD = 0.005  # [s] Period of the simplified controller
ROUNDING = 1e-9  # [s] Rounding error of sums of periods

REPEATED = ("positions", "velocities", "accelerations", "jerks", "cable_forces")
"""Fields of setpoints that controllers receive."""


class Wrenches(NamedTuple):
    """What drones and air apply to the drones' bodies."""

    thrusts: Array  # (drones,) [N]
    moments: Array  # (drones, 3) [N m], about the bodies' axes
    forces: Array  # (drones, 3) [N], of wind, downwash and pull tests


def control_period(settings: Settings) -> float:
    """Return the period [s] at which the controllers of settings run."""
    return CONTROL_PERIOD if settings.controller == IDEAL else PERIOD


class Fleet:
    """The drones of flights of one task, each with disturbances of its own.

    Arrays have the drones of all flights, flight after flight. Flights start at the task's sample
    ``first``, before which drones hover there. Uploads that exports refuse are streamed if the
    upload is not stated, ``may_stream``. Raises InputError for an unstable position loop.

    Attributes
    ----------
    settings: resolved ones.
    gains: of the position loops.
    files: what an export of the plan would contain, in words; empty if streamed.
    """

    def __init__(
        self,
        task: Task,
        settings: Settings,
        disturbances: control.Disturbances,
        airframes: Airframes,
        bodies: RigidBodies,
        period: float,
        *,
        may_stream: bool,
        flights: int = 1,
        first: int = 0,
    ) -> None:
        self._task, self._flights, self._first = task, flights, first
        self._period, self._disturbances = period, disturbances
        self.settings, self.files = settings, ""
        self._commands: Commands
        self._pilots = self._controllers(airframes, bodies, may_stream=may_stream)
        self.gains = self._pilots.gains
        own = self.gains.of_drones(slice(task.team.drones))
        models = control.FlownDrones.of(task, self.settings, own.stiffness)
        self._setpoints = _setpoints(task, self.settings, models.trims)
        self._models = models.repeated(flights)
        self._outward_pulls = _outward_pulls(task)
        self._current = first, self._repeated(self._setpoints[first])
        resting = self._setpoints[first : first + 1].ending_at_rest()[0]
        self._resting = self._repeated(resting)
        # Samples of the commands and of the plan that were sent last; None before the flight
        self._source_of_sent: tuple[int, int] | None = None

    @property
    def thrusts(self) -> Array:
        """Current thrusts (drones,) [N]."""
        return self._pilots.thrusts

    def end_at(self, index: int, task: Task) -> None:
        """Hold the setpoint of a sample, at which the plan ends with ``task``."""
        accelerations = self._task.states.accelerations[index]
        self._task = task
        self._setpoints = self._setpoints[: index + 1].ending_at_rest()
        self._current, self._source_of_sent = (index, self._repeated(self._setpoints[index])), None
        if isinstance(self._pilots, Autopilots):
            self._commands = self._commands.until(index, accelerations)

    def advance(
        self,
        time: float,
        index: int,
        actual: RigidBodies,
        pull: Array | None = None,
        offset: Array | None = None,
    ) -> Wrenches:
        """Return what acts on the drones in the next period, from their ``actual`` state.

        Drones follow the setpoint of a sample. With an ``offset`` (drones, 3) [m] they rest there,
        before the flight. ``pull`` (drones,) is a factor of the plan's tension: less than 1 while
        a hitch is tightened, more than 1 in the pull test, in which drones add the force; None is
        1.
        """
        disturbances, models, period = self._disturbances, self._models, self._period
        if index != self._current[0]:
            self._current = index, self._repeated(self._setpoints[index])
        setpoints = self._current[1]
        if offset is not None:
            positions = self._repeat(self._task.states.positions[index]) + offset + models.trims
            setpoints = replace(self._resting, positions=positions)
        bodies = models.measured(actual)
        if self.settings.estimator is None:
            measured = bodies.positions + disturbances.noise.advance(period)
            velocities = bodies.velocities + disturbances.velocity_noise.advance(period)
            bodies = replace(bodies, positions=measured, velocities=velocities)
        push = disturbances.wind.advance(period) + disturbances.steady_wind
        if models.drag:
            push -= models.drag * actual.velocities
        added = None if pull is None else self._added_pulls(index, pull)
        self._command(time, index, setpoints, bodies, added)
        if added is not None and not isinstance(self._pilots, control.Pilots):
            push += added
        if self.settings.perturbations.downwash:
            push += self._downwash(index, actual.positions)
        thrusts, moments = models.actual(self._pilots.thrusts, self._pilots.moments)
        return Wrenches(thrusts, moments, push)

    def _repeat(self, values: Array) -> Array:
        """Return values of a flight's drones (2n, …) for those of all flights."""
        return values if self._flights == 1 else np.concatenate([values] * self._flights)

    def _repeated(self, setpoints: States) -> States:
        """Return the setpoints of a flight for the drones of all flights."""
        if self._flights == 1:
            return setpoints
        each: Any = {name: self._repeat(getattr(setpoints, name)) for name in REPEATED}
        return replace(setpoints, **each)

    def _controllers(
        self, airframes: Airframes, bodies: RigidBodies, *, may_stream: bool
    ) -> control.Pilots | Autopilots:
        """Return the drones' controllers, and store the commands of flight controllers."""
        task, settings = self._task, self.settings
        team = task.team
        if self._flights > 1:
            team = Crew([(str(flight), team) for flight in range(self._flights)])
        if settings.controller == IDEAL:
            return control.Pilots(airframes, team, settings)
        estimator, self._command_delay = None, 0.0
        loops = [*self._receive(may_stream=may_stream)] * self._flights
        settings = self.settings
        if isinstance(settings.estimator, EstimatorParameters):
            stated = [kind.latency or 0.0 for part in task.teams for kind in part.team.quadrotor]
            latency = max(stated) if settings.latency is None else settings.latency
            age = frame_age(latency) if latency else LATENCY
            self._command_delay = 0.0 if settings.upload else latency or LATENCY
            measuring = self._disturbances.sensor_random
            estimator = Estimator(settings.estimator, bodies, measuring, round(age / PERIOD))
        masses, inertia = airframes.masses, airframes.inertia
        return Autopilots(loops, masses, inertia, team.max_thrust, settings.lag, estimator)

    def _receive(self, *, may_stream: bool) -> Sequence[FlightController]:
        """Store the commands of flight controllers, from files or the plan; return their loops."""
        task, settings = self._task, self.settings
        teams = [flown_team(part.team, settings) for part in task.teams]
        loops = [kind.loop for team in teams for kind in team.kinds]
        if (files := task.received) is not None:
            self._commands = files.commands
            return files.loops or loops
        pairs = [*zip(task.teams, teams, strict=True)]
        try:
            each = [received(part, team, settings) for part, team in pairs]
        except (InfeasibleError, UnsupportedError):
            if not may_stream:
                raise
            self.settings = replace(settings, upload=False)
            each = [received(part, team, self.settings) for part, team in pairs]
        self._commands = Commands.joined(each)
        self.files = self._commands.files
        return loops

    def _hovering(self) -> Commands:
        """Return the first commands as drones hold them before the flight, at rest."""
        first = self._first
        return self._commands.until(first, self._task.states.accelerations[first])[first]

    def _added_pulls(self, index: int, pull: Array) -> Array:
        """Return the force (drones, 3) [N] that drones add to the plan's, by factors of tension."""
        pulling = self.gains.feed_forward | (pull > 1.0)
        return ((pull - 1.0) * pulling)[:, None] * self._repeat(self._outward_pulls[index])

    def _downwash(self, index: int, positions: Array) -> Array:
        """Return the downwash (drones, 3) [N] of each flight's drones, and of drones that pass."""
        flights, passing = self._flights, self._task.passing
        drones = positions.reshape(flights, -1, 3)
        thrusts = self._pilots.thrusts.reshape(flights, -1)
        count = drones.shape[1]
        if passing.names:
            others = np.repeat(passing.at(index)[None], flights, axis=0)
            drones = np.concatenate([drones, others], axis=1)
            weights = np.repeat(GRAVITY * passing.masses[None], flights, axis=0)
            thrusts = np.concatenate([thrusts, weights], axis=1)
        return control.downwash(drones, thrusts)[:, :count].reshape(-1, 3)

    def _command(
        self, time: float, index: int, setpoints: States, bodies: RigidBodies, added: Array | None
    ) -> None:
        """Run controllers and motors for a period.

        Setpoints are those of a sample, or of drones that rest before the flight. Simplified
        controllers pull with ``added`` (drones, 3) [N] in addition.
        """
        if isinstance(self._pilots, control.Pilots):
            self._command_simplified(self._pilots, time, setpoints, bodies, added)
            return
        before_flight = self._first - 1
        delayed = math.floor(RATE * (time - self._command_delay) + ROUNDING)
        sample = max(before_flight, delayed)
        follows_plan = setpoints is self._current[1]  # Else drones rest at offsets that may change
        source = (sample, index) if follows_plan else None
        if source is None or source != self._source_of_sent:
            self._source_of_sent = source
            commands = self._hovering() if sample == before_flight else self._commands[sample]
            self._sent = self._shifted(commands, setpoints, index)
        self._pilots.advance(self._sent, bodies, self._period)

    def _command_simplified(
        self,
        pilots: control.Pilots,
        time: float,
        setpoints: States,
        bodies: RigidBodies,
        added: Array | None,
    ) -> None:
        """Run simplified controllers for a period; they integrate errors during the flight only."""
        pilots.command(setpoints, bodies, self._period, 0.0 if added is None else added)
        start = self._first / RATE
        if time >= start:
            pilots.integrate(setpoints.positions - bodies.positions, self._period)

    def _shifted(self, commands: Commands, setpoints: States, index: int) -> Commands:
        """Return commands with the differences of setpoints from those of the plan."""
        plan, repeat = self._task.states, self._repeat
        return Commands(
            repeat(commands.positions) + (setpoints.positions - repeat(plan.positions[index])),
            repeat(commands.velocities) + (setpoints.velocities - repeat(plan.velocities[index])),
            repeat(commands.accelerations),
            repeat(commands.rates),
        )


def _setpoints(task: Task, settings: Settings, trims: Array) -> States:
    """Return the setpoints of simplified controllers, with the drones' trims (2n, 3) [m].

    Accelerations that files hold include the forces of cables.
    """
    states, files = task.states, task.received
    if files is None or settings.controller != IDEAL:
        return replace(states, positions=states.positions + trims)
    sent, none = files.commands, np.zeros_like(states.positions)
    return replace(
        states,
        positions=sent.positions + trims,
        velocities=sent.velocities,
        accelerations=sent.accelerations,
        jerks=none,
        cable_forces=none,
    )


def _outward_pulls(task: Task) -> Array:
    """Return outward tensions along the legs, horizontal with objects (samples, 2n, 3) [N]."""
    states, cargo = task.states, task.cargo
    legs = states.positions - states.vertices[:, task.team.layout.pulled_to]
    pulls: Array = np.repeat(states.tensions, 2, axis=1)[..., None] * unit(legs)
    if cargo.objects:
        pulls[np.any(cargo.load_share > 0.0, axis=1), :, 2] = 0.0
    return pulls
