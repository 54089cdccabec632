"""Let Ctrl-C and SIGTERM end a command with its cleanup.

Both raise SystemExit: click turns a KeyboardInterrupt while it parses arguments into "Aborted!" and
exit code 1. Compiled modules that are being imported turn SystemExit into an ImportError; the
context then ends with SystemExit all the same.
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


def how_to_end() -> str:
    """Return how a user ends a command that runs until then, as words for a message."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        return f"Ctrl-C is ignored, as in jobs in the background; `kill {os.getpid()}` ends this"
    return "Ctrl-C ends this"


@contextmanager
def exit_on_signals(*, final: bool = False) -> Iterator[None]:
    """Let SIGINT and SIGTERM raise SystemExit with their exit codes within the context.

    Only the main thread receives signals. ``final``: the process ends with the context, so that
    later signals end it immediately.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []

    def exit_with_code(number: int, _: FrameType | None) -> None:
        received.append(number)
        raise SystemExit(128 + number) from None

    signals = [n for n, default in _DEFAULTS.items() if signal.getsignal(n) is default]
    for number in signals:
        signal.signal(number, exit_with_code)
    try:
        yield
    except Exception:
        if received:  # compiled code has turned SystemExit into another error
            raise SystemExit(128 + received[0]) from None
        raise
    finally:
        for number in signals:
            signal.signal(number, signal.SIG_DFL if final else _DEFAULTS[number])
