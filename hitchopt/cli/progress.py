"""Progress on stderr: a bar for work that takes longer than two seconds, or a line per message.

The bar is filled by the count in a message, such as ``speed, 4 of 18``, or by its percentage.
"""

from __future__ import annotations

import re
import threading
import time
from typing import TYPE_CHECKING, TextIO

from hitchopt.cli.output import echo, output

if TYPE_CHECKING:
    from rich.progress import Progress

DELAY = 2.0
"""Time without a bar [s]."""


LINES = 1.0
"""Shortest time between lines of percentages [s]."""

COUNT = re.compile(r"(\d[\d.]*) of (\d[\d.]*)|(\d[\d.]*)%")
"""Count or percentage in a message."""


def done_of(message: str) -> tuple[float | None, float | None]:
    """Return what is done, and of how much, as a message says; None of either without a count."""
    found = COUNT.search(message)
    if found is None:
        return None, None
    done, total, percent = found.groups()
    count = (float(percent), 100.0) if percent else (float(done), float(total))
    return count if count[1] > 0.0 else (None, None)


class LateProgress:
    """Context manager and callback: shows a bar and the last message once ``delay`` is over.

    Parameters
    ----------
    stream: output stream; nothing is shown unless it is a terminal.
    message: first message.
    limit: time limit [s], shown next to the elapsed time, or None.
    delay: time before the bar is shown [s].
    """

    def __init__(
        self, stream: TextIO | None, message: str, limit: float | None = None, delay: float = DELAY
    ) -> None:
        self._stream = stream
        self._at_most = "" if limit is None else f"of at most {limit:.0f} s"
        self._message = message
        self._done: tuple[float | None, float | None] = (None, None)
        self._begun = self._next_line = time.monotonic()
        self._quiet, self._verbose = output().quiet, output().verbose
        self._bar: Progress | None = None
        self._lock = threading.Lock()
        self._timer = threading.Timer(delay, self._show)
        self._timer.daemon = True

    def __enter__(self) -> LateProgress:
        lines = self._quiet or self._verbose
        if self._stream is not None and self._stream.isatty() and not lines:
            self._timer.start()
        self(self._message)
        return self

    def __exit__(self, *_: object) -> None:
        self._timer.cancel()
        if self._timer.is_alive():
            self._timer.join()
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, message: str) -> None:
        """Show a message about the current work."""
        with self._lock:
            self._message = message
            self._done = done_of(message)
            now = time.monotonic()
            if self._verbose and not ("%" in message and now < self._next_line):
                echo(f"{now - self._begun:6.1f} s  {message}", err=True)
                self._next_line = now + LINES
            if self._bar is not None:
                task = self._bar.task_ids[0]
                completed, total = self._done
                self._bar.update(task, description=message, completed=completed, total=total)

    def _show(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        with self._lock:
            self._bar = Progress(
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                TimeElapsedColumn(),
                TextColumn(self._at_most, markup=False),
                console=Console(file=self._stream),
                transient=True,
            )
            task = self._bar.add_task(self._message, total=None)  # until there is a count
            self._bar.update(task, completed=self._done[0], total=self._done[1])
            self._bar.start()
