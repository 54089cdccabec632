"""Ctrl-C and SIGTERM end a command alike: what it was writing is cleaned up.

Neither may raise during an import: compiled modules turn the exception into an ImportError or print
a traceback. A signal that arrives then is handled when the import is over.
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
"""Exit codes of processes that ended by SIGINT and by SIGTERM, the same as in shells."""

RESEND_DELAY = 0.02
"""Delay before a signal that arrived during an import is sent again [s]."""

_IMPORTING = "<frozen importlib._bootstrap"

_handled: list[int] = []
"""Signals that have been handled within the outermost context."""

_DEFAULTS: dict[int, Callable[[int, FrameType | None], None] | signal.Handlers] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
}
"""Handlers that are replaced; another handler, or an ignored signal (nohup), is left alone."""


@contextmanager
def ending_signals() -> Iterator[None]:
    """Let SIGINT raise KeyboardInterrupt, and SIGTERM SystemExit, within the context.

    Other threads than the main one are not affected: signals do not reach them.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    changed = [n for n, default in _DEFAULTS.items() if signal.getsignal(n) is default]
    if changed:
        _handled.clear()
    for number in changed:
        signal.signal(number, _end)
    try:
        yield
    except Exception:
        for number in _handled:  # compiled code has turned it into another error
            _raise(number)
        raise
    finally:
        for number in changed:
            signal.signal(number, _DEFAULTS[number])


def _end(number: int, frame: FrameType | None) -> None:
    if _importing(frame):
        again = threading.Timer(RESEND_DELAY, os.kill, (os.getpid(), number))
        again.daemon = True
        again.start()
        return
    _handled.append(number)
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
