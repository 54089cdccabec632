"""How long it takes to form a hitch, to fly and to plan, over the number of robots.

Usage: python -m benchmarks.forming

Two tables: from the pre-hitch on, on regular n-gons of the same edge, cable, legs and ellipse (the
paper's claim is that the flight takes as long for any n); and from scattered robots on the ground,
turned and numbered at random, to the tensioned hitch. Then how many of random irregular hitches on
unequal cables are formed. Every plan is certified.
"""

from __future__ import annotations

import math
import time
from collections import Counter

import numpy as np
from numpy.typing import NDArray

import hitchopt as ho
from benchmarks.environment import print_environment
from benchmarks.relaxed_clearance import DEFAULT, HEADING, NOTE, clearance_text
from hitchopt.hitch import Hitch, Team
from hitchopt.planners.forming.prehitch import find_prehitch
from hitchopt.planners.forming.turns import SwapSettings
from hitchopt.planners.forming.tying_stages import tied
from hitchopt.requirements import Limits, Requirements, Separation
from hitchopt.steps.form import Assign
from hitchopt.steps.free_cables import staged

Array = NDArray[np.float64]

EDGE, CABLE, ALTITUDE = 1.3, 2.3, 1.5
"""[m] Legs of 0.5 m."""

SWAP = SwapSettings(radius=0.3, tilt=math.radians(45.0))

TYING = (6, 12, 25, 50, 100, 200)
FROM_GROUND = (6, 12, 24, 48)

RANDOM = 60
"""Irregular hitches."""


def regular_hitch(n: int) -> Hitch:
    """Return the n-gon that all rows are of; clearances grow tight with n, so they are relaxed."""
    return Hitch.balanced(Team(n, CABLE), ho.regular_polygon(n, EDGE).vertices, ALTITUDE)


def cable_clearance(n: int) -> float:
    """Return the clearance [m] that legs of 0.5 m leave, or the default where that is smaller."""
    return min(DEFAULT, 0.9 * 0.5 * math.sin(2.0 * math.pi / n))


def tying_row(n: int) -> tuple[float, str]:
    """Return the processor seconds of one n, and the row of the table."""
    hitch = regular_hitch(n)
    separation = Separation(cable=cable_clearance(n))
    requirements = Requirements(Limits(), separation, None)
    start = time.process_time()
    pre = find_prehitch(hitch, separation, SWAP)
    motion = staged(tied(pre, hitch, requirements.limits, SWAP), hitch, 0, requirements)
    planned = time.process_time()
    certificate = ho.certify(motion)
    done = time.process_time()
    text = f"{n:6d} {motion.duration:9.4f} {planned - start:9.3f} {done - planned:10.2f}"
    clearance = clearance_text(separation.cable)
    return done - start, f"{text}  {'yes' if certificate.certified else 'NO':9}  {clearance:>10}"


def scattered(n: int, seed: int) -> tuple[Array, Array]:
    """Return q and r (n, 3) [m] of robots on the ground, at random angles and in random order."""
    rng = np.random.default_rng(seed)
    columns = math.ceil(math.sqrt(n))
    k = rng.permutation(n)
    middles = 1.6 * np.column_stack([k % columns, k // columns, np.zeros(n)])
    middles -= np.mean(middles, axis=0)
    angles = rng.uniform(-math.pi, math.pi, n)
    arms = 0.5 * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(n)])
    return middles - arms, middles + arms


def ground_row(n: int, seed: int) -> str:
    """Return the row of one team."""
    q, r = scattered(n, seed)
    separation = Separation(cable=cable_clearance(n))
    start = time.process_time()
    try:
        plan = ho.form(
            Team(n, CABLE),
            q,
            r,
            ho.regular_polygon(n, EDGE),
            ALTITUDE,
            legs="balanced",
            separation=separation,
        )
    except ho.HitchoptError as error:
        return f"{n:6d} {seed:5d}  not planned: {str(error).splitlines()[0][:60]}"
    seconds = time.process_time() - start
    clearance, first = clearance_text(separation.cable), plan.phases[1].name
    return f"{n:6d} {seed:5d} {plan.duration:9.2f} {seconds:9.2f}  {clearance:>10}  {first}"


def random_polygon(n: int, rng: np.random.Generator) -> Array:
    """Return an irregular convex polygon (n, 2) [m] on an ellipse."""
    while True:
        angles = np.sort(rng.uniform(0.0, 2.0 * math.pi, n))
        gaps = np.diff(np.append(angles, angles[0] + 2.0 * math.pi))
        if np.min(gaps) >= math.pi / n:
            break
    radius = 0.55 / math.sin(math.pi / n)
    points = radius * np.column_stack([np.cos(-angles), np.sin(-angles)])
    return points * [1.0, rng.uniform(0.8, 1.2)] + rng.uniform(-1.0, 1.0, 2)


def random_outcome(rng: np.random.Generator) -> str:
    """Return what becomes of one random hitch: formed, or what binds first."""
    n = int(rng.integers(3, 9))
    polygon = ho.ConvexPolygon(random_polygon(n, rng))
    cables = polygon.edge_lengths + rng.uniform(0.8, 1.2, n)
    if rng.random() < 0.5:
        cables = rng.permutation(cables)
    k, columns = np.arange(n), math.ceil(math.sqrt(n))
    middles = 1.7 * np.column_stack([k % columns, k // columns, np.zeros(n)]).astype(np.float64)
    middles[:, :2] = middles[:, :2] + rng.uniform(-0.15, 0.15, (n, 2))
    angles = rng.uniform(-math.pi, math.pi, n)
    arms = 0.45 * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(n)])
    middles[:, 2] = rng.choice([0.0, 2.5])
    team = Team(n, cables, cable_density=float(rng.choice([0.0, 0.005])))
    altitude = float(rng.choice([1.0, 1.6]))
    order: Assign = "fixed" if rng.random() < 1.0 / 3.0 else "auto"
    try:
        ho.form(team, middles - arms, middles + arms, polygon, altitude, assign=order)
    except ho.InfeasibleError as error:
        first = error.violations[0]
        at_rest = "end of step" in first.when or first.constraint == "legs"
        return "the hitch breaks a limit at rest" if at_rest else f"refused: {first.constraint}"
    except ho.HitchoptError:
        return "a planner failed"
    return "formed"


def main() -> None:
    """Print both tables."""
    print_environment("processor seconds of one run each; one process, the first row warmed up")
    print(NOTE)
    tying_row(TYING[0])
    print("\nfrom the pre-hitch to the tensioned hitch")
    print(f"{'n':>6s} {'flight[s]':>9s} {'plan[s]':>9s} {'certify[s]':>10s}  certified  {HEADING}")
    costs = []
    for n in TYING:
        cost, row = tying_row(n)
        costs.append(cost)
        print(row, flush=True)
    slope = np.polyfit(np.log(TYING), np.log(costs), 1)[0]
    print(f"log-log slope of planning and certifying: {slope:.2f}")
    print("\nfrom scattered robots on the ground to the tensioned hitch")
    head = f"{'n':>6s} {'seed':>5s} {'flight[s]':>9s} {'plan[s]':>9s}"
    print(f"{head}  {HEADING}  first phase in the air")
    for n in FROM_GROUND:
        for seed in range(3):
            print(ground_row(n, seed), flush=True)
    rng = np.random.default_rng(5)
    outcomes = Counter(random_outcome(rng) for _ in range(RANDOM))
    print(
        f"\n{RANDOM} random irregular hitches, n = 3 to 8, unequal cables, a third in a given order"
    )
    for outcome, count in outcomes.most_common():
        print(f"{count:6d} {outcome}")


if __name__ == "__main__":
    main()
