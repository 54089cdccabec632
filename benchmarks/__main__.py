"""All benchmarks: hitchopt against its rivals on the same morphs, and over n.

Usage: python -m benchmarks [--quick] [--limit SECONDS] [--samples M] [--output DIR]

Takes minutes; writes what it has after every case, so it may be interrupted.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.environment import busy, environment
from benchmarks.measure import OURS, RATE, RIVALS, Measurement
from benchmarks.results import best_time, draw, markdown, row, slope, write_csv
from hitchopt.model.cache import VARIABLE

TOLERANCES = (
    f"hitchopt: certificate within 1e-4, verified by samples at {RATE / 1000:.0f} kHz (column rate "
    "where these would be too many); IPOPT: 1e-8; a limit is broken from 0 % on, see excess"
)
LIMITATIONS = (
    "one machine, one run each, every one in its own process; processor time, not the wall's; "
    "regular n-gons, L = 2 m, turned by 0.3 rad or 0.6 m of travel, or scaled and shifted; most "
    "rivals up to n = 12; rivals' models are built by this repository's authors; opti, rockit "
    "and lean are let off cable_clearance and crossing, lean also jerk, toppra knows boxes of "
    "speed and acceleration only; "
    "rivals' times leave imports out but not the building of their programs, which they do anew "
    "every time, and get 6 GB; first and second are whole solves in one process, with their "
    "certificates and without memory of earlier ones, but with the solvers that earlier ones have "
    "built for programs of the same structure, and rivals are compared with these alone; "
    "again is no solve: the same morph once more, its plan taken from memory"
)
STOPPED = 90.0
"""[s] Rivals are stopped so long after their limit, by the clock on the wall: for building their
programs, before IPOPT looks at any, and for whoever else is at work."""


@dataclass(frozen=True)
class Case:
    """One measurement to be made."""

    solver: str
    kind: str
    robots: int


def cases(*, quick: bool) -> list[Case]:
    """Return what is measured, in this order."""
    small = [3, 6] if quick else [3, 6, 12]
    large = [3, 10, 30] if quick else [3, 10, 30, 100, 300]
    found = [Case("straight", "scaled", n) for n in large]
    found += [Case("optimised", "turned", n) for n in (small if quick else [*small, 24, 48])]
    found += [Case(s, "turned", n) for s in ("toppra", "lean", "opti", "rockit") for n in small]
    found += [Case("opti fine", "turned", n) for n in (3, 6)]
    if quick:
        return found
    return [
        *found,
        Case("optimised", "turned", 100),
        Case("toppra", "turned", 100),
        Case("opti", "turned", 100),
        Case("straight", "scaled", 1000),
    ]


def measured(case: Case, limit: float, samples: float) -> Measurement:
    """Return what a process of its own measures; rivals are stopped some time after their limit."""
    with tempfile.TemporaryDirectory() as models:
        if case.solver not in OURS:
            return _alone(case, limit, samples, models)
        cold = _alone(case, limit, 0.0, models)  # leaves its models there
        return replace(_alone(case, limit, samples, models), cold=cold.first)


def _alone(case: Case, limit: float, samples: float, models: str) -> Measurement:
    """Return what a process of its own measures that keeps its models in a given place."""
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    environment = {**os.environ, **threads, VARIABLE: models}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # nobody compiles sources every time
    command = [sys.executable, "-m", "benchmarks.measure", case.solver, case.kind]
    numbers = [str(case.robots), str(limit), str(samples)]
    until = None if case.solver in OURS else limit + STOPPED
    used = _children()
    try:
        done = subprocess.run(
            [*command, *numbers],
            capture_output=True,
            text=True,
            check=False,
            timeout=until,
            env=environment,
        )
    except subprocess.TimeoutExpired:
        used = _children() - used
        return Measurement(case.solver, case.kind, case.robots, "timed out", first=used)
    if done.returncode != 0:
        said = done.stderr.strip().splitlines()
        status = f"failed: {said[-1] if said else f'exit code {done.returncode}'}"
        return Measurement(case.solver, case.kind, case.robots, status)
    return Measurement(**json.loads(done.stdout.splitlines()[-1]))


def _children() -> float:
    """Return the processor time of all processes that were started and have ended [s]."""
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime


def compared(measurements: Sequence[Measurement]) -> list[str]:
    """Return what the measurements come to: counts, ratios, slopes."""
    lines = []
    for solver in (*OURS, *RIVALS):
        counts = Counter(m.status for m in measurements if m.solver == solver)
        if counts:
            lines.append(f"{solver}: " + ", ".join(f"{v} {k}" for k, v in counts.items()))
    own = {m.robots: m for m in measurements if m.solver == "optimised"}
    for m in measurements:
        if m.solver not in RIVALS or m.robots not in own:
            continue
        ours, theirs = own[m.robots], best_time(m)
        if theirs is None or ours.first is None or ours.second is None or ours.flight is None:
            continue
        line = (
            f"n = {m.robots}, {m.solver} over hitchopt: time {theirs / ours.second:.2g} "
            f"({theirs / ours.first:.2g} of the first solve)"
        )
        if m.flight is None:
            lines.append(f"{line}, at least: it {m.status}")
        else:
            kept = "never keeps its limits" if m.kept is None else f"{ours.flight / m.kept:.3f}"
            lines.append(
                f"{line}; hitchopt's flight over its {ours.flight / m.flight:.3f}, "
                f"over its slowed until it keeps the limits: {kept}"
            )
    lines += [
        f"n = {m.robots}, {m.solver}: first solve over second {m.first / m.second:.1f} "
        f"({m.cold / m.second:.1f} without models on disk), "
        f"with imports {(m.imports + m.first) / m.second:.1f}"
        for m in measurements
        if m.imports and m.cold and m.first and m.second
    ]
    for solver in OURS:
        large = [m for m in measurements if m.solver == solver and m.robots >= 6]
        slopes = {name: slope(large, name) for name in ("second", "certify", "write", "peak")}
        told = ", ".join(f"{name} {value:.2f}" for name, value in slopes.items())
        lines.append(f"{solver}, log-log slope over n from 6 on: {told}")
    return lines


def main() -> None:
    """Print machine, versions, tolerances and limitations, then measure and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a few small ones")
    parser.add_argument("--limit", type=float, default=30.0, help="for IPOPT in a rival [s]")
    parser.add_argument(
        "--patience", type=float, default=200.0, help="times ours that a rival gets at least"
    )
    parser.add_argument("--samples", type=float, default=4e7, help="of all drones, at most")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "results")
    arguments = parser.parse_args()
    head = [
        f"{datetime.date.today()}; {environment(('rockit-meco',))}",
        f"busy before the start: {busy():.1f} processes on average over a minute",
        f"tolerances: {TOLERANCES}; rivals' IPOPT stops after {arguments.limit:g} s or "
        f"{arguments.patience:g} times ours, their process {STOPPED:g} s later",
        f"limitations: {LIMITATIONS}",
    ]
    print("\n".join(head), flush=True)
    print("processor times in s, peak in MB")
    print(markdown([])[0], flush=True)
    measurements: list[Measurement] = []
    for case in cases(quick=arguments.quick):
        ours = [
            m.second for m in measurements if (m.solver, m.robots) == ("optimised", case.robots)
        ]
        limit = max([arguments.limit, *(arguments.patience * (s or 0.0) for s in ours)])
        measurements.append(measured(case, limit, arguments.samples))
        print(f"| {' | '.join(row(measurements[-1]))} |", flush=True)
        write(arguments.output, head, measurements)  # whoever interrupts it keeps what there is
    print("\n".join(compared(measurements)))


def write(directory: Path, head: Sequence[str], measurements: Sequence[Measurement]) -> None:
    """Write CSV, Markdown and the picture."""
    directory.mkdir(parents=True, exist_ok=True)
    write_csv(directory / "benchmarks.csv", measurements)
    draw(directory / "benchmarks.png", measurements)
    lines = ["# Benchmarks", "", *(f"- {line}" for line in head), "", *markdown(measurements), ""]
    lines += ["![Time over n](benchmarks.png)", ""]
    lines += [f"- {line}" for line in compared(measurements)]
    (directory / "benchmarks.md").write_text("\n".join([*lines, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
