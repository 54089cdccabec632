"""Deviations of a flight from its plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.simulation.drone_control import POSITION_GAIN
from hitchopt.simulation.flight_records import Flight
from hitchopt.simulation.hitch_sag import predicted_sag

Array = NDArray[np.float64]

SAGS = 100
"""Number of times at which the sag is predicted; it is interpolated in between."""

STILL = 1e-6
"""Largest movement from one sample to the next of a vertex that is at rest [m]."""

TIGHT = 0.5
"""Least tension over the team's at which a vertex counts; a hitch that is being drawn tight has
ill-defined vertices."""

SAMPLE_SLACK = 5.1e-3
"""Largest delay of a sample after its setpoint [s]: it is taken at the first command after it."""

SAME_SAMPLE = 1e-5
"""Rounding of sample times [s]."""


@dataclass(frozen=True)
class Spread:
    """Mean, standard deviation and largest value of some errors, as the paper gives them.

    Attributes
    ----------
    mean, deviation, largest: nan where there are no errors.
    """

    mean: float
    deviation: float
    largest: float

    @classmethod
    def of(cls, errors: Array) -> Spread:
        """Return the spread of the errors that exist (not nan)."""
        there = errors[np.isfinite(errors)]
        if not there.size:
            return cls(np.nan, np.nan, np.nan)
        return cls(float(np.mean(there)), float(np.std(there)), float(np.max(there)))


@dataclass(frozen=True, eq=False)
class VertexErrors:
    """Distances of the vertices from the plan's, while the plan has a hitch.

    Attributes
    ----------
    t: (samples,) [s]
    rows: samples of the flight's record (samples,).
    planned: planned vertices (samples, clasps, 3) [m].
    sag: (samples, clasps) [m], predicted for the cables' weight, which the plan neglects.
    errors: (samples, clasps) [m], distances; nan where cables do not bear on each other.
    without_sag: (samples, clasps) [m], distances from the planned vertices less the sag.
    moving: whether the plan moves any vertex (samples,).
    """

    t: Array
    rows: NDArray[np.intp]
    planned: Array
    sag: Array
    errors: Array
    without_sag: Array
    moving: NDArray[np.bool_]

    @property
    def lost(self) -> float:
        """Share of samples and vertices at which cables do not bear on each other."""
        return float(np.mean(np.isnan(self.errors))) if self.errors.size else 0.0


def vertex_errors(flight: Flight) -> VertexErrors:
    """Return the errors at the samples of a flight at which its plan has a hitch, drawn tight.

    The first sample does not count: no contact forces were gathered before it.
    """
    task, record = flight.task, flight.record
    clasps, formed = task.team.layout.clasps, np.flatnonzero(task.formed)
    times, vertices = task.t[formed], task.vertices[formed]
    rows = np.flatnonzero((record.t > SAME_SAMPLE) & (record.t <= task.duration + SAME_SAMPLE))
    asked = record.t[rows] + task.t[0]
    nearest = np.searchsorted(0.5 * (times[1:] + times[:-1]), asked)
    near = np.zeros(len(rows), dtype=np.bool_)
    if formed.size:
        near = np.abs(times[nearest] - asked) <= SAMPLE_SLACK
        near &= np.all(task.tensions[formed[nearest]] >= TIGHT * task.team.tension, axis=-1)
    rows, place = rows[near], nearest[near]
    step = np.zeros(len(formed))
    step[1:] = np.max(np.linalg.norm(np.diff(vertices, axis=0), axis=-1), axis=-1, initial=0.0)
    planned, sag = vertices[place][:, clasps], _sags(flight, formed[place])[:, clasps]
    offset = record.vertices[rows] - planned
    raised = offset + sag[..., None] * [0.0, 0.0, 1.0]
    return VertexErrors(
        record.t[rows],
        rows,
        planned,
        sag,
        np.linalg.norm(offset, axis=-1),
        np.linalg.norm(raised, axis=-1),
        step[place] > STILL,
    )


def _sags(flight: Flight, rows: NDArray[np.intp]) -> Array:
    """Return (rows, points) [m], predicted for some rows of the plan and interpolated between."""
    task, ranks = flight.task, np.arange(len(rows))
    points, stiffness = task.team.layout.points, POSITION_GAIN * task.team.mass[::2]
    if not len(rows):
        return np.zeros((0, points))
    chosen = np.unique(np.linspace(0, len(rows) - 1, min(SAGS, len(rows))).round().astype(np.intp))
    at = rows[chosen]
    planned = zip(task.setpoints.positions[at], task.vertices[at], task.tensions[at], strict=True)
    sags = np.array([predicted_sag(task.team, flight.density, *x, stiffness) for x in planned])
    return np.column_stack([np.interp(ranks, chosen, sags[:, p]) for p in range(points)])


def tracking_errors(flight: Flight) -> Array:
    """Return (samples, 2n) [m]: distances of drones from their commands, until the flight's end."""
    record = flight.record
    during = record.t <= flight.task.duration + SAME_SAMPLE
    errors: Array = np.linalg.norm(record.drones[during] - record.commanded[during], axis=-1)
    return errors
