"""Hand-made worlds, tasks such as a hitch at rest, and flights without movement."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.geometry import regular_polygon
from hitchopt.hitch import Hitch, Team
from hitchopt.lab.simulation.control import PositionGains
from hitchopt.lab.simulation.record import Film, FlightSamples, SimulatedFlight
from hitchopt.lab.simulation.ropes import Ropes
from hitchopt.lab.simulation.settings import FAST, Preset, Settings
from hitchopt.lab.simulation.task import RATE, Task, TeamTask
from hitchopt.lab.simulation.world import World
from hitchopt.motion.states import States
from hitchopt.objects import SolidObject
from hitchopt.values import Array


def world_of(
    *lengths: float,
    preset: Preset = FAST,
    friction: float = 0.1,
    mass: ArrayLike = 0.13,
    objects: dict[str, SolidObject] | None = None,
) -> World:
    """Return a world of straight cables of given lengths [m] and 10 g/m, and of objects."""
    ropes = Ropes(np.array(lengths), 0.01, friction, preset)
    return World(ropes, np.broadcast_to(mass, 2 * len(lengths)), 0.0, objects or {})


def smooth_step(x: Array) -> Array:
    """Rise from 0 to 1, at rest up to the jerk at both ends."""
    x = np.clip(x, 0.0, 1.0)
    return x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3)


def states_of(t: Array, positions: Array, **known: Array) -> States:
    """Return states of drones at some positions; other fields are zero unless they are known."""
    zero = dict.fromkeys((each.name for each in fields(States)), np.zeros_like(positions))
    given: Any = {**zero, "formed": np.zeros(len(positions), dtype=np.bool_), **known}
    return States(**given | {"t": t, "positions": positions})


def hanging_task(team: Team, positions: Array, cable_forces: Array) -> Task:
    """Return the task of positions (samples, 2n, 3) [m] without a hitch."""
    t = np.arange(len(positions)) / RATE
    velocities = np.gradient(positions, 1.0 / RATE, axis=0)
    accelerations = np.gradient(velocities, 1.0 / RATE, axis=0)
    jerks = np.gradient(accelerations, 1.0 / RATE, axis=0)
    given = {"velocities": velocities, "accelerations": accelerations, "jerks": jerks}
    given |= {"cable_forces": cable_forces, "vertices": np.zeros((len(t), team.layout.points, 3))}
    given |= {"tensions": np.zeros((len(t), team.robots))}
    given |= {"masses": np.broadcast_to(team.mass, positions.shape[:-1])}
    return Task((TeamTask(team, states_of(t, positions, **given)),))


def resting_task(hitch: Hitch, seconds: float, *, formed: bool = True, since: int = 0) -> Task:
    """Return the task of a hitch at rest, formed from sample ``since`` on, or of its drones."""
    count = round(seconds * RATE) + 1
    positions, forces = (
        np.repeat(x[None], count, axis=0) for x in (hitch.drones, hitch.cable_forces)
    )
    is_formed = (np.arange(count) >= since) & formed
    vertices = np.where(is_formed[:, None, None], hitch.vertices, 0.0)
    tensions = np.where(is_formed[:, None], hitch.team.tension, 0.0)
    fields_of_states: Any = {"formed": is_formed, "vertices": vertices, "tensions": tensions}
    task = hanging_task(hitch.team, positions, forces)
    return changed(task, states=replace(task.states, **fields_of_states))


def changed(task: Task, **values: Any) -> Task:
    """Return the task of a single team with other values of its ``TeamTask``."""
    (team_task,) = task.teams
    return replace(task, teams=(replace(team_task, **values),))


def regular_hitch(n: int, edge: float = 1.3, **of_team: Any) -> Hitch:
    """Return a regular hitch with legs of 0.5 m."""
    options = {"tension": 0.5, "cable_density": 0.01, "cable_friction": 0.1, **of_team}
    team = Team(n, edge + 1.0, **options)
    return Hitch.balanced(team, regular_polygon(n, edge), altitude=2.0)


def flight_of(task: Task, hitch: Hitch, t: Array, **known: Any) -> SimulatedFlight:
    """Return a flight at rest at times ``t``.

    ``known`` replaces fields of ``FlightSamples``, ``Film`` or ``SimulatedFlight``.
    """
    n, count, settings = hitch.team.robots, len(t), known.pop("settings", Settings())
    drones = np.repeat(hitch.drones[None], count, axis=0)
    ones, drone_ones = np.ones((count, n)), np.ones((count, 2 * n))
    vertices = np.repeat(hitch.vertices[None], count, axis=0)
    no_poses, index = np.zeros((count, 0, 7)), np.array([task.index(each) for each in t])
    places, others = (t, index, drones, drones, vertices), (no_poses, no_poses[..., 0] > 0.0)
    record = FlightSamples(*places, ones, ones, ones, drone_ones, 0.0 * drone_ones, *others)
    share = np.linspace(0.0, 1.0, 12)[:, None]  # cables are drawn straight
    nodes = [(1.0 - share) * q + share * r for q, r in hitch.drones.reshape(n, 2, 3)]
    shapes = np.repeat(np.concatenate(nodes)[None], count, axis=0), 12 * np.arange(n + 1)
    film = Film(t, *shapes, no_poses)  # type: ignore[arg-type]
    parts: list[Any] = []
    for part in (record, film):
        names = {each.name for each in fields(part)} & known.keys()
        parts.append(replace(part, **{name: known.pop(name) for name in names}))
    gains = PositionGains.of(hitch.team, settings)
    options: dict[str, Any] = {"touches": {}, "linking": None, "rested": np.nan, "pulled": np.nan}
    options |= {"gains": gains, "density": 0.01, "extra_length": 0.0, "end_offset": 0.0}
    return SimulatedFlight(
        task, settings, *parts, **{**options, "objects": {}, "error": None, **known}
    )
