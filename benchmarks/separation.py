"""Single drones: circles, random teams and crowds, compared with plain casadi and IPOPT.

Usage: python -m benchmarks separation [circles] [random] [crowds] [rival]

``circles``: every drone flies to the opposite point; ``random``: 100 seeded teams of 10 to 30
drones; ``crowds``: random positions, as dense as 1000 drones in 20 × 20 × 10 m; ``rival``: small
circles by IPOPT, ellipsoids and limits kept at knots alone.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from scipy.interpolate import BSpline

import hitchopt as ho
from benchmarks.measuring import Table, parser, slope, timed
from hitchopt.planners.timing.ramps import fastest_ramps
from problems.swarm import (
    antipodal_circle,
    random_crowd,
    random_team,
)

LIMITATIONS = (
    "one machine, one run each; processor time with the certificate's; bound: what the drone that "
    "flies farthest takes alone; the rival is built by this repository's authors"
)

CIRCLES, SMALL, CROWDS, TEAMS = (6, 12, 24, 64, 200), (6, 12, 24), (100, 300, 1000), 100

DEGREE, POINTS, KNOTS, FIXED = 5, 14, 24, 3
"""Degree, number of control points and number of knots of the rival's splines; number of control
points at either end that are fixed by rest."""


def bound(problem: ho.Problem) -> float:
    """Return the minimum duration of the drone with the longest distance alone [s]."""
    limits = problem.limits
    distance = np.linalg.norm(problem.mission[0].goal - problem.start, axis=1)
    durations, _ = fastest_ramps(distance, limits.speed, limits.acceleration, limits.jerk)
    return float(np.max(durations))


def cells(problem: ho.Problem) -> tuple[float, float, float, float, str]:
    """Return processor time, duration, its ratio to the bound, separation and certificate."""
    plan, elapsed = timed(lambda: ho.separate(problem))
    ratio, certificate = plan.duration / bound(problem), plan.certificate
    certified = "yes" if certificate.certified else "NO"
    return elapsed, plan.duration, ratio, certificate["separation"].worst or 0.0, certified


COLUMNS = ("processor [s]", "duration [s]", "over bound", "separation, all t", "certified")


def circles(table: Table) -> None:
    """Add the circles."""
    table.section("Circles", "N", *COLUMNS)
    ho.separate(ho.problem_from_dict(antipodal_circle(2)))  # imports are not measured
    times = []
    for n in CIRCLES:
        row = cells(ho.problem_from_dict(antipodal_circle(n)))
        times.append(row[0])
        table.row(n, *row)
    table.note(f"time grows as N^{slope(CIRCLES, times):.2f}")


def random(table: Table) -> None:
    """Add the random teams."""
    times, ratios, failed = [], [], []
    for seed in range(TEAMS):
        try:
            elapsed, _, ratio, *_ = cells(ho.problem_from_dict(random_team(seed)))
        except ho.InfeasibleError:
            failed.append(str(seed))
            continue
        times.append(elapsed)
        ratios.append(ratio)
    columns = "teams", "certified", "refused seeds", "median [s]", "most [s]", "over bound, median"
    table.section("Random teams of 10 to 30 in 4 × 4 × 2 m", *columns)
    middle = float(np.median(times)), max(times), float(np.median(ratios))
    table.row(TEAMS, TEAMS - len(failed), ", ".join(failed), *middle)


def crowds(table: Table) -> None:
    """Add the crowds."""
    table.section("Crowds between random positions", "N", *COLUMNS)
    for n in CROWDS:
        table.row(n, *cells(ho.problem_from_dict(random_crowd(n))))


def rival(table: Table) -> None:
    """Add the circles of the rival."""
    columns = ("N", "processor [s]", "duration [s]", "separation, 2000 samples")
    table.section("Plain casadi and IPOPT on circles", *columns)
    for n in SMALL:
        (duration, separation), elapsed = timed(
            partial(fly, ho.problem_from_dict(antipodal_circle(n)))
        )
        table.row(n, elapsed, duration, separation)


def fly(problem: ho.Problem, limit: float = 120.0) -> tuple[float, float]:
    """Return the duration [s] of IPOPT's solution and its minimum separation, or nan.

    Drones are B-splines from rest to rest with free final time. The initial guess are lines that
    bulge to the right, which breaks the symmetry of circles.
    """
    n, limits, goal = problem.team.drones, problem.limits, problem.mission[0].goal
    spans = POINTS - DEGREE
    places = np.concatenate([np.zeros(DEGREE), np.linspace(0.0, 1.0, spans + 1), np.ones(DEGREE)])
    basis, s = BSpline(places, np.eye(POINTS), DEGREE), np.linspace(0.0, 1.0, KNOTS)
    opti = ca.Opti()
    inner, T = opti.variable(POINTS - 2 * FIXED, 3 * n), opti.variable()
    ends = [ca.DM(np.tile(end.ravel(), (FIXED, 1))) for end in (problem.start, goal)]
    control = ca.vertcat(ends[0], inner, ends[1])
    for order, limit_of_order in ((1, limits.speed), (2, limits.acceleration), (3, limits.jerk)):
        rate = ca.reshape(ca.mtimes(ca.DM(basis(s, order)), control).T, 3, n * KNOTS)
        opti.subject_to(ca.vec(ca.sum1(rate**2)) <= (limit_of_order * T**order) ** 2)
    points = ca.mtimes(ca.DM(basis(s)), control)
    i, j = np.triu_indices(n, 1)
    squared = ca.MX(0.0)
    for axis, scale in enumerate(problem.separation.scale):
        offset = points[:, (3 * i + axis).tolist()] - points[:, (3 * j + axis).tolist()]
        squared = squared + (float(scale) * offset) ** 2
    opti.subject_to(ca.vec(squared) >= 1.0)
    opti.subject_to(T >= 0.1)
    opti.minimize(T)
    opti.set_initial(T, 1.2 * bound(problem))
    share = np.linspace(0.0, 1.0, POINTS - 2 * FIXED + 2)[1:-1, None, None]
    line = goal - problem.start
    right = np.column_stack([line[:, 1], -line[:, 0], np.zeros(n)])
    right /= np.maximum(np.linalg.norm(right, axis=1, keepdims=True), 1e-9)
    bulge = 1.2 * problem.separation.radius * n / np.pi * np.sin(np.pi * share) * right
    guess = problem.start + share * line + bulge
    opti.set_initial(inner, guess.reshape(len(share), -1))
    quiet: dict[str, Any] = {"print_level": 0, "sb": "yes", "max_iter": 3000, "max_cpu_time": limit}
    opti.solver("ipopt", {"expand": True, "print_time": False}, quiet)
    try:
        solution = opti.solve()
    except RuntimeError:
        return np.nan, np.nan
    curve = BSpline(places, np.asarray(solution.value(control), dtype=np.float64), DEGREE)
    flown = curve(np.linspace(0.0, 1.0, 2000)).reshape(-1, n, 3) * problem.separation.scale
    separation = float(np.min(np.linalg.norm(flown[:, i] - flown[:, j], axis=-1)))
    return float(solution.value(T)), separation


PARTS: dict[str, Callable[[Table], None]] = {
    "circles": circles,
    "random": random,
    "crowds": crowds,
    "rival": rival,
}


def main() -> None:
    """Print and write the requested parts."""
    cli = parser(__doc__)
    cli.add_argument("parts", nargs="*", choices=[*PARTS, []], default=[], help="or all")
    options = cli.parse_args()
    table = Table(options.output / "separation.md", "Single drones", LIMITATIONS)
    for name in options.parts or PARTS:
        PARTS[name](table)
