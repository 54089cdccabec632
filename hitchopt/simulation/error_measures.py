"""How well a flight kept to its plan, in numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import Team
from hitchopt.simulation.drone_control import POSITION_GAIN
from hitchopt.simulation.flight_records import Flight
from hitchopt.simulation.hitch_sag import predicted_sag
from hitchopt.simulation.setpoint_tables import SAME_SAMPLE, Setpoints, VertexTable

Array = NDArray[np.float64]

SAGS = 100
"""Times at which the sag is predicted; in between it is interpolated."""

STILL = 1e-6
"""[m] A vertex that moves less from one sample to the next stands still."""


@dataclass(frozen=True)
class Spread:
    """Some errors in three numbers, as the paper gives them.

    Attributes
    ----------
    mean, deviation, largest: nan where there are no errors.
    """

    mean: float
    deviation: float
    largest: float

    @classmethod
    def of(cls, errors: Array) -> Spread:
        """Return the spread of those errors that are there (not nan)."""
        there = errors[np.isfinite(errors)]
        if not there.size:
            return cls(np.nan, np.nan, np.nan)
        return cls(float(np.mean(there)), float(np.std(there)), float(np.max(there)))


@dataclass(frozen=True, eq=False)
class VertexErrors:
    """How far the vertices were from where the plan has them, while it has any.

    Attributes
    ----------
    t: (samples,) [s]
    rows: (samples,), those of the flight's record.
    planned: (samples, clasps, 3) [m]
    sag: (samples, clasps) [m], predicted of cables with weight, which the plan leaves out.
    errors: (samples, clasps) [m], distances; nan where cables do not bear on each other.
    without_sag: (samples, clasps) [m], the same to where the sag lets the plan's vertex be.
    moving: (samples,), whether the plan moves any vertex then.
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


def vertex_errors(
    flight: Flight, team: Team, setpoints: Setpoints, vertices: VertexTable
) -> VertexErrors:
    """Return the errors at those samples of the flight at which the plan has a hitch, drawn tight.

    Parameters
    ----------
    flight: simulated; its first sample, in which nothing has been gathered, does not count.
    team: who flew.
    setpoints, vertices: the plan's tables.
    """
    clasps = team.layout.clasps
    record, begin = flight.record, float(setpoints.t[0])
    rows = np.flatnonzero((record.t > SAME_SAMPLE) & (record.t <= flight.duration + SAME_SAMPLE))
    place = _nearest(vertices.t, record.t[rows] + begin, SAMPLE_SLACK)
    rows, place = rows[place >= 0], place[place >= 0]
    tight = np.all(vertices.tensions[place] >= TIGHT * team.tension, axis=-1)
    rows, place = rows[tight], place[tight]
    planned = vertices.positions[place][:, clasps]
    sag = _sags(team, flight.density, setpoints, vertices, place)[:, clasps]
    offset = record.vertices[rows] - planned
    lowered = offset.copy()
    lowered[..., 2] += sag
    step = np.zeros(len(vertices.t))
    if len(vertices.t) > 1:
        paces = np.max(np.linalg.norm(np.diff(vertices.positions, axis=0), axis=-1), axis=-1)
        step[1:] = paces
    return VertexErrors(
        record.t[rows],
        rows,
        planned,
        sag,
        np.linalg.norm(offset, axis=-1),
        np.linalg.norm(lowered, axis=-1),
        step[place] > STILL,
    )


TIGHT = 0.5
"""Of the team's tension; with less, while a hitch is being drawn tight, its place means little."""

SAMPLE_SLACK = 5.1e-3
"""[s] A sample is taken at the first command after its setpoint."""


def _nearest(times: Array, asked: Array, within: float) -> NDArray[np.intp]:
    """Return the indices of the times nearest to those asked for, -1 where none is near."""
    if not len(times):
        return np.full(len(asked), -1)
    after = np.clip(np.searchsorted(times, asked), 1, max(len(times) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(times) - 1)
    nearer = np.where(np.abs(times[after] - asked) < np.abs(times[before] - asked), after, before)
    found: NDArray[np.intp] = np.where(np.abs(times[nearer] - asked) <= within, nearer, -1)
    return found


def _sags(
    team: Team,
    density: float,
    setpoints: Setpoints,
    vertices: VertexTable,
    rows: NDArray[np.intp],
) -> Array:
    """Return (rows, points) [m], predicted at some rows and interpolated at the others."""
    points = team.layout.points
    if not len(rows):
        return np.zeros((0, points))
    chosen = np.unique(np.linspace(0, len(rows) - 1, min(SAGS, len(rows))).round().astype(np.intp))
    told = _nearest(setpoints.t, vertices.t[rows[chosen]], SAME_SAMPLE)
    sags = np.array(
        [
            predicted_sag(
                team,
                density,
                setpoints.positions[i],
                vertices.positions[row],
                vertices.tensions[row],
                POSITION_GAIN * team.mass[::2],
            )
            for i, row in zip(told, rows[chosen], strict=True)
        ]
    )
    ranks = np.arange(len(rows))
    return np.column_stack([np.interp(ranks, chosen, sags[:, p]) for p in range(points)])


def tracking_errors(flight: Flight) -> Array:
    """Return (samples, 2n) [m]: drones to where they were told to be, until the flight's end."""
    record = flight.record
    during = record.t <= flight.duration + SAME_SAMPLE
    errors: Array = np.linalg.norm(record.drones[during] - record.told[during], axis=-1)
    return errors
