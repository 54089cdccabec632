"""Vertex errors of simulated flights of Experiment 2 with and without feedback.

Usage: python -m benchmarks.feedback [--preset fast|accurate] [--friction MU …] [--seeds N]
       [--flights with|without|both]

The plan knows neither friction nor weight of its cables. Vertices are measured with noise of 1 cm
per axis and a delay of 50 ms. Errors are distances in three dimensions, sag included, over all
vertices while the plan moves one.
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
from hitchopt.simulation.flight_task import Task, read_task
from hitchopt.simulation.simulate import simulate
from hitchopt.simulation.simulation_settings import PRESETS, Perturbations, Settings

PROBLEM = Path(__file__).parents[1] / "problems" / "paper_experiment_2.yaml"
FLIGHTS = {"with": (True,), "without": (False,), "both": (True, False)}
MEASURED = Perturbations(vertex_noise=0.01, vertex_delay=0.05)


def row(task: Task, preset: str, friction: float, seed: int, *, feedback: bool) -> str:
    """Return the row of a flight."""
    settings = Settings(
        preset=PRESETS[preset],
        perturbations=MEASURED,
        seed=seed,
        friction=friction,
        pull_test=False,
        feedback=feedback,
    )
    begin = time.perf_counter()
    done = simulate(task, settings)
    errors = done.errors
    moved = int(np.argmax(np.ptp(errors.planned, axis=0).max(axis=-1)))
    own = errors.errors[errors.moving, moved]
    each = (done.run.moving.mean, done.run.moving.largest, float(np.nanmean(own)))
    numbers = " | ".join(f"{100.0 * value:.2f}" for value in each)
    begun = f"| {friction:g} | {seed} | {'yes' if feedback else 'no'} |"
    return f"{begun} {numbers} | {done.run.verdict} | <!-- {time.perf_counter() - begin:.0f} s -->"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--preset", choices=sorted(PRESETS), default="accurate")
    parser.add_argument("--friction", type=float, nargs="*", default=[0.1, 0.3])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--flights", choices=sorted(FLIGHTS), default="both")
    given = parser.parse_args()
    versions = f"Python {platform.python_version()}, MuJoCo {mujoco.__version__}"
    print(f"{platform.machine()}, {versions}, preset {given.preset}\n")
    print(
        "| friction | seed | feedback | mean error while moving [cm] | largest [cm] | "
        "mean of the moved vertex [cm] | verdict |\n|---|---|---|---|---|---|---|"
    )
    with tempfile.TemporaryDirectory() as place:
        task = read_task(ho.solve(PROBLEM).save(Path(place) / "plan"))
    for friction in given.friction:
        for seed in range(given.seeds):
            for feedback in FLIGHTS[given.flights]:
                print(row(task, given.preset, friction, seed, feedback=feedback), flush=True)


if __name__ == "__main__":
    main()
