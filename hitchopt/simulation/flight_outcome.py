"""Outcome of a flight: whether the hitch holds, and otherwise what failed, where and when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.simulation.flight_records import Flight
from hitchopt.simulation.object_outcome import (
    DROPPED,
    PLACED,
    TILTED,
    ObjectState,
    object_states,
)
from hitchopt.simulation.simulation_settings import Loss
from hitchopt.values import Array

HELD = 0.10
"""Largest movement under the pull test of a vertex that is held [m]."""

JUDGED = 0.5
"""Time over which a vertex's position is averaged before the pull test, and at its end [s]."""

SUCCEEDED, FAILED, NOT_SIMULATED = "succeeded", "failed", "not simulated"

START, INVALID = "start", "invalid"
UNSIMULATED = (START, INVALID)
"""Failures of the simulation itself: it could not begin, or left its valid range."""


@dataclass(frozen=True)
class Failure:
    """One failure.

    Attributes
    ----------
    kind: one of UNSIMULATED, which say nothing about the plan, or ``touch``, ``unlinked``,
        ``tangled``, ``lost`` (cables that do not bear on each other), ``slipped`` (moved under the
        pull test); of objects ``dropped``, ``misplaced`` or ``caught`` (not free at the end).
    where: names of drones, cables, vertices or objects.
    time: [s], from the flight's start.
    words: description.
    """

    kind: str
    where: tuple[str, ...]
    time: float
    words: str


@dataclass(frozen=True)
class Clasp:
    """State of one vertex at the end of a flight.

    Attributes
    ----------
    name: p0, p1, ….
    linking: Gauss's linking number of its two cables, ±1 for a clasp. Cables that merely cross may
        have any of 0 and ±1: a clasp bears as well.
    bearing: contact force after the rest [N].
    least_bearing: contact force from which on it bears [N].
    moved: movement under the pull test [m]; nan without one.
    holds: whether it is linked once, bears and is held.
    bears: whether its cables press on each other as those of a clasp do.
    """

    name: str
    linking: int
    bearing: float
    least_bearing: float
    moved: float
    holds: bool
    bears: bool


@dataclass(frozen=True)
class Outcome:
    """Outcome of a flight.

    Attributes
    ----------
    clasps: vertices of a plan that ends with a hitch, once it has rested; else none.
    failures: all failures, by time.
    objects: those that can move.
    """

    clasps: tuple[Clasp, ...]
    failures: tuple[Failure, ...]
    objects: tuple[ObjectState, ...] = ()

    @property
    def verdict(self) -> str:
        """SUCCEEDED, FAILED, or NOT_SIMULATED where nothing but the simulation failed."""
        if self.succeeded:
            return SUCCEEDED
        simulated = any(failure.kind not in UNSIMULATED for failure in self.failures)
        return FAILED if simulated else NOT_SIMULATED

    @property
    def succeeded(self) -> bool:
        """Whether nothing failed."""
        return not self.failures

    @property
    def hitched(self) -> bool:
        """Whether there are vertices and all of them hold."""
        return bool(self.clasps) and all(clasp.holds for clasp in self.clasps)


def judge(flight: Flight) -> Outcome:
    """Return the outcome of a flight.

    Where its plan ends with a hitch every vertex must hold, else the cables must be free of each
    other. Objects must be where the plan puts them, and free unless it ends holding them.
    After the loss of a drone nothing is judged but contacts of survivors.
    """
    if flight.lost is not None:
        return _after_loss(flight, flight.lost)
    failures = [
        Failure("touch", (e.first, e.second), e.time, f"{e.first} touches {e.second}")
        for e in flight.touches
    ]
    if (error := flight.error) is not None:
        failures.append(Failure(INVALID, (error.where,), error.time, str(error)))
    clasps: tuple[Clasp, ...] = ()
    if flight.linking is not None:
        clasps = _clasps(flight, flight.linking) if flight.task.formed[-1] else ()
        failures += _wrong_links(flight, flight.linking)
        failures += [failure for clasp in clasps for failure in _weak(flight, clasp)]
    objects = object_states(flight)
    failures += [failure for each in objects for failure in _mishandled(flight, each)]
    failures.sort(key=lambda failure: failure.time)
    return Outcome(clasps, tuple(failures), objects)


def _after_loss(flight: Flight, lost: Loss) -> Outcome:
    """Return the outcome of a flight in which a drone is lost."""
    names = set(flight.task.team.drone_names) - {lost.drone}
    failures = [
        Failure("touch", (e.first, e.second), e.time, f"{e.first} touches {e.second}")
        for e in flight.touches
        if e.time < lost.time or {e.first, e.second} & names
    ]
    if (error := flight.error) is not None:
        failures.append(Failure(INVALID, (error.where,), error.time, str(error)))
    failures.sort(key=lambda failure: failure.time)
    return Outcome((), tuple(failures))


def _clasps(flight: Flight, links: NDArray[np.int64]) -> tuple[Clasp, ...]:
    """Return the state of every vertex."""
    team, least = flight.task.team, flight.least_bearing
    layout = team.layout
    before, bearing = _means(flight, flight.rested)
    moved = np.linalg.norm(_means(flight, flight.pulled)[0] - before, axis=-1)
    held = (moved <= HELD) | np.isnan(flight.pulled)  # without a pull test both are nan
    linking = links[layout.behind, layout.ahead]
    bears = (bearing >= least) & (least > 0.0)
    holds = (np.abs(linking) == 1) & bears & held & (flight.error is None)
    names = [team.point_names[point] for point in layout.clasps]
    columns = (column.tolist() for column in (linking, bearing, least, moved, holds, bears))
    return tuple(Clasp(*values) for values in zip(names, *columns, strict=True))


def _means(flight: Flight, end: float) -> tuple[Array, Array]:
    """Return mean vertices and contact forces over the last JUDGED seconds until ``end`` [s]."""
    record = flight.record
    chosen = (record.t > end - JUDGED) & (record.t <= end + 1e-9)
    vertices, bearing = record.vertices[chosen], record.bearing[chosen]
    there = np.isfinite(vertices[..., :1])
    count = np.sum(there, axis=0)
    sums = np.sum(np.where(there, vertices, 0.0), axis=0)
    places: Array = np.divide(sums, count, out=np.full_like(sums, np.nan), where=count > 0)
    forces: Array = np.sum(bearing, axis=0) / max(len(bearing), 1)
    return places, forces


def _wrong_links(flight: Flight, linking: NDArray[np.int64]) -> list[Failure]:
    """Return the pairs of cables that are not linked as the plan's end requires."""
    team = flight.task.team
    layout = team.layout
    point = np.full(linking.shape, -1)  # where a pair of cables is to be linked
    if flight.task.formed[-1]:
        point[layout.behind, layout.ahead] = point[layout.ahead, layout.behind] = layout.clasps
    failures = []
    for i, j in np.argwhere(np.triu(np.abs(linking) != (point >= 0), 1)):
        words = f"cables {i} and {j} are linked {linking[i, j]} times, "
        if point[i, j] >= 0:
            name = team.point_names[point[i, j]]
            words = f"{name}: {words}not once"
            failures.append(Failure("unlinked", (name,), flight.rested, words))
        else:
            names, words = (f"cable {i}", f"cable {j}"), f"{words}and should not be"
            failures.append(Failure("tangled", names, flight.rested, words))
    return failures


def _weak(flight: Flight, clasp: Clasp) -> list[Failure]:
    """Return the failures of a clasp that is linked."""
    if abs(clasp.linking) != 1:
        return []
    if not clasp.bears:
        words = (
            f"{clasp.name}: its cables press with {clasp.bearing:.3f} N, less than the "
            f"{clasp.least_bearing:.3f} N from which on a clasp bears: they merely cross"
        )
        return [Failure("lost", (clasp.name,), flight.rested, words)]
    if clasp.moved > HELD:
        words = f"{clasp.name}: moves {clasp.moved:.3f} m under the pull test, more than {HELD} m"
        return [Failure("slipped", (clasp.name,), flight.pulled, words)]
    return []


def _mishandled(flight: Flight, state: ObjectState) -> list[Failure]:
    """Return what went wrong with an object."""
    name, found = state.name, []
    if np.isfinite(state.dropped):
        words = f"{name} is dropped: more than {100 * DROPPED:g} cm below its planned height"
        found.append(Failure("dropped", (name,), state.dropped, words))
    if flight.linking is None:  # the flight never ended
        return found
    if not state.well_placed:
        words = (
            f"{name} is {100 * state.placed:.1f} cm from its place, tilted by {state.tilted:.1f}°, "
            f"turned by {state.turned:.1f}°; at most {100 * PLACED:g} cm and {TILTED:g}°"
        )
        found.append(Failure("misplaced", (name,), flight.rested, words))
    cargo = flight.task.cargo
    if not (state.free or cargo.held[-1, cargo.names.index(name)]):
        found.append(Failure("caught", (name,), flight.rested, f"{name}: cables touch it still"))
    return found
