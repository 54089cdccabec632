"""Simulation of a task: its flight, judged."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from hitchopt.one_line import OneLine
from hitchopt.simulation.error_measures import Spread, VertexErrors, tracking_errors, vertex_errors
from hitchopt.simulation.flight_outcome import SUCCEEDED, Failure, Outcome, judge
from hitchopt.simulation.flight_records import Flight
from hitchopt.simulation.flight_task import Task
from hitchopt.simulation.lost_drones import LossOutcome, loss_outcome
from hitchopt.simulation.rope_flight import Progress, fly
from hitchopt.simulation.simulation_settings import Settings

NOTHING = Spread(np.nan, np.nan, np.nan)


@dataclass(frozen=True)
class Run(OneLine):
    """Figures of one flight; nan where it could not begin.

    Attributes
    ----------
    seed: of its perturbations; the same seed gives the same flight.
    verdict: that of its Outcome.
    failures: all failures, by time.
    vertex_error: distances of vertices from the plan's in three dimensions, sag included, over
        vertices and time [m].
    resting, moving: the same while the plan stands still, and while it moves a vertex; nan where it
        does not.
    without_sag: level part of vertex_error [m].
    tracking: distances of drones from their commands [m].
    peak_tension, peak_thrust: [N]
    saturated: share of samples at which a drone's command exceeded its thrust.
    pace: simulated seconds per second of one processor.
    placed, tilted, slipped: largest of the objects' distances from their places at the end [m],
        angles from the vertical [°], and movements relative to the hitch that carries them [m].
    """

    seed: int
    verdict: str
    failures: tuple[Failure, ...]
    vertex_error: Spread = NOTHING
    resting: Spread = NOTHING
    moving: Spread = NOTHING
    without_sag: Spread = NOTHING
    tracking: Spread = NOTHING
    peak_tension: float = np.nan
    peak_thrust: float = np.nan
    saturated: float = np.nan
    pace: float = np.nan
    placed: float = np.nan
    tilted: float = np.nan
    slipped: float = np.nan

    @property
    def succeeded(self) -> bool:
        """Whether nothing failed."""
        return self.verdict == SUCCEEDED


@dataclass(frozen=True, eq=False)
class Simulation(OneLine):
    """A flight, its outcome and its settings.

    Attributes
    ----------
    settings: settings of the simulation.
    flight: records of the flight.
    outcome: whether it succeeded.
    errors: of its vertices.
    processor: processor time [s].
    """

    settings: Settings
    flight: Flight
    outcome: Outcome
    errors: VertexErrors
    processor: float

    @property
    def loss(self) -> LossOutcome | None:
        """What became of the others after the loss of a drone; None where none was lost."""
        lost = self.flight.lost
        return None if lost is None else loss_outcome(self.flight, lost)

    @property
    def run(self) -> Run:
        """Figures of the flight."""
        record, errors, times = self.flight.record, self.errors, self.flight.film.t
        simulated = float(times[-1] - times[0]) if len(times) else 0.0  # settling included
        return Run(
            self.settings.seed,
            self.outcome.verdict,
            self.outcome.failures,
            Spread.of(errors.errors),
            Spread.of(errors.errors[~errors.moving]),
            Spread.of(errors.errors[errors.moving]),
            Spread.of(errors.without_sag),
            Spread.of(tracking_errors(self.flight)),
            float(np.max(record.peak_tensions)),
            float(np.max(record.thrusts)),
            float(np.mean(record.saturated)),
            simulated / max(self.processor, 1e-9),
            **{name: self._worst(name) for name in ("placed", "tilted", "slipped")},
        )

    def _worst(self, name: str) -> float:
        """Return the largest value of a figure of the objects; nan without any."""
        values = [getattr(state, name) for state in self.outcome.objects]
        return float(np.fmax.reduce([np.nan, *values]))


def simulate(task: Task, settings: Settings, progress: Progress | None = None) -> Simulation:
    """Return the judged flight of a task.

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
    begin = time.process_time()
    flight = fly(task, settings, progress)
    processor = time.process_time() - begin
    return Simulation(settings, flight, judge(flight), vertex_errors(flight), processor)
