"""The simulated flight and its record: settling, setpoints, rest, and a pull test."""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from itertools import islice
from time import process_time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError, Progress
from hitchopt.geometry.vectors import length
from hitchopt.lab.simulation import contacts, control, ropes
from hitchopt.lab.simulation.commands import resolved
from hitchopt.lab.simulation.fleet import Fleet, control_period
from hitchopt.lab.simulation.hitched import fly_hitched
from hitchopt.lab.simulation.planned_rests import REST_TIME, PullTest, pull_tests
from hitchopt.lab.simulation.record import (
    FRAME_PERIOD,
    REPORT_PERIOD,
    Film,
    FlightSample,
    FlightSamples,
    SimulatedFlight,
    ground_of,
)
from hitchopt.lab.simulation.settings import CLASPS, Settings
from hitchopt.lab.simulation.task import RATE, Task
from hitchopt.lab.simulation.world import InvalidRunError, RigidBodies, World, check_valid
from hitchopt.support import Feature
from hitchopt.values import Array

SETTLE_TIME = 2.5  # Settling time before the flight [s]
# Its first part, in which the tension grows while drones move from the ends of loose cables to
# the first setpoint [s]: sudden tension would tear loose clasps
TIGHTENING_TIME = 1.5

SETTLE_DAMPING = 40.0  # Initial damping of cables while they settle, against whipping [1/s]
MIN_CALM_TENSION = 0.25  # Smallest tension, over the team's, at which ropes do not whip
PULL_RATIO = 1.5  # Tension of the pull test over the plan's
PULL_TIME = 2.0  # Duration of the pull test [s]; the tension grows during its first half

REST_SAMPLES = round(REST_TIME * RATE)  # Number of samples of a rest before a pull test
ESTIMATE_STEPS = 60  # Steps whose time predicts that of the whole flight
# Period of searches for contacts, and of checks of strain and penetration [s]
CHECK_PERIOD = 0.02

LOSS_TIME = 2.5  # Time after the loss of a drone with more substeps [s]
# Number of substeps during that time: fast sliding at its clasp would strain ropes by more than 2
# %
LOSS_SUBSTEPS = 3
# Times after a cable is let go [s] between which all others are loose, without its bends
LOOSE_TIMES = (0.5, 1.0)

ROUNDING = 1e-9  # Rounding error of sums of periods [s]


def fly(task: Task, settings: Settings, progress: Progress | None = None) -> SimulatedFlight:
    """Return the flight of a task's setpoints, with the error that ended it early, if any.

    Parameters and errors are those of ``FlightInProgress``, or of ``fly_hitched``.
    """
    (flight,) = fly_seeds(task, settings, [settings.seed], progress)
    return flight


def fly_seeds(
    task: Task, settings: Settings, seeds: Sequence[int], progress: Progress | None = None
) -> list[SimulatedFlight]:
    """Return a flight as ``fly`` for each seed."""
    if settings.cables == CLASPS:
        return fly_hitched(task, settings, seeds, progress)
    each = [replace(settings, seed=seed) for seed in seeds]
    return [FlightInProgress(task, settings).flown(progress) for settings in each]


@dataclass(frozen=True, eq=False)
class _Moment:
    """The commands of a plan at one of its samples, used for several steps."""

    index: int  # of the sample
    end_offsets: Array  # of thick ropes from their drones (2n, 3) [m]
    load_shares: Array  # of loads that cables carry (n,)
    is_slack: bool  # whether the plan's tensions are too small to calm ropes


class FlightInProgress:
    """A flight in progress, with cables as they are before the first step.

    It begins with a hitch if the plan has one at the first setpoint, else with hanging cables.
    Controllers receive only setpoints, including planned cable forces. Raises InputError for a
    density too small for the team's tension or an unstable position loop, ShapeError for cables too
    short for the first setpoints, and UnsupportedError without mujoco, or for several teams with
    a lost robot.
    """

    def __init__(self, task: Task, settings: Settings) -> None:
        team, preset = task.team, settings.preset
        may_stream, settings = settings.upload is None, resolved(task, settings)
        if task.flight is not None and settings.lost is not None:
            task.flight.of_one_team(Feature.SIMULATED_LOSS)
        self._task, parts = task, task.teams
        disturbances = control.Disturbances(settings.perturbations, team.robots, settings.seed)
        end_offsets = [ropes.leg_end_offsets(part, preset.diameter) for part in parts]
        extra = [ropes.thickness_allowance(part, preset.diameter, preset.segment) for part in parts]
        self._end_offsets = np.concatenate(end_offsets, axis=1)
        self._extra_lengths = np.concatenate(extra)
        first = np.cumsum([part.team.robots for part in parts])[:-1]
        lengths = np.split(
            team.cable_length * disturbances.cable_scale + self._extra_lengths, first
        )
        each = list[ropes.Ropes]()
        for part, sizes in zip(parts, lengths, strict=True):
            tension = ropes.largest_tension(part)
            each.append(ropes.Ropes.of(part.team, settings, sizes, tension))
            each[-1].check_tension(tension)
        joined, ground = ropes.Ropes.joined(each), ground_of(task)
        objects = disturbances.disturbed(task.cargo.objects)
        self._world = world = World(joined, team.mass, ground, objects, team.drone_names)
        start = task.states.positions[0] + self._end_offsets[0] + disturbances.start_offset
        world.place(
            [
                cable
                for part, own, drones in zip(parts, each, np.split(start, 2 * first), strict=True)
                for cable in (
                    ropes.clasped(own, part.team.layout, drones, part.states.vertices[0])
                    if part.states.formed[0]
                    else ropes.hanging(own, drones, ground)
                )
            ]
        )
        self._calm_tension = MIN_CALM_TENSION * team.tension
        self._mean_calm_tension = float(np.mean(self._calm_tension))
        step = joined.preset.time_step
        self._substeps = max(1, round(control_period(settings) / step))
        self._period = self._substeps * step
        self._moment = self._moment_at(0)
        self._fleet = Fleet(
            task,
            settings,
            disturbances,
            world,
            self._bodies,
            self._period,
            may_stream=may_stream,
        )
        self._settings, self.files = self._fleet.settings, self._fleet.files
        self._loads = contacts.HungLoads(world, team) if np.any(team.load) else None
        self._contacts = contacts.ClaspContacts(world, team)
        self._objects = contacts.ObjectContacts(world, task.cargo)
        self._least_bearing = contacts.least_bearing(task)
        self._lost = _lost(task, settings)
        self._damping, self._drag = 0.0, control.CableDrag(world)
        self._tensions = world.tensions  # of all segments after the last step
        self._loose_offset = self._drones(0) - task.states.positions[0]
        self._settling = iter(self._times(-SETTLE_TIME, 0.0))
        self._start_record(_planned_tests(task, settings))

    def _start_record(self, planned_tests: list[PullTest]) -> None:
        """Start an empty record of the flight, with pull tests before the plan's end."""
        world = self._world
        count = len(world.ropes.lengths)
        self._progress: Progress | None = None
        self._starts = world.cable_vertices[:-1] - np.arange(count)  # of each cable's edges
        self._peaks: Array = np.zeros(count)
        self._error: InvalidRunError | None = None  # that ended the settling
        self._check_time = self._frame_time = -np.inf
        self._frames: list[tuple[float, NDArray[np.float32], NDArray[np.float32]]] = []
        self._rows: list[FlightSample] = []
        self._touches: dict[tuple[str, str], float] = {}
        self._linking: NDArray[np.int64] | None = None
        self._rested = self._pulled = float("nan")
        self._planned_tests, self._tests = planned_tests, dict[float, SimulatedFlight]()

    @property
    def _bodies(self) -> RigidBodies:
        """State of the drones, without the end offsets of thick ropes."""
        actual = self._world.bodies
        return replace(actual, positions=actual.positions - self._moment.end_offsets)

    def settled(self) -> World:
        """Return the world at the plan's start, with taut cables if it begins with a hitch."""
        self._settle()
        return self._world

    def flown(self, progress: Progress | None = None) -> SimulatedFlight:
        """Return the flight, simulated to its end or until the simulation becomes invalid."""
        self._progress = progress
        try:
            self._fly_all()
        except InvalidRunError as error:
            return self._flight(error)
        return self._flight(None)

    def _fly_all(self) -> None:
        """Simulate the flight; raises InvalidRunError if the simulation leaves its valid range."""
        end = self._task.duration
        self._settle()
        self._contacts.collect()
        self._peaks[:] = 0.0
        self._sample(0.0, 0, 0)
        self._fly(0.0, end)
        self._rest_and_pull(end, REST_TIME)

    def _rest_and_pull(self, begin: float, seconds: float) -> None:
        """Rest from a time [s] on, and pull all hitches, where the plan ends."""
        self._rested = begin + seconds
        if seconds > 0.0:
            self._fly(begin, self._rested)
        self._linking = ropes.linking_matrix(self._world.cables)
        if self._settings.pull_test and self._lost is None:
            self._fly(self._rested, self._rested + PULL_TIME, PULL_RATIO)
            self._pulled = self._rested + PULL_TIME

    def _tested(self, test: PullTest) -> SimulatedFlight:
        """Return a copy of this flight whose plan ends now, at a pull test."""
        shared = self._task, self._settings, self._rows, self._frames, self._progress
        branch = deepcopy(self, {id(each): each for each in shared})
        return branch.ended(self._task.index(test.time), test.since)

    def ended(self, index: int, since: float) -> SimulatedFlight:
        """Return the flight, now, if its plan ends at a sample, with a pull test.

        It rests until nothing has moved for REST_TIME since a time [s].
        """
        last = self._rows[-REST_SAMPLES:]
        self._task = self._task.until(index)
        self._fleet.end_at(index, self._task)
        self._moment = self._moment_at(index)
        self._start_record([])
        self._rows, now = last, last[-1].t
        try:
            self._rest_and_pull(now, max(0.0, REST_TIME - (now - since)))
        except InvalidRunError as error:
            return self._flight(error)
        return self._flight(None)

    @property
    def steps(self) -> int:
        """Number of steps of the whole flight, pull tests included."""
        seconds = SETTLE_TIME + self._task.duration + REST_TIME
        if self._settings.pull_test and self._lost is None:
            rests = (max(0.0, REST_TIME - (x.time - x.since)) for x in self._planned_tests)
            seconds += PULL_TIME + sum(rest + PULL_TIME for rest in rests)
        return round(seconds / self._period)

    def expected_seconds(self) -> float:
        """Return the processor time of the flight [s], extrapolated from its first steps."""
        start = process_time()
        try:
            self._settle(ESTIMATE_STEPS)
        except InvalidRunError as error:
            self._error = error
        return (process_time() - start) / ESTIMATE_STEPS * self.steps

    def _settle(self, steps: int | None = None) -> None:
        """Continue to settle for some steps, or to the end, without friction and its history."""
        if self._error is not None:
            raise self._error
        task, world = self._task, self._world
        tied = np.concatenate(
            [np.full(part.team.drones, part.states.formed[0]) for part in task.teams]
        )
        friction = world.model.flex_friction.copy()
        world.model.flex_friction[:] = 0.0
        for time in islice(self._settling, steps):
            progress = min(1.0, (time + SETTLE_TIME) / TIGHTENING_TIME)
            share = progress**3 * (10.0 - 15.0 * progress + 6.0 * progress**2)
            self._damping = SETTLE_DAMPING * (1.0 - share)
            offset = (1.0 - share) * tied[:, None] * self._loose_offset
            self._step(time, 0, np.where(tied, share, 1.0), offset)
        world.model.flex_friction[:] = friction

    def _fly(self, begin: float, end: float, pull: float = 1.0) -> None:
        """Fly between two times [s], while the tension grows to ``pull`` times its value."""
        task, sample = self._task, math.floor(RATE * begin + ROUNDING)
        index = task.index(begin)
        for time in self._times(begin, end):
            if (now := math.floor(RATE * time + ROUNDING)) != sample:
                following = task.index(time)
                self._sample(time, index, following)
                sample, index = now, following
                if self._progress is not None and sample % REPORT_PERIOD == 0:
                    self._progress(f"flying, {time:.1f} of {end:.1f} s")
                if self._planned_tests and time >= self._planned_tests[0].time - ROUNDING:
                    test = self._planned_tests.pop(0)
                    self._tests[test.time] = self._tested(test)
            growth = min(1.0, 2.0 * (time - begin) / (end - begin))
            factor = 1.0 + (pull - 1.0) * growth
            self._step(time, index, None if pull == 1.0 else np.full(task.team.drones, factor))
        self._sample(end, index, task.index(end))

    def _times(self, begin: float, end: float) -> list[float]:
        """Return the times of the commands in [begin, end)."""
        count = max(0, round((end - begin) / self._period))
        times: list[float] = (begin + self._period * np.arange(count, dtype=np.float64)).tolist()
        return times

    def _step(
        self, time: float, index: int, pull: Array | None = None, offset: Array | None = None
    ) -> None:
        """Command the drones by a setpoint, with an ``offset`` [m], and advance by one period.

        ``pull`` (2n,) is a factor of the plan's tension by drone: less than 1 while a hitch is
        tightened, more than 1 in the pull test, in which drones add the force; None is 1.
        """
        world, task, substeps = self._world, self._task, 1
        is_loose = False
        if index != self._moment.index:
            self._moment = self._moment_at(index)
        if self._lost is not None and time >= self._lost.time:
            self._lose(self._lost, time)
            is_loose = True
            substeps = LOSS_SUBSTEPS if time < self._lost.time + LOSS_TIME else 1
        world.push(*self._fleet.advance(time, index, self._bodies, pull, offset))
        is_loose, load_shares = is_loose or self._moment.is_slack, self._moment.load_shares
        if pull is not None:
            by_cable = np.minimum(pull[::2], 1.0)
            is_loose = self._are_slack(by_cable * task.states.tensions[index])
            load_shares = by_cable * load_shares
        if self._loads is not None:
            self._loads.apply(load_shares, self._period)
        self._drag.apply(self._damping)
        mean_tension = np.add.reduce(self._tensions) / len(self._tensions)
        is_loose |= bool(mean_tension < self._mean_calm_tension)
        substeps = max(substeps, world.ropes.substeps(float(np.maximum.reduce(self._tensions))))
        world.step(self._substeps, loose=is_loose, substeps=substeps)
        self._observe(time)

    def _lose(self, lost: _Lost, time: float) -> None:
        """Let go of a cable.

        Others are as long as without the bends that vanish before a chain of them is taut.
        """
        self._world.let_go(lost.cable)
        share = float(np.interp(time - lost.time, LOOSE_TIMES, (0.0, 1.0)))
        self._world.shorten(share * lost.bends)

    def _observe(self, time: float) -> None:
        """Check and record the state after the step at a time [s]."""
        world, index = self._world, self._moment.index
        self._tensions = world.tensions
        self._contacts.gather()
        np.maximum(self._peaks, np.maximum.reduceat(self._tensions, self._starts), out=self._peaks)
        if time - self._check_time >= CHECK_PERIOD - ROUNDING or not world.is_finite:
            self._check_time = time
            check_valid(world, time)
            if time >= 0.0:
                passing = self._task.passing
                touching = contacts.touching(world, passing.names, passing.at(index))
                for pair in (*touching, *self._objects.wrong(index)):
                    self._touches.setdefault(pair, time)
        if time - self._frame_time >= FRAME_PERIOD - ROUNDING:
            self._frame_time = time
            state = (world.nodes.astype(np.float32), world.poses.astype(np.float32))
            self._frames.append((time, *state))

    def _moment_at(self, index: int) -> _Moment:
        """Return what the plan commands at a sample."""
        return _Moment(
            index,
            self._end_offsets[index],
            self._task.load_shares(index),
            is_slack=self._are_slack(self._task.states.tensions[index]),
        )

    def _are_slack(self, tensions: Array) -> bool:
        """Return whether planned tensions (n,) [N] are too small for ropes to be calm."""
        return bool(np.logical_or.reduce(tensions < self._calm_tension))

    def _drones(self, index: int) -> Array:
        """Return positions of the drones without the end offsets of thick ropes (2n, 3) [m]."""
        return np.asarray(self._world.drones - self._end_offsets[index])

    def _sample(self, time: float, index: int, following: int) -> None:
        """Record the state at ``time`` [s], from setpoint ``index`` to the ``following`` one."""
        world = self._world
        vertices, bearing = self._contacts.collect(self._least_bearing[index])
        upward = np.minimum(np.maximum(world.bodies.attitudes[:, 2, 2], -1.0), 1.0)
        sample = FlightSample(
            t=time,
            setpoint=following,
            drones=self._drones(index),
            commanded=self._task.states.positions[index],
            vertices=vertices,
            bearing=bearing,
            tensions=np.add.reduceat(self._tensions, self._starts) / world.ropes.segments,
            peak_tensions=self._peaks.copy(),
            thrusts=self._fleet.thrusts.copy(),
            tilts=np.arccos(upward),
            poses=world.poses,
            touched=self._objects.cables,
        )
        self._rows.append(sample)
        self._peaks[:] = 0.0

    def _flight(self, error: InvalidRunError | None) -> SimulatedFlight:
        """Return the simulated part of the flight."""
        world = self._world
        if not self._rows:  # ended while it settled
            self._sample(0.0, 0, 0)
        t, nodes, poses = zip(*self._frames, strict=True) if self._frames else ((), (), ())
        shapes = np.array(nodes, dtype=np.float32), world.cable_vertices
        return SimulatedFlight(
            self._task,
            self._settings,
            FlightSamples(*(np.array(column) for column in zip(*self._rows, strict=True))),
            Film(np.array(t), *shapes, np.array(poses, dtype=np.float32)),
            self._touches,
            self._linking,
            self._rested,
            self._pulled,
            gains=self._fleet.gains,
            density=world.ropes.density,
            extra_length=float(np.max(self._extra_lengths)),
            end_offset=float(np.max(length(self._end_offsets))),
            objects=world.objects,
            error=error,
            pull_tests=self._tests,
        )


def _planned_tests(task: Task, settings: Settings) -> list[PullTest]:
    """Return the pull tests before the plan's end, by time."""
    if not settings.pull_test or settings.lost is not None:
        return []
    return sorted(test for test in {*pull_tests(task).values()} if test.time < task.duration)


class _Lost(NamedTuple):
    """A loss during a flight."""

    cable: int  # The cable that is let go
    time: float  # [s]
    # (n,) [m], additional lengths of other cables for their bends about a cable that is let go
    bends: Array


def _lost(task: Task, settings: Settings) -> _Lost | None:
    """Return what is lost, if anything; InputError if invalid."""
    lost, names, end = settings.lost, task.team.drone_names, task.duration
    if lost is None:
        return None
    if not {*lost.drones} <= {*names}:
        robots = ", ".join(map(str, task.team.labels))
        raise InputError("cut", lost.name, f"one of {robots}", "name a robot")
    if lost.time >= end:
        raise InputError("cut", lost.time, f"before the flight ends at {end:g} s", "lower it")
    preset, cable = settings.preset, names.index(lost.drones[0]) // 2
    bends = ropes.bends_about(task.teams[0], preset.diameter, preset.segment, cable)
    return _Lost(cable, lost.time, bends)
