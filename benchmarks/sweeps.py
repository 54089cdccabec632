"""Sweeps: plans a second with one worker and with two, and rows of a study that is killed.

Usage: python -m benchmarks sweeps [--plans N] [--kills K]
"""

from __future__ import annotations

import json
import random
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from subprocess import DEVNULL
from time import perf_counter, sleep
from typing import Any

import hitchopt as ho
from benchmarks.measuring import Table, parser

PROBLEM: dict[str, Any] = {
    "team": {"robots": 3, "cable_length": 2.4},
    "start": {"hitch": {"polygon": [[0, -1], [-0.4, 0.5], [0.4, 0.5]], "altitude": 1.0}},
    "mission": [{"morph": {"polygon": [[0, -0.5], [-0.4, 0.5], [0.4, 0.5]]}}],
}

LIMITATIONS = (
    "one machine, by the clock; triangles of different tension; the first rows not counted"
)

UNCOUNTED = 4
"""Rows for each worker that are not counted, while workers import what they need."""


def study(plans: int) -> dict[str, Any]:
    """Return a study of so many triangles, all different."""
    tensions = {"grid": {"from": 0.2, "to": 0.8, "count": plans}}
    return {"problem": PROBLEM, "parameters": {"team.tension": tensions}}


def swept(plans: int, workers: int) -> float:
    """Return the time a plan takes in a sweep [s]."""
    times: list[float] = []
    with tempfile.TemporaryDirectory() as place:
        ho.run_sweep(
            study(plans), place, workers=workers, progress=lambda _: times.append(perf_counter())
        )
    first = UNCOUNTED * workers
    return (times[-1] - times[first]) / (plans - 1 - first)


def killed(plans: int, kills: int) -> bool:
    """Kill the sweep's process so many times; return whether its rows are those of a whole one."""
    chance = random.Random(0)
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        file = place / "study.json"
        file.write_text(json.dumps(study(plans)), encoding="utf-8")
        whole = ho.run_sweep(file, place / "whole", workers=2)
        command = [sys.executable, "-m", "hitchopt", "sweep", str(file)]
        command += ["-o", str(place / "killed")]
        for _ in range(kills):
            process = subprocess.Popen(
                command, stdout=DEVNULL, stderr=DEVNULL, start_new_session=True
            )
            sleep(chance.uniform(4.0, 12.0))
            process.send_signal(signal.SIGKILL)
            process.wait()
        found = ho.run_sweep(file, place / "killed", workers=2)
    same = [name for name in map(str, whole.columns) if not name.startswith("time.")]
    return bool(found[same].equals(whole[same]))


def main() -> None:
    """Print and write the tables."""
    options = parser(__doc__, plans=400, kills=5).parse_args()
    table = Table(options.output / "sweeps.md", "Sweeps", LIMITATIONS, ("dask",))
    table.section("", "workers", "time of a plan [ms]", "throughput over one worker")
    one = swept(options.plans, 1)
    table.row(1, 1e3 * one, 1.0)
    two = swept(options.plans, 2)
    table.row(2, 1e3 * two, one / two)
    if options.kills:
        same = "the same" if killed(options.plans, options.kills) else "NOT the same"
        table.note(f"{options.plans} plans, killed {options.kills} times: rows are {same}")
