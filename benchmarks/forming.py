"""How long it takes to form a hitch, to fly and to plan, over the number of robots.

Usage: python -m benchmarks.forming

Two tables: from the pre-hitch on, on regular n-gons of the same edge, cable, legs and ellipse (the
paper's claim is that the flight takes as long for any n); and from scattered robots on the ground,
turned and numbered at random, to the tensioned hitch. Every plan is certified.
"""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import NDArray

import hitchopt as ho
from benchmarks.environment import print_environment
from hitchopt.hitch import Hitch, Limits, Separation, Team
from hitchopt.mission.free_flight import staged
from hitchopt.mission.motions import Kept
from hitchopt.planners.forming.prehitch import find_prehitch
from hitchopt.planners.forming.settings import SwapSettings
from hitchopt.planners.forming.tying import tied

Array = NDArray[np.float64]

EDGE, CABLE, ALTITUDE = 1.3, 2.3, 1.5
"""[m] Legs of 0.5 m."""

SWAP = SwapSettings(radius=0.3, tilt=math.radians(45.0))

TYING = (6, 12, 25, 50, 100, 200)
FROM_GROUND = (6, 12, 24, 48)


def regular_hitch(n: int) -> Hitch:
    """Return the n-gon that all rows are of; clearances grow tight with n, so they are relaxed."""
    return Hitch.balanced(Team(n, CABLE), ho.regular_polygon(n, EDGE).vertices, ALTITUDE)


def tying_row(n: int) -> tuple[float, str]:
    """Return the processor seconds of one n, and the row of the table."""
    hitch = regular_hitch(n)
    separation = Separation(cable=min(0.1, 0.9 * 0.5 * math.sin(2.0 * math.pi / n)))
    kept = Kept(Limits(), separation, None)
    start = time.process_time()
    pre = find_prehitch(hitch, separation, SWAP)
    motion = staged(tied(pre, hitch, kept.limits, SWAP), hitch, 0, kept)
    planned = time.process_time()
    certificate = ho.certify(motion)
    done = time.process_time()
    text = f"{n:6d} {motion.duration:9.4f} {planned - start:9.3f} {done - planned:10.2f}"
    return done - start, f"{text}  {'yes' if certificate.certified else 'NO'}"


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
    separation = Separation(cable=min(0.1, 0.9 * 0.5 * math.sin(2.0 * math.pi / n)))
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
    way = plan.phases[1].name
    return f"{n:6d} {seed:5d} {plan.duration:9.2f} {seconds:9.2f}  {way}"


def main() -> None:
    """Print both tables."""
    print_environment("processor seconds of one run each; one process, the first row warmed up")
    tying_row(TYING[0])
    print("\nfrom the pre-hitch to the tensioned hitch")
    print(f"{'n':>6s} {'flight[s]':>9s} {'plan[s]':>9s} {'certify[s]':>10s}  certified")
    costs = []
    for n in TYING:
        cost, row = tying_row(n)
        costs.append(cost)
        print(row, flush=True)
    slope = np.polyfit(np.log(TYING), np.log(costs), 1)[0]
    print(f"log-log slope of planning and certifying: {slope:.2f}")
    print("\nfrom scattered robots on the ground to the tensioned hitch")
    print(f"{'n':>6s} {'seed':>5s} {'flight[s]':>9s} {'plan[s]':>9s}  first phase in the air")
    for n in FROM_GROUND:
        for seed in range(3):
            print(ground_row(n, seed), flush=True)


if __name__ == "__main__":
    main()
