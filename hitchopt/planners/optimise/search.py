"""The search for a way: every guess is optimised and refined until its path is clear."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InfeasibleError
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.sharing import measured
from hitchopt.hitch.sharing_task import SharingTask
from hitchopt.model.evaluation import drone_jets
from hitchopt.planners.demands import Demands
from hitchopt.planners.feasibility import check_loads, check_shapes
from hitchopt.planners.flight import Flight
from hitchopt.planners.leg_law import KeptDistances, legs_clear, with_legs_clear
from hitchopt.planners.optimise.guesses import guesses, widened
from hitchopt.planners.optimise.program import Bounds, build_program, solve_program
from hitchopt.planners.optimise.way import Way
from hitchopt.planners.path import ShapePath, drones_along
from hitchopt.planners.timing import TimingError, fastest_profile
from hitchopt.planners.warp import WarpError
from hitchopt.trajectory import bernstein

Array = NDArray[np.float64]

ROUNDS = ((1, 1.02), (2, 1.02), (2, 1.05), (4, 1.02), (4, 1.05))
"""How many times the first knots' steps, and margin at the knots: while the path between them is
not clear, closer knots are set, and wider margins."""

STEP = 0.6
"""[m] No vertex is to go farther from one of the first knots to the next, about."""

FEWEST_STEPS, MOST_STEPS = 8, 16
"""Of the first knots."""

CLOSEST = 0.3
"""A straight guess whose distances fall below this share of their limits is not worth a try."""

WIDER = 0.25
"""By how much guesses are widened half way where none has led to a way as it is."""

SHARPEST_LOSS = 0.1
"""Share of a polygon's smallest exterior angle and shortest edge that a guess has to keep."""

SETTLED = 0.05
"""[m] A step of the optimiser that moves no vertex by more is the last one."""

FIRST_STEPS, LATER_STEPS = 12, 3
"""Of the optimiser, from a guess and from a way that it has found."""

WORSE = 1.1
"""A way that promises to take longer than the fastest one found by this factor is not refined."""

SAME = 0.05
"""[m] Ways that differ by less at every knot are one."""

HALVINGS = 3
"""Of pieces, to bound their tensions closely."""

GRID = 101
"""Points at which candidates are timed to be compared."""


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
    kept: limits, separation and arena.
    judge: has the last word on every path.
    tension: smallest and largest [N] where tensions may change on the way.
    end_margins: how many times their limits the first and last hitch keep their distances.
    """

    kept: KeptDistances
    judge: Judge
    tension: tuple[float, float] | None
    end_margins: tuple[float, float]

    def bounds(self, margin: float) -> Bounds:
        """Return what the optimiser keeps at knots."""
        kept = self.kept
        return Bounds(
            kept.limits, kept.separation, kept.arena, self.tension, margin, self.end_margins
        )


def candidates(
    start: Hitch,
    end: Hitch,
    kept: KeptDistances,
    judge: Judge,
    tension: tuple[float, float] | None = None,
) -> list[Candidate]:
    """Return the ways found from all guesses, the fastest first; none for chains.

    Parameters
    ----------
    start, end: hitches at one altitude that keep all limits.
    kept: limits, separation and arena.
    judge: has the last word on every path; those that it turns down are refined.
    tension: smallest and largest [N] where tensions may change on the way.
    """
    if not isinstance(start.polygon, ConvexPolygon) or not isinstance(end.polygon, ConvexPolygon):
        return []  # chains are not optimised
    search = Search(kept, judge, tension, (end_margin(start, kept), end_margin(end, kept)))
    found = guesses(start.polygon, end.polygon, FEWEST_STEPS + 1)
    ways = [Way.through(guess.name, start, end, guess.polygons) for guess in found]
    sound = [way for way in ways if _sound(way)]
    loose = [way for way in sound if _closest(way, kept) >= CLOSEST]
    found_ways = searched(loose or sound, search)
    if found_ways:
        return found_ways
    # Wider on the way, legs have more room to pass one another.
    wide = [
        Way.through(guess.name, start, end, widened(guess.polygons, WIDER)) for guess in found[1:]
    ]
    return searched([way for way in wide if _sound(way)], search)


def searched(ways: Sequence[Way], search: Search) -> list[Candidate]:
    """Return the ways found from the given first ones, the fastest first."""
    bounds = search.bounds(ROUNDS[0][1])
    firsts: list[Way] = []
    for way in ways:
        solved = _settled(way.resampled(_steps(way) + 1), bounds, FIRST_STEPS)
        if solved is not None and not any(_same(solved, other) for other in firsts):
            firsts.append(solved)
    found: list[Candidate] = []
    fastest = np.inf
    for promise, way in sorted(
        ((_promise(way, search.kept), way) for way in firsts), key=lambda entry: entry[0]
    ):
        if promise > WORSE * fastest:
            break
        found += _refined(way, search)
        fastest = min((candidate.flight.duration for candidate in found), default=np.inf)
    return sorted(found, key=lambda candidate: candidate.flight.duration)


def _refined(way: Way, search: Search) -> Iterator[Candidate]:
    """Yield what comes of a way of least energy: its flight, then a faster one if there is.

    Where limits are broken between the knots, more of them are set, and wider margins.
    """
    steps = len(way.polygons) - 1
    for finer, margin in ROUNDS:
        bounds = search.bounds(margin)
        if (finer, margin) != ROUNDS[0]:
            if len(way.polygons) != finer * steps + 1:
                way = way.resampled(finer * steps + 1)
            solved = _settled(way, bounds, LATER_STEPS)
            if solved is None:
                continue
            way = solved
        clear = _candidate(way, search)
        if clear is not None:
            yield clear
            faster = _settled(way, bounds, LATER_STEPS, fastest=True)
            quick = None if faster is None else _candidate(faster, search)
            if quick is not None:
                yield quick
            return


def _promise(way: Way, kept: KeptDistances) -> float:
    """Return how long a way takes [s], be its path clear between the knots or not."""
    try:
        return _duration(way.path(), kept)
    except (InfeasibleError, TimingError):
        return math.inf


def _settled(way: Way, bounds: Bounds, most: int, *, fastest: bool = False) -> Way | None:
    """Return the way that is reached in steps of the optimiser, or None where one fails.

    Every step sees the pairs that come near on it, along normals that fit.
    """
    for _ in range(most):
        moved = solve_program(build_program(way, bounds, fastest=fastest))
        if moved is None:
            return None
        far = float(np.max(np.abs(moved.polygons - way.polygons)))
        way = moved
        if far < SETTLED:
            break
    return way


def _steps(way: Way) -> int:
    """Return how many steps between knots a way needs, its longest one's being STEP."""
    travel = np.linalg.norm(np.diff(way.polygons, axis=0), axis=-1)
    longest = float(np.max(np.sum(travel, axis=0)))
    return int(np.clip(np.ceil(longest / STEP), FEWEST_STEPS, MOST_STEPS))


def _sound(way: Way) -> bool:
    """Return whether a guess is a hitch all the way: convex, with edges, legs and slack."""
    edges = np.roll(way.polygons, -1, axis=1) - way.polygons
    lengths = np.linalg.norm(edges, axis=-1)
    behind = np.roll(edges, 1, axis=1)
    right = behind[..., 1] * edges[..., 0] - behind[..., 0] * edges[..., 1]
    angles = np.arctan2(right, np.sum(behind * edges, axis=-1))
    ends = np.minimum(angles[0].min(), angles[-1].min())
    shortest = np.minimum(lengths[0].min(), lengths[-1].min())
    return bool(
        np.min(way.slack) > 0.0
        and np.min(angles) > SHARPEST_LOSS * ends
        and np.min(lengths) > SHARPEST_LOSS * shortest
    )


def end_margin(hitch: Hitch, kept: KeptDistances) -> float:
    """Return how many times their limits a hitch keeps its distances."""
    polygon, q_legs = hitch.polygon.vertices[None], hitch.q_legs[None]
    return _measured(hitch.team, polygon, q_legs, kept) * (1.0 - 1e-4)


def _closest(way: Way, kept: KeptDistances) -> float:
    """Return how many times their limits a way keeps its distances at its knots."""
    return _measured(way.team, way.polygons, way.q_legs, kept)


def _measured(team: Team, polygons: Array, q_legs: Array, kept: KeptDistances) -> float:
    widest = max(margin for _, margin in ROUNDS)
    return measured(SharingTask(team, kept.separation, None, polygons, q_legs, 0.0, widest))


def _same(way: Way, other: Way) -> bool:
    """Return whether two guesses have come to one and the same way."""
    if len(way.polygons) != len(other.polygons):
        other = other.resampled(len(way.polygons))
    apart = max(
        float(np.max(np.abs(way.polygons - other.polygons))),
        float(np.max(np.abs(way.q_legs - other.q_legs))),
    )
    return apart < SAME


def _candidate(way: Way, search: Search) -> Candidate | None:
    kept, path = search.kept, way.path()
    try:
        check_shapes(path)
        if not legs_clear(path, kept):
            path = with_legs_clear(path, kept)
            if not legs_clear(path, kept):
                return None
        check_loads(path, kept.limits)
        flight = search.judge(path) if _inside(path, kept) else None
        if flight is not None and not _tensions_kept(flight, search.tension):
            return None
    except (InfeasibleError, TimingError, WarpError):
        return None
    return None if flight is None else Candidate(way.name, flight)


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


def _inside(path: ShapePath, kept: KeptDistances) -> bool:
    if kept.arena is None:
        return True
    drones = drones_along(path, np.linspace(0.0, 1.0, GRID)).positions[..., 0]
    return bool(np.all((drones >= kept.arena.lower) & (drones <= kept.arena.upper)))


def _duration(path: ShapePath, kept: KeptDistances) -> float:
    s = np.linspace(0.0, 1.0, GRID)
    flat = path.flat(s)
    demands = Demands.of(path.team, kept.limits, flat, drone_jets(path.team, flat))
    return fastest_profile(s, demands).duration
