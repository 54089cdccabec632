"""Setpoints as MAVLink's SET_POSITION_TARGET_LOCAL_NED, for autopilots in offboard mode.

Drone ``i`` of the plan is system ``i + 1``. Position, velocity, acceleration and yaw are set; the
acceleration is ``a - F / m`` with the cable's force F, since autopilots add gravity only. They
answer with LOCAL_POSITION_NED.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import numpy as np

from hitchopt.errors import UnsupportedError
from hitchopt.flying.course import Flown
from hitchopt.flying.outlet import DatagramOutlet
from hitchopt.values import Array

OWN_SYSTEM = 245
"""System number of this sender, beyond those of usual fleets and below ground stations' 255."""

BEAT = 1.0
"""[s] Period of heartbeats: autopilots take a sender for lost after some seconds."""


def messages() -> Any:
    """Return pymavlink's definitions of messages.

    Raises
    ------
    UnsupportedError: pymavlink is not installed.
    """
    try:
        return import_module("pymavlink.dialects.v20.common")
    except ImportError as error:
        words = f"MAVLink needs the package pymavlink ({error}); pip install 'hitchopt[fly]'"
        raise UnsupportedError(words) from None


class MavlinkOutlet(DatagramOutlet):
    """A fleet of autopilots, whose local north-east-down axes share one origin."""

    def __init__(self, *fleet: Any) -> None:
        super().__init__(*fleet)
        self._mavlink = messages()
        self._sender = self._mavlink.MAVLink(None, srcSystem=OWN_SYSTEM)
        self._begun: float | None = None
        self._beaten = -math.inf

    def send(self, flown: Flown, now: float) -> None:
        """Send every autopilot its setpoint, and a heartbeat now and then."""
        frame, at, link = self._frame, flown.setpoints, self._mavlink
        if self._begun is None:
            self._begun = now
        if now - self._beaten >= BEAT:
            self._beaten = now
            kind = (link.MAV_TYPE_ONBOARD_CONTROLLER, link.MAV_AUTOPILOT_INVALID)
            beat = self._sender.heartbeat_encode(*kind, 0, 0, link.MAV_STATE_ACTIVE)
            for to in dict.fromkeys(self._addresses):
                self._datagrams.send(beat.pack(self._sender), to)
        parts = (
            frame.points(at.positions),
            frame.vectors(at.velocities),
            frame.vectors(flown.feed_forward),
        )
        boot = int(1e3 * (now - self._begun)) % 2**32
        mask = link.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
        axes = (link.MAV_FRAME_LOCAL_NED, mask)
        for i, row in enumerate(np.concatenate(parts, axis=-1).tolist()):
            message = self._sender.set_position_target_local_ned_encode(
                boot, i + 1, link.MAV_COMP_ID_AUTOPILOT1, *axes, *row, frame.heading, 0.0
            )
            self._datagrams.send(message.pack(self._sender), self._addresses[i])

    def answers(self, data: bytes) -> Iterator[tuple[object, Array]]:
        """Yield the positions that a datagram tells."""
        parser = self._mavlink.MAVLink(None)  # whole messages: damage ends with a datagram
        parser.robust_parsing = True
        for message in parser.parse_buffer(data) or []:
            place = message.get_srcSystem() - 1
            if message.get_type() == "LOCAL_POSITION_NED" and place in range(len(self._names)):
                yield self._names[place], np.array([message.x, message.y, message.z])
