"""Setpoints as JSON over UDP: one datagram for every drone and time, for receivers of one's own.

A receiver answers each datagram's sender with ``{"drone": "q0", "position": [x, y, z]}``, measured,
in the axes of the setpoints (east-north-up).
"""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np

from hitchopt.flying.course import Flown
from hitchopt.flying.datagrams import json_object
from hitchopt.flying.outlet import DatagramOutlet
from hitchopt.model.evaluation import attitudes
from hitchopt.values import MAX_COORDINATE, Array

FORMAT = "hitchopt-setpoint/1"


class JsonOutlet(DatagramOutlet):
    """A fleet that reads JSON."""

    _number = 0

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

    def answers(self, data: bytes) -> Iterator[tuple[object, Array]]:
        """Yield the position that a datagram tells."""
        answer = json_object(data)
        place = answer.get("position")
        if isinstance(place, list) and all(
            type(x) in (int, float) and abs(x) <= MAX_COORDINATE for x in place
        ):
            yield answer.get("drone"), np.array(place, dtype=np.float64)
