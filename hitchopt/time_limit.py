"""A limit on how long planning may take, kept by every loop that may run for long.

A limit holds for all that is called within it, in its own thread only. Loops ask ``check_time``;
solvers in compiled code are told ``time_left``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from hitchopt.errors import TimeLimitError, Violation

Progress = Callable[[str], None]

REMEDY = (
    "allow more seconds (--limit, or limit=), or make the problem easier: more room, more time, "
    "fewer robots"
)


class TimeIsUp(BaseException):
    """Ends whatever is planned; ``time_limit`` makes a TimeLimitError of it.

    It is no Exception: planners that try another guess where one is refused must not go on.
    """


_END: ContextVar[float] = ContextVar("end", default=math.inf)
"""[s] By the monotonic clock."""


@dataclass
class _Listener:
    """Passes on what is being done, and remembers it."""

    progress: Progress | None
    last: str = ""

    def __call__(self, message: str) -> None:
        self.last = message
        if self.progress is not None:
            self.progress(message)


@contextmanager
def time_limit(seconds: float | None, progress: Progress | None = None) -> Iterator[Progress]:
    """Give what is called within at most ``seconds``; an earlier end of an outer limit stays.

    Yields what to call with what is being done now, which ``progress`` is told and the error names.

    Parameters
    ----------
    seconds: [s], or None for no limit.
    progress: called with what is being done now.

    Raises
    ------
    TimeLimitError: the time is up.
    """
    listener = _Listener(progress)
    if seconds is None:
        yield listener
        return
    begun = time.monotonic()
    end = begun + seconds
    if _END.get() <= end:  # whoever set that end answers for it
        yield listener
        return
    token = _END.set(end)
    try:
        yield listener
    except TimeIsUp:
        when = f"(last: {listener.last})" if listener.last else ""
        spent = max(time.monotonic() - begun, seconds)
        violation = Violation("time limit", spent, seconds, "max", "s", (), when, REMEDY)
        raise TimeLimitError([violation]) from None
    finally:
        _END.reset(token)


def time_left() -> float:
    """Return how long planning may still take [s]; infinite without a limit, never below 0."""
    end = _END.get()
    return end if math.isinf(end) else max(0.0, end - time.monotonic())


def check_time() -> None:
    """Raise TimeIsUp where the limit has been reached."""
    if time_left() <= 0.0:
        raise TimeIsUp
