"""Signals that arrive while casadi is at work, answered after it and not lost.

IPOPT's interface looks for signals itself, and when a handler raises, as Python's own does for
Ctrl-C, takes that for a failed evaluation and goes on: an interrupted run would return a plan
all the same, along another path than without.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

NUMBERS = tuple(int(number) for number in signal.valid_signals())


@contextmanager
def answered_later() -> Iterator[None]:
    """Answer signals that come within the context at its end, in their order.

    Only those that Python code answers, and in the main thread: no other one ever does.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers = {number: signal.getsignal(number) for number in NUMBERS}
    waiting: list[tuple[int, FrameType | None]] = []

    def wait(number: int, frame: FrameType | None) -> None:
        waiting.append((number, frame))

    changed = [number for number, handler in handlers.items() if callable(handler)]
    try:
        for number in changed:
            signal.signal(number, wait)
        yield
    finally:
        for number in changed:
            signal.signal(number, handlers[number])
        for number, frame in waiting:  # also where the work has failed
            handler = handlers[number]
            if callable(handler):
                handler(number, frame)
