"""Verdicts at every rest of a flight: where steps end with a taut hitch, and after the plan.

Every step of a mission ends at rest. Values are means over the time at rest before the step ends,
a second at most; a step that ends without staying at rest is judged by its last tenth of a second.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import OneLine
from hitchopt.geometry.vectors import length
from hitchopt.hitch.flight_controller import Tube
from hitchopt.lab.simulation.contacts import least_bearing
from hitchopt.lab.simulation.flight import SimulatedFlight
from hitchopt.lab.simulation.judgement import (
    AVERAGING_TIME,
    ROUNDING,
    ObjectState,
    Outcome,
    Spread,
    allowed_errors,
    clasp_links,
    object_states,
    resting_samples,
    taut_samples,
)
from hitchopt.lab.simulation.ropes import linking_matrix
from hitchopt.lab.simulation.task import TeamTask
from hitchopt.values import Array

SHORTEST = 0.1  # Shortest time over which values at rest are averaged [s]
AFTER = "rest"  # Name of the rest after the plan


@dataclass(frozen=True)
class VertexAtRest:
    """One vertex at a rest: its error [m], and whether it holds."""

    mean: float
    deviation: float
    largest: float
    linking: int  # linking number of its two cables, over their clasps; ±1 for a clasp
    bearing: float  # mean contact force [N]
    # whether it is linked once and bears; after the plan, also whether it does not slip if pulled
    holds: bool


@dataclass(frozen=True, eq=False)
class Rest(OneLine):
    """A rest of one team: its vertices, the errors of its drones, and objects."""

    phase: str  # name of the phase that ends there, or ``rest`` after the plan
    start: float  # from which values are averaged [s]
    end: float  # [s]
    vertices: dict[str, VertexAtRest]  # by name
    drones: tuple[float, float]  # largest error of a drone, level and upright [m]
    allowed: Tube  # tracking errors that the plan allows for
    objects: tuple[ObjectState, ...]  # all movable ones

    @property
    def hitched(self) -> bool:
        """Whether all vertices hold."""
        return all(vertex.holds for vertex in self.vertices.values())

    def to_dict(self) -> dict[str, Any]:
        """Return the rest as data for JSON."""
        level, upright = self.drones
        return {
            "phase": self.phase,
            "start": self.start,
            "end": self.end,
            "vertices": {name: asdict(vertex) for name, vertex in self.vertices.items()},
            "drones": {"level": level, "height": upright, "allowed": asdict(self.allowed)},
            "objects": [asdict(each) for each in self.objects],
        }


def rests(flight: SimulatedFlight, outcome: Outcome) -> tuple[Rest, ...]:
    """Return all rests of a flight with a taut hitch, by time; ``outcome`` judges the last one."""
    task, found = flight.task, list[Rest]()
    holds_at_end = {clasp.name: clasp.holds for clasp in outcome.clasps}
    clasps = drones = slice(0, 0)
    for part in task.teams:
        clasps = slice(clasps.stop, clasps.stop + len(part.team.layout.clasps))
        drones = slice(drones.stop, drones.stop + part.team.drones)
        spans = [*_spans(part)]
        if part.states.formed[-1] and np.isfinite(flight.rested):
            spans.append((AFTER, flight.rested - AVERAGING_TIME, flight.rested))
        for phase, start, end in spans:
            rows = np.flatnonzero(
                (flight.record.t > start + ROUNDING) & (flight.record.t <= end + ROUNDING)
            )
            if rows.size and flight.record.t[-1] >= end - ROUNDING:
                last = holds_at_end if phase == AFTER else {}
                vertices = _vertices(flight, rows, end, clasps, last)
                errors = _drone_errors(flight, rows, drones)
                objects = object_states(flight, end, end - start)
                allowed = allowed_errors(flight)
                found.append(Rest(phase, start, end, vertices, errors, allowed, objects))
    return tuple(sorted(found, key=lambda rest: rest.end))


def _spans(part: TeamTask) -> Iterator[tuple[str, float, float]]:
    """Yield name, start and end [s] of the rests at which steps of a team end, its last excluded.

    Only rests with a taut hitch are yielded. Times count from the flight's start.
    """
    if part.motion is None:
        return
    t, phases = part.states.t - part.states.t[0], part.motion.phases
    taut = taut_samples(part)
    still = taut & resting_samples(part)
    for phase, following in pairwise(phases):
        if phase.step == following.step:
            continue
        end = phase.end - float(part.states.t[0])
        index = part.index(end)
        if not taut[index]:
            continue
        moving = np.flatnonzero(~still[: index + 1])
        since = t[moving[-1]] if moving.size else t[0]
        yield phase.name, float(min(max(since, end - AVERAGING_TIME), end - SHORTEST)), end


def _vertices(
    flight: SimulatedFlight,
    rows: NDArray[np.intp],
    end: float,
    clasps: slice,
    holds_at_end: dict[str, bool],
) -> dict[str, VertexAtRest]:
    """Return the vertices of a team at rows of the record that end at a time [s]."""
    task, record, layout = flight.task, flight.record, flight.task.team.layout
    index = record.index[rows]
    planned = task.states.vertices[index][:, layout.clasps[clasps]]
    errors = length(record.vertices[rows][:, clasps] - planned)
    bearing = np.mean(record.bearing[rows][:, clasps], axis=0)
    least = least_bearing(task)[index[-1], clasps]
    links = clasp_links(_linking(flight, end), layout)[clasps]
    vertices = {}
    for c, point in enumerate(layout.clasps[clasps].tolist()):
        name, spread = task.team.point_names[point], Spread.of(errors[:, c])
        bears = bool(bearing[c] >= least[c] > 0.0)
        holds = holds_at_end.get(name, bears and abs(int(links[c])) == 1)
        linking, force = int(links[c]), float(bearing[c])
        vertices[name] = VertexAtRest(**vars(spread), linking=linking, bearing=force, holds=holds)
    return vertices


def _linking(flight: SimulatedFlight, end: float) -> NDArray[np.int64]:
    """Return the linking numbers (n, n) of all cables in the last frame up to a time [s]."""
    film = flight.film
    frame = max(int(np.searchsorted(film.t, end + ROUNDING, side="right")) - 1, 0)
    return linking_matrix(np.split(film.nodes[frame].astype(np.float64), film.cables[1:-1]))


def _drone_errors(
    flight: SimulatedFlight, rows: NDArray[np.intp], drones: slice
) -> tuple[float, float]:
    """Return the largest distances of drones from their planned places, level and upright [m]."""
    record = flight.record
    planned: Array = flight.task.states.positions[record.index[rows]][:, drones]
    errors = record.drones[rows][:, drones] - planned
    level = np.hypot(errors[..., 0], errors[..., 1])
    return float(np.max(level)), float(np.max(np.abs(errors[..., 2])))
