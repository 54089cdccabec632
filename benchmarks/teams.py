"""Several teams in one arena: three that cross, ten at random, and random pairs.

Usage: python -m benchmarks teams [--pairs N]
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import ArrayLike

import hitchopt as ho
from benchmarks.measuring import Array, Table, parser
from hitchopt.steps.moving import Transport

LIMITATIONS = (
    "one machine, one run each; processor time with the certificate's; every plan is certified; "
    "priorities are incomplete: failure does not prove infeasibility"
)

MIN_DISTANCE = 2.6
"""Minimum distance between random starts, and between random goals [m]."""

Entry = tuple[int, float, float, ArrayLike, ArrayLike, float]
"""Robots, length of cables and edges [m], centroids at the start and the goal [m], turn [rad]."""


def crossing(*entries: Entry, size: float) -> ho.Problem:
    """Return the problem of regular hitches that move simultaneously within ±size [m]."""
    teams, start, item = {}, {}, {}
    for name, (n, cable, edge, at, to, turn) in zip("abcdefghijkl", entries, strict=False):
        x, y, z = np.asarray(at, dtype=float)
        polygon = ho.ConvexPolygon(ho.regular_polygon(n, edge, turn).vertices + [x, y])
        teams[name] = ho.Team(n, cable)
        start[name] = ho.HitchStart(polygon, float(z))
        item[name] = Transport(np.asarray(to, dtype=float))
    arena = ho.Arena([-size, -size, 0.0], [size, size, 3.0])
    return ho.Problem(teams, start, [item], arena=arena)


def places(rng: np.random.Generator, count: int, size: float, min_distance: float) -> list[Array]:
    """Return random positions [x, y] within ±size [m] with a minimum distance [m]."""
    result = list[Array]()
    while len(result) < count:
        place = rng.uniform(-size, size, 2)
        if all(np.linalg.norm(place - other) > min_distance for other in result):
            result.append(place)
    return result


def three() -> ho.Problem:
    """Return the problem of teams of 3, 4 and 6 robots that cross in 6 × 6 × 3 m."""
    entries: list[Entry] = [
        (3, 1.7, 0.9, [-2.0, -1.5, 1.5], [2.0, 1.5, 1.5], 0.0),
        (4, 1.6, 0.8, [2.0, -1.5, 1.5], [-2.0, 1.5, 1.5], 0.0),
        (6, 1.4, 0.6, [0.0, 1.9, 1.5], [0.0, -1.9, 1.5], 0.0),
    ]
    return crossing(*entries, size=3.0)


def triangles(count: int = 10, seed: int = 0) -> ho.Problem:
    """Return the problem of triangles on random goals in 12 × 12 × 3 m."""
    rng = np.random.default_rng(seed)
    starts, goals = (places(rng, count, 4.6, MIN_DISTANCE) for _ in range(2))
    ends = [(np.append(a, 1.5), np.append(b, 1.5)) for a, b in zip(starts, goals, strict=True)]
    return crossing(*[(3, 2.0, 1.0, a, b, 0.0) for a, b in ends], size=6.0)


def pair(seed: int) -> ho.Problem:
    """Return the problem of two random regular hitches at different altitudes."""
    rng = np.random.default_rng(seed)
    starts, goals = (places(rng, 2, 2.6, MIN_DISTANCE) for _ in range(2))
    entries = list[Entry]()
    for a, b in zip(starts, goals, strict=True):
        n, edge, z = int(rng.integers(3, 7)), rng.uniform(0.7, 1.2), rng.uniform(1.2, 1.8)
        ends = np.append(a, z), np.append(b, z)
        entries.append((n, edge + rng.uniform(0.7, 1.0), edge, *ends, rng.uniform(0.0, 6.0)))
    return crossing(*entries, size=4.5)


def outcome(problem: ho.Problem) -> tuple[float, float, str]:
    """Return the processor time [s], the plan's duration [s], and the reason without a plan."""
    start_time, duration, reason = time.process_time(), np.nan, ""
    try:
        duration = ho.solve(problem).duration
    except ho.InfeasibleError as error:
        reason = f"{error.violations[0].constraint} of {', '.join(error.violations[0].where)}"
    return time.process_time() - start_time, duration, reason


def main() -> None:
    """Print and write the tables."""
    options = parser(__doc__, pairs=40).parse_args()
    table = Table(options.output / "teams.md", "Several teams", LIMITATIONS)
    table.section("Crossing", "task", "processor [s]", "duration [s]", "refused")
    outcome(pair(0))  # imports are not measured
    table.row("3, 4 and 6 robots in 6 × 6 × 3 m", *outcome(three()))
    table.row("ten triangles in 12 × 12 × 3 m", *outcome(triangles()))
    outcomes = [outcome(pair(seed)) for seed in range(options.pairs)]
    table.section("Random pairs", "pairs", "planned", "median [s]", "most [s]", "refused")
    refused = "; ".join(f"{seed}: {one[2]}" for seed, one in enumerate(outcomes) if one[2])
    times = [one[0] for one in outcomes]
    planned = sum(not one[2] for one in outcomes)
    table.row(len(outcomes), planned, float(np.median(times)), max(times), refused)
