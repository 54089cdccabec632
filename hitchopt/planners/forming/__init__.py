"""Planners that form a hitch in midair and take it apart again: the paper's Action 1."""

from __future__ import annotations

from dataclasses import dataclass

from hitchopt.errors import InputError, OneLine
from hitchopt.values import acute, not_negative, positive, whole


@dataclass(frozen=True)
class SwapSettings(OneLine):
    """Settings of pairs of drones that turn about each other.

    Parameters
    ----------
    radius: no semi-axis of the ellipses is smaller than this [m].
    tilt: of the axis of turning, upward from level [rad]; None: 45°.
    seconds: no half turn is faster than this [s]; None: as fast as the limits allow.
    sense: 1: every q goes up first; -1: down first; 0: chosen, which is up.
    """

    radius: float = 0.15
    tilt: float | None = None
    seconds: float | None = None
    sense: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius", positive("radius", self.radius))
        if self.seconds is not None:
            object.__setattr__(self, "seconds", positive("seconds", self.seconds))
        if self.tilt is not None:
            object.__setattr__(self, "tilt", acute("tilt", not_negative("tilt", self.tilt)))
        if whole("sense", self.sense, -1) > 1:
            raise InputError("sense", self.sense, "1, -1 or 0", "leave it out")
