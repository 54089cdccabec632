"""What a search has to keep, and what becomes of a way: a flight that the judge lets pass."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InfeasibleError
from hitchopt.hitch.leg_lengths import measured
from hitchopt.planners.optimise.knot_path import Way
from hitchopt.planners.optimise.variable_bounds import Bounds
from hitchopt.planners.path.leg_law import CLEAR, sharing_task
from hitchopt.planners.path.path_feasibility import check_loads, check_shapes
from hitchopt.planners.path.shape_path import ShapePath, drones_along, legs_along
from hitchopt.planners.timing.flight_curves import Flight
from hitchopt.planners.timing.speed_profile import TimingError, time_estimate
from hitchopt.planners.timing.time_warp import WarpError
from hitchopt.requirements import Requirements
from hitchopt.trajectory import bernstein

Array = NDArray[np.float64]

HALVINGS = 3
"""Of pieces, to bound their tensions closely."""

GRID = 101
"""Points at which ways are timed to be compared."""

PROBES = 65
"""Points of the path at which distances are looked at before the judge looks at all of it, and
again as many near its ends."""

NEAR_END = 0.1
"""Of the path."""

Judge = Callable[[ShapePath], Flight | None]
"""Flies a path and looks at all of the time: the flight if it keeps every limit, else None."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A way that the judge has let pass.

    Attributes
    ----------
    name: of the guess that it came from.
    flight: along it.
    """

    name: str
    flight: Flight


@dataclass(frozen=True, eq=False)
class Search:
    """What every way of one search has to keep.

    Attributes
    ----------
    requirements: of the problem.
    judge: has the last word on every path.
    tension: smallest and largest [N] where tensions may change on the way.
    end_margins: how many times their limits the first and last hitch keep their distances.
    """

    requirements: Requirements
    judge: Judge
    tension: tuple[float, float] | None
    end_margins: tuple[float, float]

    def bounds(self, margin: float) -> Bounds:
        """Return what the optimiser keeps, distances at ``margin`` times their limits."""
        return Bounds(self.requirements, self.tension, margin, self.end_margins)


def clear(way: Way, search: Search) -> bool:
    """Return whether a way looks as if it could be flown: cheap, and not the last word."""
    path = way.path()
    try:
        check_shapes(path)
        if not _distances_kept(path, search.requirements):
            return False
        check_loads(path, search.requirements.limits)
    except InfeasibleError:
        return False
    return _inside(path, search.requirements)


def judged(way: Way, search: Search) -> Candidate | None:
    """Return what comes of a way if it keeps every limit for all of the time."""
    try:
        flight = search.judge(way.path())
    except (InfeasibleError, TimingError, WarpError):
        return None
    if flight is None or not _tensions_kept(flight, search.tension):
        return None
    return Candidate(way.name, flight)


def promise(way: Way, requirements: Requirements) -> float:
    """Return an estimate of how long a way takes [s], without a limit of jerk, clear or not."""
    return time_estimate(way.path(), requirements.limits, np.linspace(0.0, 1.0, GRID))


def _distances_kept(path: ShapePath, requirements: Requirements) -> bool:
    """Return whether legs are long enough and distances kept, looked at closely near the ends."""
    inner = np.linspace(0.0, 1.0, PROBES)
    s = np.concatenate([inner, NEAR_END * inner[1:-1], 1.0 - NEAR_END * inner[1:-1]])
    s = np.unique(s)
    shortest = float(np.min(legs_along(path, s)[1:-1]))
    return (
        shortest >= requirements.limits.leg
        and measured(sharing_task(path, requirements, s, CLEAR)) >= CLEAR
    )


def _tensions_kept(flight: Flight, tension: tuple[float, float] | None) -> bool:
    """Return whether tensions stay within their range, by the hulls of their polynomials."""
    if tension is None:
        return True
    pieces = [flight.tensions.coefficients]
    for _ in range(HALVINGS):
        pieces = [half for piece in pieces for half in bernstein.halve(piece)]
    least, most = min(float(np.min(p)) for p in pieces), max(float(np.max(p)) for p in pieces)
    slack = 1e-9 * tension[1]
    return least >= tension[0] - slack and most <= tension[1] + slack


def _inside(path: ShapePath, requirements: Requirements) -> bool:
    if requirements.arena is None:
        return True
    drones = drones_along(path, np.linspace(0.0, 1.0, GRID)).positions[..., 0]
    return bool(np.all((drones >= requirements.arena.lower) & (drones <= requirements.arena.upper)))
