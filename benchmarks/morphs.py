"""Morphs: solve times over n, of random polygons, and comparison with plain casadi and IPOPT.

Usage: python -m benchmarks morphs [--quick] [--limit SECONDS] [--count N]

Every row of regular n-gons is measured in a process of its own. ``straight`` scales and shifts a
polygon; ``optimised`` turns it by 0.3 rad, or less where vertices would go farther than 0.6 m;
``half turn`` turns it by π, for which the straight path is blocked. Second solves are the least of
several in one process, each to a goal a millimetre farther: what a program that plans again and
again waits for. The rival builds its solver in its first solve, and keeps it.

``--count`` random polygons of 3 to 24 vertices are stretched, turned and moved, all in one process.
``--limit`` bounds IPOPT's processor time in the rival.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial

import numpy as np

import hitchopt as ho
from benchmarks.measuring import (
    CLEARANCE,
    CLEARANCE_NOTE,
    DEFAULT_CLEARANCE,
    Table,
    clearance_text,
    parser,
    peak_memory,
    slope,
    timed,
)
from benchmarks.rival import Rival, RivalError, RivalFlight
from problems.random_morph import random_convex_polygon

LIMITATIONS = (
    "one machine, one run each in its own process; processor time; cables of 2 m; "
    "first and second are whole solves with their certificates and without imports, the second "
    "the fastest of several; the rival limits "
    "neither jerk nor clearances of cables, and its model is built by this repository's authors; "
    f"{CLEARANCE_NOTE}"
)

TURN, TRAVEL = 0.3, 0.6
"""Maximum turn [rad] and travel of vertices [m] of optimised morphs."""

STEP = 1e-3
"""[m] Distance of the goals of consecutive solves."""

MAX_RIVAL_ROBOTS = 12
"""Maximum size of random polygons that the rival gets: its graph grows with the square of n."""

SIZES = ((3, 6), (7, 12), (13, 24))
"""Smallest and largest numbers of vertices of rows of random polygons."""

COUNT_OF_SIZES = SIZES[-1][1] - SIZES[0][0] + 1
"""Number of sizes of random polygons; consecutive seeds have consecutive sizes."""


@dataclass(frozen=True)
class Measurements:
    """Measurements of one process; a rival has no memory or certificate."""

    first: float  # processor time [s]
    second: float | None = None  # processor time [s]
    certify: float | None = None  # processor time [s]
    write: float | None = None  # processor time [s]
    flight: float | None = None  # duration of the flight [s]
    peak: float | None = None  # peak memory [MB]
    remark: str = ""  # violations or errors


def clearance(n: int) -> float:
    """Return the cable clearance [m] of an n-gon, whose drones have distances ``e sin(2π/n)``."""
    return min(DEFAULT_CLEARANCE, 0.15 * float(np.sin(2.0 * np.pi / n)))


def measure(kind: str, n: int, limit: float) -> Measurements:
    """Return the measurements of a morph in this process; ``rival`` solves the optimised one."""
    separation = ho.Separation(cable=clearance(n), crossing=min(0.05, clearance(n)))
    team, limits = ho.Team(n, 2.0), ho.Limits()
    start = ho.Hitch.spread(team, ho.regular_polygon(n, 1.3), separation=separation)
    if kind == "straight":
        goal = ho.regular_polygon(n, 1.35).translated([0.3, 0.0])
    else:
        radius = 0.65 / np.sin(np.pi / n)
        turn = np.pi if kind == "half turn" else min(TURN, TRAVEL / radius)
        goal = ho.regular_polygon(n, 1.3).rotated(turn)
    if kind == "rival":
        return _rival(start, goal, limits, separation, limit)

    def plan(k: int = 0) -> ho.Plan:
        moved = goal.translated([STEP * k, 0.0])
        return ho.morph(start, moved, separation=separation, optimize=kind != "straight")

    _, first = timed(plan)
    second = _least(plan, 9 if n <= 12 else 3 if n <= 100 else 1)
    last_plan = plan()
    certify, peak = timed(lambda: ho.certify(last_plan.motion))[1], peak_memory()
    with tempfile.TemporaryDirectory() as place:
        write = timed(lambda: last_plan.save(place))[1]
    remark = "" if last_plan.certificate.certified else "not certified"
    return Measurements(first, second, certify, write, last_plan.duration, peak, remark)


def _rival(
    start: ho.Hitch,
    goal: ho.ConvexPolygon,
    limits: ho.Limits,
    separation: ho.Separation,
    limit: float,
) -> Measurements:
    rival = Rival(start.team, limits, separation, limit)
    ends = [_end(start, goal.translated([STEP * k, 0.0]), limits, separation) for k in range(4)]
    flight, first = timed(lambda: _attempt(rival, start, ends[0]))
    second = _least(lambda k: _attempt(rival, start, ends[k]), 3)
    if isinstance(flight, RivalError):
        return Measurements(first, second, remark=str(flight))
    remark = f"breaks speed or acceleration by {flight.excess:.1%}" if flight.excess > 0.0 else ""
    return Measurements(first, second, flight=flight.duration, remark=remark)


def _end(
    start: ho.Hitch, goal: ho.ConvexPolygon, limits: ho.Limits, separation: ho.Separation
) -> ho.Hitch:
    """Return the hitch on the goal with the nearest fractions."""
    kept = start.fractions
    return ho.Hitch.nearest(start.team, goal, 1.0, kept, limits=limits, separation=separation)


def _attempt(
    rival: Rival, start: ho.Hitch, end: ho.Hitch, seed: ho.Plan | None = None
) -> RivalFlight | RivalError:
    """Return the rival's flight or its error."""
    try:
        return rival.solve(start, end, seed)
    except RivalError as error:
        return error


def _least(solve: Callable[[int], object], count: int) -> float:
    """Return the least processor time [s] of calls with 1, 2, … ``count``."""
    return min(timed(partial(solve, k))[1] for k in range(1, count + 1))


def random_task(seed: int) -> tuple[ho.Hitch, ho.ConvexPolygon, ho.Separation]:
    """Return a random hitch of 3 to 24 robots and a goal near it; most drones have neighbours."""
    n = SIZES[0][0] + seed % COUNT_OF_SIZES
    rng = np.random.default_rng([n, seed])
    edge = min(1.3, 2.0 * rng.uniform(0.55, 2.0) * np.sin(np.pi / n))
    polygon = random_convex_polygon(n, float(edge), rng, 0.1)
    moved = polygon.vertices * np.exp(rng.uniform(-0.15, 0.15, 2))
    goal = ho.ConvexPolygon(moved).rotated(rng.uniform(-1.0, 1.0) / n)
    separation = ho.Separation(cable=clearance(n), crossing=min(0.05, clearance(n)))
    start = ho.Hitch.spread(ho.Team(n, 2.0), polygon, separation=separation)
    return start, goal.translated(rng.uniform(-0.3, 0.3, 2)), separation


@dataclass(frozen=True)
class Outcome:
    """A second solve of a random polygon."""

    seconds: float  # processor time [s]
    flight: float | None  # duration of the flight [s]; None without one


def outcomes(seed: int, rivals: dict[int, Rival], limit: float) -> dict[str, Outcome]:
    """Return the outcomes by kind, none if the start is infeasible; ``rivals`` are kept by n."""
    try:
        start, goal, separation = random_task(seed)
    except ho.InfeasibleError:
        return {}

    def plan_of(optimize: bool) -> ho.Plan | None:
        try:
            return ho.morph(start, goal, separation=separation, optimize=optimize)
        except ho.InfeasibleError:
            return None

    n, results, plans = start.team.robots, dict[str, Outcome](), dict[str, ho.Plan | None]()
    for kind, optimize in (("straight", False), ("optimised", True)):
        plan, seconds = timed(partial(plan_of, optimize))
        plans[kind] = plan
        results[kind] = Outcome(seconds, None if plan is None else plan.duration)
    if n <= MAX_RIVAL_ROBOTS and results["straight"].flight is not None:
        end = _end(start, goal, ho.Limits(), separation)
        if n not in rivals:
            rivals[n] = Rival(start.team, ho.Limits(), separation, limit)
            _attempt(rivals[n], start, end)
        for kind, seed_plan in (("rival", None), ("rival from straight", plans["straight"])):
            solved, seconds = timed(partial(_attempt, rivals[n], start, end, seed_plan))
            flight = None if isinstance(solved, RivalError) else solved.duration
            results[kind] = Outcome(seconds, flight)
    return results


def measure_random(count: int, limit: float, table: Table) -> None:
    """Write the rows of random polygons: processor times, and ratios to the straight plans."""
    columns = ("n", "kind", "morphs", "none", "p50 [s]", "p95 [s]", "worst [s]")
    ratios = ("time / straight: p50", "p95", "worst", "flight / straight: p50", "least", "worst")
    table.section("Random polygons, second solves", *columns, *ratios)
    rivals = dict[int, Rival]()
    outcomes(0, rivals, limit)  # first solves
    by_size: dict[int, list[dict[str, Outcome]]] = defaultdict(list)
    for seed in range(count):
        by_size[SIZES[0][0] + seed % COUNT_OF_SIZES].append(outcomes(seed, rivals, limit))
    for least, largest in (*SIZES, (SIZES[0][0], SIZES[-1][1])):
        found = [each for n in range(least, largest + 1) for each in by_size[n]]
        for kind in ("straight", "optimised", "rival", "rival from straight"):
            pairs = [(each["straight"], each[kind]) for each in found if kind in each]
            if not pairs:
                continue
            seconds = [one.seconds for _, one in pairs]
            times = [one.seconds / straight.seconds for straight, one in pairs]
            flights = [
                one.flight / straight.flight
                for straight, one in pairs
                if one.flight is not None and straight.flight is not None
            ]
            missing = sum(one.flight is None for _, one in pairs)
            cells = [*np.percentile(seconds, [50, 95, 100]), *np.percentile(times, [50, 95, 100])]
            cells += [*np.percentile(flights, [50, 0, 100])] if flights else []
            row = (f"{least} to {largest}", kind, len(pairs), missing)
            table.row(*row, *(float(cell) for cell in cells))


def measure_many(quick: bool, table: Table) -> None:
    """Write how many straight morphs all processors plan per second."""
    table.section("Many morphs on all processors", "n", "morphs", "planned", "morphs per second")
    for n in (3, 6) if quick else (3, 6, 12, 24):
        separation = ho.Separation(cable=clearance(n), crossing=min(0.05, clearance(n)))
        start = ho.Hitch.spread(ho.Team(n, 2.0), ho.regular_polygon(n, 1.3), separation=separation)
        count = 16 if quick else 64
        goals = [start.polygon.translated([STEP * k, 0.1]) for k in range(count)]
        begin = time.perf_counter()
        plans = ho.morphs([(start, goal) for goal in goals], separation=separation)
        seconds = time.perf_counter() - begin
        planned = sum(isinstance(plan, ho.Plan) for plan in plans)
        table.row(n, count, planned, count / seconds)


def measure_in_process(kind: str, n: int, limit: float) -> Measurements:
    """Return the measurements of a separate process."""
    command = [sys.executable, "-m", "benchmarks", "morphs", "--one", kind, str(n), str(limit)]
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    process = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, **threads}
    )
    if process.returncode != 0:
        return Measurements(np.nan, remark=(process.stderr.strip().splitlines() or ["failed"])[-1])
    return Measurements(**json.loads(process.stdout.splitlines()[-1]))


def main() -> None:
    """Print and write the table."""
    cli = parser(__doc__, limit=120.0, count=200)
    cli.add_argument("--quick", action="store_true", help="a few small ones")
    cli.add_argument("--one", nargs=3, metavar=("KIND", "N", "LIMIT"), help="print it as JSON")
    options = cli.parse_args()
    if options.one:
        kind, n, limit = options.one
        print(json.dumps(asdict(measure(kind, int(n), float(limit)))))
        return
    cases = [
        ("straight", n) for n in ((3, 10, 30) if options.quick else (3, 10, 30, 100, 300, 1000))
    ]
    cases += [("optimised", n) for n in ((3, 6) if options.quick else (3, 6, 12, 24, 100))]
    cases += [("half turn", n) for n in ((3, 6) if options.quick else (3, 6, 12))]
    cases += [("rival", n) for n in ((3, 6) if options.quick else (3, 6, 12))]
    table = Table(options.output / "morphs.md", "Morphs", LIMITATIONS)
    columns = ("first [s]", "second [s]", "certify [s]", "write [s]", "flight [s]", "peak [MB]")
    table.section("", "kind", "n", *columns, CLEARANCE, "remark")
    results: dict[tuple[str, int], Measurements] = {}
    for kind, n in cases:
        one = results[kind, n] = measure_in_process(kind, n, options.limit)
        values = (one.first, one.second, one.certify, one.write, one.flight, one.peak)
        cells = ("" if value is None else value for value in values)
        table.row(kind, n, *cells, clearance_text(clearance(n)), one.remark)
    for n in (n for kind, n in results if kind == "rival"):
        ours, theirs = results["optimised", n], results["rival", n]
        if ours.second and theirs.second and ours.flight and theirs.flight:
            table.note(
                f"n = {n}: the rival takes {theirs.first / ours.first:.1f} times as long, first "
                f"solve by first, and {theirs.second / ours.second:.1f} times, second by second; "
                f"hitchopt's flight over the rival's: {ours.flight / theirs.flight:.3f}"
            )
    for kind in ("straight", "optimised"):
        large = {n: one.second for (k, n), one in results.items() if k == kind and n >= 6}
        times = [time for time in large.values() if time]
        if len(times) == len(large) > 1:
            exponent = slope(list(large), times)
            table.note(f"{kind}: second solves grow as n^{exponent:.2f} from n = 6 on")
    measure_many(options.quick, table)
    measure_random(22 if options.quick else options.count, options.limit, table)
