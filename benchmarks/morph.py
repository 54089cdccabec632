"""How long a straight morph of a regular n-gon takes to plan, certify and write, and where.

Usage: python -m benchmarks.morph [ROBOTS …] [--density KG/M] [--repeat N] [--profile]
"""

from __future__ import annotations

import argparse
import cProfile
import pstats
import resource
import tempfile
import time

import numpy as np

import hitchopt as ho
from benchmarks.environment import print_environment
from benchmarks.relaxed_clearance import DEFAULT, HEADING, NOTE, clearance_text
from hitchopt.planners.path.shape_path import ShapePath
from hitchopt.planners.timing.demands import Demands
from hitchopt.planners.timing.speed_profile import fastest_profile

FINE = 1001


def cable_clearance(n: int) -> float:
    """Return the cable clearance [m] of the benchmarks' n-gons, relaxed where it is too small.

    A drone stands about ``e sin(2π/n)`` from its neighbour's cable.
    """
    return min(DEFAULT, 0.15 * float(np.sin(2.0 * np.pi / n)))


def problem(n: int, density: float = 0.0) -> tuple[ho.Hitch, ho.ConvexPolygon, ho.Separation]:
    """Return a regular n-gon with edges of 1.3 m to be scaled to 1.35 m and shifted by 0.3 m.

    Cables of 2 m. Clearances are asked for as the geometry allows.
    """
    clearance = cable_clearance(n)
    separation = ho.Separation(cable=clearance, crossing=min(0.05, clearance))
    team = ho.Team(n, 2.0, cable_density=density)
    start = ho.Hitch.spread(team, ho.regular_polygon(n, 1.3), separation=separation)
    return start, ho.regular_polygon(n, 1.35).translated([0.3, 0.0]), separation


def processor_time(n: int, density: float, repeat: int) -> str:
    """Return a row: the least and the median processor time of morphs to slightly other polygons.

    What is imported and compiled once is not timed.
    """
    start, goal, separation = problem(n, density)
    times = []
    for i in range(repeat + 1):
        began = time.process_time()
        ho.morph(start, goal.translated([1e-4 * i, 0.0]), separation=separation)
        times.append(time.process_time() - began)
    return f"{n:6d} {density:9g} {min(times[1:]):10.3f} {np.median(times[1:]):11.3f}"


def measure(n: int, density: float) -> str:
    """Return a row of the table."""
    start, goal, separation = problem(n, density)
    began = time.perf_counter()
    plan = ho.morph(start, goal, separation=separation)
    planned = time.perf_counter()
    ho.certify(plan.motion)
    certified = time.perf_counter()
    with tempfile.TemporaryDirectory() as place:
        plan.save(place)
        written = time.perf_counter()
    end = ho.Hitch(start.team, goal, 1.0, plan.at(plan.duration).legs[:, 0])
    path = ShapePath.straight(start, end)
    s = np.linspace(0.0, 1.0, FINE)
    optimum = fastest_profile(s, Demands.along(path, ho.Limits(), s)).duration
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return (
        f"{n:6d} {plan.motion.drones.pieces:7d} {planned - began:10.2f} {certified - planned:12.2f}"
        f" {written - certified:9.2f} {plan.duration:11.3f} {optimum:11.3f} {memory:10.0f}"
        f" {clearance_text(separation.cable):>11}"
    )


def main() -> None:
    """Print machine, versions, settings, then one row per n."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robots", type=int, nargs="*", default=[3, 10, 30, 100, 300])
    parser.add_argument("--density", type=float, default=0.0, help="of the cables [kg/m]")
    parser.add_argument(
        "--repeat", type=int, help="print the processor time of so many solves each instead"
    )
    parser.add_argument(
        "--profile", action="store_true", help="show where the last one's time goes"
    )
    arguments = parser.parse_args()
    print_environment("one run each, in one process; certificate within 1e-4; setpoints at 100 Hz")
    if arguments.repeat:
        print("     n  density  least [s]  median [s]   of processor time")
        for n in arguments.robots:
            print(processor_time(n, arguments.density, arguments.repeat), flush=True)
        return
    print("toppra: its optimum on a grid of 1000 steps, without a jerk limit")
    print(NOTE)
    print(
        "     n  pieces   plan [s]  certify [s]  write [s]  flight [s]  toppra [s]  peak [MB]"
        f"  {HEADING}"
    )
    ho.morph(*problem(3)[:2])  # what is imported and compiled once is not timed
    for n in arguments.robots:
        print(measure(n, arguments.density), flush=True)
    if arguments.profile:
        start, goal, separation = problem(arguments.robots[-1], arguments.density)
        profile = cProfile.Profile()
        profile.runcall(ho.morph, start, goal, separation=separation)
        pstats.Stats(profile).sort_stats("tottime").print_stats(25)


if __name__ == "__main__":
    main()
