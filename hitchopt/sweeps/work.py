"""The row of a case, planned and flown; and the workers that compute rows, on dask."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from hitchopt.errors import (
    HitchoptError,
    InfeasibleError,
    InputError,
    TimeLimitError,
    UnsupportedError,
)
from hitchopt.sweeps.study import Case

if TYPE_CHECKING:
    from hitchopt.plan import Plan

Row = dict[str, Any]
"""A row of the results, by column; unknown values are None."""

# Values of the column ``status``
PLANNED, INFEASIBLE, LATE, FAILED, WRONG = "planned", "infeasible", "time limit", "failed", "wrong"

# Statuses of errors; that of all others is FAILED
STATUS = {TimeLimitError: LATE, InfeasibleError: INFEASIBLE, InputError: WRONG}

# Settings of dask. Its profiler takes more than a tenth of a plan's time, and workers that give
# freed memory back at once a seventh of it
SETTINGS = {
    "distributed.scheduler.allowed-failures": 3,  # of workers with a task: it may kill them
    "distributed.comm.timeouts.connect": "5s",
    "distributed.worker.daemon": True,
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.gil.enabled": False,
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
}


class SweepError(HitchoptError):
    """A sweep that ended early: rows that were written stay, the same call goes on from there."""


def first_columns(case: Case, digest: str) -> Row:
    """Return the columns of a case's row that name it."""
    row: Row = {"digest": digest, "problem": case.name, "seed": case.seed}
    return row | {f"parameter.{key}": value for key, value in case.point.items()}


def row_of(case: Case, digest: str) -> Row:
    """Return the row of a case; errors that hitchopt raises on purpose become rows."""
    from hitchopt.api import solve
    from hitchopt.mission.loading import any_problem_from_dict

    row, begin = first_columns(case, digest), time.process_time()
    try:
        plan = solve(any_problem_from_dict(case.problem), limit=case.limit)
        row |= {"status": PLANNED, "duration": plan.duration}
        row |= {f"check.{check.name}": check.worst for check in plan.certificate.checks}
        row["time.plan"] = time.process_time() - begin
        if case.simulate is not None:
            begin = time.process_time()
            row |= {f"simulate.{key}": value for key, value in _simulated(plan, case).items()}
            row["time.simulate"] = time.process_time() - begin
    except HitchoptError as error:
        status = next((word for kind, word in STATUS.items() if isinstance(error, kind)), FAILED)
        row.setdefault("status", status)  # a plan stays one
        row["message"] = str(error)
        if isinstance(error, InfeasibleError) and error.violations:
            row["binding"] = error.violations[0].constraint
        row.setdefault("time.plan", time.process_time() - begin)
    return row


def _simulated(plan: Plan, case: Case) -> Row:
    """Return figures of a simulated flight."""
    from hitchopt.simulation.judgement import simulate
    from hitchopt.simulation.settings import settings_of
    from hitchopt.simulation.task import Task

    keys: dict[str, Any] = {**(case.simulate or {}), "seed": case.seed}
    run = simulate(Task.of(plan.motion), settings_of(**keys)).run
    row: Row = {"verdict": run.verdict, "succeeded": run.succeeded, **run.figures}
    if run.failures:
        row |= {"failure": run.failures[0].kind, "failure_time": run.failures[0].time}
    return row


def finished(
    work: Callable[..., Any],
    tasks: Mapping[str, tuple[Any, ...]],
    width: int,
    scheduler: str | None = None,
    *,
    shared: object = None,
) -> Generator[tuple[str, Any], None, None]:
    """Yield the key of every task and its future, which has a result or an exception.

    Workers call ``work`` with the arguments of each task and, unless it is None, the ``shared``
    one, which is sent but once. They are ``width`` processes on this machine, or those of a dask
    ``scheduler`` at an address.

    Raises
    ------
    SweepError: the scheduler was lost.
    InputError: the scheduler cannot be reached.
    UnsupportedError: dask.distributed is not installed.
    """
    if not tasks:
        return
    with _client(width, scheduler) as (client, as_completed):
        columns = [list(column) for column in zip(*tasks.values(), strict=True)]
        if shared is not None:  # a task that dask computes again where workers die
            columns.append([client.submit(lambda value: value, shared, pure=False)] * len(tasks))
        lost, status = "", "finished"
        try:
            futures = client.map(work, *columns, key=list(tasks), pure=False, batch_size=1000)
            for future in as_completed(futures, loop=client.loop, raise_errors=False):
                if (status := future.status) not in {"finished", "error"}:
                    break
                yield str(future.key), future
        except (OSError, TimeoutError) as error:
            lost = str(error) or type(error).__name__
        if lost or status not in {"finished", "error"}:
            raise SweepError(
                f"the scheduler was lost ({lost or f'a task was {status}'}); rows that were "
                "written stay: run the same study again"
            )


@contextlib.contextmanager
def _client(width: int, scheduler: str | None) -> Iterator[Any]:
    """Yield a client of a scheduler's cluster, or of one of this machine that ends with it."""
    try:
        import dask
        import distributed
    except ImportError:
        needed = "sweeps need dask.distributed: pip install 'hitchopt[sweep]'"
        raise UnsupportedError(needed) from None
    for name in ("distributed", "distributed.scheduler", "distributed.nanny", "distributed.worker"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with dask.config.set(SETTINGS), contextlib.ExitStack() as stack:
        address = scheduler
        if address is None:
            cluster = distributed.LocalCluster(
                n_workers=width, threads_per_worker=1, processes=True,
                dashboard_address="127.0.0.1:0", host="127.0.0.1",
            )  # fmt: skip
            address = stack.enter_context(cluster).scheduler_address
        try:
            client = distributed.Client(address, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            remedy = "start `dask scheduler` and `dask worker ADDRESS`"
            raise InputError("scheduler", scheduler, f"reachable ({error})", remedy) from None
        yield stack.enter_context(client), distributed.as_completed
