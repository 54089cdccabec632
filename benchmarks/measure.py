"""One solver on one morph, in a process of its own: prints what it measured as JSON.

Usage: python -m benchmarks.measure SOLVER KIND ROBOTS SECONDS SAMPLES [GIGABYTES]

With 0 samples a solver of ours ends after its first solve.

A fresh process tells the peak memory of this morph alone, and how long a first solve takes with
all that is imported and compiled for it. Times are the process's processor time, so that others on
the machine disturb them less.
"""

from __future__ import annotations

import json
import os
import resource
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from benchmarks.rival import Solution
    from benchmarks.tasks import Task

OURS = ("straight", "optimised")

RIVALS = ("lean", "opti", "opti fine", "rockit", "toppra")

MEMORY = 6.0
"""[GB] That a rival may take unless told otherwise: the programs of large teams would take the
machine down."""

REPEATS, FEW = 3, 100
"""Of the second solve, of which the median counts, up to that many robots."""

VARIABLE = "HITCHOPT_MEMORY"
"""Off for all benchmarks."""

RATE = 10_000.0
"""[Hz] of the samples that a result is checked at, unless there are too many of them."""


@dataclass(frozen=True)
class Measurement:
    """What one solver did; None is what it did not get to.

    Attributes
    ----------
    solver, kind, robots: who, on which of ``tasks.KINDS``, with how many cables.
    status: ``solved``, ``breaks …``, ``failed: …`` or ``timed out``.
    imports: from the start of the process until everything is imported, matplotlib too [s].
    cold: a solve in a fresh process, no model being on disk yet [s].
    first: the same in another one that finds them there [s].
    second: the same once more in that process, the median of some [s]; with its certificate, all.
    again: the same morph asked for again, taken from memory [s]; in all others nothing is.
    certify, sharing: of the plan, of the first hitch's legs [s].
    write, csv: of all files, and of the setpoints' CSV at 100 Hz among them [s].
    flight: duration of what was found [s].
    kept: duration of that, slowed until its samples keep all limits of motion [s].
    peak: memory [MB], before writing and sampling.
    certified: whether the certificate holds; rivals have none.
    broken: the limit whose samples are worst, and by how much of it they break it (below 0: kept).
    excess: of ``broken``.
    rate: of the samples [Hz].
    """

    solver: str
    kind: str
    robots: int
    status: str
    imports: float | None = None
    cold: float | None = None
    first: float | None = None
    second: float | None = None
    again: float | None = None
    certify: float | None = None
    sharing: float | None = None
    write: float | None = None
    csv: float | None = None
    flight: float | None = None
    kept: float | None = None
    peak: float | None = None
    certified: bool | None = None
    broken: str | None = None
    excess: float | None = None
    rate: float | None = None


def main() -> None:
    """Measure what the command line says."""
    solver, kind, robots, seconds, most, *more = sys.argv[1:]
    memory = float(more[0]) if more else MEMORY
    from benchmarks.tasks import make_task

    task = make_task(kind, int(robots))
    if solver in OURS:
        found = _ours(solver, kind, task, _imported(), float(most))
    else:
        found = _rival(solver, kind, task, float(seconds), float(most), memory)
    print(json.dumps(asdict(found)))


def _imported() -> float:
    """Return the processor time when hitchopt and what draws is imported [s]."""
    import hitchopt.view.summary  # noqa: F401

    return time.process_time()


def _ours(solver: str, kind: str, task: Task, imports: float, most: float) -> Measurement:
    import hitchopt as ho
    from benchmarks.sampled import check_samples, kept_duration
    from benchmarks.samples import of_motion
    from hitchopt.exports.setpoints import write_setpoints

    def plan() -> ho.Plan:
        goal, separation = task.end.polygon, task.separation
        optimize = solver != "straight"
        return ho.morph(
            task.start, goal, limits=task.limits, separation=separation, optimize=optimize
        )

    team, polygon = task.start.team, task.start.polygon
    try:
        first = _seconds(plan)
        if most == 0.0:
            return Measurement(solver, kind, task.robots, "solved", imports, first=first)
        repeats = REPEATS if task.robots <= FEW else 1
        second = statistics.median(_seconds(plan) for _ in range(repeats))
        found = plan()
    except ho.HitchoptError as error:
        return Measurement(solver, kind, task.robots, f"failed: {type(error).__name__}")
    certify = _seconds(lambda: ho.certify(found.motion))
    sharing = _seconds(lambda: ho.Hitch.spread(team, polygon, separation=task.separation))
    peak = _peak()
    again = _again(plan)
    with tempfile.TemporaryDirectory() as place:
        write = _seconds(lambda: found.save(place))
        csv = _seconds(lambda: write_setpoints(Path(place) / "setpoints.csv", found.motion, 100.0))
    rate, sample = _rate(task, found.duration, most), of_motion(found.motion)
    findings = check_samples(task, found.duration, sample, rate)
    worst = findings[0]
    return Measurement(
        solver,
        kind,
        task.robots,
        _status(worst.name, worst.excess),
        imports,
        None,
        first,
        second,
        again,
        certify,
        sharing,
        write,
        csv,
        found.duration,
        kept_duration(task, found.duration, sample, rate, findings),
        peak,
        found.certificate.certified,
        worst.name,
        worst.excess,
        rate,
    )


def _again(plan: Callable[[], object]) -> float:
    """Return how long it takes to ask again for what has been planned [s]."""
    off = os.environ.pop(VARIABLE)
    try:
        plan()
        return statistics.median(_seconds(plan) for _ in range(REPEATS))
    finally:
        os.environ[VARIABLE] = off


def _rival(
    solver: str, kind: str, task: Task, seconds: float, most: float, memory: float
) -> Measurement:
    from benchmarks.rival import RivalError
    from benchmarks.sampled import check_samples, kept_duration

    solve = _solver_of(solver, task, seconds)
    resource.setrlimit(resource.RLIMIT_AS, (int(memory * 1e9), int(memory * 1e9)))
    began = time.process_time()
    try:
        found = solve()
    except MemoryError:
        took = time.process_time() - began
        status = f"failed: over {memory:g} GB"
        return Measurement(solver, kind, task.robots, status, first=took)
    except RivalError as error:
        took = time.process_time() - began
        return Measurement(solver, kind, task.robots, f"failed: {error}", first=took)
    first, peak = time.process_time() - began, _peak()
    rate = _rate(task, found.duration, most)
    findings = check_samples(task, found.duration, found.sample, rate)
    worst = findings[0]
    return Measurement(
        solver,
        kind,
        task.robots,
        _status(worst.name, worst.excess),
        first=first,
        flight=found.duration,
        kept=kept_duration(task, found.duration, found.sample, rate, findings),
        peak=peak,
        broken=worst.name,
        excess=worst.excess,
        rate=rate,
    )


def _solver_of(solver: str, task: Task, seconds: float) -> Callable[[], Solution]:
    """Return the rival of that name, all that it needs imported."""
    if solver == "toppra":
        from benchmarks.naive_toppra import solve_toppra

        return lambda: solve_toppra(task)
    if solver == "lean":
        from benchmarks.lean_rival import solve_lean

        return lambda: solve_lean(task, seconds)
    if solver == "rockit":
        from benchmarks.rockit_rival import solve_rockit

        return lambda: solve_rockit(task, seconds)
    from benchmarks.plain_opti import COARSE, FINE, solve_opti

    return lambda: solve_opti(task, FINE if solver == "opti fine" else COARSE, seconds)


def _status(name: str, excess: float) -> str:
    return "solved" if excess <= 0.0 else f"breaks {name}"


def _rate(task: Task, duration: float, most: float) -> float:
    """Return RATE, or what comes to ``most`` samples of all drones."""
    return min(RATE, most / (2 * task.robots * duration))


def _seconds(work: Callable[[], object]) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began


def _peak() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


if __name__ == "__main__":
    main()
