"""Live flight: latency of retargets, of morphs like others, and of stops.

Usage: python -m benchmarks live [--retargets N] [--stops N] [--robots N ...]

A hitch is steered to random goals at random times while it moves: polygons, single vertices, poses.
Every answer is timed with its certificate, and every hundredth whole plan is certified anew. Morphs
to goals near an earlier plan's are timed with and without that plan.
"""

from __future__ import annotations

import time
from itertools import product
from typing import Any

import numpy as np

import hitchopt as ho
from benchmarks.measuring import PROBLEMS, Table, parser

LIMITATIONS = "one machine, one pass; processor time; goals and times are seeded"

CHAIN = 20
"""Number of retargets of a replanner before a new one starts."""

STOPPED = ("triangle", "move_edge", "hexagon", "tie_carry_untie", "swarms/head_on")


LOADED = {"load": 0.008, "cable_density": 0.005}
"""Loads at the clasps [kg] and weight of cables [kg/m] of the loaded teams."""


def hitch(n: int, **team: Any) -> ho.Hitch:
    """Return the initial hitch."""
    length, radius = (2.4, 0.75) if n == 3 else (2.0, 0.65 / np.sin(np.pi / n))
    angles = -2.0 * np.pi * np.arange(n) / n
    polygon = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    return ho.Hitch.spread(ho.Team(robots=n, cable_length=length, **team), polygon, altitude=1.0)


def goal(rng: np.random.Generator, first: ho.Hitch, now: ho.Hitch) -> dict[str, Any]:
    """Return a random goal: a polygon, a vertex, or a pose."""
    kind = rng.integers(3)
    base = first.polygon.vertices - first.polygon.centroid
    size = float(np.min(np.linalg.norm(base, axis=1)))
    spread = 0.35 * size if len(base) == 3 else 0.03 * size
    if kind == 0:
        moved = rng.uniform(0.85, 1.1) * base + rng.uniform(-spread, spread, base.shape)
        return {"polygon": moved + now.polygon.centroid + rng.uniform(-0.3, 0.3, 2)}
    if kind == 1:
        k = int(rng.integers(len(base)))
        return {"vertex": k, "to": now.polygon.vertices[k] + rng.uniform(-spread, spread, 2)}
    place = rng.uniform([-1.0, -1.0, 0.8], [1.0, 1.0, 1.6])
    return {"to": place, "yaw": float(rng.uniform(-2.0, 2.0))}


def retargets(n: int, count: int, **team: Any) -> tuple[object, ...]:
    """Return the row of a team: latency [ms], answers, and plans that fail a new certificate."""
    rng, first = np.random.default_rng(n), hitch(n, **team)
    times: list[float] = []
    accepted = checked = broken = 0
    for i in range(count):
        if i % CHAIN == 0:
            steered, clock = ho.Replanner(first.team, first), 0.0
        clock += float(rng.uniform(0.2, 1.2))
        request, start_time = goal(rng, first, steered.goal), time.process_time()
        try:
            answer = steered.retarget(**request, at=clock)
        except ho.HitchoptError:  # a polygon that is not convex
            continue
        times.append(1e3 * (time.process_time() - start_time))
        accepted += answer.accepted
        if answer.accepted:
            clock = max(clock, answer.start)
            if i % 100 == 0:
                checked += 1
                broken += not answer.plan.certificate.certified
    middle, high = np.quantile(times, [0.5, 0.99]).tolist()
    kind = "loaded" if team else "weightless"
    return n, kind, len(times), middle, high, accepted, f"{broken} of {checked}"


SPREADS = {3: 0.03, 12: 0.01}
"""Largest displacements of goals [m] from those of an earlier plan, by n; 0.01 m of others."""


def morphs_like(n: int, count: int) -> tuple[object, ...]:
    """Return the row of a team: latency [ms] without and with an earlier plan, and durations."""
    rng, start = np.random.default_rng(n), hitch(n)
    near = 0.9 * start.polygon.vertices + [0.2, 0.1]
    earlier = ho.morph(start, near)
    spread = SPREADS.get(n, 0.01)
    times: dict[bool, list[float]] = {True: [], False: []}
    ratios = []
    for _ in range(count):
        polygon = near + rng.uniform(-spread, spread, near.shape)
        durations = {}
        for is_like, latencies in times.items():
            start_time = time.process_time()
            plan = ho.morph(start, polygon, like=earlier if is_like else None)
            plan.certificate.raise_if_violated()
            latencies.append(1e3 * (time.process_time() - start_time))
            durations[is_like] = plan.duration
        ratios.append(durations[True] / durations[False])
    quantiles = [np.quantile(times[is_like], [0.5, 0.99]).tolist() for is_like in (False, True)]
    return n, count, *quantiles[0], *quantiles[1], float(np.mean(ratios)), max(ratios)


def stops(stem: str, count: int) -> tuple[object, ...]:
    """Return the row of a plan stopped at random times: longest stop, certified bound, latency."""
    plan = ho.solve(PROBLEMS / f"{stem}.yaml")
    rng = np.random.default_rng(1)
    times, longest = [], 0.0
    for moment in rng.uniform(0.0, plan.duration, count).tolist():
        player = ho.Player(plan, moment)
        start_time = time.process_time()
        longest = max(longest, player.pause())
        times.append(1e3 * (time.process_time() - start_time))
    return stem, longest, plan.certificate["stoppable"].worst, float(np.median(times))


def main() -> None:
    """Print and write the tables."""
    options = parser(__doc__, retargets=500, stops=100, robots=[3, 12]).parse_args()
    table = Table(options.output / "live.md", "Live flight", LIMITATIONS)
    columns = ("median [ms]", "p99 [ms]", "accepted", "broken when certified anew")
    table.section("Retargets", "n", "cables", "retargets", *columns)
    for n, team in product(options.robots, ({}, LOADED)):
        table.row(*retargets(n, options.retargets, **team))
    plain = ("median [ms]", "p99 [ms]")
    like = ("like another: median [ms]", "p99 [ms]", "mean duration ratio", "largest")
    table.section("Straight morphs", "n", "goals", *plain, *like)
    for n in options.robots:
        table.row(*morphs_like(n, options.retargets))
    table.section("Stops", "plan", "longest [s]", "stoppable [s]", "found in, median [ms]")
    for stem in STOPPED:
        table.row(*stops(stem, options.stops))
