"""A clock of the machine that tests set."""

from __future__ import annotations


class Clock:
    """A monotonic clock that goes on by ``tick`` [s] whenever it is read."""

    def __init__(self) -> None:
        self.now, self.tick = 0.0, 1.0

    def monotonic(self) -> float:
        """Return the time [s]."""
        self.now += self.tick
        return self.now
