"""From a plan's directory to a judged flight."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hitchopt.errors import UnsupportedError
from hitchopt.export.directory import PLAN, SETPOINTS, VERTICES
from hitchopt.export.plan_file import read_plan
from hitchopt.hitch import Team
from hitchopt.simulation.error_measures import VertexErrors, vertex_errors
from hitchopt.simulation.flight_outcome import Outcome, judge
from hitchopt.simulation.flight_records import Flight
from hitchopt.simulation.rope_flight import fly
from hitchopt.simulation.setpoint_tables import (
    Setpoints,
    VertexTable,
    read_setpoints,
    read_vertices,
)
from hitchopt.simulation.simulation_settings import Settings

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Task:
    """What is to be flown: a plan's tables, and its team.

    Attributes
    ----------
    team: who flies.
    setpoints, vertices: the tables.
    digest: of setpoints.csv, so that results tell which plan they are of; or empty.
    """

    team: Team
    setpoints: Setpoints
    vertices: VertexTable
    digest: str = ""

    @property
    def ends_formed(self) -> bool:
        """Whether there is a hitch at the last setpoint."""
        return self.vertices.index(float(self.setpoints.t[-1])) is not None


@dataclass(frozen=True, eq=False)
class Simulation:
    """A flight, what became of it, and how it was simulated.

    Attributes
    ----------
    task: what was flown.
    settings: how.
    flight: what happened.
    outcome: whether it holds.
    errors: of its vertices.
    processor: what it took [s].
    """

    task: Task
    settings: Settings
    flight: Flight
    outcome: Outcome
    errors: VertexErrors
    processor: float

    @property
    def pace(self) -> float:
        """Simulated seconds, settling included, per second of one processor."""
        times = self.flight.film.t
        simulated = float(times[-1] - times[0]) if len(times) else 0.0
        return simulated / max(self.processor, 1e-9)


def read_task(directory: Path) -> Task:
    """Return what a plan's directory has to fly: the tables, and of the plan only its team.

    Raises
    ------
    FileError: a file is missing or broken.
    UnsupportedError: a plan of drones without cables.
    """
    team = read_plan(directory / PLAN).team
    if not team.has_cables:
        raise UnsupportedError(
            f"{directory}: a plan of single drones has no cables; simulate a hitch's plan"
        )
    path = directory / SETPOINTS
    setpoints = read_setpoints(path, team)
    vertices = read_vertices(directory / VERTICES, team)
    return Task(team, setpoints, vertices, hashlib.sha256(path.read_bytes()).hexdigest())


def simulate(task: Task, settings: Settings, progress: Progress | None = None) -> Simulation:
    """Return the judged flight of a plan.

    Parameters
    ----------
    task: what is flown.
    settings: how.
    progress: called now and then with what is being done.

    Raises
    ------
    InputError: a preset that cannot carry the team's tension.
    ShapeError: cables that cannot hang between the first setpoints.
    UnsupportedError: mujoco is not installed.
    """
    begin = time.process_time()
    flight = fly(task.team, task.setpoints, task.vertices, settings, progress)
    processor = time.process_time() - begin
    outcome = judge(flight, task.team, formed=task.ends_formed)
    errors = vertex_errors(flight, task.team, task.setpoints, task.vertices)
    return Simulation(task, settings, flight, outcome, errors, processor)
