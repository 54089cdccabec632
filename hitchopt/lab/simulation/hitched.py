"""Flights of tied hitches, whose cables slide through clasps: one per seed, all at once.

They fly the parts of a plan in which its hitch is closed. Tying and untying, contacts of drones and
cables, objects that move, and pull tests need ropes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError, Progress
from hitchopt.geometry.vectors import length
from hitchopt.lab.simulation import control
from hitchopt.lab.simulation.clasps import AXIAL_STIFFNESS, ClaspWorld
from hitchopt.lab.simulation.commands import resolved
from hitchopt.lab.simulation.control import PositionGains
from hitchopt.lab.simulation.fleet import Fleet, control_period
from hitchopt.lab.simulation.planned_rests import REST_TIME
from hitchopt.lab.simulation.record import (
    FRAME_PERIOD,
    REPORT_PERIOD,
    Film,
    FlightSample,
    FlightSamples,
    SimulatedFlight,
    layout_links,
)
from hitchopt.lab.simulation.settings import CLASPS, Settings
from hitchopt.lab.simulation.task import RATE, Cargo, Span, Task, closed_spans
from hitchopt.lab.simulation.world import InvalidRunError, RigidBodies
from hitchopt.support import Feature, Neighbour, unsupported
from hitchopt.values import Array, known

SETTLE_TIME = 1.0  # [s] Time at rest, without friction, before a hitch flies
MAX_DISTANCE = 5.0  # [m] Distance from the plan at which a flight is lost


def fly_hitched(
    task: Task, settings: Settings, seeds: Sequence[int], progress: Progress | None = None
) -> list[SimulatedFlight]:
    """Return a flight of a plan's hitches for each seed, none of which depends on the others.

    Raises UnsupportedError for several teams and objects that can move, and InputError for
    a lost robot or a plan without a hitch.
    """
    part = task.of_one_team(Feature.CLASPS)
    if task.cargo.movable.any():
        raise unsupported(Feature.CLASPS, Neighbour.OBJECTS)
    if settings.lost is not None:
        raise InputError("cut", settings.lost, f"omitted with cables={CLASPS}", "simulate ropes")
    spans = [*closed_spans(part)]
    if not spans:
        raise InputError("cables", CLASPS, "ropes for a plan without a hitch", "simulate ropes")
    flights = HitchedFlights(task, settings, seeds)
    try:
        for span in spans:
            flights.fly(span, progress)
    except InvalidRunError as error:
        if len(seeds) == 1:
            return flights.recorded(error)
        half = len(seeds) // 2
        return [
            flight
            for part_of_seeds in (seeds[:half], seeds[half:])
            for flight in fly_hitched(task, settings, part_of_seeds, progress)
        ]
    return flights.recorded(None)


class HitchedFlights:
    """Flights of one team's hitches with different seeds, as hitches of one crew."""

    def __init__(self, task: Task, settings: Settings, seeds: Sequence[int]) -> None:
        self._task, self._seeds = task, seeds
        self._may_stream, self._settings = settings.upload is None, resolved(task, settings)
        self._period = control_period(self._settings)
        self._rows: list[FlightSample] = []
        self._frames: list[tuple[float, NDArray[np.float32], NDArray[np.float32]]] = []
        self._poses = _poses(task.cargo)
        self._gains: PositionGains | None = None
        self._rested = float("nan")

    def fly(self, span: Span, progress: Progress | None = None) -> None:
        """Fly a span of the plan, and rest after it if the plan ends with it.

        Raises InvalidRunError if a flight is lost.
        """
        task, settings, team = self._task, self._settings, self._task.team
        flights, states = len(self._seeds), task.states[span.first]
        density = settings.density or team.cable_density
        disturbances = control.Disturbances(settings.perturbations, task.team.robots, *self._seeds)
        friction = task.team.friction if settings.friction is None else settings.friction
        still = np.zeros_like(states.positions)
        leaning = control.desired_attitudes(states.thrusts(team))
        unstretched = team.cable_length / (1.0 + team.tension / AXIAL_STIFFNESS)
        world = ClaspWorld(
            team,
            states.vertices,
            RigidBodies(states.positions, still, leaning, still),
            unstretched * disturbances.cable_scale.reshape(flights, -1),
            states.tensions,
            density,
        )
        fleet = Fleet(
            task,
            settings,
            disturbances,
            world,
            world.bodies,
            self._period,
            may_stream=self._may_stream,
            flights=flights,
            first=span.first,
        )
        self._settings = fleet.settings
        self._gains = fleet.gains.of_drones(slice(task.team.drones))
        begin, rest = span.first / RATE, np.zeros_like(world.drones)
        for step in range(-round(SETTLE_TIME / self._period), 0):
            time = begin + step * self._period
            world.push(*fleet.advance(time, span.first, world.bodies, offset=rest))
            world.step(self._period)
        world.friction = friction
        duration = task.duration
        times = np.minimum(np.arange(span.first, span.last + 1) / RATE, duration)
        if span.last == len(task.states.t) - 1:
            self._rested = duration + REST_TIME
            resting = duration + np.arange(1, round(REST_TIME * RATE) + 1) / RATE
            times = np.concatenate([times, resting])
        steps = round(1.0 / (RATE * self._period))
        for sample, time in enumerate(times.tolist()):
            index = min(span.first + sample, span.last)
            self._record(world, fleet, time, index)
            if progress is not None and sample % REPORT_PERIOD == 0:
                progress(f"flying, {time:.1f} of {times[-1]:.1f} s")
            for step in range(steps if sample < len(times) - 1 else 0):
                now = time + step * self._period
                world.push(*fleet.advance(now, index, world.bodies))
                world.step(self._period)

    def _repeat(self, values: Array) -> Array:
        """Return values of one flight (k, …) for all flights."""
        return np.concatenate([values] * len(self._seeds))

    def _record(self, world: ClaspWorld, fleet: Fleet, time: float, index: int) -> None:
        """Record the state at a time [s] and sample; raise InvalidRunError for a lost flight."""
        task = self._task
        planned = self._repeat(task.states.positions[index])
        distances = length(world.drones - planned)
        if not np.max(distances) < MAX_DISTANCE or not np.isfinite(world.vertices).all():
            words = f"a drone or vertex is more than {MAX_DISTANCE:g} m from its plan"
            raise InvalidRunError("state", words, time, "all", "simulate ropes")
        leg, clasp = world.shortest_leg
        if leg <= 0.0:
            name = task.team.point_names[task.team.layout.clasps[clasp]]
            words = f"{name} has slid along a cable to its drone"
            raise InvalidRunError("leg", words, time, name, "simulate ropes")
        poses, flights = self._poses, len(self._seeds)
        upward = np.minimum(np.maximum(world.bodies.attitudes[:, 2, 2], -1.0), 1.0)
        self._rows.append(
            FlightSample(
                t=time,
                setpoint=index,
                drones=world.drones,
                commanded=planned,
                vertices=world.vertices.reshape(-1, 3),
                bearing=world.bearing.ravel(),
                tensions=world.mean_tensions.ravel(),
                peak_tensions=world.largest_tensions.ravel(),
                thrusts=fleet.thrusts.copy(),
                tilts=np.arccos(upward),
                poses=np.concatenate([poses] * flights),
                touched=np.zeros(len(poses) * flights, dtype=np.bool_),
            )
        )
        if not self._frames or time >= self._frames[-1][0] + FRAME_PERIOD - 1e-9:
            self._frames.append(
                (time, world.nodes.reshape(-1, 3).astype(np.float32), poses.astype(np.float32))
            )

    def recorded(self, error: InvalidRunError | None) -> list[SimulatedFlight]:
        """Return the flights as they were recorded, with the error that ended them, if any."""
        task, flights = self._task, len(self._seeds)
        gains = known(self._gains)  # of a span that was flown
        columns: list[Any] = [np.array(column) for column in zip(*self._rows, strict=True)]
        t, nodes, poses = zip(*self._frames, strict=True)
        cables = 4 * np.arange(task.team.robots + 1)
        ended = error is None and np.isfinite(self._rested)

        def of_flight(values: Any, flight: int) -> Any:
            """Return the rows of a flight, in values (samples, rows, …) or of all (samples,)."""
            if values.ndim == 1:
                return values
            return np.split(values, flights, axis=1)[flight]

        return [
            SimulatedFlight(
                task,
                replace(self._settings, seed=seed),
                FlightSamples(*(of_flight(column, i) for column in columns)),
                Film(np.array(t), of_flight(np.array(nodes), i), cables, np.array(poses)),
                touches={},
                linking=layout_links(task.team.layout) if ended else None,
                rested=self._rested,
                pulled=float("nan"),
                gains=gains,
                density=self._settings.density or task.team.cable_density,
                extra_length=0.0,
                end_offset=0.0,
                objects=dict(task.cargo.objects),
                error=error,
            )
            for i, seed in enumerate(self._seeds)
        ]


def _poses(cargo: Cargo) -> Array:
    """Return the poses (objects, 7) of objects that do not move, as in ``FlightSamples``."""
    planned = cargo.poses[0]
    half_yaws = 0.5 * np.arctan2(planned[:, 4], planned[:, 3])
    poses = np.zeros((len(planned), 7))
    poses[:, :3], poses[:, 3], poses[:, 6] = planned[:, :3], np.cos(half_yaws), np.sin(half_yaws)
    return poses
