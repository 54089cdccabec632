"""Records of a simulated flight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hitchopt.objects import SolidObject
from hitchopt.simulation.drone_control import PositionGains
from hitchopt.simulation.flight_task import Task
from hitchopt.simulation.simulation_settings import Loss
from hitchopt.simulation.validity import InvalidRunError
from hitchopt.values import Array


@dataclass(frozen=True, eq=False)
class Record:
    """Measurements, sample by sample; times count from the flight's start, after settling.

    Attributes
    ----------
    t: (samples,) [s], those of the setpoints, and of rest and pull test after them.
    drones: positions (samples, 2n, 3) [m].
    commanded: commanded positions (samples, 2n, 3) [m]: the setpoints.
    vertices: (samples, clasps, 3) [m], nan where cables do not bear on each other.
    bearing: contact forces (samples, clasps) [N].
    tensions: means over each cable's length (samples, n) [N].
    peak_tensions: largest values over length and time since the last sample (samples, n) [N].
    thrusts: (samples, 2n) [N]
    saturated: whether a drone's command exceeded its thrust (samples, 2n).
    poses: of the objects (samples, objects, 7): positions of their bases [m], and quaternions.
    touched: whether cables touch an object (samples, objects).
    """

    t: Array
    drones: Array
    commanded: Array
    vertices: Array
    bearing: Array
    tensions: Array
    peak_tensions: Array
    thrusts: Array
    saturated: NDArray[np.bool_]
    poses: Array
    touched: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Film:
    """Shapes of the cables over time; settling is included, at negative times.

    Attributes
    ----------
    t: (frames,) [s]
    nodes: (frames, nodes, 3) [m], cable after cable, drones at their ends.
    cables: (n + 1,), first node of each cable, and the number of nodes.
    poses: of the objects (frames, objects, 7): positions of their bases [m], and quaternions.
    wires: (objects, rings, points, 3) [m]: closed outlines of every object in its own frame.
    """

    t: Array
    nodes: NDArray[np.float32]
    cables: NDArray[np.intp]
    poses: NDArray[np.float32]
    wires: NDArray[np.float32]


@dataclass(frozen=True)
class Touch:
    """First contact of two things that should stay apart.

    Attributes
    ----------
    time: [s], from the flight's start.
    first, second: names, such as ``q0`` and ``r2``, or ``q0`` and ``cable 2``.
    """

    time: float
    first: str
    second: str


@dataclass(frozen=True, eq=False)
class Flight:
    """A flight that was simulated to its end, or until the simulation became invalid.

    Attributes
    ----------
    task: what was flown.
    record: measurements over the flight, rest and pull test.
    film: shapes of the cables over all of it.
    touches: first contacts, by time.
    linking: linking numbers (n, n) of all pairs of cables after the rest; None if not reached.
    rested, pulled: times [s] at which rest and pull test ended; nan if they did not.
    density: of the simulated cables [kg/m].
    least_bearing: contact forces (clasps,) [N] from which on a clasp bears at the end; zero without
        a hitch.
    gains: of the drones' position loops.
    longer: largest length that a rope has more than its cable [m]; the bends of thick ropes use it
        up, so that the planned length is the effective one.
    error: what ended the flight early, or None.
    ground: height of the ground [m].
    lost: the drone whose motors stopped, or None.
    objects: as they really were: masses, friction and where they stood.
    """

    task: Task
    record: Record
    film: Film
    touches: tuple[Touch, ...]
    linking: NDArray[np.int64] | None
    rested: float
    pulled: float
    density: float
    least_bearing: Array
    gains: PositionGains
    longer: float
    error: InvalidRunError | None
    ground: float = 0.0
    lost: Loss | None = None
    objects: Mapping[str, SolidObject] = field(default_factory=dict)
