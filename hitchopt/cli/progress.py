"""A progress bar on the terminal for work that takes longer than two seconds."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from rich.progress import Progress

DELAY = 2.0
"""Time without a bar [s]."""


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
        self._bar: Progress | None = None
        self._lock = threading.Lock()
        self._timer = threading.Timer(delay, self._show)
        self._timer.daemon = True

    def __enter__(self) -> LateProgress:
        if self._stream is not None and self._stream.isatty():
            self._timer.start()
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
            if self._bar is not None:
                self._bar.update(self._bar.task_ids[0], description=message)

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
            self._bar.add_task(self._message, total=None)  # progress is not measured
            self._bar.start()
