"""Morphs of regular n-gons: solve times over n, and beside plain casadi and IPOPT.

Usage: python -m benchmarks morphs [--quick] [--limit SECONDS]

Every row is measured in a process of its own. ``straight`` scales and shifts a polygon;
``optimised`` turns it by 0.3 rad, or less where vertices would go farther than 0.6 m; ``half turn``
turns it by π, for which the straight path is blocked. Second solves are the least of nine in one
process, up to n = 12: what a program that plans again and again waits for.
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
    seconds,
    slope,
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
"""[rad], [m]"""


@dataclass(frozen=True)
class Measured:
    """What one process measured; a rival has no second solve, memory or certificate.

    Attributes
    ----------
    first, second, certify, write: processor times [s].
    flight: duration of what was found [s].
    peak: memory [MB].
    remark: what does not hold.
    """

    first: float
    second: float | None = None
    certify: float | None = None
    write: float | None = None
    flight: float | None = None
    peak: float | None = None
    remark: str = ""


def clearance(n: int) -> float:
    """Return the cable clearance [m] of an n-gon: drones are ``e sin(2π/n)`` from neighbours."""
    return min(DEFAULT_CLEARANCE, 0.15 * float(np.sin(2.0 * np.pi / n)))


def measure(kind: str, n: int, limit: float) -> Measured:
    """Return what a morph takes in this process; ``rival`` solves the optimised one."""
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

    first = seconds(plan)
    second = min(seconds(plan) for _ in range(9 if n <= 12 else 3 if n <= 100 else 1))
    found = plan()
    certify, peak = seconds(lambda: ho.certify(found.motion)), peak_memory()
    with tempfile.TemporaryDirectory() as place:
        write = seconds(lambda: found.save(place))
    remark = "" if found.certificate.certified else "not certified"
    return Measured(first, second, certify, write, found.duration, peak, remark)


def _rival(
    start: ho.Hitch,
    goal: ho.ConvexPolygon,
    limits: ho.Limits,
    separation: ho.Separation,
    limit: float,
) -> Measured:
    end = ho.Hitch.nearest(
        start.team, goal, 1.0, start.fractions, limits=limits, separation=separation
    )
    began = time.process_time()
    try:
        found = solve(start, end, limits, separation, limit)
    except RivalError as error:
        return Measured(time.process_time() - began, remark=str(error))
    took = time.process_time() - began
    remark = f"breaks speed or acceleration by {found.excess:.1%}" if found.excess > 0.0 else ""
    return Measured(took, flight=found.duration, remark=remark)


def alone(kind: str, n: int, limit: float) -> Measured:
    """Return what a process of its own measures."""
    command = [sys.executable, "-m", "benchmarks.morphs", "--one", kind, str(n), str(limit)]
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, **threads}
    )
    if done.returncode != 0:
        return Measured(np.nan, remark=(done.stderr.strip().splitlines() or ["failed"])[-1])
    return Measured(**json.loads(done.stdout.splitlines()[-1]))


def main() -> None:
    """Print and write the table."""
    options = parser(__doc__)
    options.add_argument("--quick", action="store_true", help="a few small ones")
    options.add_argument("--limit", type=float, default=120.0, help="for IPOPT in the rival [s]")
    options.add_argument("--one", nargs=3, metavar=("KIND", "N", "LIMIT"), help="print it as JSON")
    given = options.parse_args()
    if given.one:
        kind, n, limit = given.one
        print(json.dumps(asdict(measure(kind, int(n), float(limit)))))
        return
    cases = [("straight", n) for n in ((3, 10, 30) if given.quick else (3, 10, 30, 100, 300, 1000))]
    cases += [("optimised", n) for n in ((3, 6) if given.quick else (3, 6, 12, 24, 100))]
    cases += [("half turn", n) for n in ((3, 6) if given.quick else (3, 6, 12))]
    cases += [("rival", n) for n in ((3, 6) if given.quick else (3, 6, 12))]
    table = Table(given.output / "morphs.md", "Morphs", LIMITATIONS)
    columns = ("first [s]", "second [s]", "certify [s]", "write [s]", "flight [s]", "peak [MB]")
    table.section("", "kind", "n", *columns, CLEARANCE, "remark")
    found: dict[tuple[str, int], Measured] = {}
    for kind, n in cases:
        one = found[kind, n] = alone(kind, n, given.limit)
        values = (one.first, one.second, one.certify, one.write, one.flight, one.peak)
        cells = ("" if value is None else value for value in values)
        table.row(kind, n, *cells, clearance_text(clearance(n)), one.remark)
    for n in (n for kind, n in found if kind == "rival"):
        ours, theirs = found["optimised", n], found["rival", n]
        if ours.second and ours.flight and theirs.flight:
            table.note(
                f"n = {n}: the rival takes {theirs.first / ours.second:.1f} times as long as a "
                f"second solve, {theirs.first / ours.first:.1f} times as long as a first one; "
                f"hitchopt's flight over the rival's: {ours.flight / theirs.flight:.3f}"
            )
    for kind in ("straight", "optimised"):
        large = {n: one.second for (k, n), one in found.items() if k == kind and n >= 6}
        times = [time for time in large.values() if time]
        if len(times) == len(large) > 1:
            exponent = slope(list(large), times)
            table.note(f"{kind}: second solves grow as n^{exponent:.2f} from n = 6 on")


if __name__ == "__main__":
    main()
