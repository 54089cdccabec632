"""Which paths are worth the optimiser's time, look flyable, and pass the judge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hitchopt.errors import InfeasibleError
from hitchopt.geometry.vectors import length
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.leg_lengths import reference_margin, reference_margins
from hitchopt.hitch.leg_task import LegTask
from hitchopt.planners.optimise.knot_path import KnotPath
from hitchopt.planners.optimise.search_task import Search
from hitchopt.planners.path.leg_law import CLEAR, leg_task_of
from hitchopt.planners.path.path_feasibility import check_shapes_at, exterior_angles
from hitchopt.planners.path.shape_path import ShapePath, Shapes, shapes_along
from hitchopt.planners.timing.flight_curves import Flight
from hitchopt.planners.timing.speed_profile import TimingError
from hitchopt.planners.timing.time_estimates import flight_estimate, grid_demands
from hitchopt.planners.timing.time_warp import WarpError
from hitchopt.requirements import Requirements
from hitchopt.trajectory import bernstein
from hitchopt.values import Array

CLOSEST = 0.3
"""Share of their limits that the distances of a guess must exceed for it to be tried."""

SHARPEST_LOSS = 0.1
"""Share of its ends' smallest exterior angle and shortest edge that a guess must exceed."""

WIDEST = 1.05
"""Largest margin of any round; larger ones need not be told apart."""

LEVEL_ENOUGH = 0.95
"""Share of its limits that a rolled hitch's distances must exceed without roll: the rows nearest to
the ends leave knots no room to be off by more."""

BELOW = 1.0 - 1e-4
"""Factor on an end's own margin: the end is to satisfy it in spite of rounding."""

SAME = 0.05
"""[m] Paths that differ by less at every knot count as one."""

HALVINGS = 3
"""Number of halvings of pieces, to bound their tensions closely."""

PROBES = 33
"""Number of points at which a path's distances are evaluated before the judge decides, and again
near each end; its shapes at twice as many."""

NEAR_END = 0.1
"""Share of the path that is near an end."""

SPARSE, DENSE = (np.linspace(0.0, 1.0, count) for count in (PROBES, 2 * PROBES - 1))

NEAR_ENDS = np.concatenate([NEAR_END * SPARSE[1:-1], 1.0 - NEAR_END * SPARSE[1:-1]])

PLACES = np.unique(np.concatenate([DENSE, NEAR_ENDS]))
"""Where a path's shapes are evaluated."""

DISTANCES = np.isin(PLACES, np.concatenate([SPARSE, NEAR_ENDS]))
"""(PLACES,): whether its distances are evaluated there too."""


def sound(path: KnotPath) -> bool:
    """Return whether a guess is a hitch everywhere: convex, with edges, legs and slack."""
    lengths = length(path.edges)
    angles = exterior_angles(path.team.layout, path.edges)
    smallest, shortest = (np.min(values[[0, -1]]) for values in (angles, lengths))
    return bool(
        np.min(path.slack) > 0.0
        and np.min(angles) > SHARPEST_LOSS * smallest
        and np.min(lengths) > SHARPEST_LOSS * shortest
    )


def loose(paths: Sequence[KnotPath], requirements: Requirements) -> list[KnotPath]:
    """Return those of guesses from one hitch to another whose bodies are not all in one heap."""
    if not paths:
        return []
    polygons, q_legs = (
        np.concatenate([getattr(path, name) for path in paths]) for name in ("polygons", "q_legs")
    )
    rolls = [path.roll for path in paths if path.roll is not None]
    roll = np.concatenate(rolls) if rolls else None
    margins = _margins(paths[0].team, requirements, polygons, q_legs, roll)
    first = np.cumsum([0, *(len(path.polygons) for path in paths[:-1])])
    smallest = np.minimum.reduceat(margins, first)
    return [path for path, margin in zip(paths, smallest, strict=True) if margin >= CLOSEST]


def end_margins(start: Hitch, end: Hitch, requirements: Requirements) -> tuple[float, float]:
    """Return how many times their limits the distances of the hitches at both ends are."""
    polygons, q_legs, roll = (
        np.stack(part)
        for part in (
            (start.polygon.vertices, end.polygon.vertices),
            (start.q_legs, end.q_legs),
            (start.roll, end.roll),
        )
    )
    first, last = BELOW * _margins(start.team, requirements, polygons, q_legs, roll)
    return float(first), float(last)


def level_enough(hitch: Hitch, requirements: Requirements) -> bool:
    """Return whether a hitch keeps distances, or nearly so, without its roll.

    The optimiser's program has legs in the plane, so that no path of it ends at one that does not.
    """
    if not np.any(hitch.roll):
        return True
    polygon, q_legs = hitch.polygon.vertices[None], hitch.q_legs[None]
    return bool(_margins(hitch.team, requirements, polygon, q_legs, None)[0] > LEVEL_ENOUGH)


def _margins(
    team: Team, requirements: Requirements, polygons: Array, q_legs: Array, roll: Array | None
) -> Array:
    """Return how many times their limits the distances of hitches (J,) are, walls left out."""
    bare = replace(requirements, arena=None)
    return reference_margins(LegTask(team, bare, polygons, q_legs, 0.0, WIDEST, roll=roll))


def same(path: KnotPath, other: KnotPath) -> bool:
    """Return whether two guesses have come to one and the same path."""
    if path.steps != other.steps:
        other = other.resampled(path.steps + 1)
    apart = (path.polygons - other.polygons, path.q_legs - other.q_legs)
    return max(float(np.max(np.abs(part))) for part in apart) < SAME


def clear(knots: KnotPath, search: Search) -> bool:
    """Return whether a path looks as if it could be flown: cheap, the judge decides later."""
    path, requirements = knots.path, search.requirements
    shapes = shapes_along(path, PLACES)
    try:
        check_shapes_at(PLACES, shapes, path.team.layout)
    except InfeasibleError:
        return False
    if not _distances_hold(path, requirements, shapes.chosen(DISTANCES)):
        return False
    demands = grid_demands(path, requirements.limits)
    if max(float(np.max(ratios)) for ratios in demands.at_rest()) >= demands.share:
        return False
    arena, drones = requirements.arena, demands.drones[..., 0]
    return arena is None or bool(np.all((drones >= arena.lower) & (drones <= arena.upper)))


def judged(path: ShapePath, search: Search) -> Flight | None:
    """Return the flight along a path if it satisfies every limit all of the time."""
    try:
        flight = search.judge(path)
    except (InfeasibleError, TimingError, WarpError):
        return None
    return flight if flight and _tensions_within(flight, search.tension) else None


def estimate(path: KnotPath, requirements: Requirements) -> float:
    """Return an estimate of how long a flight along a path takes [s], clear or not."""
    return flight_estimate(path.path, requirements.limits)


def _distances_hold(path: ShapePath, requirements: Requirements, shapes: Shapes) -> bool:
    """Return whether legs are long enough and distances hold at shapes of a path."""
    if np.min(shapes.legs[1:-1]) < requirements.limits.leg:
        return False
    return reference_margin(leg_task_of(path, requirements, shapes, CLEAR)) >= CLEAR


def _tensions_within(flight: Flight, tension: tuple[float, float] | None) -> bool:
    """Return whether tensions stay within their range, by the hulls of their polynomials."""
    if tension is None:
        return True
    hulls = flight.tensions.coefficients
    for _ in range(HALVINGS):
        hulls = np.concatenate(bernstein.halve(hulls))
    slack = 1e-9 * tension[1]
    return bool(np.min(hulls) >= tension[0] - slack and np.max(hulls) <= tension[1] + slack)
