"""What every perturbation of a flight does to resting vertices, by statics.

Usage: python -m benchmarks.rest_errors [ROBOTS …] [--samples N]

The hitches of ``benchmarks.flights weight`` at rest, with the perturbations of simulated flights
one by one and all together: mean distance of vertices to the plan, of cables without thickness and
of ropes as thick as simulated ones. Noise and gusts count as if drones followed them at once, which
is more than they do in flight.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np

import hitchopt as ho
from benchmarks.environment import print_environment
from benchmarks.flight_plans import at_rest
from benchmarks.settling import passing
from hitchopt.simulation.drone_control import POSITION_GAIN
from hitchopt.simulation.simulation_settings import ACCURATE, USUAL

LIMITATIONS = (
    "statics alone: no swinging, friction or downwash; ropes of 12 mm stand for drones that are "
    "moved aside by what planned bends take"
)

SEED = 0


def samples(team: ho.Team, count: int) -> dict[str, dict[str, Any]]:
    """Return the conditions (count, …) of each kind of perturbation, by name."""
    rng = np.random.default_rng(SEED)
    drones = (count, team.drones, 3)
    heading = rng.uniform(0.0, 2.0 * np.pi, (count, 1))
    level = np.stack([np.cos(heading), np.sin(heading), 0.0 * heading], axis=-1)
    noise = {"offsets": USUAL.noise * rng.standard_normal(drones)}
    lengths = 1.0 + USUAL.cable_error * rng.standard_normal((count, team.robots))
    cables = {"cable_length": team.cable_length * lengths}
    gusts = USUAL.wind / np.sqrt(3.0) * rng.standard_normal(drones)
    steady = np.broadcast_to(USUAL.steady_wind * level, drones)
    return {
        "none": {},
        f"noise of {100.0 * USUAL.noise:g} cm": noise,
        f"cables {100.0 * USUAL.cable_error:g} % off": cables,
        f"steady wind, {USUAL.steady_wind:g} N": {"forces": steady},
        f"gusts, {USUAL.wind:g} N": {"forces": gusts},
        "all": {**noise, **cables, "forces": steady + gusts},
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a row for every number of robots and kind of perturbation."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robots", type=int, nargs="*", default=[3, 4, 6])
    parser.add_argument("--samples", type=int, default=600)
    given = parser.parse_args(arguments)
    print_environment(LIMITATIONS)
    print("\n| n | perturbation | thin cables [cm] | ropes of 12 mm [cm] | samples within 2 cm |")
    print("|---|---|---|---|---|")
    for n in given.robots:
        plan = ho.solve(at_rest(n))
        team = plan.motion.team
        times = np.full(given.samples, plan.duration)
        aside = passing(plan, ACCURATE.diameter)
        for name, conditions in samples(team, given.samples).items():
            means = []
            for shift in (0.0, aside):
                moved = {**conditions, "offsets": conditions.get("offsets", 0.0) + shift}
                stiffness = POSITION_GAIN * team.mass
                found = ho.settle(plan, times, stiffness=stiffness, **moved)
                away = np.linalg.norm(found.vertices - found.planned_vertices, axis=-1)
                means.append(np.mean(away, axis=-1))
            within = float(np.mean(means[1] <= 0.02))
            thin, thick = (f"{100.0 * np.mean(each):.2f}" for each in means)
            print(f"| {n} | {name} | {thin} | {thick} | {within:.0%} |", flush=True)


if __name__ == "__main__":
    main()
