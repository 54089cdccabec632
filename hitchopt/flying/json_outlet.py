"""Setpoints as JSON over UDP: one datagram for every drone and time, for receivers of one's own.

A receiver answers each datagram's sender with ``{"drone": "q0", "position": [x, y, z]}``, measured,
in the axes of the setpoints (east-north-up).
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

import numpy as np

from hitchopt.exports.reference_frame import ReferenceFrame
from hitchopt.flying.course import Flown
from hitchopt.flying.datagrams import Address, Datagrams, json_object
from hitchopt.model.evaluation import attitudes
from hitchopt.values import Array

FORMAT = "hitchopt-setpoint/1"


class JsonOutlet:
    """A fleet behind UDP.

    Parameters
    ----------
    names: of the drones.
    addresses: where each of them listens.
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
        self._number = 0

    def send(self, flown: Flown, now: float) -> None:
        """Send every drone its setpoint."""
        frame, at = self._frame, flown.setpoints
        turned = attitudes(
            frame.vectors(flown.thrusts), frame.vectors(flown.thrust_rates), frame.heading
        )
        rows = {
            "position": frame.points(at.positions),
            "velocity": frame.vectors(at.velocities),
            "acceleration": frame.vectors(at.accelerations),
            "jerk": frame.vectors(at.jerks),
            "feed_forward": frame.vectors(flown.feed_forward),
            "quaternion": turned.quaternions,
            "body_rates": turned.body_rates,
        }
        lists = {key: values.tolist() for key, values in rows.items()}
        head = {
            "format": FORMAT,
            "number": self._number,
            "time": now,
            "plan_time": at.time,
            "clock_rate": at.rate,
            "yaw": frame.heading,
        }
        for i, (name, to) in enumerate(zip(self._names, self._addresses, strict=True)):
            own = {key: values[i] for key, values in lists.items()}
            self._datagrams.send(json.dumps({**head, "drone": name, **own}).encode(), to)
        self._number += 1

    def measured(self) -> dict[str, Array]:
        """Return measured positions; answers of hosts that are sent nothing are ignored."""
        hosts = {host for host, _ in self._addresses}
        found: dict[str, Array] = {}
        for data, (host, _) in self._datagrams.received():
            answer = json_object(data)
            place = answer.get("position")
            if host in hosts and answer.get("drone") in self._names and _point(place):
                point = np.array(place, dtype=np.float64) - self._frame.shift
                found[answer["drone"]] = point @ self._frame.rotation
        return found

    def close(self, *, landed: bool) -> None:  # noqa: ARG002
        """Close the socket."""
        self._datagrams.close()


def _point(given: object) -> bool:
    return (
        isinstance(given, list)
        and len(given) == 3
        and all(type(x) in (int, float) and math.isfinite(x) for x in given)
    )
