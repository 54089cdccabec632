"""Forming hitches: from the ground over n, and random irregular hitches.

Usage: python -m benchmarks forming [--robots N ...] [--random N]

Robots stand on the ground, turned and numbered at random, and tie a regular hitch of edges of
1.3 m with cables of 2.3 m. Then random irregular hitches with unequal cables are formed, a third of
them in a given order of robots.
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

import hitchopt as ho
from benchmarks.measuring import (
    CLEARANCE,
    CLEARANCE_NOTE,
    DEFAULT_CLEARANCE,
    Array,
    Table,
    clearance_text,
    parser,
    timed,
)
from hitchopt.errors import AT_END

LIMITATIONS = (
    f"one machine, one run each; processor time with the certificate's; {CLEARANCE_NOTE}; of the "
    "random hitches those whose goal breaks a limit at rest are counted apart"
)

EDGE, CABLE, LEG, ALTITUDE = 1.3, 2.3, 0.5, 1.5
"""Lengths of edges, cables and legs, and altitude [m]."""


def scattered(n: int, rng: np.random.Generator, spacing: float) -> tuple[Array, Array]:
    """Return q and r (n, 3) [m] of robots on the ground, at random angles and in random order."""
    columns = math.ceil(math.sqrt(n))
    k, angles = rng.permutation(n), rng.uniform(-math.pi, math.pi, n)
    middles = spacing * np.column_stack([k % columns, k // columns, np.zeros(n)])
    arms = 0.5 * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(n)])
    middles = middles - np.mean(middles, axis=0)
    return middles - arms, middles + arms


def regular(n: int, seed: int) -> tuple[object, ...]:
    """Return the row of a regular hitch that is formed from the ground."""
    clearance = min(DEFAULT_CLEARANCE, 0.9 * LEG * math.sin(2.0 * math.pi / n))
    q, r = scattered(n, np.random.default_rng(seed), 1.6)
    team, polygon = ho.Team(n, CABLE), ho.regular_polygon(n, EDGE)
    separation = ho.Separation(cable=clearance)
    plan, elapsed = timed(lambda: ho.form(team, q, r, polygon, ALTITUDE, separation=separation))
    return n, seed, plan.duration, plan.motion.phases[0].name, elapsed, clearance_text(clearance)


def irregular(rng: np.random.Generator) -> str:
    """Return the outcome of a random irregular hitch: formed, or the first violation."""
    n = int(rng.integers(3, 9))
    angles = 2.0 * np.pi * (np.arange(n) + rng.uniform(-0.25, 0.25, n)) / n
    radius = rng.uniform(0.55, 0.8) / np.sin(np.pi / n)
    points = radius * np.column_stack([np.cos(-angles), np.sin(-angles)])
    polygon = ho.ConvexPolygon(points * [1.0, rng.uniform(0.8, 1.2)] + rng.uniform(-1.0, 1.0, 2))
    cables = polygon.edge_lengths + rng.uniform(0.8, 1.2, n)
    team = ho.Team(n, cables, cable_density=float(rng.choice([0.0, 0.005])))
    q, r = scattered(n, rng, 1.7)
    altitude, fixed = float(rng.choice([1.0, 1.6])), rng.random() < 1.0 / 3.0
    try:
        ho.form(team, q, r, polygon, altitude, assign="fixed" if fixed else "auto")
    except ho.InfeasibleError as error:
        first = error.violations[0]
        at_rest = first.when == AT_END or first.constraint == "legs"
        return "its goal breaks a limit at rest" if at_rest else f"refused: {first.constraint}"
    return "formed"


def main() -> None:
    """Print and write both tables."""
    options = parser(__doc__, robots=[6, 12, 24, 48], random=60).parse_args()
    table = Table(options.output / "forming.md", "Forming", LIMITATIONS)
    columns = ("flight [s]", "first phase", "plan [s]", CLEARANCE)
    table.section("Regular hitches from the ground", "n", "seed", *columns)
    for n in options.robots:
        table.row(*regular(n, 0))
    if options.random:
        table.section(
            f"{options.random} random irregular hitches, n = 3 to 8", "outcome", "hitches"
        )
        rng = np.random.default_rng(5)
        outcomes = Counter(irregular(rng) for _ in range(options.random))
        for name, count in outcomes.most_common():
            table.row(name, count)
