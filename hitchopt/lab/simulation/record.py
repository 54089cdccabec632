"""The record of a simulated flight: samples, shapes of the cables, and how it ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch.team import Layout
from hitchopt.lab.simulation.control import PositionGains
from hitchopt.lab.simulation.ropes import linking_matrix
from hitchopt.lab.simulation.settings import CLASPS, Settings
from hitchopt.lab.simulation.task import Task
from hitchopt.lab.simulation.world import BODY_HALF_HEIGHT, InvalidRunError, cable_names
from hitchopt.objects import SolidObject
from hitchopt.values import Array

FRAME_PERIOD = 0.04  # [s] Period of recorded cable shapes
REPORT_PERIOD = 50  # Samples between two calls of ``progress``
REST_HEIGHT = BODY_HALF_HEIGHT + 0.005  # [m] Height of the centre of a drone on the ground
ROUNDING = 1e-5  # [s] Rounding error of sample times


@dataclass(frozen=True, eq=False)
class FlightSamples:
    """Samples of a flight; times start at the flight's start, after settling."""

    t: Array  # (samples,) [s], at the rate of the setpoints, rest and pull test included
    index: NDArray[np.intp]  # (samples,), index of the setpoint that applies from this time on
    drones: Array  # positions (samples, 2n, 3) [m]
    commanded: Array  # positions of the setpoints (samples, 2n, 3) [m]
    vertices: Array  # (samples, clasps, 3) [m], nan if cables do not bear on each other
    bearing: Array  # contact forces (samples, clasps) [N]
    tensions: Array  # means over each cable's length (samples, n) [N]
    # largest values over length and time since the last sample (samples, n) [N]
    peak_tensions: Array
    thrusts: Array  # (samples, 2n) [N]
    tilts: Array  # of the drones (samples, 2n) [rad]
    # of the objects (samples, objects, 7): positions of their bases [m], and quaternions
    poses: Array
    touched: NDArray[np.bool_]  # whether cables touch an object (samples, objects)


class FlightSample(NamedTuple):
    """One sample: a row of ``FlightSamples``, with fields in the same order."""

    t: float
    setpoint: int  # `index` there
    drones: Array
    commanded: Array
    vertices: Array
    bearing: Array
    tensions: Array
    peak_tensions: Array
    thrusts: Array
    tilts: Array
    poses: Array
    touched: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Film:
    """Shapes of the cables over time, including settling at negative times."""

    t: Array  # (frames,) [s]
    nodes: NDArray[np.float32]  # (frames, nodes, 3) [m], cable after cable, drones at their ends
    cables: NDArray[np.intp]  # (n + 1,), first node of each cable, and the number of nodes
    poses: NDArray[np.float32]  # of the objects (frames, objects, 7), as in a ``FlightSamples``


@dataclass(frozen=True, eq=False)
class SimulatedFlight:
    """A flight that was simulated to its end, or until the simulation became invalid."""

    task: Task  # of the flight
    settings: Settings  # of the flight, with what they leave to the plan
    record: FlightSamples  # samples
    film: Film  # shapes of the cables
    # times [s] of first forbidden contacts by pairs of names, such as ``("q0", "r2")`` or ``("q0",
    # "cable 2")``
    touches: dict[tuple[str, str], float]
    # linking numbers (n, n) of all pairs of cables after the rest; None if not reached
    linking: NDArray[np.int64] | None
    rested: float  # time at which the rest ended [s]; nan if not reached
    pulled: float  # time at which the pull test ended [s]; nan if not reached
    gains: PositionGains  # of the drones' position loops
    density: Array | float  # of the simulated cables [kg/m], of each (n,) for several teams
    extra_length: float  # largest additional length of a rope [m], for the bends of thick ropes
    # largest distance of a rope's end from its drone [m], which aligns the legs of thick ropes with
    # those of thin cables
    end_offset: float
    objects: dict[str, SolidObject]  # simulated objects by name, with perturbations
    error: InvalidRunError | None  # the error that ended the flight early, or None
    # Pull tests before the plan's end, by time [s]: flights of the plan up to there, whose records
    # begin with the last second before
    pull_tests: Mapping[float, SimulatedFlight] = field(default_factory=dict)

    def links_at(self, time: float) -> NDArray[np.int64]:
        """Return the linking numbers (n, n) of all cables in the last frame up to a time [s]."""
        if self.settings.cables == CLASPS:
            return layout_links(self.task.team.layout)
        film = self.film
        frame = max(int(np.searchsorted(film.t, time + ROUNDING, side="right")) - 1, 0)
        return linking_matrix(np.split(film.nodes[frame].astype(np.float64), film.cables[1:-1]))

    @property
    def cable_names(self) -> list[str]:
        """Names of cables (n,): cable 0, cable 1, …, or a.cable 0, … for several teams."""
        return cable_names(self.task.team.drone_names)


def layout_links(layout: Layout) -> NDArray[np.int64]:
    """Return the linking numbers (n, n) of the cables of a closed hitch, one per clasp."""
    links = np.zeros((layout.robots, layout.robots), dtype=np.int64)
    np.add.at(links, (layout.behind, layout.ahead), 1)
    return links + links.T


def ground_of(task: Task) -> float:
    """Return the height of the ground [m], without objects below the lowest drone.

    Without a ground it is below all cables.
    """
    lowest = float(np.min(task.states.positions[..., 2])) - REST_HEIGHT
    floor = task.cargo.floor
    if floor is None:
        return lowest - float(np.max(task.team.cable_length))
    return floor if task.cargo.objects else min(floor, lowest)
