"""Links by their names: which of them have been silent for too long."""

from __future__ import annotations

import math
from collections.abc import Iterable


class LinkWatch:
    """When each of several links was heard of last.

    Parameters
    ----------
    timeouts: time [s] after which a silent link is lost, by the links' names.
    """

    def __init__(self, timeouts: dict[str, float]) -> None:
        self._timeouts = timeouts
        self._heard = dict.fromkeys(timeouts, -math.inf)

    def heard(self, names: Iterable[str], now: float) -> None:
        """Note that links were heard of at a time [s]; other names are ignored."""
        for name in names:
            if name in self._heard:
                self._heard[name] = now

    def lost(self, now: float) -> tuple[str, ...]:
        """Return the names of the links that are lost at a time [s], never heard ones too."""
        return tuple(
            name for name, last in self._heard.items() if now - last > self._timeouts[name]
        )
