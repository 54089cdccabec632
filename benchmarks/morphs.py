"""Morphs of regular n-gons: solve times over n, and comparison with plain casadi and IPOPT.

Usage: python -m benchmarks morphs [--quick] [--limit SECONDS]

Every row is measured in a process of its own. ``straight`` scales and shifts a polygon;
``optimised`` turns it by 0.3 rad, or less where vertices would go farther than 0.6 m; ``half turn``
turns it by π, for which the straight path is blocked. Second solves are the least of nine in one
process, up to n = 12: what a program that plans again and again waits for.
``--limit`` bounds IPOPT's processor time in the rival.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass

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
from benchmarks.rival import RivalError, solve

LIMITATIONS = (
    "one machine, one run each in its own process; processor time; regular n-gons, cables of 2 m; "
    "first and second are whole solves with their certificates and without imports, the second "
    "with the solvers that the first one built, the least of several; the rival knows "
    "neither jerk nor clearances of cables, and its model is built by this repository's authors; "
    f"{CLEARANCE_NOTE}"
)

TURN, TRAVEL = 0.3, 0.6
"""Maximum turn [rad] and travel of vertices [m] of optimised morphs."""


@dataclass(frozen=True)
class Measurements:
    """Measurements of one process; a rival has no second solve, memory or certificate."""

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

    def plan() -> ho.Plan:
        ho.forget()
        return ho.morph(start, goal, separation=separation, optimize=kind != "straight")

    _, first = timed(plan)
    second = min(timed(plan)[1] for _ in range(9 if n <= 12 else 3 if n <= 100 else 1))
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
    end = ho.Hitch.nearest(
        start.team, goal, 1.0, start.fractions, limits=limits, separation=separation
    )
    start_time = time.process_time()
    try:
        flight = solve(start, end, limits, separation, limit)
    except RivalError as error:
        return Measurements(time.process_time() - start_time, remark=str(error))
    elapsed = time.process_time() - start_time
    remark = f"breaks speed or acceleration by {flight.excess:.1%}" if flight.excess > 0.0 else ""
    return Measurements(elapsed, flight=flight.duration, remark=remark)


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
    cli = parser(__doc__, limit=120.0)
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
        if ours.second and ours.flight and theirs.flight:
            table.note(
                f"n = {n}: the rival takes {theirs.first / ours.second:.1f} times as long as a "
                f"second solve, {theirs.first / ours.first:.1f} times as long as a first one; "
                f"hitchopt's flight over the rival's: {ours.flight / theirs.flight:.3f}"
            )
    for kind in ("straight", "optimised"):
        large = {n: one.second for (k, n), one in results.items() if k == kind and n >= 6}
        times = [time for time in large.values() if time]
        if len(times) == len(large) > 1:
            exponent = slope(list(large), times)
            table.note(f"{kind}: second solves grow as n^{exponent:.2f} from n = 6 on")
