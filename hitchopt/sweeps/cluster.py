"""Work on dask: a cluster of this machine or any scheduler, and results as they arrive."""

from __future__ import annotations

import contextlib
import itertools
import logging
from collections.abc import Callable, Generator, Iterator, Mapping
from typing import Any

from hitchopt.errors import HitchoptError, InputError, UnsupportedError

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


class SweepError(HitchoptError):
    """A sweep that ended early: rows that were written stay, the same call goes on from there."""


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


STAY = "rows that were written stay: run the same study again"


@contextlib.contextmanager
def _client(distributed: Any, width: int, scheduler: str | None) -> Iterator[Any]:
    """Yield a client of a scheduler's cluster, or of one of this machine that ends with it."""
    import dask

    for name in ("distributed", "distributed.scheduler", "distributed.nanny", "distributed.worker"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with dask.config.set(SETTINGS), contextlib.ExitStack() as stack:
        if scheduler is None:
            cluster = stack.enter_context(
                distributed.LocalCluster(
                    n_workers=width,
                    threads_per_worker=1,
                    processes=True,
                    dashboard_address="127.0.0.1:0",
                    host="127.0.0.1",
                )
            )
            address = cluster.scheduler_address
        else:
            address = scheduler
        try:
            client = distributed.Client(address, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            remedy = "start `dask scheduler` and `dask worker ADDRESS`"
            raise InputError("scheduler", scheduler, f"reachable ({error})", remedy) from None
        yield stack.enter_context(client)
