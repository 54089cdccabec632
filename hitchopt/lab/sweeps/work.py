"""Compute the rows of cases by planning and simulation, in parallel on dask."""

from __future__ import annotations

import contextlib
import logging
import sys
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from types import ModuleType
from typing import TYPE_CHECKING, Any

from hitchopt.errors import (
    HitchoptError,
    InfeasibleError,
    InputError,
    TimeLimitError,
    optional_module,
)
from hitchopt.lab.sweeps.study import Case

if TYPE_CHECKING:
    from hitchopt.plan import Plan

Row = dict[str, Any]
"""A row of the results, by column; unknown values are None."""

PLANNED, FAILED = "planned", "failed"  # Values of the column ``status``, besides those of errors

STATUS = {TimeLimitError: "time limit", InfeasibleError: "infeasible", InputError: "wrong"}
"""Statuses of errors; other errors are FAILED."""

# Settings of dask. The profiler takes more than a tenth of the planning time, and returning freed
# memory to the system at once a seventh.
SETTINGS = {
    "distributed.scheduler.allowed-failures": 3,  # workers that a task may kill
    "distributed.comm.timeouts.connect": "5s",
    "distributed.worker.daemon": True,
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.gil.enabled": False,
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
}


class SweepError(HitchoptError):
    """An interrupted sweep: computed rows are saved, and the same call continues it."""


def case_columns(case: Case, digest: str) -> Row:
    """Return the columns of a row that identify the case."""
    row: Row = {"digest": digest, "problem": case.name, "seed": case.seed}
    return row | {f"parameter.{key}": value for key, value in case.point.items()}


def compute_row(case: Case, digest: str) -> Row:
    """Return the row of a case; a HitchoptError becomes a row."""
    from hitchopt.api import solve
    from hitchopt.mission.loading import any_problem_from_dict

    row, start = case_columns(case, digest), time.process_time()
    try:
        plan = solve(any_problem_from_dict(case.problem), limit=case.limit)
        row |= {"status": PLANNED, "duration": plan.duration}
        row |= {f"check.{check.name}": check.worst for check in plan.certificate.checks}
        row["time.plan"] = time.process_time() - start
        if case.simulate is not None:
            start = time.process_time()
            row |= {f"simulate.{key}": value for key, value in _simulate(plan, case).items()}
            row["time.simulate"] = time.process_time() - start
    except HitchoptError as error:
        status = next((word for kind, word in STATUS.items() if isinstance(error, kind)), FAILED)
        row.setdefault("status", status)  # PLANNED if only the simulation failed
        row["message"] = str(error)
        if isinstance(error, InfeasibleError) and error.violations:
            row["binding"] = error.violations[0].constraint
        row.setdefault("time.plan", time.process_time() - start)
    return row


def _simulate(plan: Plan, case: Case) -> Row:
    """Return the results of a simulated flight."""
    from hitchopt.lab.simulation.judgement import simulate
    from hitchopt.lab.simulation.settings import settings_of
    from hitchopt.lab.simulation.task import Task

    keys: dict[str, Any] = {**(case.simulate or {}), "seed": case.seed}
    run = simulate(Task.of(plan.motion), settings_of(**keys)).run
    row: Row = {"verdict": run.verdict, "succeeded": run.succeeded, **run.figures}
    if run.failures:
        row |= {"failure": run.failures[0].kind, "failure_time": run.failures[0].time}
    return row


def run_tasks(
    function: Callable[..., Any],
    tasks: Mapping[str, tuple[Any, ...]],
    workers: int,
    scheduler: str | None = None,
    *,
    shared: object = None,
) -> Generator[tuple[str, Any], None, None]:
    """Run tasks in parallel; yield the key and the completed future of each.

    Workers call ``function`` with the arguments of each task and, unless it is None, with the
    ``shared`` argument, which is sent only once. They are processes of this machine, or those of a
    dask ``scheduler`` at an address.

    Raises
    ------
    SweepError: the scheduler was lost.
    InputError: the scheduler cannot be reached.
    UnsupportedError: dask.distributed is not installed.
    """
    if not tasks:
        return
    with _client(workers, scheduler) as (client, as_completed):
        columns = [list(column) for column in zip(*tasks.values(), strict=True)]
        if shared is not None:  # a task, which dask recomputes if workers die
            columns.append([client.submit(lambda value: value, shared, pure=False)] * len(tasks))
        reason = ""
        try:
            futures = client.map(function, *columns, key=list(tasks), pure=False, batch_size=1000)
            for future in as_completed(futures, loop=client.loop, raise_errors=False):
                if future.status not in {"finished", "error"}:
                    reason = f"a task was {future.status}"
                    break
                yield str(future.key), future
        except (OSError, TimeoutError) as error:
            reason = str(error) or type(error).__name__
        if reason:
            raise SweepError(
                f"the scheduler was lost ({reason}); rows that were written stay: run the same "
                "study again"
            )


@contextlib.contextmanager
def _hidden_main() -> Iterator[None]:
    """Let new processes not import the calling script, which needs no ``__name__`` guard then.

    Workers run functions of this package alone.
    """
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


@contextlib.contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator[Any]:
    """Yield a client of a scheduler's cluster, or of a temporary cluster on this machine."""
    packages = ("dask", "distributed")
    dask, distributed = (optional_module(name, "sweeps need", "sweep") for name in packages)
    for name in ("distributed", "distributed.scheduler", "distributed.nanny", "distributed.worker"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with dask.config.set(SETTINGS), contextlib.ExitStack() as stack:
        address = scheduler
        if address is None:
            stack.enter_context(_hidden_main())
            cluster = distributed.LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=True,
                dashboard_address="127.0.0.1:0", host="127.0.0.1",
            )  # fmt: skip
            address = stack.enter_context(cluster).scheduler_address
        try:
            client = distributed.Client(address, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            remedy = "start `dask scheduler` and `dask worker ADDRESS`"
            raise InputError("scheduler", scheduler, f"reachable ({error})", remedy) from None
        yield stack.enter_context(client), distributed.as_completed
