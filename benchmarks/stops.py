"""Random stops of the common clock at 1 kHz, and random aborts at 10 kHz.

Usage: python -m benchmarks.stops [--stops N] [--aborts N] [PROBLEM …]

It plans problems of the collection, stops each N times at random, aborts it N times at random in
every way, and prints what the largest value over its limit is. Samples share nothing with the
certificate but the polynomials.
"""

from __future__ import annotations

import argparse
import platform
import time
from pathlib import Path

import numpy as np

import hitchopt as ho
from hitchopt.errors import InfeasibleError
from hitchopt.stopping.abort import WAYS, Aborts
from hitchopt.stopping.player import Player
from hitchopt.values import Array

PROBLEMS = Path(__file__).parents[1] / "problems"
USUAL = ("triangle", "move_edge", "hexagon", "tie_carry_untie", "swarms/head_on")
RATE, ABORT_RATE = 1e3, 1e4


def over(values: Array, limit: float) -> float:
    """Return the largest norm over its limit."""
    return float(np.max(np.linalg.norm(values, axis=-1))) / limit


def stop(player: Player, limits: ho.Limits) -> tuple[float, float]:
    """Return the largest acceleration or jerk over its limit in a stop, and its duration [s]."""
    seconds, worst = player.pause(), 0.0
    for _ in range(int(seconds * RATE) + 2):
        here = player.step(1.0 / RATE)
        ratios = over(here.accelerations, limits.acceleration), over(here.jerks, limits.jerk)
        worst = max(worst, *ratios)
    return worst if player.resting else np.inf, seconds


def flown(plan: ho.Plan, begin: float) -> float:
    """Return the largest value over its limit in a plan from a time on, sampled."""
    limits, team = plan.motion.requirements.limits, plan.motion.team
    worst = 0.0
    for times in np.array_split(
        np.arange(begin, plan.duration, 1.0 / ABORT_RATE), int(plan.duration) + 1
    ):
        states = plan.at(times)
        thrusts = states.thrusts(team)
        level = np.hypot(thrusts[..., 0], thrusts[..., 1])
        worst = max(
            worst,
            over(states.velocities, limits.speed),
            over(states.accelerations, limits.acceleration),
            over(states.jerks, limits.jerk),
            float(np.max(np.linalg.norm(thrusts, axis=-1) / team.max_thrust)),
            float(np.max(np.arctan2(level, thrusts[..., 2]))) / limits.tilt,
        )
    return worst


def measure(stem: str, stops: int, aborts: int) -> str:
    """Return a row of the table."""
    plan = ho.solve(PROBLEMS / f"{stem}.yaml")
    rng = np.random.default_rng(1)
    limits = plan.motion.requirements.limits
    common = Aborts(plan.motion)
    table, found = common.stops, []
    for moment in rng.uniform(0.0, plan.duration, stops):
        player = Player(plan, float(moment), stops=table)
        found.append(stop(player, limits))
    worst, longest = np.max(found, axis=0)
    ended, tried, largest = 0, 0, 0.0
    held = 0
    for moment in rng.uniform(0.0, plan.duration, aborts):
        for how in WAYS:
            tried += 1
            try:
                done = common.found(float(moment), how)
            except InfeasibleError:
                continue
            ended += 1
            held += how == "hold"
            whole = ho.Plan(done.certified.motion, done.certified.certificate)
            largest = max(largest, flown(whole, max(done.start - 0.01, 0.0)))
    reported = plan.certificate["stoppable"].bound
    return (
        f"| {stem} | {stops} | {worst:.7f} | {longest:.3f} | {reported:.3f} | {held}/{aborts} | "
        f"{ended}/{tried} | {largest:.7f} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stops", type=int, default=100)
    parser.add_argument("--aborts", type=int, default=3)
    parser.add_argument("problems", nargs="*", default=USUAL)
    given = parser.parse_args()
    print(f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}\n")
    print(
        "| plan | stops | largest value over its limit | longest stop [s] | stoppable [s] | "
        "holds | aborts | largest value over its limit |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for stem in given.problems:
        begin = time.perf_counter()
        print(
            measure(stem, given.stops, given.aborts),
            f"<!-- {time.perf_counter() - begin:.0f} s -->",
            flush=True,
        )


if __name__ == "__main__":
    main()
