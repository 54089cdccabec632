"""Work on dask: a cluster of this machine or any scheduler, and results as they arrive."""

from __future__ import annotations

import contextlib
import itertools
import logging
from collections.abc import Callable, Generator, Iterator, Mapping
from typing import Any

from hitchopt.errors import HitchoptError, InputError, UnsupportedError

AHEAD = 8
"""Tasks per worker that are handed to the scheduler at a time."""

LOST = 3
"""Number of workers that may die with a task before it counts as failed: it may kill them."""

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
        rest = iter(tasks.items())
        pending = distributed.as_completed(loop=client.loop, raise_errors=False)

        def hand_out(count: int) -> None:
            for key, arguments in itertools.islice(rest, count):
                pending.add(client.submit(work, *arguments, key=key, pure=False))

        try:
            hand_out(ahead)
            for future in pending:
                if future.status not in {"finished", "error"}:
                    raise SweepError(f"the scheduler was lost (a task was {future.status}); {STAY}")
                yield str(future.key), future
                hand_out(1)
        except (OSError, TimeoutError, distributed.CommClosedError) as error:
            reason = error or type(error).__name__
            raise SweepError(f"the scheduler was lost ({reason}); {STAY}") from error


STAY = "rows that were written stay: run the same study again"


@contextlib.contextmanager
def _client(distributed: Any, width: int, scheduler: str | None) -> Iterator[Any]:
    """Yield a client of a scheduler's cluster, or of one of this machine that ends with it."""
    import dask

    settings = {
        "distributed.scheduler.allowed-failures": LOST,
        "distributed.comm.timeouts.connect": "5s",
        "distributed.worker.daemon": True,
    }
    for name in ("distributed", "distributed.scheduler", "distributed.nanny", "distributed.worker"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with dask.config.set(settings), contextlib.ExitStack() as stack:
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
