"""Deviations of a flight from its plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch.cable_parts import CableParts
from hitchopt.simulation.flight_records import Flight
from hitchopt.values import Array

STILL = 1e-6
"""Largest movement from one sample to the next of a vertex that is at rest [m], and largest change
of a tension that is steady, over the team's."""

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
    """Errors of the vertices while the plan has a hitch, and until it has rested.

    Attributes
    ----------
    t: (samples,) [s]
    rows: samples of the flight's record (samples,).
    planned: planned vertices (samples, clasps, 3) [m].
    offsets: (samples, clasps, 3) [m], from the planned vertices; nan where cables do not bear on
        each other.
    moving: whether the plan moves any vertex or changes any tension (samples,): a hitch that is
        being drawn tight is not at rest yet.
    """

    t: Array
    rows: NDArray[np.intp]
    planned: Array
    offsets: Array
    moving: NDArray[np.bool_]

    @property
    def errors(self) -> Array:
        """(samples, clasps) [m]: distances in three dimensions, sag included."""
        distances: Array = np.linalg.norm(self.offsets, axis=-1)
        return distances

    @property
    def without_sag(self) -> Array:
        """(samples, clasps) [m]: the level part of the distances."""
        level: Array = np.linalg.norm(self.offsets[..., :2], axis=-1)
        return level

    @property
    def lost(self) -> float:
        """Share of samples and vertices at which cables do not bear on each other."""
        return float(np.mean(np.isnan(self.errors))) if self.errors.size else 0.0


def vertex_errors(flight: Flight) -> VertexErrors:
    """Return the errors at the samples of a flight at which its plan has a hitch, drawn tight.

    The first sample does not count: no contact forces were gathered before it. After its end a plan
    stands still; the time of rest counts, the pull test does not.
    """
    task, record = flight.task, flight.record
    clasps, formed = task.team.layout.clasps, np.flatnonzero(task.formed)
    times, vertices = task.t[formed], task.vertices[formed]
    end = np.fmax(task.duration, flight.rested) + SAME_SAMPLE
    rows = np.flatnonzero((record.t > SAME_SAMPLE) & (record.t <= end))
    asked = task.t[0] + np.minimum(record.t[rows], task.duration)
    nearest = np.searchsorted(0.5 * (times[1:] + times[:-1]), asked)
    near = np.zeros(len(rows), dtype=np.bool_)
    if formed.size:
        near = np.abs(times[nearest] - asked) <= SAMPLE_SLACK
        near &= np.all(task.tensions[formed[nearest]] >= TIGHT * task.team.tension, axis=-1)
    rows, place = rows[near], nearest[near]
    step = np.zeros(len(formed))
    shifts = np.linalg.norm(np.diff(vertices, axis=0), axis=-1)
    changes = np.abs(np.diff(task.tensions[formed], axis=0)) / task.team.tension
    step[1:] = np.max(np.concatenate([shifts, changes], axis=-1), axis=-1, initial=0.0)
    planned = vertices[place][:, clasps]
    moving = (step[place] > STILL) & (record.t[rows] <= task.duration + SAME_SAMPLE)
    return VertexErrors(record.t[rows], rows, planned, record.vertices[rows] - planned, moving)


def effective_lengths(flight: Flight) -> Array:
    """Return (n,) [m]: legs, edges and the arcs of their sag, between vertices at rest.

    It is how long the cables are for the hitch; nan where the flight did not rest in a hitch, or
    lost a drone.
    """
    record, team = flight.record, flight.task.team
    rows = (record.t > flight.task.duration + SAME_SAMPLE) & (record.t <= flight.rested)
    if not rows.any() or not flight.task.formed[-1] or flight.lost is not None:
        return np.full(team.robots, np.nan)
    drones = np.mean(record.drones[rows], axis=0)
    vertices = np.empty((team.layout.points, 3))
    vertices[team.layout.anchors] = drones  # a chain's ends; clasps follow
    vertices[team.layout.clasps] = np.mean(record.vertices[rows], axis=0)
    parts = CableParts.of(team, drones[None], vertices[None])
    found: Array = parts.lengths(flight.density, np.mean(record.tensions[rows], axis=0)[None])[0]
    return found


def tracking_errors(flight: Flight) -> Array:
    """Return (samples, 2n) [m]: distances of drones from their commands, until the flight's end."""
    record = flight.record
    during = record.t <= flight.task.duration + SAME_SAMPLE
    errors: Array = np.linalg.norm(record.drones[during] - record.commanded[during], axis=-1)
    return errors
