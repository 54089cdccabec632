"""What carries setpoints to drones and brings measurements back."""

from __future__ import annotations

from typing import Protocol

from hitchopt.flying.course import Flown
from hitchopt.values import Array


class Outlet(Protocol):
    """A fleet that is sent setpoints."""

    def send(self, flown: Flown, now: float) -> None:
        """Send every drone its setpoint at a time [s]; a network that fails is no error."""

    def measured(self) -> dict[str, Array]:
        """Return what has arrived since the last call: positions (3,) [m] in the plan's axes.

        Keys are the drones' names in the plan.
        """

    def close(self, *, landed: bool) -> None:
        """End the stream."""
