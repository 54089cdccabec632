"""Plans aborted at random: simulated flights under perturbations.

Usage: python -m benchmarks.aborted [--flights N] [--first SEED] [--problem NAME]

A seed gives the time of the command, uniform over the plan, the kind of abort and the usual
perturbations of the flight, with the fast preset. A flight succeeds where its outcome does (no
touch, and clasps linked, bearing and held under a pull test where the abort ends hitched, else
cables free of each other) and its drones have been within STILL of their setpoints in the last half
second before it is judged. A hold between hanging cables and a hitch is no end: after it the clock
goes on to the end of the plan. Rows are printed as they come: an interrupted series goes on with
``--first``.
"""

from __future__ import annotations

import argparse
import platform
import tempfile
import time
from pathlib import Path

import mujoco
import numpy as np

import hitchopt as ho
from hitchopt.errors import InfeasibleError
from hitchopt.motion.retiming import followed, retimed
from hitchopt.simulation.flight_task import read_task
from hitchopt.simulation.simulate import Simulation, simulate
from hitchopt.simulation.simulation_settings import USUAL, Settings
from hitchopt.stopping.abort import PASSING, WAYS, Aborts

PROBLEMS = Path(__file__).parents[1] / "problems"
STILL, JUDGED = 0.1, 0.5
"""[m], [s] Largest distance from their setpoints of drones that rest, over so long."""


def away(done: Simulation) -> float:
    """Return the largest distance of a drone from its setpoint before the flight is judged [m]."""
    record, rested = done.flight.record, done.flight.rested
    chosen = (record.t > rested - JUDGED) & (record.t <= rested + 1e-9)
    off = record.drones[chosen] - record.commanded[chosen]
    return float(np.max(np.linalg.norm(off, axis=-1), initial=0.0))


def flown(aborts: Aborts, seed: int) -> tuple[str, bool]:
    """Return the row of a flight, and whether it succeeded."""
    rng = np.random.default_rng(seed)
    command, how = float(rng.uniform(0.0, aborts.motion.duration)), str(rng.choice(WAYS))
    try:
        abort = aborts.found(command, how)
    except InfeasibleError as error:
        return f"| {seed} | {how} | {command:.2f} | – | – | – | refused: {error} |", False
    found = abort.certified
    motion = found.motion
    if how == "hold" and motion.phases[-1].state in PASSING:
        onward = aborts.player.path(abort.rest, aborts.motion.duration)
        motion = followed(motion, retimed(aborts.motion, onward))
        how = "hold, then on"
    with tempfile.TemporaryDirectory() as place:
        task = read_task(ho.Plan(motion, found.certificate).save(place))
    done = simulate(task, Settings(perturbations=USUAL, seed=seed))
    far = away(done)
    succeeded = done.outcome.succeeded and far <= STILL
    ends = "hitched" if task.formed[-1] else "untied"
    low = float(np.max(task.setpoints.positions[-1, :, 2]) - done.flight.ground)
    ends += " on the ground" if low < STILL else " in the air"
    words = "; ".join(f"t = {each.time:.1f} s: {each.words}" for each in done.outcome.failures)
    verdict = "succeeded" if succeeded else words or "not still"
    return (
        f"| {seed} | {how} | {command:.2f} | {task.duration:.1f} | {ends} | {100 * far:.1f} | "
        f"{verdict} |"
    ), succeeded


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--problem", default="tie_carry_untie")
    given = parser.parse_args()
    versions = f"Python {platform.python_version()}, MuJoCo {mujoco.__version__}"
    print(f"{platform.machine()}, {versions}, preset fast\n")
    print(
        "| seed | abort | command [s] | flight [s] | ends | drones off [cm] | outcome |\n"
        "|---|---|---|---|---|---|---|"
    )
    aborts = Aborts(ho.solve(PROBLEMS / f"{given.problem}.yaml").motion)
    count = 0
    for seed in range(given.first, given.first + given.flights):
        begin = time.perf_counter()
        row, succeeded = flown(aborts, seed)
        count += succeeded
        print(row, f"<!-- {time.perf_counter() - begin:.0f} s -->", flush=True)
    print(f"\n{count} of {given.flights} succeeded")


if __name__ == "__main__":
    main()
