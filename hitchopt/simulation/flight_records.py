"""What a simulated flight leaves behind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import HitchoptError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Record:
    """What was measured, sample by sample; times from the flight's start, settling is not in it.

    Attributes
    ----------
    t: (samples,) [s], those of the setpoints, and of rest and pull test after them.
    drones: (samples, 2n, 3) [m], where they are.
    told: (samples, 2n, 3) [m], where they were told to be: their setpoints, moved aside where
        thick ropes ask for it.
    vertices: (samples, clasps, 3) [m], nan where cables do not bear on each other.
    bearing: (samples, clasps) [N], how hard they do.
    tensions: (samples, n) [N], the cables' means over their length.
    peak_tensions: (samples, n) [N], their largest over length and time since the last sample.
    thrusts: (samples, 2n) [N]
    saturated: (samples, 2n), whether a drone wanted more than it has.
    """

    t: Array
    drones: Array
    told: Array
    vertices: Array
    bearing: Array
    tensions: Array
    peak_tensions: Array
    thrusts: Array
    saturated: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Film:
    """The cables over time, for looking at; settling is in it, at negative times.

    Attributes
    ----------
    t: (frames,) [s]
    nodes: (frames, nodes, 3) [m], cable after cable, drones at their ends.
    cables: (n + 1,), where each cable's nodes begin.
    """

    t: Array
    nodes: NDArray[np.float32]
    cables: NDArray[np.intp]


@dataclass(frozen=True)
class TouchEvent:
    """When two things touched first, and what.

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
    """A flight that was simulated to its end, or to where it meant nothing any more.

    Attributes
    ----------
    record: over the flight, rest and pull test.
    film: of all of it.
    events: first touches.
    linking: (n, n), of every pair of cables after the rest; None if that was not reached.
    duration: of the setpoints [s].
    rested, pulled: times [s] at which rest and pull test ended; nan if they did not.
    density: of the simulated cables [kg/m].
    error: what ended it early, or None.
    least_bearing: (clasps,) [N], the contact force from which on a clasp bears in the end; zero
        without a hitch.
    """

    record: Record
    film: Film
    events: tuple[TouchEvent, ...]
    linking: NDArray[np.int64] | None
    duration: float
    rested: float
    pulled: float
    density: float
    error: HitchoptError | None
    least_bearing: Array
