"""Sweeps: throughput of two workers and of one, and rows of a study that is killed again and again.

Usage: python -m benchmarks.sweeps [--plans N] [--kills K] [--output DIR]
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import pandas

import hitchopt as ho
from benchmarks.environment import busy, environment
from hitchopt.sweeps.dataset import MEASURED, load_sweep
from hitchopt.sweeps.study_file import study_from_dict
from hitchopt.sweeps.work import outcome_of

PROBLEM: dict[str, Any] = {
    "team": {"robots": 3, "cable_length": 2.4},
    "start": {"hitch": {"polygon": [[0, -1], [-0.4, 0.5], [0.4, 0.5]], "altitude": 1.0}},
    "mission": [{"morph": {"polygon": [[0, -0.5], [-0.4, 0.5], [0.4, 0.5]]}}],
}

LONGEST = 12.0
"""Longest time until something is killed [s]: rows arrive from the fifth second on."""


PATIENCE = 5.0
"""How long a process is given to end by itself [s]."""


def study(plans: int) -> dict[str, Any]:
    """Return a study of so many triangles, all different."""
    drawn = {"random": {"from": 0.2, "to": 0.8}}
    return {"problem": PROBLEM, "parameters": {"team.tension": drawn}, "samples": plans}


def plain_loop(plans: int) -> float:
    """Return how long so many plans take without dask, each with its row [s]."""
    cases = list(study_from_dict(study(plans)).cases())
    outcome_of(cases[-1], "")  # imports, models
    begin = time.perf_counter()
    for case in cases:
        outcome_of(case, case.digest)
    return time.perf_counter() - begin


def swept(plans: int, workers: int) -> tuple[float, float]:
    """Return how long a sweep takes from its first row on, and in all [s]."""
    times: list[float] = []
    with tempfile.TemporaryDirectory() as place:
        begin = time.perf_counter()
        ho.run_sweep(
            study(plans),
            place,
            workers=workers,
            progress=lambda _: times.append(time.perf_counter()),
        )
        whole = time.perf_counter() - begin
    settled = 4 * workers  # the first ones import what they need
    return (times[-1] - times[settled]) * plans / (plans - 1 - settled), whole


def killed(plans: int, kills: int) -> tuple[int, bool]:
    """Kill client, scheduler or a worker so many times; return the runs, and whether rows agree."""
    chance = random.Random(0)
    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / "study.json"
        file.write_text(json.dumps(study(plans)))
        whole = fixed(ho.run_sweep(file, Path(place) / "whole", workers=2))
        runs, hits = 0, 0
        while True:
            runs += 1
            done = one_run(Path(place), chance, hits < kills)
            hits += not done
            rows = len(load_sweep(Path(place) / "killed")) if runs > 1 or done else 0
            print(f"run {runs}: {'ended' if done else 'killed'}, {rows} rows", flush=True)
            if done and hits >= kills:
                break
            if done:  # all rows were there too early: begin with fewer
                for path in list((Path(place) / "killed" / "rows").iterdir())[::2]:
                    path.unlink()
        found = fixed(load_sweep(Path(place) / "killed"))
    return runs, bool(found.equals(whole))


def one_run(place: Path, chance: random.Random, kill: bool) -> bool:
    """Run the study with its own scheduler and workers; return whether it ended by itself."""
    port = chance.randrange(20000, 60000)
    address = f"tcp://127.0.0.1:{port}"
    scheduler = _start(
        "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-show"
    )
    worker = _start("distributed.cli.dask_worker", address, "--nworkers", "2", "--nthreads", "1")
    sweep = ["sweep", str(place / "study.json"), "-o", str(place / "killed")]
    client = _start("hitchopt", *sweep, "--scheduler", address)
    victims = {"client": client, "scheduler": scheduler, "worker": worker}
    try:
        if kill:
            time.sleep(chance.uniform(3.0, LONGEST))
            if client.poll() is not None:
                return client.returncode == 0
            victim = victims[chance.choice(sorted(victims))]
            victim.send_signal(signal.SIGKILL)
            if victim is worker:  # its nannies' processes end with it: work goes to new ones
                worker = _start(
                    "distributed.cli.dask_worker", address, "--nworkers", "2", "--nthreads", "1"
                )
        try:
            client.wait(20.0 if kill else 600.0)
        except subprocess.TimeoutExpired:
            return False
        return client.returncode == 0
    finally:
        for process in (client, worker, scheduler, *victims.values()):
            if process.poll() is None:
                process.terminate()
                try:
                    process.wait(PATIENCE)
                except subprocess.TimeoutExpired:  # a worker without scheduler may wait for it
                    process.kill()
                    process.wait()


def _start(module: str, *arguments: str) -> subprocess.Popen[bytes]:
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen([sys.executable, "-m", module, *arguments], **quiet, env=os.environ)  # type: ignore[call-overload, no-any-return]


def fixed(rows: pandas.DataFrame) -> pandas.DataFrame:
    """Return the columns that do not differ from run to run."""
    return rows[[name for name in map(str, rows.columns) if not name.startswith(MEASURED)]]


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plans", type=int, default=2000)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "results")
    arguments = parser.parse_args()
    lines = [
        "# Sweeps",
        "",
        f"- {environment()}",
        f"- busy before the start: {busy():.1f} processes",
    ]
    n = arguments.plans
    if n:
        loop = plain_loop(n // 4) * 4.0
        one, whole_one = swept(n, 1)
        two, whole_two = swept(n, 2)
        lines += [
            f"- {n} triangle plans, by the clock: plain loop {1e3 * loop / n:.1f} ms a plan (of a "
            f"quarter of them), one worker {1e3 * one / n:.1f} ms ({one / loop:.2f} times the "
            f"loop), two workers {one / two:.2f} times the throughput of one",
            f"- with the start of the cluster: {whole_one:.1f} s and {whole_two:.1f} s",
        ]
        print("\n".join(lines[-2:]), flush=True)
    if arguments.kills:
        runs, same = killed(400, arguments.kills)
        lines.append(
            f"- 400 plans, client, scheduler or workers killed {arguments.kills} times in {runs} "
            f"runs: rows {'are the same' if same else 'DIFFER'} (times and memory aside)"
        )
        print(lines[-1])
    (arguments.output / "sweeps.md").write_text("\n".join([*lines, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
