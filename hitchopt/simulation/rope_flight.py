"""The simulated flight: settle, fly the setpoints, rest, and pull at the hitch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import ceil

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError
from hitchopt.geometry.vectors import unit
from hitchopt.objects.placing import TOUCH
from hitchopt.simulation.air_forces import downwash, drag
from hitchopt.simulation.cable_shapes import clasped, hanging
from hitchopt.simulation.clasp_contacts import least_bearing
from hitchopt.simulation.disturbances import Disturbances
from hitchopt.simulation.drone_control import PositionGains, desired_thrusts
from hitchopt.simulation.drone_motors import Motors
from hitchopt.simulation.flight_recorder import Recorder
from hitchopt.simulation.flight_records import Flight
from hitchopt.simulation.flight_task import Task
from hitchopt.simulation.hung_loads import HungLoads
from hitchopt.simulation.linking_numbers import linking_matrix
from hitchopt.simulation.mujoco_world import World
from hitchopt.simulation.mujoco_xml import BODY_HALF_HEIGHT
from hitchopt.simulation.rope_thickness import thickness_allowance
from hitchopt.simulation.ropes import ropes_of
from hitchopt.simulation.simulation_settings import Loss, Settings
from hitchopt.simulation.validity import InvalidRunError, check_valid, tensions
from hitchopt.simulation.vertex_feedback import VertexFeedback
from hitchopt.values import Array

Progress = Callable[[str], None]
"""Called repeatedly with a description of the current work."""

CONTROL = 0.005
"""Period of the controller [s], rounded to whole time steps."""

SETTLE = 2.5
"""Time before the flight in which cables are drawn tight, or come to rest [s]."""

DRAWN = 1.5
"""Part of SETTLE in which drones move from the positions of loose cables to the first setpoint, and
the cables' tension grows to its value [s]: drawn at once, loose clasps would tear."""

DAMPING = 40.0
"""Rate at which cables lose speed when they begin to settle [1/s]: falling freely until they are
taut, they would whip. In the flight only air slows them."""

TIGHT = 0.25
"""Tension over the team's from which on ropes do not whip."""

REST = 1.0
"""Time after the flight, before anything is judged [s]."""

PULL, PULLED = 1.5, 2.0
"""Pull test: tension over the plan's, and duration [s]; the tension grows in half of it."""

RESTING_SAMPLE = 0.01
"""Time between samples after the last setpoint [s]."""

REPORT_PERIOD = 50
"""Setpoints between two calls of ``progress``."""

FALLING, FALLING_STEP, FALLING_PARTS = 2.5, 0.00034, 3
"""[s] Time after the loss of a drone in which steps are at most so long, and that part of the
preset's: ropes slide fast over each other at its clasp, and strain by more than 2 % there else."""

REST_HEIGHT = BODY_HALF_HEIGHT + 0.005
"""Height of the centre of a drone on the ground [m]."""


def fly(task: Task, settings: Settings, progress: Progress | None = None) -> Flight:
    """Return the flight of a task's setpoints, with the error that ended it early, if any.

    It begins with a hitch where the plan has one at the first setpoint, else with hanging cables.
    The plan's hitch also defines the correction of ``rope_thickness``, whose size the flight
    states. Drones know their setpoints alone: the ropes' weight is not fed forward unless the
    setpoints' cable forces hold it.

    Parameters
    ----------
    task: setpoints and planned hitch.
    settings: settings of the simulation.
    progress: called repeatedly with a description of the current work.

    Raises
    ------
    InputError: a preset that cannot bear the team's tension, or an unstable position loop.
    ShapeError: cables that cannot hang between the first setpoints.
    UnsupportedError: mujoco is not installed.
    """
    run = _Run(task, settings, progress)
    try:
        run.fly()
    except InvalidRunError as error:
        return run.flight(error)
    return run.flight(None)


class _Run:
    """A flight in progress.

    Parameters
    ----------
    task, settings, progress: see ``fly``.
    """

    def __init__(self, task: Task, settings: Settings, progress: Progress | None) -> None:
        team, preset = task.team, settings.preset
        self._task, self._settings, self._progress = task, settings, progress
        self._disturbances = Disturbances(settings.perturbations, team.robots, settings.seed)
        self._setpoints = task.setpoints
        allowance = thickness_allowance(task, preset.diameter, preset.segment)
        lengths = team.cable_length * self._disturbances.cable_scale + allowance
        ropes = ropes_of(team, settings, lengths)
        ropes.check_tension(float(np.max(task.tensions)))
        ground = settings.ground
        if ground is None:  # at 0, or such that even the lowest drone stands above it
            lowest = float(np.min(self._setpoints.positions[..., 2])) - REST_HEIGHT
            ground = task.cargo.floor if task.cargo.objects else min(0.0, lowest)
        elif task.cargo.objects and abs(ground - task.cargo.floor) > TOUCH:
            bound = f"{task.cargo.floor:g}, on which objects stand"
            raise InputError("ground", ground, bound, "leave it out")
        objects = self._disturbances.disturbed(task.cargo.objects)
        rigid = settings.body == "rigid"
        world = World(ropes, team.mass, rigid=rigid, ground=ground, objects=objects)
        start = self._setpoints.positions[0] + self._disturbances.start_offset
        if task.formed[0]:
            world.place(clasped(ropes, team.layout, start, task.vertices[0]))
        else:
            world.place(hanging(ropes, start, ground))
        self._world = world
        self._motors = Motors(world, team.max_thrust, settings.lag)
        self._loads = HungLoads(world, team) if np.any(team.load) else None
        self._recorder = Recorder(world, task, self._motors)
        self._least_bearing = least_bearing(task)
        self._gains = PositionGains.of(team, settings)
        self._feedback = None
        if settings.feedback:
            parts = (task, settings, world, self._disturbances, self._gains.stiffness)
            self._feedback = VertexFeedback(*parts)
        self._wound = np.zeros_like(start)
        self._longer = float(np.max(allowance))
        self._substeps = max(1, round(CONTROL / ropes.preset.time_step))
        self._period = self._substeps * ropes.preset.time_step
        self._damping = 0.0
        self._lost = _place_of(settings.lost, task)
        least = ceil(ropes.preset.time_step / FALLING_STEP - 1e-9)
        self._fine = max(least, FALLING_PARTS)
        self._linking: NDArray[np.int64] | None = None
        self._rested = self._pulled = float("nan")

    def fly(self) -> None:
        """Simulate all of it.

        Raises
        ------
        InvalidRunError: the simulation left its valid range.
        """
        task, world = self._task, self._world
        end, last = task.duration, len(task.t) - 1
        formed = task.formed[0]
        loose = world.drones - self._setpoints.positions[0] if formed else 0.0
        friction = world.model.flex_friction.copy()
        world.model.flex_friction[:] = 0.0  # such that the initial state has no history
        for time in self._times(-SETTLE, 0.0):
            drawn = min(1.0, (time + SETTLE) / DRAWN)
            share = drawn**3 * (10.0 - 15.0 * drawn + 6.0 * drawn**2)
            self._damping = DAMPING * (1.0 - share)
            self._step(time, 0, share if formed else 1.0, (1.0 - share) * loose)
        world.model.flex_friction[:] = friction
        self._recorder.clear()
        self._sample(0.0, 0)
        current = 0
        for time in self._times(0.0, end):
            index = task.index(time)
            if index != current:
                self._sample(time, current)
                current = index
                if self._progress is not None and index % REPORT_PERIOD == 0:
                    self._progress(f"flying, {time:.1f} of {end:.1f} s")
            self._step(time, index, 1.0)
        self._sample(end, last)
        self._rest(end, end + REST, 1.0)
        self._rested = end + REST
        self._linking = linking_matrix(world.cables)
        if self._settings.pull_test and self._settings.lost is None:
            self._rest(self._rested, self._rested + PULLED, PULL)
            self._pulled = self._rested + PULLED

    def _rest(self, begin: float, end: float, pull: float) -> None:
        """Hold the last setpoint, the tension growing to ``pull`` times its value half-way."""
        every, last = max(1, round(RESTING_SAMPLE / self._period)), len(self._task.t) - 1
        for step, time in enumerate(self._times(begin, end)):
            if step and step % every == 0:
                self._sample(time, last)
            grown = min(1.0, 2.0 * (time - begin) / (end - begin))
            self._step(time, last, 1.0 + (pull - 1.0) * grown)
        self._sample(end, last)

    def _times(self, begin: float, end: float) -> Array:
        """Return the times of the commands in [begin, end)."""
        count = max(0, round((end - begin) / self._period))
        times: Array = begin + self._period * np.arange(count, dtype=np.float64)
        return times

    def _step(self, time: float, index: int, pull: float, offset: Array | float = 0.0) -> None:
        """Command the drones and advance the world by one period.

        Parameters
        ----------
        time: [s]
        index: setpoint that applies.
        pull: factor of the plan's tension. Less than 1 reduces what is fed forward while a hitch is
            drawn tight; more than 1 is the force of the pull test, which every drone adds.
        offset: from the setpoint's positions (2n, 3) [m].
        """
        world, disturbances = self._world, self._disturbances
        fine = 1
        if self._lost is not None and time >= self._lost[1]:
            self._motors.stop(self._lost[0])
            fine = self._fine if time < self._lost[1] + FALLING else 1
        setpoints, gains = self._setpoints[index], self._gains
        setpoints = replace(setpoints, positions=setpoints.positions + offset)
        measured = world.drones + disturbances.noise.advance(self._period)
        velocities = world.data.qvel[world.drone_dofs]
        velocities = velocities + disturbances.velocity_noise.advance(self._period)
        if self._feedback is not None and time >= 0.0:
            setpoints = self._feedback.corrected(setpoints, time, self._period, measured)
        desired = desired_thrusts(setpoints, world.masses, gains, measured, velocities, self._wound)
        if pull != 1.0:
            pulling = gains.feed_forward | (pull > 1.0)
            desired += (pull - 1.0) * pulling[:, None] * self._outward_pulls(index)
        if time >= 0.0:
            error = setpoints.positions - measured
            self._wound += self._period * gains.integral[:, None] * error
        self._motors.apply(desired, setpoints, self._period)
        push = disturbances.wind.advance(self._period) + disturbances.steady_wind
        if self._settings.perturbations.downwash:
            push = push + downwash(world.drones, self._motors.thrusts)
        world.data.xfrc_applied[world.drone_bodies, :3] += push
        if self._loads is not None:
            shares = min(pull, 1.0) * self._task.load_shares(index)
            self._loads.apply(shares, self._period)
        world.data.qfrc_applied[world.node_dofs] = drag(world, self._damping)
        tight = TIGHT * self._task.team.tension
        loose = np.any(min(pull, 1.0) * self._task.tensions[index] < tight)
        loose = loose or np.mean(tensions(world)) < np.mean(tight)  # whatever the plan says
        world.step(self._substeps, loose=bool(loose), finer=fine)
        check_valid(world, time)
        if self._feedback is not None and time >= 0.0:
            self._feedback.observe(time + self._period, self._least_bearing[index])
        self._recorder.observe(time, index)

    def _outward_pulls(self, index: int) -> Array:
        """Return (2n, 3) [N]: the plan's tensions along the legs outward; zero without a hitch.

        Level ones while the hitch bears an object: with the others it would be lifted.
        """
        task = self._task
        legs = task.setpoints.positions[index] - task.vertices[index][task.team.layout.pulled_to]
        pulls: Array = np.repeat(task.tensions[index], 2)[:, None] * unit(legs)
        if task.cargo.objects and np.any(task.cargo.borne[index] > 0.0):
            pulls[:, 2] = 0.0
        return pulls

    def _sample(self, time: float, index: int) -> None:
        """Record a sample at ``time`` [s], at which setpoint ``index`` applies."""
        least = self._least_bearing[index]
        commanded = self._setpoints.positions[index]
        if self._feedback is not None:
            commanded = commanded + self._feedback.offsets
        self._recorder.sample(time, commanded, least)

    def flight(self, error: InvalidRunError | None) -> Flight:
        """Return the flight as far as it was simulated."""
        if self._recorder.empty:  # ended while it settled
            self._sample(0.0, 0)
        return Flight(
            self._task,
            self._recorder.record,
            self._recorder.film,
            self._recorder.touches,
            self._linking,
            self._rested,
            self._pulled,
            self._world.ropes.density,
            self._least_bearing[-1],
            self._gains,
            self._longer,
            error,
            self._world.ground,
            self._settings.lost,
            self._world.objects,
        )


def _place_of(lost: Loss | None, task: Task) -> tuple[int, float] | None:
    """Return the index of a lost drone and the time of its loss [s].

    Raises
    ------
    InputError: the team has no such drone, or the flight has ended by then.
    """
    if lost is None:
        return None
    names = task.team.drone_names
    if lost.drone not in names:
        raise InputError("--lose", lost.drone, f"one of {', '.join(names)}", "name a drone")
    if lost.time >= task.duration:
        bound = f"before the flight ends at {task.duration:g} s"
        raise InputError("--lose", lost.time, bound, "lose it in flight")
    return names.index(lost.drone), lost.time
