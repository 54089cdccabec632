"""Random hard morphs: success rate of the optimiser where the straight path is infeasible.

Usage: python -m benchmarks hard_morphs [--seeds N] [--robots N ...]

The morphs are those of ``problems.random_morph``: turned by any angle, scaled, shifted, reshaped.
"""

from __future__ import annotations

import time

import numpy as np

import hitchopt as ho
from benchmarks.measuring import Table, parser
from problems.random_morph import wild_morph

LIMITATIONS = (
    "one machine, one run each; processor time; every success is a certificate; morphs of which "
    "an end breaks a limit at rest are counted apart; the search is local: failure does not prove "
    "infeasibility"
)


def outcome(n: int, seed: int) -> tuple[str, float, float]:
    """Return ``solved``, ``ends`` or ``failed``, the plan's duration and the processor time [s]."""
    problem = ho.problem_from_dict(wild_morph(n, seed))
    start_time = time.process_time()
    try:
        plan = ho.solve(problem)
    except ho.InfeasibleError as error:
        at_rest = any("start" in one.when or "end" in one.when for one in error.violations)
        return "ends" if at_rest else "failed", np.nan, time.process_time() - start_time
    return "solved", plan.duration, time.process_time() - start_time


def main() -> None:
    """Print and write a row for each n."""
    options = parser(__doc__, seeds=10, robots=[3, 4, 5, 6, 8, 10, 12]).parse_args()
    table = Table(options.output / "hard_morphs.md", "Hard morphs", LIMITATIONS)
    columns = ("n", "morphs", "solved", "ends", "failed", "seeds that failed", "median [s]")
    table.section("", *columns, "most [s]")
    for n in options.robots:
        outcomes = [outcome(n, seed) for seed in range(options.seeds)]
        status = [one[0] for one in outcomes]
        times = [one[2] for one in outcomes if one[0] != "ends"]
        failed = ", ".join(str(seed) for seed, one in enumerate(status) if one == "failed")
        counts = [status.count(name) for name in ("solved", "ends", "failed")]
        table.row(n, len(outcomes), *counts, failed, float(np.median(times)), max(times))
