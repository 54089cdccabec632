"""The rows that mavsdk_drone_show sends to a drone, by the settings of its ``src/params.py``.

Rows are played by the clock, but not all of them are flown. Until a row is at
``INITIAL_CLIMB_ALTITUDE_THRESHOLD`` or above **and** ``INITIAL_CLIMB_TIME_THRESHOLD`` has passed,
the drone climbs straight up at 1 m/s instead, and time runs on; with a shared global origin it then
spends 3 s on a straight line to the row of that moment. A show whose last row is not above
``GROUND_ALTITUDE_THRESHOLD`` is cut off from its half on, where a row is below 2 m or in its last
second: the drone lands from there. Without ``AUTO_GLOBAL_ORIGIN_MODE`` every drone's rows are
counted from its own first one, in altitude too. Velocities and accelerations are sent only with
local setpoints, and only if asked for.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError
from hitchopt.values import Array

BLEND = 3.0
"""Duration of the straight line from the climb to the rows [s], with a shared global origin."""

LANDING_ALTITUDE, LANDING_TIME, LANDING_SHARE = 2.0, 1.0, 0.5
"""Altitude [m], remaining time [s] and share of the rows: a show that ends on the ground is cut off
from that share on, below that altitude or within that time."""

LATE = 5.0
"""Longest time that arming takes after the common start [s]: rows run meanwhile."""

NAMES = {
    "climb_altitude": "INITIAL_CLIMB_ALTITUDE_THRESHOLD",
    "climb_time": "INITIAL_CLIMB_TIME_THRESHOLD",
    "ground_altitude": "GROUND_ALTITUDE_THRESHOLD",
    "shared_origin": "AUTO_GLOBAL_ORIGIN_MODE",
    "global_setpoints": "USE_GLOBAL_SETPOINTS",
    "velocities": "FEEDFORWARD_VELOCITY_ENABLED",
    "accelerations": "FEEDFORWARD_ACCELERATION_ENABLED",
}
"""Names of the settings in ``src/params.py``."""


@dataclass(frozen=True)
class Receiver:
    """Settings of mavsdk_drone_show; those that it comes with where nothing is given.

    Attributes
    ----------
    climb_altitude, climb_time: that end the initial climb together [m], [s].
    ground_altitude: at or below which a show ends on the ground [m].
    shared_origin: whether rows are taken as they stand, not from each drone's first one.
    global_setpoints: whether positions are sent as latitude, longitude and altitude.
    velocities, accelerations: whether local setpoints hold them.
    """

    climb_altitude: float = 5.0
    climb_time: float = 5.0
    ground_altitude: float = 1.0
    shared_origin: bool = True
    global_setpoints: bool = True
    velocities: bool = False
    accelerations: bool = False

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> Receiver:
        """Return the receiver with settings by their names in ``src/params.py``.

        Raises
        ------
        FileError: a value of another type, or a number that is not finite.
        """
        values: dict[str, Any] = {}
        for field in fields(cls):
            name = NAMES[field.name]
            value = settings.get(name, field.default)
            if isinstance(field.default, bool) != isinstance(value, bool) or not (
                isinstance(value, int | float) and math.isfinite(value)
            ):
                raise FileError(f"{name}: is {value!r}, not {type(field.default).__name__}")
            values[field.name] = value
        return cls(**values)

    def settings(self) -> dict[str, float | bool]:
        """Return the settings by their names in ``src/params.py``."""
        return {NAMES[field.name]: getattr(self, field.name) for field in fields(self)}

    def lowered(self, places: Array) -> Array:
        """Return how much lower than its rows each drone flies, (D,) [m].

        Parameters
        ----------
        places: positions of the rows (S, D, 3) [m], north-east-down.
        """
        return np.zeros(places.shape[1]) if self.shared_origin else -places[0, :, 2]

    def followed(self, t: Array, places: Array, late: float = 0.0) -> NDArray[np.bool_]:
        """Return which rows are sent to which drone, (S, D).

        Parameters
        ----------
        t: times of the rows (S,) [s].
        places: positions of the rows (S, D, 3) [m], north-east-down.
        late: after the first row, how long it takes until the drone climbs [s].
        """
        altitude = -places[..., 2] - self.lowered(places)
        climbing = t - t[0] - late
        over = (altitude >= self.climb_altitude) & (climbing >= self.climb_time)[:, None]
        over &= (climbing >= 0.0)[:, None]
        climbed = np.logical_or.accumulate(over, axis=0)
        landing = climbed & (altitude[-1] <= self.ground_altitude)
        landing &= (np.arange(1, len(t) + 1) >= LANDING_SHARE * len(t))[:, None]
        landing &= (altitude < LANDING_ALTITUDE) | (t[-1] - t <= LANDING_TIME)[:, None]
        if self.shared_origin and self.global_setpoints:
            first = np.where(climbed.any(axis=0), t[np.argmax(climbed, axis=0)], np.inf)
            climbed &= t[:, None] >= first + BLEND
        return climbed & ~np.logical_or.accumulate(landing, axis=0)
