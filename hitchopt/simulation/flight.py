"""The simulated flight: settle, fly the setpoints, rest, and pull at the hitch; and its record."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError
from hitchopt.geometry.vectors import unit
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import TOUCH
from hitchopt.simulation.contacts import (
    ClaspContacts,
    HungLoads,
    ObjectContacts,
    least_bearing,
    touching,
)
from hitchopt.simulation.control import (
    Disturbances,
    Motors,
    PositionGains,
    VertexFeedback,
    desired_thrusts,
    downwash,
    drag,
)
from hitchopt.simulation.ropes import (
    clasped,
    hanging,
    linking_matrix,
    ropes_of,
    thickness_allowance,
)
from hitchopt.simulation.settings import Loss, Settings
from hitchopt.simulation.task import Task
from hitchopt.simulation.world import (
    BODY_HALF_HEIGHT,
    InvalidRunError,
    World,
    check_valid,
    tensions,
)
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

WHIPPING = 0.25
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

FRAME_PERIOD, TOUCH_PERIOD = 0.04, 0.02
"""Times between two recorded shapes of the cables, and between two searches for contacts [s]."""

ROUNDING = 1e-9
"""Rounding of sums of periods [s]."""


@dataclass(frozen=True, eq=False)
class Record:
    """Measurements, sample by sample; times count from the flight's start, after settling.

    Attributes
    ----------
    t: (samples,) [s], those of the setpoints, and of rest and pull test after them.
    drones: positions (samples, 2n, 3) [m].
    commanded: commanded positions (samples, 2n, 3) [m]: the setpoints.
    vertices: (samples, clasps, 3) [m], nan where cables do not bear on each other.
    bearing: contact forces (samples, clasps) [N].
    tensions: means over each cable's length (samples, n) [N].
    peak_tensions: largest values over length and time since the last sample (samples, n) [N].
    thrusts: (samples, 2n) [N]
    saturated: whether a drone's command exceeded its thrust (samples, 2n).
    poses: of the objects (samples, objects, 7): positions of their bases [m], and quaternions.
    touched: whether cables touch an object (samples, objects).
    """

    t: Array
    drones: Array
    commanded: Array
    vertices: Array
    bearing: Array
    tensions: Array
    peak_tensions: Array
    thrusts: Array
    saturated: NDArray[np.bool_]
    poses: Array
    touched: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Film:
    """Shapes of the cables over time; settling is included, at negative times.

    Attributes
    ----------
    t: (frames,) [s]
    nodes: (frames, nodes, 3) [m], cable after cable, drones at their ends.
    cables: (n + 1,), first node of each cable, and the number of nodes.
    poses: of the objects (frames, objects, 7): positions of their bases [m], and quaternions.
    """

    t: Array
    nodes: NDArray[np.float32]
    cables: NDArray[np.intp]
    poses: NDArray[np.float32]


@dataclass(frozen=True)
class Touch:
    """First contact of two things that should stay apart.

    Attributes
    ----------
    time: [s], from the flight's start.
    first, second: names, such as ``q0`` and ``r2``, or ``q0`` and ``cable 2``.
    """

    time: float
    first: str
    second: str


@dataclass(frozen=True, eq=False)
class Flight:
    """A flight that was simulated to its end, or until the simulation became invalid.

    Attributes
    ----------
    task: what was flown.
    record: measurements over the flight, rest and pull test.
    film: shapes of the cables over all of it.
    touches: first contacts, by time.
    linking: linking numbers (n, n) of all pairs of cables after the rest; None if not reached.
    rested, pulled: times [s] at which rest and pull test ended; nan if they did not.
    density: of the simulated cables [kg/m].
    least_bearing: contact forces (clasps,) [N] from which on a clasp bears at the end; zero without
        a hitch.
    gains: of the drones' position loops.
    longer: largest length that a rope has more than its cable [m]; the bends of thick ropes use it
        up, so that the planned length is the effective one.
    error: what ended the flight early, or None.
    ground: height of the ground [m].
    lost: the drone whose motors stopped, or None.
    objects: as they really were: masses, friction and where they stood.
    """

    task: Task
    record: Record
    film: Film
    touches: tuple[Touch, ...]
    linking: NDArray[np.int64] | None
    rested: float
    pulled: float
    density: float
    least_bearing: Array
    gains: PositionGains
    longer: float
    error: InvalidRunError | None
    ground: float = 0.0
    lost: Loss | None = None
    objects: Mapping[str, SolidObject] = field(default_factory=dict)


def fly(task: Task, settings: Settings, progress: Progress | None = None) -> Flight:
    """Return the flight of a task's setpoints, with the error that ended it early, if any.

    It begins with a hitch where the plan has one at the first setpoint, else with hanging cables.
    The plan's hitch also defines the correction for the ropes' thickness, whose size the flight
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
    """A flight in progress; parameters are those of ``fly``."""

    def __init__(self, task: Task, settings: Settings, progress: Progress | None) -> None:
        team, preset = task.team, settings.preset
        self._task, self._settings, self._progress = task, settings, progress
        disturbances = Disturbances(settings.perturbations, team.robots, settings.seed)
        self._disturbances = disturbances
        allowance = thickness_allowance(task, preset.diameter, preset.segment)
        self._longer = float(np.max(allowance))
        ropes = ropes_of(team, settings, team.cable_length * disturbances.cable_scale + allowance)
        ropes.check_tension(float(np.max(task.tensions)))
        ground = _ground(task, settings)
        objects = disturbances.disturbed(task.cargo.objects)
        rigid = settings.body == "rigid"
        world = World(ropes, team.mass, rigid=rigid, ground=ground, objects=objects)
        start = task.setpoints.positions[0] + disturbances.start_offset
        if task.formed[0]:
            world.place(clasped(ropes, team.layout, start, task.vertices[0]))
        else:
            world.place(hanging(ropes, start, ground))
        self._world = world
        self._motors = Motors(world, team.max_thrust, settings.lag)
        self._loads = HungLoads(world, team) if np.any(team.load) else None
        self._contacts = ClaspContacts(world, team)
        self._objects = ObjectContacts(world, task.cargo)
        self._starts = np.searchsorted(world.edge_cables, np.arange(team.robots))
        self._peaks: Array = np.zeros(team.robots)
        self._searched = self._framed = -np.inf
        self._frames: list[tuple[float, NDArray[np.float32], NDArray[np.float32]]] = []
        self._rows: list[tuple[NDArray[Any], ...]] = []
        self._touches: dict[tuple[str, str], Touch] = {}
        self._least_bearing = least_bearing(task)
        self._gains = PositionGains.of(team, settings)
        self._feedback = None
        if settings.feedback:
            parts = (task, settings, world, disturbances, self._gains.stiffness)
            self._feedback = VertexFeedback(*parts)
        self._wound = np.zeros_like(start)
        self._substeps = max(1, round(CONTROL / preset.time_step))
        self._period = self._substeps * preset.time_step
        self._damping = 0.0
        self._lost = _place_of(settings.lost, task)
        self._fine = max(ceil(preset.time_step / FALLING_STEP - ROUNDING), FALLING_PARTS)
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
        loose = world.drones - task.setpoints.positions[0] if formed else 0.0
        friction = world.model.flex_friction.copy()
        world.model.flex_friction[:] = 0.0  # such that the initial state has no history
        for time in self._times(-SETTLE, 0.0):
            drawn = min(1.0, (time + SETTLE) / DRAWN)
            share = drawn**3 * (10.0 - 15.0 * drawn + 6.0 * drawn**2)
            self._damping = DAMPING * (1.0 - share)
            self._step(time, 0, share if formed else 1.0, (1.0 - share) * loose)
        world.model.flex_friction[:] = friction
        self._contacts.collect()
        self._peaks[:] = 0.0
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
        world, disturbances, task, gains = self._world, self._disturbances, self._task, self._gains
        fine = 1
        if self._lost is not None and time >= self._lost[1]:
            self._motors.stop(self._lost[0])
            fine = self._fine if time < self._lost[1] + FALLING else 1
        setpoints = task.setpoints[index]
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
            self._loads.apply(min(pull, 1.0) * task.load_shares(index), self._period)
        world.data.qfrc_applied[world.node_dofs] = drag(world, self._damping)
        tight = WHIPPING * task.team.tension
        loose = np.any(min(pull, 1.0) * task.tensions[index] < tight)
        loose = loose or np.mean(tensions(world)) < np.mean(tight)  # whatever the plan says
        world.step(self._substeps, loose=bool(loose), finer=fine)
        check_valid(world, time)
        if self._feedback is not None and time >= 0.0:
            self._feedback.observe(time + self._period, self._least_bearing[index])
        self._observe(time, index)

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

    def _observe(self, time: float, index: int) -> None:
        """Update peaks, contacts and shapes after a step, in which sample ``index`` applied."""
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

    def _sample(self, time: float, index: int) -> None:
        """Record the state at ``time`` [s], at which setpoint ``index`` applies, and the peaks."""
        world, motors = self._world, self._motors
        commanded = self._task.setpoints.positions[index]
        if self._feedback is not None:
            commanded = commanded + self._feedback.offsets
        contacts = self._contacts.collect(self._least_bearing[index])
        means = np.add.reduceat(tensions(world), self._starts) / world.ropes.segments
        state = (means, self._peaks.copy(), motors.thrusts.copy(), motors.saturated.copy())
        things = (world.poses, self._objects.cables)
        self._rows.append((np.array(time), world.drones, commanded, *contacts, *state, *things))
        self._peaks[:] = 0.0

    def flight(self, error: InvalidRunError | None) -> Flight:
        """Return the flight as far as it was simulated."""
        world = self._world
        if not self._rows:  # ended while it settled
            self._sample(0.0, 0)
        t, nodes, poses = zip(*self._frames, strict=True) if self._frames else ((), (), ())
        film = Film(
            np.array(t),
            np.array(nodes, dtype=np.float32),
            world.cable_vertices,
            np.array(poses, dtype=np.float32),
        )
        return Flight(
            self._task,
            Record(*(np.array(column) for column in zip(*self._rows, strict=True))),
            film,
            tuple(self._touches.values()),
            self._linking,
            self._rested,
            self._pulled,
            world.ropes.density,
            self._least_bearing[-1],
            self._gains,
            self._longer,
            error,
            world.ground,
            self._settings.lost,
            world.objects,
        )


def _ground(task: Task, settings: Settings) -> float:
    """Return the height of the ground [m].

    Raises
    ------
    InputError: a ground on which objects do not stand.
    """
    cargo, ground = task.cargo, settings.ground
    if ground is None:  # at 0, or such that even the lowest drone stands above it
        lowest = float(np.min(task.setpoints.positions[..., 2])) - REST_HEIGHT
        return cargo.floor if cargo.objects else min(0.0, lowest)
    if cargo.objects and abs(ground - cargo.floor) > TOUCH:
        bound = f"{cargo.floor:g}, on which objects stand"
        raise InputError("ground", ground, bound, "leave it out")
    return ground


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
