"""Ctrl-C and SIGTERM end a command alike: what it was writing is cleaned up.

Neither may raise during an import: compiled modules turn the exception into an ImportError or print
a traceback; nor within pydantic, whose compiled code panics where Python code that it calls raises.
A signal that arrives then is handled when that is over. Both raise SystemExit, by which click, too,
ends quietly while it parses arguments; it makes "Aborted!" and 1 of a KeyboardInterrupt.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

INTERRUPTED = 128 + signal.SIGINT
"""Exit code of processes that ended by SIGINT, the same as in shells."""

_DEFAULTS: dict[int, Callable[[int, FrameType | None], None] | signal.Handlers] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
}
"""Handlers that are replaced; another handler, or an ignored signal (nohup), is left alone."""

RESEND_DELAY = 0.02  # Delay before a signal that arrived at a wrong time is sent again [s]

_IMPORTING, _VALIDATING = "<frozen importlib._bootstrap", "pydantic."
"""Beginnings of the file's and of the module's name of code within which signals do not raise."""

_handled: list[int] = []  # Signals that have been handled within the outermost context


@contextmanager
def ending_signals(*, last: bool = False) -> Iterator[None]:
    """Let SIGINT and SIGTERM raise SystemExit with their exit codes within the context.

    Signals reach the main thread alone. ``last``: the process ends with the context, and signals
    then end it at once.
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
        if _handled:  # compiled code has turned it into another error
            raise SystemExit(128 + _handled[0]) from None
        raise
    finally:
        for number in changed:
            signal.signal(number, signal.SIG_DFL if last else _DEFAULTS[number])


def _end(number: int, frame: FrameType | None) -> None:
    if _shielded(frame):
        again = threading.Timer(RESEND_DELAY, os.kill, (os.getpid(), number))
        again.daemon = True
        again.start()
    else:
        _handled.append(number)
        raise SystemExit(128 + number) from None


def _shielded(frame: FrameType | None) -> bool:
    while frame is not None:
        module = str(frame.f_globals.get("__name__"))
        if frame.f_code.co_filename.startswith(_IMPORTING) or module.startswith(_VALIDATING):
            return True
        frame = frame.f_back
    return False
