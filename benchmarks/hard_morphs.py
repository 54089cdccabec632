"""Hard morphs: success rate, proofs and processor time between wild polygons.

Usage: python -m benchmarks hard_morphs [--seeds N] [--robots N ...] [--heavy 1]

The morphs are those of ``problems.random_morph.wild_morph``. None is left out after it was drawn.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

import hitchopt as ho
from benchmarks.measuring import Table, parser
from hitchopt import verify
from problems.random_morph import wild_morph

LIMITATIONS = (
    "one machine, one run each; processor time with both ends, without imports; every plan is "
    "certified, proven ones also by hitchopt verify; the search is local: failure does not prove "
    "infeasibility"
)


@dataclass(frozen=True)
class Outcome:
    """A morph that was planned or refused."""

    seconds: float  # [s], processor time of planning, with both ends
    duration: float = np.nan  # [s], of the flight; nan if it was refused
    vertex_time: float = np.nan  # [s], of the slowest vertex alone, on a line at its largest speed
    proven: bool = False


def outcome(problem: dict[str, Any]) -> Outcome:
    """Return the outcome of planning a problem of ``wild_morph`` and verifying the plan."""
    task = ho.problem_from_dict(problem)
    start_time = time.process_time()
    try:
        plan = ho.solve(task)
    except ho.InfeasibleError:
        return Outcome(time.process_time() - start_time)
    seconds = time.process_time() - start_time
    start = np.array(problem["start"]["hitch"]["polygon"])
    moved = np.linalg.norm(plan.end.polygon.vertices - start, axis=1)
    vertex_time = float(np.max(moved)) / task.limits.vertex_speed
    with tempfile.TemporaryDirectory() as folder:
        plan.save(folder, picture=False)
        proven = all(row.verdict in verify.PASSING for row in verify.verify(folder))
    return Outcome(seconds, plan.duration, vertex_time, proven)


def main() -> None:
    """Print and write a row for each n."""
    options = parser(__doc__, seeds=10, robots=[3, 4, 5, 6, 7, 8], heavy=0).parse_args()
    name = "hard_morphs_heavy" if options.heavy else "hard_morphs"
    title = "Hard morphs with heavy cables" if options.heavy else "Hard morphs"
    table = Table(options.output / f"{name}.md", title, LIMITATIONS)
    ratio = "flight over slowest vertex (median)"
    columns = ("n", "morphs", "planned", "proven", "seeds that failed", ratio, "median [s]")
    table.section("", *columns, "most [s]")
    outcome(wild_morph(3, 0))  # imports
    for n in options.robots:
        outcomes = [
            outcome(wild_morph(n, seed, heavy=bool(options.heavy))) for seed in range(options.seeds)
        ]
        planned = [each for each in outcomes if np.isfinite(each.duration)]
        failed = [str(seed) for seed, each in enumerate(outcomes) if each not in planned]
        ratios = [each.duration / each.vertex_time for each in planned]
        seconds = [each.seconds for each in outcomes]
        counts = len(outcomes), len(planned), sum(each.proven for each in outcomes)
        medians = float(np.median(ratios)), float(np.median(seconds))
        table.row(n, *counts, ", ".join(failed), *medians, max(seconds))
