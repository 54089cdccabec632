"""The simulated flight: settle, fly the setpoints, rest, and pull at the hitch; and its record."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch import GRAVITY
from hitchopt.objects import SolidObject
from hitchopt.simulation import contacts, control, ropes
from hitchopt.simulation.autopilots import PERIOD, Autopilots
from hitchopt.simulation.commands import Commands, flown_team, received
from hitchopt.simulation.estimator import Estimator
from hitchopt.simulation.settings import Settings
from hitchopt.simulation.task import RATE, Setpoints, Task
from hitchopt.simulation.world import (
    BODY_HALF_HEIGHT,
    Bodies,
    InvalidRunError,
    World,
    cable_names,
    check_valid,
)
from hitchopt.values import Array

Progress = Callable[[str], None]
"""Called repeatedly with a description of the current work."""

CONTROL = 0.005  # Period of the controller [s], rounded to whole time steps

# Time before the flight in which cables come to rest [s]; and its part in which drones move from
# the ends of loose cables to the first setpoint, while the tension grows: drawn at once, loose
# clasps would tear
SETTLE, DRAWN = 2.5, 1.5

DAMPING = 40.0  # Rate at which cables lose speed when they begin to settle, not to whip [1/s]

WHIPPING = 0.25  # Tension over the team's from which on ropes do not whip
REST = 1.0  # Time after the flight, before anything is judged [s]

# Pull test: tension over the plan's, and duration [s]; the tension grows in half of it
PULL, PULLED = 1.5, 2.0

FRAME_PERIOD, TOUCH_PERIOD = 0.04, 0.02  # Of shapes of cables and of searches for contacts [s]
REPORT_PERIOD = 50  # Samples between two calls of ``progress``

# Time after the loss of a drone [s] in which steps are that part of the preset's: ropes slide fast
# over each other at its clasp, and strain by more than 2 % there else
FALLING, FALLING_PARTS = 2.5, 3

REST_HEIGHT = BODY_HALF_HEIGHT + 0.005  # Height of the centre of a drone on the ground [m]
ROUNDING = 1e-9  # Rounding of sums of periods [s]


@dataclass(frozen=True, eq=False)
class Record:
    """Measurements, sample by sample; times count from the flight's start, after settling.

    Attributes
    ----------
    t: (samples,) [s], at the rate of the setpoints, rest and pull test included.
    index: (samples,), the task's sample that applies from then on.
    drones, commanded: positions, and the setpoints' (samples, 2n, 3) [m].
    vertices: (samples, clasps, 3) [m], nan where cables do not bear on each other.
    bearing: contact forces (samples, clasps) [N].
    tensions: means over each cable's length (samples, n) [N].
    peak_tensions: largest values over length and time since the last sample (samples, n) [N].
    thrusts: (samples, 2n) [N]
    tilts: of the drones (samples, 2n) [rad].
    poses: of the objects (samples, objects, 7): positions of their bases [m], and quaternions.
    touched: whether cables touch an object (samples, objects).
    """

    t: Array
    index: NDArray[np.intp]
    drones: Array
    commanded: Array
    vertices: Array
    bearing: Array
    tensions: Array
    peak_tensions: Array
    thrusts: Array
    tilts: Array
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
    poses: of the objects (frames, objects, 7), as in a ``Record``.
    """

    t: Array
    nodes: NDArray[np.float32]
    cables: NDArray[np.intp]
    poses: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Flight:
    """A flight that was simulated to its end, or until the simulation became invalid.

    Attributes
    ----------
    task, settings: what was flown, and how.
    record, film: measurements and shapes of the cables.
    touches: times [s] of first contacts of two things that should stay apart, by their names, such
        as ``("q0", "r2")`` or ``("q0", "cable 2")``.
    linking: linking numbers (n, n) of all pairs of cables after the rest; None if not reached.
    rested, pulled: times [s] at which rest and pull test ended; nan if they did not.
    gains: of the drones' position loops.
    density: of the simulated cables [kg/m], of each (n,) if there are several groups.
    longer: largest length that a rope has more than its cable [m], as bends of thick ropes use up.
    aside: largest distance of a rope's end from its drone's position [m], so that legs of thick
        ropes point as those of thin cables do.
    objects: as they really were, by name.
    error: what ended the flight early, or None.
    """

    task: Task
    settings: Settings
    record: Record
    film: Film
    touches: dict[tuple[str, str], float]
    linking: NDArray[np.int64] | None
    rested: float
    pulled: float
    gains: control.PositionGains
    density: Array | float
    longer: float
    aside: float
    objects: dict[str, SolidObject]
    error: InvalidRunError | None

    @property
    def cable_names(self) -> list[str]:
        """(n,): cable 0, cable 1, …, or a.cable 0, … of several groups."""
        return cable_names(self.task.team.drone_names)


def fly(task: Task, settings: Settings, progress: Progress | None = None) -> Flight:
    """Return the flight of a task's setpoints, with the error that ended it early, if any.

    It begins with a hitch where the plan has one at the first setpoint, else with hanging cables.
    Drones know their setpoints alone, with the cable forces that these hold.

    Raises
    ------
    InputError: a preset that cannot bear the team's tension, or an unstable position loop.
    ShapeError: cables that cannot hang between the first setpoints.
    UnsupportedError: mujoco is not installed, or several groups with feedback or a lost drone.
    """
    run = _Run(task, settings, progress)
    try:
        run.fly()
    except InvalidRunError as error:
        return run.flight(error)
    return run.flight(None)


class _Run:
    """A flight in progress."""

    def __init__(self, task: Task, settings: Settings, progress: Progress | None) -> None:
        team, preset = task.team, settings.preset
        if task.motion is not None and settings.lost is not None:
            task.motion.refuse_several("the simulated loss of a drone")
        self._task, self._settings, self._progress = task, settings, progress
        disturbances = control.Disturbances(settings.perturbations, team.robots, settings.seed)
        self._disturbances, parts = disturbances, task.parts
        aside = [ropes.legs_aside(part, preset.diameter) for part in parts]
        longer = [ropes.thickness_allowance(p, preset.diameter, preset.segment) for p in parts]
        self._aside, self._longer = np.concatenate(aside, axis=1), np.concatenate(longer)
        first = np.cumsum([part.team.robots for part in parts])[:-1]
        lengths = np.split(team.cable_length * disturbances.cable_scale + self._longer, first)
        each = list[ropes.Ropes]()
        for part, sizes in zip(parts, lengths, strict=True):
            tension = float(max(np.max(part.team.tension), np.max(part.tensions)))
            each.append(ropes.Ropes.of(part.team, settings, sizes, tension))
            each[-1].check_tension(tension)
        built, ground = ropes.Ropes.joined(each), ground_of(task)
        objects = disturbances.disturbed(task.cargo.objects)
        self._world = world = World(built, team.mass, ground, objects, team.drone_names)
        start = task.setpoints.positions[0] + self._aside[0] + disturbances.start_offset
        world.place(
            [
                cable
                for part, own, drones in zip(parts, each, np.split(start, 2 * first), strict=True)
                for cable in (
                    ropes.clasped(own, part.team.layout, drones, part.vertices[0])
                    if part.formed[0]
                    else ropes.hanging(own, drones, ground)
                )
            ]
        )
        self._pilots = self._crew()
        self._loads = contacts.HungLoads(world, team) if np.any(team.load) else None
        self._contacts = contacts.ClaspContacts(world, team)
        self._objects = contacts.ObjectContacts(world, task.cargo)
        self._least_bearing = contacts.least_bearing(task)
        loops, delay = self._pilots.gains.stiffness, settings.perturbations.vertex_delay
        self._feedback = None
        if settings.feedback:
            self._feedback = control.VertexFeedback(task, delay, disturbances, loops)
        self._lost = _lost_drone(task, settings)
        step, period = built.preset.time_step, CONTROL if settings.controller is None else PERIOD
        self._substeps = max(1, round(period / step))
        self._period = self._substeps * step
        self._damping = 0.0
        self._starts = world.cable_vertices[:-1] - np.arange(team.robots)  # of each cable's edges
        self._peaks: Array = np.zeros(team.robots)
        self._searched = self._framed = -np.inf
        self._frames: list[tuple[float, NDArray[np.float32], NDArray[np.float32]]] = []
        self._rows: list[tuple[Any, ...]] = []
        self._touches: dict[tuple[str, str], float] = {}
        self._linking: NDArray[np.int64] | None = None
        self._rested = self._pulled = float("nan")

    def _crew(self) -> control.Pilots | Autopilots:
        """Return the drones' controllers; commands for flight controllers are stored."""
        task, settings, world = self._task, self._settings, self._world
        if settings.controller is None:
            return control.Pilots(world, task.team, settings)
        teams, estimator = [flown_team(part.team, settings) for part in task.parts], None
        both = zip(task.parts, teams, strict=True)
        self._sent = [received(part, team, settings) for part, team in both]
        if settings.estimator is not None:
            measuring = self._disturbances.measuring
            estimator = Estimator(settings.estimator, self._bodies(0), measuring)
        loops = [kind.loop for team in teams for kind in team.quadrotor for _ in range(2)]
        most = task.team.max_thrust
        return Autopilots(loops, world.masses, world.inertia, most, settings.lag, estimator)

    def fly(self) -> None:
        """Simulate all of it; raises InvalidRunError where the simulation leaves its range."""
        task, world = self._task, self._world
        end = task.duration
        tied = np.concatenate([np.full(part.team.drones, part.formed[0]) for part in task.parts])
        loose = tied[:, None] * (self._drones(0) - task.setpoints.positions[0])
        friction = world.model.flex_friction.copy()
        world.model.flex_friction[:] = 0.0  # so that the initial state has no history
        for time in self._times(-SETTLE, 0.0):
            drawn = min(1.0, (time + SETTLE) / DRAWN)
            share = drawn**3 * (10.0 - 15.0 * drawn + 6.0 * drawn**2)
            self._damping = DAMPING * (1.0 - share)
            self._step(time, 0, np.where(tied, share, 1.0), (1.0 - share) * loose)
        world.model.flex_friction[:] = friction
        self._contacts.collect()
        self._peaks[:] = 0.0
        self._sample(0.0, 0)
        self._fly(0.0, end)
        self._fly(end, end + REST)
        self._rested = end + REST
        self._linking = ropes.linking_matrix(world.cables)
        if self._settings.pull_test and self._lost is None:
            self._fly(self._rested, self._rested + PULLED, PULL)
            self._pulled = self._rested + PULLED

    def _fly(self, begin: float, end: float, pull: float = 1.0) -> None:
        """Fly from a time to another [s], the tension growing to ``pull`` times its value."""
        task, sample = self._task, math.floor(RATE * begin + ROUNDING)
        index = task.index(begin)
        for time in self._times(begin, end):
            if (now := math.floor(RATE * time + ROUNDING)) != sample:
                self._sample(time, index)
                sample, index = now, task.index(time)
                if self._progress is not None and sample % REPORT_PERIOD == 0:
                    self._progress(f"flying, {time:.1f} of {end:.1f} s")
            grown = min(1.0, 2.0 * (time - begin) / (end - begin))
            self._step(time, index, 1.0 + (pull - 1.0) * grown)
        self._sample(end, index)

    def _times(self, begin: float, end: float) -> Array:
        """Return the times of the commands in [begin, end)."""
        count = max(0, round((end - begin) / self._period))
        return begin + self._period * np.arange(count, dtype=np.float64)

    def _step(
        self, time: float, index: int, pull: Array | float, offset: Array | float = 0.0
    ) -> None:
        """Command the drones by a setpoint, moved by an offset [m], and advance by one period.

        ``pull`` is a factor of the plan's tension, of all or by drone (2n,): less than 1 while a
        hitch is drawn tight, more in the pull test, whose force every drone adds.
        """
        world, task, period, flying = self._world, self._task, self._period, time >= 0.0
        pull = np.broadcast_to(pull, task.team.drones)
        disturbances, pilots, fine = self._disturbances, self._pilots, 1
        if self._lost is not None and time >= self._lost[1]:
            pilots.stop(self._lost[0])
            fine = FALLING_PARTS if time < self._lost[1] + FALLING else 1
        setpoints = task.setpoints[index]
        setpoints = replace(setpoints, positions=setpoints.positions + offset)
        bodies, passing = self._bodies(index), task.passing.at(index)
        if self._settings.estimator is None:
            measured = bodies.positions + disturbances.noise.advance(period)
            velocities = bodies.velocities + disturbances.velocity_noise.advance(period)
            bodies = replace(bodies, positions=measured, velocities=velocities)
        measured = bodies.positions
        if self._feedback is not None and flying:
            setpoints = self._feedback.corrected(setpoints, time, period, measured)
        pulling = pilots.gains.feed_forward | (pull > 1.0)
        added = ((pull - 1.0) * pulling)[:, None] * self._outward_pulls(index)
        push = disturbances.wind.advance(period) + disturbances.steady_wind
        push = push + self._command(time, index, setpoints, bodies, added)
        if self._settings.perturbations.downwash:
            drones = np.concatenate([world.drones, passing])
            thrusts = np.concatenate([pilots.thrusts, GRAVITY * task.passing.masses])
            push = push + control.downwash(drones, thrusts)[: len(push)]
        world.push(pilots.thrusts, pilots.moments, push)
        planned = np.minimum(pull[::2], 1.0)  # by cable
        if self._loads is not None:
            self._loads.apply(planned * task.load_shares(index), period)
        world.data.qfrc_applied[world.node_dofs] = control.drag(world, self._damping)
        tight = WHIPPING * task.team.tension
        loose = np.any(planned * task.tensions[index] < tight)
        loose = loose or np.mean(world.tensions) < np.mean(tight)  # in the plan or in fact
        fine = max(fine, world.ropes.finer(float(np.max(world.tensions))))  # than the plan's, maybe
        world.step(self._substeps, loose=bool(loose), finer=fine)
        check_valid(world, time)
        self._contacts.gather()
        np.maximum(self._peaks, np.maximum.reduceat(world.tensions, self._starts), out=self._peaks)
        if flying and time - self._searched >= TOUCH_PERIOD - ROUNDING:
            self._searched = time
            touching = contacts.touching(world, task.passing.names, passing)
            for pair in (*touching, *self._objects.wrong(index)):
                self._touches.setdefault(pair, time)
        if time - self._framed >= FRAME_PERIOD - ROUNDING:
            self._framed = time
            state = (world.nodes.astype(np.float32), world.poses.astype(np.float32))
            self._frames.append((time, *state))

    def _command(
        self, time: float, index: int, setpoints: Setpoints, bodies: Bodies, added: Array
    ) -> Array:
        """Run the drones' motors for a period; return the forces that they know nothing of.

        ``added`` (2n, 3) [N] is an external pull; the setpoints are those of an index, corrected.
        """
        pilots, period, plan = self._pilots, self._period, self._task.setpoints[index]
        if isinstance(pilots, control.Pilots):
            pilots.command(setpoints, bodies, period, added)
            if time >= 0.0:
                pilots.wind(setpoints.positions - bodies.positions, period)
            return np.zeros_like(added)
        now = [vars(sent[max(0, math.floor(RATE * time + ROUNDING))]) for sent in self._sent]
        sent = Commands(*(np.concatenate([each[x.name] for each in now]) for x in fields(Commands)))
        positions = sent.positions + (setpoints.positions - plan.positions)
        velocities = sent.velocities + (setpoints.velocities - plan.velocities)
        moved = replace(sent, positions=positions, velocities=velocities)
        pilots.advance(moved, bodies, period)
        return added

    def _bodies(self, index: int) -> Bodies:
        """Return the drones' state, beside which legs of thick ropes end."""
        return replace(self._world.bodies, positions=self._drones(index))

    def _drones(self, index: int) -> Array:
        """Return (2n, 3) [m]: positions of the drones, beside which legs of thick ropes end."""
        return np.asarray(self._world.drones - self._aside[index])

    def _outward_pulls(self, index: int) -> Array:
        """Return (2n, 3) [N]: the plan's tensions along the legs outward; level with an object."""
        task = self._task
        legs = task.setpoints.positions[index] - task.vertices[index][task.team.layout.pulled_to]
        pulls: Array = np.repeat(task.tensions[index], 2)[:, None] * unit(legs)
        if task.cargo.objects and np.any(task.cargo.borne[index] > 0.0):
            pulls[:, 2] = 0.0
        return pulls

    def _sample(self, time: float, index: int) -> None:
        """Record the state at ``time`` [s], until which setpoint ``index`` applied, and peaks."""
        world = self._world
        commanded = self._task.setpoints.positions[index]
        touched = self._contacts.collect(self._least_bearing[index])
        if self._feedback is not None:
            commanded = commanded + self._feedback.offsets
            self._feedback.observe(time, touched[0])
        means = np.add.reduceat(world.tensions, self._starts) / world.ropes.segments
        tilts = np.arccos(np.clip(world.bodies.attitudes[:, 2, 2], -1.0, 1.0))
        state = (means, self._peaks.copy(), self._pilots.thrusts.copy(), tilts)
        places = (time, self._task.index(time), self._drones(index), commanded)
        self._rows.append((*places, *touched, *state, world.poses, self._objects.cables))
        self._peaks[:] = 0.0

    def flight(self, error: InvalidRunError | None) -> Flight:
        """Return the flight as far as it was simulated."""
        world = self._world
        if not self._rows:  # ended while it settled
            self._sample(0.0, 0)
        t, nodes, poses = zip(*self._frames, strict=True) if self._frames else ((), (), ())
        shapes = np.array(nodes, dtype=np.float32), world.cable_vertices
        return Flight(
            self._task,
            self._settings,
            Record(*(np.array(column) for column in zip(*self._rows, strict=True))),
            Film(np.array(t), *shapes, np.array(poses, dtype=np.float32)),
            self._touches,
            self._linking,
            self._rested,
            self._pulled,
            gains=self._pilots.gains,
            density=world.ropes.density,
            longer=float(np.max(self._longer)),
            aside=float(np.max(length(self._aside))),
            objects=world.objects,
            error=error,
        )


def ground_of(task: Task) -> float:
    """Return the height [m] on which objects stand; else 0, or lower for the lowest drone."""
    lowest = float(np.min(task.setpoints.positions[..., 2])) - REST_HEIGHT
    return task.cargo.floor if task.cargo.objects else min(0.0, lowest)


def _lost_drone(task: Task, settings: Settings) -> tuple[int, float] | None:
    """Return the index of a lost drone and the time of its loss [s]; InputError for a wrong one."""
    lost, names, end = settings.lost, task.team.drone_names, task.duration
    if lost is None:
        return None
    if lost.drone not in names:
        raise InputError("lose", lost.drone, f"one of {', '.join(names)}", "name a drone")
    if lost.time >= end:
        raise InputError("lose", lost.time, f"before the flight ends at {end:g} s", "lower it")
    return names.index(lost.drone), lost.time
