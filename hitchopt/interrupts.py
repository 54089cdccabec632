"""Ctrl-C and SIGTERM end a command alike: what it was writing is cleaned up.

An import is the one place in which neither may raise: compiled modules make an ImportError of it,
or print a traceback. What comes meanwhile is answered when the import is over.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

INTERRUPTED, TERMINATED = 130, 143
"""Exit codes, as shells tell processes that ended by SIGINT and by SIGTERM."""

AGAIN = 0.02
"""[s] After which a signal that came within an import is sent again."""

_IMPORTING = "<frozen importlib._bootstrap"

_answered: list[int] = []
"""Signals that have been answered within the outermost context."""

_DEFAULTS: dict[int, Callable[[int, FrameType | None], None] | signal.Handlers] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
}
"""Whoever has set another handler, or ignores the signal as under nohup, is left to it."""


@contextmanager
def ending_signals() -> Iterator[None]:
    """Let SIGINT raise KeyboardInterrupt, and SIGTERM SystemExit, within the context.

    In the main thread only: signals reach no other one.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    changed = [n for n, default in _DEFAULTS.items() if signal.getsignal(n) is default]
    if changed:
        _answered.clear()
    for number in changed:
        signal.signal(number, _end)
    try:
        yield
    except Exception:
        for number in _answered:  # compiled code has made another error of it
            _raise(number)
        raise
    finally:
        for number in changed:
            signal.signal(number, _DEFAULTS[number])


def _end(number: int, frame: FrameType | None) -> None:
    if _importing(frame):
        again = threading.Timer(AGAIN, os.kill, (os.getpid(), number))
        again.daemon = True
        again.start()
        return
    _answered.append(number)
    _raise(number)


def _raise(number: int) -> NoReturn:
    if number == signal.SIGINT:
        raise KeyboardInterrupt from None
    raise SystemExit(TERMINATED) from None


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith(_IMPORTING):
            return True
        frame = frame.f_back
    return False
