"""What a worker does with a case: plan, fly, settle, export it; and the workers, on dask."""

from __future__ import annotations

import contextlib
import itertools
import logging
import resource
import tempfile
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hitchopt.errors import (
    HitchoptError,
    InfeasibleError,
    InputError,
    TimeLimitError,
    UnsupportedError,
)
from hitchopt.sweeps.study import Case, Section

if TYPE_CHECKING:
    from hitchopt.plan import Plan

Row = dict[str, Any]
"""A row of the results, by column; what is not known is None."""

PLANNED, INFEASIBLE, LATE, FAILED, WRONG = "planned", "infeasible", "time limit", "failed", "wrong"
"""Values of the column ``status``."""

RATE = 100.0
"""Setpoints per second that are simulated [Hz]."""

AHEAD = 8
"""Tasks per worker that are handed to the scheduler before any of them is done."""

LOST = 3
"""Number of workers that may die with a task before it counts as failed: it may kill them."""

SETTINGS = {
    "distributed.scheduler.allowed-failures": LOST,
    "distributed.comm.timeouts.connect": "5s",
    "distributed.worker.daemon": True,
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.tick.cycle": "10s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.admin.system-monitor.gil.enabled": False,
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
}
"""Settings of dask. Its profiler looks at all stacks a hundred times a second, which takes more
than a tenth of a plan's time; clocks that tick less often leave plans alone too. Its workers would
give freed memory back at once: a plan would fault ten thousand pages anew, a seventh of its time.
"""

EXTRA = "pip install 'hitchopt[sweep]'"

STAY = "rows that were written stay: run the same study again"


class SweepError(HitchoptError):
    """A sweep that ended early: rows that were written stay, the same call goes on from there."""


@dataclass(frozen=True)
class Outcome:
    """What a worker returns.

    Attributes
    ----------
    digest: of the case.
    row: its row.
    files: bytes of its exported files, by name.
    """

    digest: str
    row: Row
    files: dict[str, bytes] = field(default_factory=dict)


def first_columns(case: Case, digest: str) -> Row:
    """Return the columns of a case's row that name it."""
    row: Row = {"digest": digest, "problem": case.name, "seed": case.seed}
    return row | {f"parameter.{key}": value for key, value in case.point.items()}


def outcome_of(case: Case, digest: str) -> Outcome:
    """Return the outcome of a case; errors that hitchopt raises on purpose become rows."""
    from hitchopt.api import solve
    from hitchopt.mission.loading import any_problem_from_dict

    row = first_columns(case, digest)
    files: dict[str, bytes] = {}
    begin = time.process_time()
    try:
        plan = solve(any_problem_from_dict(case.problem), limit=case.limit)
        row |= {"status": PLANNED, "duration": plan.duration}
        row |= {f"check.{check.name}": check.worst for check in plan.certificate.checks}
        row["time.plan"] = time.process_time() - begin
        row |= _done(plan, case, files)
    except HitchoptError as error:
        kinds = {TimeLimitError: LATE, InfeasibleError: INFEASIBLE, InputError: WRONG}
        status = next((word for kind, word in kinds.items() if isinstance(error, kind)), FAILED)
        row.setdefault("status", status)  # a plan stays one
        row["message"] = str(error)
        if isinstance(error, InfeasibleError) and error.violations:
            row["binding"] = error.violations[0].constraint
        row.setdefault("time.plan", time.process_time() - begin)
    row["memory.peak"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return Outcome(digest, row, files)


def _done(plan: Plan, case: Case, files: dict[str, bytes]) -> Row:
    """Return the columns of what is done with a plan; exported files are added to ``files``."""
    row: Row = {}
    for name, act in (("settle", _settled), ("simulate", _simulated)):
        if (keys := getattr(case, name)) is not None:
            begin = time.process_time()
            given = {key: value for key, value in keys.items() if value is not None}
            found = act(plan, given, case.seed or 0)
            row |= {f"{name}.{key}": value for key, value in found.items()}
            row[f"time.{name}"] = time.process_time() - begin
    if case.export is not None:
        with tempfile.TemporaryDirectory() as place:
            parts = plan.export(str(case.export["format"]), place)
            for path in sorted(p for p in Path(place).rglob("*") if p.is_file()):
                files[path.relative_to(place).as_posix()] = path.read_bytes()
        row["export.position_error"] = max(part.verdict.position.worst for part in parts)
    return row


def _settled(plan: Plan, given: Section, _seed: int) -> Row:
    """Return figures of where the hitch comes to rest over the plan."""
    from hitchopt.statics.settle import settle
    from hitchopt.statics.tolerance import taut_times

    keys: dict[str, Any] = dict(given)
    settled = settle(plan, taut_times(plan.motion, keys.pop("samples")), **keys)
    return {
        "vertex_error": float(np.max(settled.displacements)),
        "tension_min": float(np.min(settled.tensions)),
        "tension_max": float(np.max(settled.tensions)),
        "slack": ", ".join(settled.slack_cables),
    }


def _simulated(plan: Plan, given: Section, seed: int) -> Row:
    """Return figures of a simulated flight."""
    from hitchopt.exports.directory import write_setpoints, write_vertices
    from hitchopt.simulation.judgement import simulate
    from hitchopt.simulation.settings import settings_of
    from hitchopt.simulation.task import read_tables

    motion, keys = plan.motion, dict[str, Any](given)
    with tempfile.TemporaryDirectory() as place:
        setpoints, vertices = Path(place) / "setpoints.csv", Path(place) / "vertices.csv"
        write_setpoints(setpoints, motion, RATE)
        write_vertices(vertices, motion, RATE)
        task = read_tables(setpoints, vertices, motion.team)
    run = simulate(task, settings_of(body=keys.pop("drones"), seed=seed, **keys)).run
    row: Row = {"verdict": run.verdict, "succeeded": run.succeeded}
    if run.failures:
        row |= {"failure": run.failures[0].kind, "failure_time": run.failures[0].time}
    for name in ("vertex_error", "resting", "moving", "without_sag", "tracking"):
        row |= {f"{name}_{key}": value for key, value in vars(getattr(run, name)).items()}
    return row | {name: getattr(run, name) for name in ("peak_tension", "peak_thrust", "saturated")}


def finished(
    work: Callable[..., Any],
    tasks: Mapping[str, tuple[Any, ...]],
    width: int,
    scheduler: str | None = None,
) -> Generator[tuple[str, Any], None, None]:
    """Yield the key of every task and its future, which has a result or an exception.

    Parameters
    ----------
    work: function that every task calls, on a worker.
    tasks: arguments, by key.
    width: number of processes on this machine where there is no scheduler.
    scheduler: address of a dask scheduler, or None.

    Raises
    ------
    SweepError: the scheduler was lost.
    InputError: the scheduler cannot be reached.
    UnsupportedError: dask.distributed is not installed.
    """
    try:
        import distributed
    except ImportError:
        raise UnsupportedError(f"sweeps need dask.distributed: {EXTRA}") from None
    with _client(distributed, width, scheduler) as client:
        ahead = AHEAD * max(width, len(client.nthreads()))
        batch = ahead // 2
        rest = iter(tasks.items())
        pending = distributed.as_completed(loop=client.loop, raise_errors=False)

        def hand_out(count: int) -> None:
            some = list(itertools.islice(rest, count))
            if some:  # many at a time: a graph of one costs as much as one of eight
                columns = zip(*(arguments for _, arguments in some), strict=True)
                pending.update(client.map(work, *columns, key=[key for key, _ in some], pure=False))

        try:
            hand_out(ahead)
            for done, future in enumerate(pending, 1):
                if future.status not in {"finished", "error"}:
                    raise SweepError(f"the scheduler was lost (a task was {future.status}); {STAY}")
                yield str(future.key), future
                if done % batch == 0:
                    hand_out(batch)
        except (OSError, TimeoutError, distributed.CommClosedError) as error:
            reason = error or type(error).__name__
            raise SweepError(f"the scheduler was lost ({reason}); {STAY}") from error


@contextlib.contextmanager
def _client(distributed: Any, width: int, scheduler: str | None) -> Iterator[Any]:
    """Yield a client of a scheduler's cluster, or of one of this machine that ends with it."""
    import dask

    for name in ("distributed", "distributed.scheduler", "distributed.nanny", "distributed.worker"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with dask.config.set(SETTINGS), contextlib.ExitStack() as stack:
        address = scheduler
        if address is None:
            cluster = distributed.LocalCluster(
                n_workers=width,
                threads_per_worker=1,
                processes=True,
                dashboard_address="127.0.0.1:0",
                host="127.0.0.1",
            )
            address = stack.enter_context(cluster).scheduler_address
        try:
            client = distributed.Client(address, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            remedy = "start `dask scheduler` and `dask worker ADDRESS`"
            raise InputError("scheduler", scheduler, f"reachable ({error})", remedy) from None
        yield stack.enter_context(client)
