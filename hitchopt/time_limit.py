"""A limit on how long planning may take, respected by every loop that may run for long.

A limit holds for everything that is called within it, in its own thread only. Loops call
``check_time``; solvers in compiled code receive ``time_left``.
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
    """Ends all planning; ``time_limit`` turns it into a TimeLimitError.

    It is no Exception, so that planners which try another guess after a refusal do not go on.
    """


_END: ContextVar[float] = ContextVar("end", default=math.inf)
"""End of the limit on the monotonic clock [s]."""


@dataclass
class _Listener:
    """Passes messages on and remembers the last one."""

    progress: Progress | None
    last: str = ""

    def __call__(self, message: str) -> None:
        self.last = message
        if self.progress is not None:
            self.progress(message)


@contextmanager
def time_limit(seconds: float | None, progress: Progress | None = None) -> Iterator[Progress]:
    """Limit the time of the context to ``seconds``; an earlier end of an outer limit stays.

    Yields a callback for messages about the current work: it passes them to ``progress``, and the
    error shows the last one.

    Parameters
    ----------
    seconds: time limit [s], or None for no limit.
    progress: callback that receives the messages, or None.

    Raises
    ------
    TimeLimitError: the time limit has been reached.
    """
    listener = _Listener(progress)
    if seconds is None:
        yield listener
        return
    begun = time.monotonic()
    end = begun + seconds
    if _END.get() <= end:  # the outer limit raises its own error
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
    """Raise TimeIsUp if the limit has been reached."""
    if time_left() <= 0.0:
        raise TimeIsUp
