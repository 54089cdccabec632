"""Latency and acceptance of retargets from moving states, and the time of a step of feedback.

Usage: python -m benchmarks.steering [--retargets N] [--from-rest M] [--robots N …] [--passes P]

A hitch is steered to random goals at random times while it moves: polygons, single vertices, and
poses. Every answer is timed, its certificate (all checks but tracking_radius and survivable)
included, by the process's time and by the wall's. Up to M goals that were refused are planned from
rest in the goal before, by the usual steps: what can be planned from there counts as missed. Every
hundredth whole plan is certified anew. The same retargets are asked for in several passes: of all
calls, quantiles hold what interrupts the process too; of the least time of each retarget, they hold
what it costs.
"""

from __future__ import annotations

import argparse
import platform
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.random import Generator

import hitchopt as ho
from hitchopt.errors import HitchoptError
from hitchopt.values import Array

ROBOTS = (3, 12)
CHAIN = 20
"""Retargets of one replanner, before a new one begins."""


def hitch(n: int) -> ho.Hitch:
    """Return the hitch that is steered."""
    length, radius = (2.4, 0.75) if n == 3 else (2.0, 0.65 / np.sin(np.pi / n))
    team = ho.Team(robots=n, cable_length=length)
    return ho.Hitch.spread(team, outline(n, radius), altitude=1.0)


def outline(n: int, radius: float) -> Array:
    """Return a regular polygon, clockwise."""
    angles = -2.0 * np.pi * np.arange(n) / n
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


@dataclass
class Counts:
    """What came of the retargets of one team."""

    wall: list[float] = field(default_factory=list)
    own: list[float] = field(default_factory=list)
    accepted: int = 0
    moving: int = 0
    later: int = 0
    missed: int = 0
    tried: int = 0
    broken: int = 0
    checked: int = 0
    reasons: dict[str, int] = field(default_factory=dict)


def goal(rng: Generator, first: ho.Hitch, now: ho.Hitch) -> dict[str, Any]:
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
        own = now.polygon.vertices[k]
        return {"vertex": k, "to": own + rng.uniform(-spread, spread, 2)}
    place = rng.uniform([-1.0, -1.0, 0.8], [1.0, 1.0, 1.6])
    return {"to": place, "yaw": float(rng.uniform(-2.0, 2.0))}


def from_rest(now: ho.Hitch, asked: dict[str, Any]) -> bool:
    """Return whether the goal can be planned from rest in the last goal, by the usual steps."""
    try:
        if "polygon" in asked:
            return ho.morph(now, asked["polygon"]).certificate.certified
        if "vertex" in asked:
            return ho.move_vertex(now, asked["vertex"], to=asked["to"]).certificate.certified
        return ho.transport(now, to=asked["to"], yaw=asked["yaw"]).certificate.certified
    except HitchoptError:
        return False


def measure(n: int, retargets: int, most: int) -> Counts:
    """Return the counts of a team."""
    rng, found, first = np.random.default_rng(n), Counts(), hitch(n)
    steered, clock = ho.Replanner(first.team, first), 0.0
    for i in range(retargets):
        if i % CHAIN == 0:
            steered, clock = ho.Replanner(first.team, first), 0.0
        clock += float(rng.uniform(0.2, 1.2))
        before, asked = steered.goal, goal(rng, first, steered.goal)
        moving = clock < steered.motion.duration
        wall, own = time.perf_counter(), time.process_time()
        try:
            answer = steered.retarget(**asked, at=clock)
        except HitchoptError as error:  # such as a polygon that is not convex
            found.reasons["wrong"] = found.reasons.get("wrong", 0) + 1
            del error
            continue
        found.wall.append(time.perf_counter() - wall)
        found.own.append(time.process_time() - own)
        found.moving += moving
        found.accepted += answer.accepted
        found.later += answer.accepted and answer.start > clock + 1e-9
        if answer.accepted and i % 100 == 0:
            found.checked += 1
            found.broken += not answer.plan.certificate.certified
        if answer.accepted:
            clock = max(clock, answer.start)
        elif found.tried < most:
            found.tried += 1
            missed = from_rest(before, asked)
            found.missed += missed
            word = ("missed: " if missed else "infeasible: ") + answer.reason[:70]
            found.reasons[word] = found.reasons.get(word, 0) + 1
    return found


def row(n: int, passes: list[Counts]) -> str:
    """Return the row of a table; what is counted is that of the first pass."""
    found = passes[0]
    each = [np.array([getattr(one, clock) for one in passes]) for clock in ("own", "wall")]
    quantiles = [
        1e3 * float(np.quantile(x, q))
        for x in (*each, np.min(each[0], axis=0))
        for q in (0.5, 0.99)
    ]
    asked, refused = len(found.wall), len(found.wall) - found.accepted
    missed = refused * found.missed / found.tried if found.tried else 0.0
    share = found.accepted / max(found.accepted + missed, 1.0)
    times = " | ".join(f"{each:.1f}" for each in quantiles)
    return (
        f"| {n} | {asked} | {found.moving} | {times} | {found.accepted} | {found.later} | "
        f"{found.missed}/{found.tried} | {share:.1%} | {found.broken}/{found.checked} |"
    )


def feedback(n: int, steps: int = 3000) -> str:
    """Return how long a step of feedback takes."""
    start = hitch(n)
    moved = start.polygon.vertices * 1.03
    plan = ho.morph(start, moved, duration=10.0)
    feed, rng = ho.Feedback(plan), np.random.default_rng(0)
    vertices = plan.at(np.linspace(0.0, plan.duration, steps)).vertices
    vertices = vertices + rng.normal(0.0, 0.01, vertices.shape)
    took = []
    for i, seen in enumerate(vertices):
        begin = time.perf_counter()
        feed.step(i * plan.duration / steps, plan.duration / steps, seen)
        took.append(time.perf_counter() - begin)
    middle, high = 1e6 * np.quantile(took, [0.5, 0.99])
    return f"| {n} | {middle:.0f} | {high:.0f} |"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--retargets", type=int, default=1000)
    parser.add_argument("--from-rest", type=int, default=50)
    parser.add_argument("--passes", type=int, default=1)
    parser.add_argument("--robots", type=int, nargs="*", default=ROBOTS)
    given = parser.parse_args()
    print(f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}\n")
    print(
        "| n | retargets | from moving states | median, process [ms] | p99, process [ms] | "
        "median, wall [ms] | p99, wall [ms] | median of least, process [ms] | "
        "p99 of least, process [ms] | accepted | begun later | refused, but planned from "
        "rest | accepted of what can be planned | broken when certified anew |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|")
    for n in given.robots:
        passes = [measure(n, given.retargets, given.from_rest)]
        passes += [measure(n, given.retargets, 0) for _ in range(given.passes - 1)]
        found = passes[0]
        print(row(n, passes), flush=True)
        for reason, count in sorted(found.reasons.items(), key=lambda item: -item[1])[:8]:
            print(f"<!-- {count} {reason} -->")
    print("\n| n | feedback, median [µs] | p99 [µs] |\n|---|---|---|")
    for n in given.robots:
        print(feedback(n))


if __name__ == "__main__":
    main()
