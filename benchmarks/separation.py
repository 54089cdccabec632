"""The separation planner on circles and random teams, beside plain Opti with ellipsoids at knots.

Usage: python -m benchmarks.separation [circles | rival | random | crowds] ...

``circles``: antipodal circles of 6 to 200 drones; ``rival``: IPOPT on those of 6, 12 and 24;
``random``: 100 seeded teams of 10 to 30 drones; ``crowds``: random places of 100 to 1000. All of
them without a word.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable

import numpy as np

import hitchopt as ho
from benchmarks.environment import busy, print_environment
from benchmarks.separation_rival import KNOTS, RivalError, RivalFlight, fly_opti
from hitchopt.checks import certify
from hitchopt.mission.loading import any_problem_from_dict
from hitchopt.mission.swarm_problem import SwarmProblem
from hitchopt.motion.motion import Motion, Phase
from hitchopt.planners.timing.ramps import fastest_ramps
from hitchopt.requirements import Requirements
from problems.swarm import antipodal_circle, random_crowd, random_team

CIRCLES = (6, 12, 24, 64, 200)
RIVAL_CIRCLES = (6, 12, 24)

RIVAL_SECONDS = 120.0
"""Processor time that IPOPT is given."""

TEAMS = 100

CROWDS = (100, 300, 1000)


def circle(n: int) -> SwarmProblem:
    """Return the antipodal circle of n drones."""
    problem = any_problem_from_dict(antipodal_circle(n))
    if not isinstance(problem, SwarmProblem):
        raise TypeError("a circle is of single drones")
    return problem


def bound(problem: SwarmProblem) -> float:
    """Return what the drone that flies farthest takes at least, alone [s]."""
    limits = problem.limits
    distance = np.linalg.norm(problem.goal - problem.start, axis=1)
    ramps = fastest_ramps(distance, limits.speed, limits.acceleration, limits.jerk)
    return float(np.max(ramps.duration))


def measure_circles() -> None:
    """Print a row for every circle, and how time grows with the number of drones."""
    print("antipodal circles (radius 2 m, or as much as sets neighbours 0.36 m apart), no arena")
    print(
        "    N  radius [m]  processor [s]  duration [s]  over bound  separation, all t  certified"
    )
    ho.separate(circle(2))  # imports are not what is measured
    counts, times = [], []
    for n in CIRCLES:
        problem = circle(n)
        began = time.process_time()
        plan = ho.separate(problem)
        seconds = time.process_time() - began
        ratio = plan.duration / bound(problem)
        radius = float(np.max(problem.start[:, 0]))
        worst = plan.certificate["separation"].worst
        print(
            f"  {n:3d}  {radius:10.2f}  {seconds:13.2f}  {plan.duration:12.3f}  {ratio:10.3f}  "
            f"{worst:17.4f}  {'yes' if plan.certificate.certified else 'NO'}",
            flush=True,
        )
        counts.append(n)
        times.append(seconds)
    for a in range(1, len(counts)):
        slope = math.log(times[a] / times[a - 1]) / math.log(counts[a] / counts[a - 1])
        print(f"  growth from {counts[a - 1]} to {counts[a]}: N^{slope:.1f}")


def measure_rival() -> None:
    """Print a row for every circle that IPOPT is given."""
    print(f"plain casadi.Opti + IPOPT, ellipsoids and limits at {KNOTS} knots, the same circles")
    print(
        "    N  processor [s]  duration [s]  iterations  separation at knots, between  worst excess"
    )
    for n in RIVAL_CIRCLES:
        problem = circle(n)
        began = time.process_time()
        try:
            found = fly_opti(problem, 1.2 * bound(problem), RIVAL_SECONDS)
        except RivalError as error:
            print(f"  {n:3d}  {time.process_time() - began:13.1f}  nothing: {error}", flush=True)
            continue
        seconds = time.process_time() - began
        print(f"  {n:3d}  {seconds:13.1f}  {_rival_row(problem, found)}", flush=True)


def _rival_row(problem: SwarmProblem, found: RivalFlight) -> str:
    curves = found.curves
    phase = Phase("fly", 0, 0.0, curves.duration)
    motion = Motion.single(
        problem.team, Requirements(problem.limits, problem.separation, None), curves, (phase,)
    )
    certificate = certify(motion)
    points = curves.at(np.linspace(0.0, curves.duration, KNOTS)) * problem.separation.scale
    i, j = np.triu_indices(problem.team.drones, 1)
    at_knots = float(np.min(np.linalg.norm(points[:, i] - points[:, j], axis=-1)))
    excess = max(
        certificate[name].bound / certificate[name].number - 1.0
        for name in ("speed", "acceleration", "jerk")
    )
    between = certificate["separation"].worst
    return (
        f"{curves.duration:12.3f}  {found.iterations:10d}  {at_knots:19.3f}, {between:7.3f}  "
        f"{excess:11.1%}"
    )


def measure_random() -> None:
    """Print how many random teams are planned and certified, and those that are not."""
    print(f"{TEAMS} random teams of 10 to 30 drones in 4 x 4 x 2 m (seeds 0 to {TEAMS - 1})")
    ratios, times, failed = [], [], 0
    for seed in range(TEAMS):
        problem = any_problem_from_dict(random_team(seed))
        if not isinstance(problem, SwarmProblem):
            raise TypeError("a random team is of single drones")
        began = time.process_time()
        try:
            plan = ho.separate(problem)
        except ho.InfeasibleError as error:
            failed += 1
            print(f"  seed {seed}: {error}", flush=True)
            continue
        times.append(time.process_time() - began)
        ratios.append(plan.duration / bound(problem))
    print(f"  planned and certified: {TEAMS - failed} of {TEAMS}")
    print(f"  processor time: {np.median(times):.2f} s (median), {np.max(times):.2f} s at most")
    print(f"  duration over bound: {np.median(ratios):.3f} (median), {np.max(ratios):.3f} at most")


def measure_crowds() -> None:
    """Print a row for random crowds of the density of 1000 drones in 20 x 20 x 10 m."""
    print("random crowds, 1000 drones in 20 x 20 x 10 m and as dense (seed 0), no arena")
    print("     N  processor [s]  duration [s]  over bound  separation, all t  certified")
    for n in CROWDS:
        problem = any_problem_from_dict(random_crowd(n))
        if not isinstance(problem, SwarmProblem):
            raise TypeError("a crowd is of single drones")
        began = time.process_time()
        plan = ho.separate(problem)
        seconds = time.process_time() - began
        print(
            f"  {n:4d}  {seconds:13.2f}  {plan.duration:12.3f}  "
            f"{plan.duration / bound(problem):10.3f}  "
            f"{plan.certificate['separation'].worst:17.4f}  "
            f"{'yes' if plan.certificate.certified else 'NO'}",
            flush=True,
        )


PARTS: dict[str, Callable[[], None]] = {
    "circles": measure_circles,
    "rival": measure_rival,
    "random": measure_random,
    "crowds": measure_crowds,
}


def main() -> None:
    """Print machine, versions, limitations, and what was asked for."""
    print_environment(
        "one run each, processor seconds in one process, certificates included; "
        f"{busy():.1f} processes wanted a core in the minute before"
    )
    for name in sys.argv[1:] or PARTS:
        print()
        PARTS[name]()


if __name__ == "__main__":
    main()
