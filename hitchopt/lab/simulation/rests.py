"""Verdicts at every rest of a flight: where steps end with a taut hitch, and after the plan.

Values are means over the time at rest before the step ends, a second at most; a step that ends
without staying at rest is judged by its last tenth of a second. Where all drones stand still, every
vertex is pulled on a copy of the flight that stops there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.drones.controllers import Tube
from hitchopt.errors import OneLine
from hitchopt.geometry.vectors import length
from hitchopt.lab.simulation.contacts import least_bearing
from hitchopt.lab.simulation.judgement import (
    ROUNDING,
    ClaspState,
    ObjectState,
    Outcome,
    Spread,
    allowed_errors,
    clasp_links,
    object_states,
    vertices_of,
)
from hitchopt.lab.simulation.planned_rests import REST_TIME, PlannedRest, pull_tests, rests_of
from hitchopt.lab.simulation.record import SimulatedFlight
from hitchopt.lab.simulation.task import Task, TeamTask
from hitchopt.values import Array

AFTER = "rest"  # Name of the rest after the plan


@dataclass(frozen=True)
class VertexAtRest:
    """One vertex at a rest: its error [m], and whether it holds."""

    mean: float
    deviation: float
    largest: float
    linking: int  # linking number of its two cables; ±1 for a clasp
    bearing: float  # mean contact force [N]
    # slip along its cables in the pull test [m]; nan without one, where other drones move
    moved: float
    holds: bool  # whether it is linked once, bears, and does not slip if it is pulled


@dataclass(frozen=True, eq=False)
class Rest(OneLine):
    """A rest of one team: its vertices, the errors of its drones, and objects."""

    phase: str  # name of the phase that ends there, or ``rest`` after the plan
    start: float  # from which values are averaged [s]
    end: float  # [s]
    vertices: dict[str, VertexAtRest]  # by name, without open ones
    drones: tuple[float, float]  # largest error of a drone, horizontal and vertical [m]
    allowed: Tube  # tracking errors that the plan allows for
    within: bool | None  # whether all drones are within these; None if the plan allows for none
    objects: tuple[ObjectState, ...]  # all movable ones

    def __str__(self) -> str:
        return f"{self.phase}, {self.end:.1f} s"

    @property
    def hitched(self) -> bool:
        """Return whether all vertices hold."""
        return all(vertex.holds for vertex in self.vertices.values())

    def to_dict(self) -> dict[str, Any]:
        """Return the rest as data for JSON."""
        level, upright = self.drones
        return {
            "phase": self.phase,
            "start": self.start,
            "end": self.end,
            "vertices": {name: asdict(vertex) for name, vertex in self.vertices.items()},
            "drones": {
                "level": level,
                "height": upright,
                "allowed": asdict(self.allowed),
                "within": self.within,
            },
            "objects": [asdict(each) for each in self.objects],
        }


def rests(flight: SimulatedFlight, outcome: Outcome) -> tuple[Rest, ...]:
    """Return all rests of a flight with a taut hitch, by time; ``outcome`` judges the last one.

    Nothing rests after the loss of a drone.
    """
    time_of_loss = np.inf if flight.settings.lost is None else flight.settings.lost.time
    t = flight.record.t
    pulled = _pulled_vertices(flight, outcome)
    judged = list[Rest]()
    for team in _teams(flight.task):
        for rest in _planned_rests(flight, team.part):
            rows = np.flatnonzero((t > rest.start + ROUNDING) & (t <= rest.end + ROUNDING))
            is_flown = t[-1] >= rest.end - ROUNDING
            if rows.size and is_flown and rest.end <= time_of_loss:
                judged.append(_judged(flight, team, rest, rows, pulled.get(rest.end, {})))
    return tuple(sorted(judged, key=lambda rest: rest.end))


class _Team(NamedTuple):
    """A team, and its part of the clasps and drones of a flight."""

    part: TeamTask
    clasps: slice
    drones: slice


def _teams(task: Task) -> Iterator[_Team]:
    """Yield the teams of a task."""
    clasps = drones = slice(0, 0)
    for part in task.teams:
        clasps = slice(clasps.stop, clasps.stop + len(part.team.layout.clasps))
        drones = slice(drones.stop, drones.stop + part.team.drones)
        yield _Team(part, clasps, drones)


def _planned_rests(flight: SimulatedFlight, part: TeamTask) -> Iterator[PlannedRest]:
    """Yield the rests of a team in the plan, and the one after it, if the hitch is tied then."""
    yield from rests_of(part)
    if part.states.formed[-1] and np.isfinite(flight.rested):
        yield PlannedRest(AFTER, flight.rested - REST_TIME, flight.rested)


def _pulled_vertices(
    flight: SimulatedFlight, outcome: Outcome
) -> dict[float, dict[str, ClaspState]]:
    """Return the vertices in valid pull tests by name, by the ends of rests that these judge [s].

    The test after the plan judges the rest there, and rests since which no drone moves.
    """
    after_plan = {clasp.name: clasp for clasp in outcome.clasps}
    by_time = {
        time: vertices_of(test) for time, test in flight.pull_tests.items() if test.error is None
    }
    by_time[flight.task.duration] = after_plan
    by_end = {end: by_time.get(test.time, {}) for end, test in pull_tests(flight.task).items()}
    by_end[flight.rested] = after_plan
    return by_end


def _judged(
    flight: SimulatedFlight,
    team: _Team,
    rest: PlannedRest,
    rows: NDArray[np.intp],
    pulled: Mapping[str, ClaspState],
) -> Rest:
    """Return the verdict on a rest of a team at rows of the record; ``pulled`` as of ``_vertices``.

    Open vertices are left out.
    """
    vertices = _vertices(flight, rows, rest.end, team.clasps, pulled)
    exist = team.part.clasps_at(team.part.index(rest.end))
    closed = [x for x, exists in zip(vertices.items(), exist, strict=True) if exists]
    errors, allowed = _drone_errors(flight, rows, team.drones), allowed_errors(flight)
    level = float(np.max(np.hypot(errors[..., 0], errors[..., 1])))
    upright = float(np.max(np.abs(errors[..., 2])))
    return Rest(
        phase=rest.phase,
        start=rest.start,
        end=rest.end,
        vertices=dict(closed),
        drones=(level, upright),
        allowed=allowed,
        within=allowed.contains(errors) if allowed.level else None,
        objects=object_states(flight, rest.end, rest.end - rest.start),
    )


def _vertices(
    flight: SimulatedFlight,
    rows: NDArray[np.intp],
    end: float,
    clasps: slice,
    pulled: Mapping[str, ClaspState],
) -> dict[str, VertexAtRest]:
    """Return the vertices of a team at rows of the record that end at a time [s].

    ``pulled`` are those of the pull test, if there is one.
    """
    task = flight.task
    record = flight.record
    layout = task.team.layout
    index = record.index[rows]
    planned = task.states.vertices[index][:, layout.clasps[clasps]]
    errors = length(record.vertices[rows][:, clasps] - planned)
    bearing = np.mean(record.bearing[rows][:, clasps], axis=0)
    least = least_bearing(task)[index[-1], clasps]
    links = clasp_links(flight.links_at(end), layout)[clasps]
    vertices = {}
    for c, point in enumerate(layout.clasps[clasps].tolist()):
        name = task.team.point_names[point]
        linking = int(links[c])
        tested = pulled.get(name)
        if tested is None:
            moved = np.nan
            holds = abs(linking) == 1 and bool(bearing[c] >= least[c] > 0.0)
        else:
            moved = tested.moved
            holds = tested.holds
        spread = vars(Spread.of(errors[:, c]))
        vertices[name] = VertexAtRest(
            **spread, linking=linking, bearing=float(bearing[c]), moved=moved, holds=holds
        )
    return vertices


def _drone_errors(flight: SimulatedFlight, rows: NDArray[np.intp], drones: slice) -> Array:
    """Return offsets of drones from their planned positions (rows, drones, 3) [m]."""
    record = flight.record
    planned = flight.task.states.positions[record.index[rows]][:, drones]
    errors: Array = record.drones[rows][:, drones] - planned
    return errors
