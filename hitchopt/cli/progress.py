"""A sign of life on the terminal for whatever takes longer than two seconds."""

from __future__ import annotations

import threading
from types import TracebackType
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from rich.progress import Progress

DELAY = 2.0
"""[s] What is over sooner needs no bar."""


class LateProgress:
    """Context manager and callback: shows what was told last beside a bar, once ``delay`` is over.

    Parameters
    ----------
    stream: where to; nothing is shown unless it is a terminal.
    message: what is being done, until told otherwise.
    limit: what it takes at most [s], shown beside the time that has passed; None: not known.
    delay: how long to stay silent [s].
    """

    def __init__(
        self,
        stream: TextIO | None,
        message: str,
        limit: float | None = None,
        delay: float = DELAY,
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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._timer.cancel()
        if self._timer.is_alive():
            self._timer.join()
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, message: str) -> None:
        """Tell what is being done now."""
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
            self._bar.add_task(self._message, total=None)  # how far it is nobody knows
            self._bar.start()
