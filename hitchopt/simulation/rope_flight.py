"""One flight: settle, fly the setpoints, rest, and pull at the hitch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import HitchoptError
from hitchopt.hitch import GRAVITY, Team
from hitchopt.simulation.air_forces import downwash, drag
from hitchopt.simulation.cable_shapes import clasped, hanging
from hitchopt.simulation.clasp_contacts import least_bearing
from hitchopt.simulation.disturbances import Disturbances
from hitchopt.simulation.drone_control import Reference, wanted_forces
from hitchopt.simulation.drone_motors import make_drones
from hitchopt.simulation.flight_recorder import Recorder
from hitchopt.simulation.flight_records import Flight
from hitchopt.simulation.linking_numbers import linking_matrix
from hitchopt.simulation.mujoco_world import World, build_world, imported_mujoco
from hitchopt.simulation.mujoco_xml import BODY
from hitchopt.simulation.rope_thickness import thickness_allowance, thickness_offsets
from hitchopt.simulation.ropes import Ropes, ropes_of
from hitchopt.simulation.setpoint_tables import Setpoints, VertexTable
from hitchopt.simulation.simulation_settings import Settings
from hitchopt.simulation.validity import check_valid

Array = NDArray[np.float64]
Progress = Callable[[str], None]

CONTROL = 0.005
"""[s] Between two commands of the controller, as nearly as time steps allow."""

SETTLE = 2.5
"""[s] Before the flight: cables are drawn tight, or come to rest."""

DRAWN = 1.5
"""[s] Of it, in which drones go from where their loose cables put them to the first setpoint, and
the cables' pull grows to what it is to be: drawn in a jerk, loose clasps would tear."""

HONEY = 40.0
"""[1/s] How fast cables lose their speed as they begin to settle; in a flight air alone slows them.
Falling free until they are taut, they would whip."""

REST = 1.0
"""[s] After the flight, before anything is judged."""

PULL, PULLED = 1.5, 2.0
"""Pull test: tension over the plan's, and how long it takes [s], half of it to grow."""

RESTING_SAMPLE = 0.01
"""[s] Between samples after the last setpoint."""


def fly(
    team: Team,
    setpoints: Setpoints,
    vertices: VertexTable,
    settings: Settings,
    progress: Progress | None = None,
) -> Flight:
    """Return the flight of the setpoints; what ends it early is in it.

    It begins with a hitch where ``vertices`` has one at the first setpoint, else with cables that
    hang free.

    Parameters
    ----------
    team: who flies.
    setpoints: what they are told.
    vertices: where the plan's hitch is: the cables' shape at the start, and how much longer they
        must be, and how far aside their ends, for being simulated so thick. Drones never learn of
        it otherwise.
    settings: of the simulation.
    progress: called now and then with what is being done.

    Raises
    ------
    InputError: a preset that cannot carry the team's tension.
    ShapeError: cables that cannot hang between the first setpoints.
    UnsupportedError: mujoco is not installed.
    """
    chance = Disturbances(settings.perturbations, team.robots, settings.seed)
    diameter = settings.preset.diameter
    allowance = thickness_allowance(team, vertices, diameter)
    aside = thickness_offsets(team, setpoints, vertices, diameter)
    setpoints = replace(setpoints, positions=setpoints.positions + aside)
    lengths = team.cable_length * chance.cable_scale + allowance
    ropes = ropes_of(team, settings.preset, settings.density, settings.friction, lengths)
    ground = _ground(setpoints) if settings.ground is None else settings.ground
    world = build_world(ropes, team.mass, rigid=settings.body == "rigid", ground=ground)
    begins = vertices.index(float(setpoints.t[0]))
    start = setpoints.positions[0] + chance.start_offset
    if begins is None:
        world.place(hanging(ropes, start, ground))
    else:
        world.place(clasped(ropes, team.layout, start, vertices.positions[begins]))
    run = _Run(team, setpoints, vertices, settings, world, chance, progress)
    error: HitchoptError | None = None
    try:
        run.fly(formed=begins is not None)
    except HitchoptError as reason:
        error = reason
    return run.flight(error)


class _Run:
    """A flight under way."""

    def __init__(
        self,
        team: Team,
        setpoints: Setpoints,
        vertices: VertexTable,
        settings: Settings,
        world: World,
        chance: Disturbances,
        progress: Progress | None,
    ) -> None:
        self._setpoints, self._settings = setpoints, settings
        self._world, self._chance, self._progress = world, chance, progress
        self._mujoco = imported_mujoco()
        self._drones = make_drones(world, team.max_thrust, settings.lag)
        self._recorder = Recorder(world, team, self._drones)
        least = least_bearing(team, vertices)
        self._vertices = vertices
        self._least_bearing = np.vstack([least, np.zeros((1, least.shape[1]))])  # without a hitch
        # What the plan knows of the cables' weight is replaced by what it is.
        self._planned_weight = _upward(team.cable_weight)
        self._weight = _upward(_carried(world.ropes))
        step = world.ropes.preset.time_step
        self._substeps = max(1, round(CONTROL / step))
        self._period = self._substeps * step
        self._honey = 0.0
        self._linking: NDArray[np.int64] | None = None
        self._rested = self._pulled = float("nan")

    def fly(self, *, formed: bool) -> None:
        """Go through all of it; a HitchoptError tells that it ended early."""
        end, last = self._setpoints.duration, len(self._setpoints.t) - 1
        loose = self._world.drones - self._setpoints.positions[0] if formed else 0.0
        friction = self._world.model.flex_friction.copy()
        self._world.model.flex_friction[:] = 0.0  # so that where it begins is no matter of history
        for time in self._times(-SETTLE, 0.0):
            drawn = min(1.0, (time + SETTLE) / DRAWN)
            share = drawn**3 * (10.0 - 15.0 * drawn + 6.0 * drawn**2)
            self._honey = HONEY * (1.0 - share)
            self._step(time, 0, share if formed else 1.0, (1.0 - share) * loose)
        self._world.model.flex_friction[:] = friction
        self._recorder.forget()
        self._sample(0.0, 0)
        told = 0
        for time in self._times(0.0, end):
            index = self._setpoints.index(time)
            if index != told:
                self._sample(time, told)
                told = index
                self._tell(time, told)
            self._step(time, index, 1.0)
        self._sample(end, last)
        self._rest(end, end + REST, last, 1.0)
        self._rested = end + REST
        cables = [self._world.cable(k) for k in range(len(self._world.ropes.lengths))]
        self._linking = linking_matrix(cables)
        if self._settings.pull_test:
            self._rest(self._rested, self._rested + PULLED, last, PULL)
            self._pulled = self._rested + PULLED

    def _rest(self, begin: float, end: float, index: int, pull: float) -> None:
        """Hold one setpoint, its cables pulled by ``pull`` times as much half way through."""
        every = max(1, round(RESTING_SAMPLE / self._period))
        for step, time in enumerate(self._times(begin, end)):
            if step and step % every == 0:
                self._sample(time, index)
            grown = min(1.0, 2.0 * (time - begin) / (end - begin))
            self._step(time, index, 1.0 + (pull - 1.0) * grown)
        self._sample(end, index)

    def _times(self, begin: float, end: float) -> Array:
        """Return the times of the commands in [begin, end)."""
        count = max(0, round((end - begin) / self._period))
        times: Array = begin + self._period * np.arange(count, dtype=np.float64)
        return times

    def _step(self, time: float, index: int, pull: float, aside: Array | float = 0.0) -> None:
        """Command the drones and let the world go on by one period.

        Drones are to be at setpoint ``index``, and ``aside`` (2n, 3) [m] of it.
        """
        world, chance = self._world, self._chance
        reference = self._reference(index, pull, aside)
        believed = world.drones + chance.noise.advance(self._period)
        velocities = world.data.qvel[world.drone_dofs]
        wanted = wanted_forces(reference, world.masses, believed, velocities)
        self._drones.apply(world, wanted, reference, self._period)
        push = chance.wind.advance(self._period)
        if self._settings.perturbations.downwash:
            push = push + downwash(world.drones, self._drones.thrusts)
        world.data.xfrc_applied[world.drone_bodies, :3] += push
        world.data.qfrc_applied[world.node_dofs] = drag(world, self._honey)
        for _ in range(self._substeps):
            self._mujoco.mj_step(world.model, world.data)
        check_valid(world, time)
        self._recorder.watch(time)

    def _reference(self, index: int, pull: float, aside: Array | float) -> Reference:
        """Return setpoint ``index``, the cables' pull, their weight aside, times ``pull``."""
        table = self._setpoints
        tension = table.cable_forces[index] + self._planned_weight
        return Reference(
            table.positions[index] + aside,
            table.velocities[index],
            table.accelerations[index],
            table.jerks[index],
            table.yaw[index],
            pull * tension - self._weight,
        )

    def _sample(self, time: float, index: int) -> None:
        self._recorder.sample(time, self._setpoints.positions[index], self._bearing_at(index))

    def _bearing_at(self, index: int) -> Array:
        """Return (clasps,) [N]: the contact force from which on clasps bear at a setpoint."""
        row = self._vertices.index(float(self._setpoints.t[index]))
        found: Array = self._least_bearing[-1 if row is None else row]
        return found

    def _tell(self, time: float, index: int) -> None:
        if self._progress is not None and index % TELLING == 0:
            self._progress(f"flying, {time:.1f} of {self._setpoints.duration:.1f} s")

    def flight(self, error: HitchoptError | None) -> Flight:
        """Return what there is of the flight."""
        if self._recorder.empty:  # ended while it settled
            self._sample(0.0, 0)
        return Flight(
            self._recorder.record,
            self._recorder.film,
            self._recorder.events,
            self._linking,
            self._setpoints.duration,
            self._rested,
            self._pulled,
            self._world.ropes.density,
            error,
            self._bearing_at(len(self._setpoints.t) - 1),
        )


TELLING = 50
"""Setpoints between two signs of life."""


def _ground(setpoints: Setpoints) -> float:
    """Return the height [m] of a ground at 0 that even the lowest drone stands above."""
    return min(0.0, float(np.min(setpoints.positions[..., 2])) - STANDING)


STANDING = BODY.half_height + 0.005
"""[m] Height of a drone's centre that stands on the ground."""


def _carried(ropes: Ropes) -> Array:
    """Return (2n,) [N]: the half of its cable's weight that each drone carries."""
    weight: Array = np.repeat(0.5 * GRAVITY * ropes.density * ropes.lengths, 2)
    return weight


def _upward(forces: Array) -> Array:
    upward: Array = np.multiply.outer(forces, [0.0, 0.0, 1.0])
    return upward
