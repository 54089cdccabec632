"""What carries setpoints to drones and brings measurements back."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np

from hitchopt.exports.reference_frame import ReferenceFrame
from hitchopt.flying.course import Flown
from hitchopt.flying.datagrams import Address, Datagrams
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


class DatagramOutlet(ABC):
    """A fleet behind UDP; answers of hosts that are sent nothing are ignored.

    Parameters
    ----------
    names: of the drones.
    addresses: where each of them listens; equal ones for a router.
    frame: axes of what is sent.
    datagrams: the socket.
    """

    def __init__(
        self,
        names: Sequence[str],
        addresses: Sequence[Address],
        frame: ReferenceFrame,
        datagrams: Datagrams,
    ) -> None:
        self._names, self._addresses = tuple(names), tuple(addresses)
        self._frame, self._datagrams = frame, datagrams

    @abstractmethod
    def answers(self, data: bytes) -> Iterator[tuple[object, Array]]:
        """Yield whose positions a datagram tells, and where they are in the frame."""

    def measured(self) -> dict[str, Array]:
        """Return measured positions (3,) [m] in the plan's axes, by the drones' names."""
        hosts = {host for host, _ in self._addresses}
        found: dict[str, Array] = {}
        for data, (host, _) in self._datagrams.received():
            for name, point in self.answers(data) if host in hosts else ():
                if name in self._names and point.shape == (3,) and np.all(np.isfinite(point)):
                    found[str(name)] = self._frame.planned(point)
        return found

    def close(self, *, landed: bool) -> None:  # noqa: ARG002
        """Close the socket; autopilots leave offboard mode as they are set to."""
        self._datagrams.close()
