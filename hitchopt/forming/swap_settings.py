"""Planners that form and release a hitch in midair: the paper's Action 1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from hitchopt.values.fields import Key, Record, documented, words
from hitchopt.values.units import DURATION, LENGTH, SWING


@documented
@dataclass(frozen=True)
class SwapSettings(Record):
    """Settings of the swaps, in which pairs of drones turn about each other."""

    radius: Annotated[float, Key(LENGTH, "Smallest semi-axis of the ellipses")] = 0.15
    tilt: Annotated[
        float | None, Key(SWING, "Tilt of the axis of turning above horizontal; null: 45°")
    ] = None
    seconds: Annotated[
        float | None, Key(DURATION, "Shortest half turn; null: as fast as the limits allow")
    ] = None
    sense: Annotated[
        int,
        Key(
            words(up=1, down=-1, auto=0),
            "up (1): every q goes up first; down (-1): r; auto (0): up",
        ),
    ] = 0
