"""Where drones and cables leave what a plan was certified for: tracking, tensions, ground, walls.

Contacts of drones and objects, clasps and the places of objects are judged in ``judgement``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.vectors import length
from hitchopt.lab.simulation.record import REST_HEIGHT, SimulatedFlight, ground_of
from hitchopt.lab.simulation.task import TeamTask
from hitchopt.lab.simulation.world import BODY_HALF_HEIGHT
from hitchopt.motion.motion import Motion
from hitchopt.values import Array

DEPARTURES = OFF, SNAPPED, GROUND, WALL = "off", "snapped", "ground", "wall"
"""Kinds of failures of this module."""

MAX_TENSION_RATIO = 5.0
"""Largest tension of a cable over its largest planned one: beyond, it was pulled taut with a jerk.
"""

CONTACT = 1e-3  # [m] Largest gap at which bodies touch the ground, and smallest passage of a wall

LOW = 0.1
"""[m] Planned height above the ground, in addition to errors, below which drones may stand on it:
they leave it late and land early."""

ROUNDING = 1e-5  # [s] Rounding error of sample times


@dataclass(frozen=True)
class Failure:
    """One failure at a time [s] from the flight's start, in words; ``where`` are names.

    Kinds are those of ``judgement.UNSIMULATED``; ``touch``, ``unlinked``, ``tangled``, ``lost``
    (cables that do not bear on each other), ``slipped`` (in the pull test); ``off`` (a drone
    farther from its plan than the tracking errors), ``snapped`` (a tension far beyond the plan's),
    ``ground``, ``wall``; of objects ``dropped``, ``misplaced`` and ``caught`` (not free at the
    end).
    """

    kind: str
    where: tuple[str, ...]
    time: float
    words: str


def departures(flight: SimulatedFlight) -> Iterator[Failure]:
    """Yield the failures of drones and cables until the loss of a robot, one each of a kind."""
    lost, error = flight.settings.lost, flight.error
    if error is not None and error.time < 0.0:  # it ended before it began
        return
    end = np.inf if lost is None else lost.time
    yield from _snapped(flight, min(end, np.fmax(flight.task.duration, flight.rested) + ROUNDING))
    first = 0
    for part in flight.task.teams:
        drones = slice(first, first + part.team.drones)
        first = drones.stop
        if part.motion is not None:
            team = _TeamInFlight(flight, part, part.motion, drones, min(end, part.duration))
            yield from team.off()
            yield from team.on_ground()
            yield from team.beyond_walls()


def _snapped(flight: SimulatedFlight, end: float) -> Iterator[Failure]:
    """Yield tensions far beyond the plan's."""
    record, names = flight.record, flight.cable_names
    planned = np.max(flight.task.states.tensions, axis=0)
    rows = record.t <= end
    peaks = record.peak_tensions[rows]
    excess = np.where(planned > 0.0, peaks - MAX_TENSION_RATIO * planned, -np.inf)

    def words(row: int, cable: int) -> str:
        """Return the tension and its time."""
        tension = peaks[row, cable]
        return (
            f"the tension of {names[cable]} reaches {tension:.3g} N at t = {record.t[row]:.2f} s, "
            f"{tension / planned[cable]:.3g} times the largest planned one "
            f"({planned[cable]:.3g} N); the limit is {MAX_TENSION_RATIO:g} times"
        )

    yield from _failures(SNAPPED, names, record.t[rows], excess, words)


def _failures(
    kind: str, names: Sequence[str], t: Array, excess: Array, words: Callable[[int, int], str]
) -> Iterator[Failure]:
    """Yield a failure for every name whose ``excess`` (samples, names) is positive at any time.

    Its time is the first one; ``words`` of the sample and index of its largest excess describe it.
    """
    for i in np.flatnonzero(np.any(excess > 0.0, axis=0)).tolist():
        first, largest = int(np.argmax(excess[:, i] > 0.0)), int(np.argmax(excess[:, i]))
        yield Failure(kind, (names[i],), float(t[first]), words(largest, i))


def _outside(names: Sequence[str], t: Array, depths: Array) -> Iterator[Failure]:
    """Yield bodies that are beyond walls by ``depths`` (samples, names) [m]."""

    def words(row: int, i: int) -> str:
        """Return the depth and its time."""
        depth = 100.0 * depths[row, i]
        return f"{names[i]} is {depth:.1f} cm beyond a wall of the arena at t = {t[row]:.2f} s"

    yield from _failures(WALL, names, t, depths - CONTACT, words)


@dataclass(frozen=True, eq=False)
class _TeamInFlight:
    """One team in a flight, until a time ``end`` [s] and before the rest after the plan."""

    flight: SimulatedFlight
    part: TeamTask
    motion: Motion
    drones: slice  # of the flight's drones
    end: float

    @property
    def rows(self) -> NDArray[np.intp]:
        """Rows of the record."""
        return np.flatnonzero(self.flight.record.t <= self.end + ROUNDING)

    @property
    def names(self) -> Sequence[str]:
        """Names of the drones."""
        return self.flight.task.team.drone_names[self.drones]

    @property
    def cables(self) -> Sequence[str]:
        """Names of the cables."""
        return self.flight.cable_names[self.drones.start // 2 : self.drones.stop // 2]

    @property
    def _drones(self) -> Array:
        """Positions of the drones (samples, 2n, 3) [m]."""
        return self.flight.record.drones[:, self.drones]

    def _phase(self, row: int) -> str:
        """Return the name of the plan's phase at a row of the record."""
        piece = self.part.pieces[self.flight.record.index[row]]
        name: str = self.motion.phases[self.motion.phase_of_piece[piece]].name
        return name

    def off(self) -> Iterator[Failure]:
        """Yield drones that are farther from their planned positions than the tracking errors."""
        record, tube = self.flight.record, self.motion.requirements.limits.tube
        if not tube.level:
            return
        rows = self.rows
        t = record.t[rows]
        errors = self._drones[rows] - self.part.states.positions[record.index[rows]]
        scaled = length(errors / np.array([1.0, 1.0, tube.ratio]))

        def words(row: int, drone: int) -> str:
            """Return the error, its time and phase."""
            error = 100.0 * float(length(errors[row, drone]))
            return (
                f"{self.names[drone]} is {error:.3g} cm off at t = {t[row]:.2f} s "
                f"({self._phase(rows[row])}), more than limits.tracking ({tube})"
            )

        yield from _failures(OFF, self.names, t, scaled - tube.level, words)

    def on_ground(self) -> Iterator[Failure]:
        """Yield drones that touch the ground in flight, and cables where they should be above."""
        record, ground = self.flight.record, ground_of(self.flight.task)
        error = self.motion.requirements.limits.tube.largest
        planned = self.part.states.positions[..., 2]
        may_stand = planned <= ground + REST_HEIGHT + error + LOW  # (samples, drones)
        rows = self.rows
        depths = ground + BODY_HALF_HEIGHT + CONTACT - self._drones[rows, :, 2]
        depths[may_stand[record.index[rows]]] = -np.inf

        def words(row: int, drone: int) -> str:
            """Return the planned height and its time."""
            height = planned[record.index[rows[row]], drone] - ground
            at = f"at t = {record.t[rows[row]]:.2f} s"
            return f"{self.names[drone]} touches the ground {at}, {height:.2f} m below its plan"

        yield from _failures(GROUND, self.names, record.t[rows], depths, words)
        may_lie = may_stand[:, 0::2] | may_stand[:, 1::2]
        may_lie |= self.motion.in_states(lambda state: state.on_ground)[self.part.pieces, None]
        taken_off = self.motion.drones.at(self.part.states.t)[..., 2] - planned < CONTACT
        may_lie |= ~np.all(taken_off, axis=1, keepdims=True)  # before the plan, in an export
        t, nodes = self._shapes
        lowest = np.stack([np.min(each[..., 2], axis=1) for each in nodes], axis=1)
        radius = 0.5 * self.flight.settings.preset.diameter
        depths = ground + radius + CONTACT - lowest
        depths[may_lie[[self.part.index(time) for time in t]]] = -np.inf

        def words_on_cable(row: int, cable: int) -> str:
            """Return the time."""
            return f"{self.cables[cable]} touches the ground at t = {t[row]:.2f} s"

        yield from _failures(GROUND, self.cables, t, depths, words_on_cable)

    def beyond_walls(self) -> Iterator[Failure]:
        """Yield drones and cables that pass a wall or the ceiling of the arena."""
        arena = self.motion.requirements.arena
        if arena is None:
            return
        lower, upper = arena.lower - [0.0, 0.0, np.inf], arena.upper  # the ground is not a wall

        def depth(points: Array) -> Array:
            """Return how far points (…, 3) [m] are beyond the walls [m]."""
            depths: Array = np.max(np.maximum(lower - points, points - upper), axis=-1)
            return depths

        rows = self.rows
        yield from _outside(self.names, self.flight.record.t[rows], depth(self._drones[rows]))
        t, nodes = self._shapes
        depths = np.stack([np.max(depth(each), axis=1) for each in nodes], axis=1)
        yield from _outside(self.cables, t, depths)

    @property
    def _shapes(self) -> tuple[Array, list[Array]]:
        """Times (frames,) [s], and shapes of each cable (frames, nodes, 3) [m]."""
        film = self.flight.film
        frames = (film.t >= 0.0) & (film.t <= self.end + ROUNDING)
        nodes = film.nodes[frames].astype(np.float64)
        cables = np.split(nodes, film.cables[1:-1], axis=1)
        return film.t[frames], cables[self.drones.start // 2 : self.drones.stop // 2]
