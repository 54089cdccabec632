"""How far durations differ between BLAS kernels and under noise on the input.

Usage: python -m benchmarks.agreement [PROBLEM ...] [--again]

Every problem is planned with the default kernels, with those of Haswell and Sandybridge, and
three times with noise of 1e-14 m on its points. The rows go to ``results/agreement.csv`` one by
one; those that are there are not measured anew, except with ``--again``.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, cast

import numpy as np

import hitchopt as ho
from benchmarks.environment import environment
from hitchopt.mission.loading import any_problem_from_dict
from hitchopt.storage.yaml_file import read_yaml

ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).parent / "results"

NOISE = 1e-14
"""[m] Largest change of a coordinate."""

SEEDS = (1, 2, 3)
"""Of the noise."""

KERNELS = ("default", "Haswell", "Sandybridge")
"""Values of OPENBLAS_CORETYPE; the default is what OpenBLAS chooses for the processor, which on
AMD's and Intel's older ones is Haswell."""

POINTS = frozenset({"polygon", "q", "r", "start", "goal", "to", "by"})
"""Keys of coordinates."""

AGREED = 1e-6
"""Relative difference of durations up to which they agree."""


@dataclass(frozen=True)
class Run:
    """One plan of one problem.

    Attributes
    ----------
    problem: path below ``problems``, without its ending.
    kernels: OPENBLAS_CORETYPE, or "default".
    noise: seed of the noise; 0 for none.
    duration: of the plan [s].
    seconds: processor time of planning [s].
    """

    problem: str
    kernels: str
    noise: int
    duration: float
    seconds: float

    @property
    def key(self) -> tuple[str, str, int]:
        """What the run is of."""
        return self.problem, self.kernels, self.noise


def problems() -> list[str]:
    """Return the names of all problems that have a plan, circle_200 as the last one."""
    folders = (ROOT / "problems", ROOT / "problems" / "swarms")
    paths = [path for folder in folders for path in sorted(folder.glob("*.yaml"))]
    names = [str(path.relative_to(ROOT / "problems").with_suffix("")) for path in paths]
    return sorted(names, key=lambda name: name.endswith("circle_200"))


def noisy(
    data: object, rng: np.random.Generator, walls: frozenset[float], inside: bool = False
) -> object:
    """Return a problem's mapping with noise on its points; those on a wall stay there."""
    if isinstance(data, dict):
        return {key: noisy(value, rng, walls, key in POINTS) for key, value in data.items()}
    if isinstance(data, list):
        return [noisy(value, rng, walls, inside) for value in data]
    if inside and isinstance(data, int | float) and data not in walls:
        return float(data) + NOISE * float(rng.uniform(-1.0, 1.0))
    return data


def measured(name: str, kernels: str, noise: int) -> Run:
    """Return the plan's duration; this process must run the kernels."""
    data = read_yaml(ROOT / "problems" / f"{name}.yaml")
    if not isinstance(data, dict):
        raise TypeError(f"{name} is not a mapping")
    if noise:
        arena: Any = data.get("arena", {})
        walls = frozenset(float(x) for bound in arena.values() for x in bound)
        changed = noisy(data, np.random.default_rng(noise), walls)
        data = cast(dict[str, Any], changed)
    problem = any_problem_from_dict(data)
    began = time.process_time()
    duration = ho.solve(problem).duration
    return Run(name, kernels, noise, duration, time.process_time() - began)


def in_process(kernels: str, tasks: Sequence[tuple[str, int]]) -> Iterator[Run]:
    """Yield the runs of tasks (problem, noise), from a process that runs the kernels."""
    chosen = {} if kernels == "default" else {"OPENBLAS_CORETYPE": kernels}
    quiet = {"HITCHOPT_CACHE": "off", "HITCHOPT_MEMORY": "off"}
    command = [sys.executable, "-m", "benchmarks.agreement", "--child", kernels, json.dumps(tasks)]
    with subprocess.Popen(
        command, env={**os.environ, **chosen, **quiet}, stdout=subprocess.PIPE, text=True, cwd=ROOT
    ) as process:
        for line in process.stdout or ():
            yield Run(**json.loads(line))
    if process.returncode:
        raise SystemExit(f"the process with kernels {kernels} ended with {process.returncode}")


def read_runs(path: Path) -> list[Run]:
    """Return the runs of a table that was written before."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return [
            Run(
                row["problem"],
                row["kernels"],
                int(row["noise"]),
                float(row["duration"]),
                float(row["seconds"]),
            )
            for row in csv.DictReader(file)
        ]


def write_runs(path: Path, runs: Sequence[Run]) -> None:
    """Write all runs."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Run)], lineterminator="\n")
        writer.writeheader()
        writer.writerows(asdict(run) for run in runs)


def table(runs: Sequence[Run]) -> list[str]:
    """Return the lines of a table of relative differences from the default without noise."""
    first = {run.problem: run for run in runs if (run.kernels, run.noise) == ("default", 0)}
    lines = [
        "| problem | duration [s] | kernels | noise | agrees |",
        "| --- | --- | --- | --- | --- |",
    ]
    worst = 0.0
    for name, base in first.items():
        kernels, noise = (
            max(
                (
                    abs(run.duration / base.duration - 1.0)
                    for run in runs
                    if run.problem == name and (run.noise > 0) == noisy_ones
                ),
                default=0.0,
            )
            for noisy_ones in (False, True)
        )
        agrees = max(kernels, noise) <= AGREED
        worst = max(worst, kernels, noise)
        lines.append(
            f"| {name} | {base.duration:.6f} | {kernels:.1e} | {noise:.1e} | "
            f"{'yes' if agrees else 'NO'} |"
        )
    return [*lines, "", f"Largest relative difference: {worst:.1e}; {len(first)} problems."]


def main() -> None:
    """Measure what is missing and write both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="problems; all if none is given")
    parser.add_argument("--again", action="store_true", help="measure also what is there")
    arguments = parser.parse_args()
    csv_path = RESULTS / "agreement.csv"
    names = arguments.names or problems()
    kept = {run.key: run for run in read_runs(csv_path)}
    if arguments.again:
        kept = {key: run for key, run in kept.items() if run.problem not in names}
    for kernels in KERNELS:
        seeds = (0, *SEEDS) if kernels == "default" else (0,)
        tasks = [(name, seed) for name in names for seed in seeds]
        missing = [task for task in tasks if (task[0], kernels, task[1]) not in kept]
        for run in in_process(kernels, missing) if missing else ():
            kept[run.key] = run
            print(f"{run.problem:24s} {kernels:8s} {run.noise} {run.duration!r}", flush=True)
            write_runs(csv_path, list(kept.values()))
    lines = table(list(kept.values()))
    head = [
        "# Agreement of durations",
        "",
        "`python -m benchmarks.agreement`: relative differences from a plan with the default",
        "kernels of OpenBLAS; `kernels`: with those of Haswell and Sandybridge, `noise`: with",
        f"up to {NOISE:g} m on all points ({len(SEEDS)} seeds). Durations agree up to {AGREED:g}.",
        "",
        f"- {environment()}",
        "- limitations: kernels that the processor chooses anyway count as a difference of zero;",
        "  rows of other runs are kept, so the code of all rows is the same only after `--again`",
        "",
    ]
    (RESULTS / "agreement.md").write_text("\n".join([*head, *lines, ""]), encoding="utf-8")
    print("\n".join(lines))


def _child(kernels: str, tasks: Sequence[tuple[str, int]]) -> None:
    for name, noise in tasks:
        print(json.dumps(asdict(measured(name, kernels, noise))), flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        _child(sys.argv[2], json.loads(sys.argv[3]))
    else:
        main()
