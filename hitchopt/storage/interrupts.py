"""Let Ctrl-C and SIGTERM end a command with its cleanup.

Both raise SystemExit: click turns a KeyboardInterrupt while it parses arguments into "Aborted!" and
exit code 1. Signals are deferred during imports, as compiled modules turn the exception into an
ImportError or print a traceback.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

EXIT_INTERRUPTED = 128 + signal.SIGINT  # Exit code of processes ended by SIGINT, as in shells

_DEFAULTS: dict[int, Callable[[int, FrameType | None], None] | signal.Handlers] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
}
"""Handlers to replace; other handlers and ignored signals (nohup) are left alone."""

RESEND_DELAY = 0.02  # Delay before a deferred signal is sent again [s]

_IMPORT_FILES = "<frozen importlib._bootstrap"
"""Prefix of names of files within which signals are deferred."""

_received: list[int] = []  # Signals handled within the outermost context


def how_to_end() -> str:
    """Return how a user ends a command that runs until then, as words for a message."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        return f"Ctrl-C is ignored, as in jobs in the background; `kill {os.getpid()}` ends this"
    return "Ctrl-C ends this"


@contextmanager
def exit_on_signals(*, final: bool = False) -> Iterator[None]:
    """Let SIGINT and SIGTERM raise SystemExit with their exit codes within the context.

    Only the main thread receives signals. ``final``: the process ends with the context, so that
    later signals end it at once.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    signals = [n for n, default in _DEFAULTS.items() if signal.getsignal(n) is default]
    if signals:
        _received.clear()
    for number in signals:
        signal.signal(number, _exit)
    try:
        yield
    except Exception:
        if _received:  # compiled code has turned SystemExit into another error
            raise SystemExit(128 + _received[0]) from None
        raise
    finally:
        for number in signals:
            signal.signal(number, signal.SIG_DFL if final else _DEFAULTS[number])


def _exit(number: int, frame: FrameType | None) -> None:
    if _is_deferred(frame):
        resend = threading.Timer(RESEND_DELAY, os.kill, (os.getpid(), number))
        resend.daemon = True
        resend.start()
    else:
        _received.append(number)
        raise SystemExit(128 + number) from None


def _is_deferred(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith(_IMPORT_FILES):
            return True
        frame = frame.f_back
    return False
