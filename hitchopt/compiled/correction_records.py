"""What steps of ``Feedback`` take, for compiled code and numpy alike."""

from __future__ import annotations

from typing import NamedTuple

from hitchopt.values import Array


class Law(NamedTuple):
    """Constants of the filter and the law, as ``hitchopt.feedback.feedback`` explains them."""

    proportional: float
    integral: float
    lead: float
    unwinding: float
    smoothing: float
    largest_error: float
    largest_move: float
    held: float
    fading: float
    passes: int
    largest: float


class CorrectionState(NamedTuple):
    """What a step changes in place.

    Attributes
    ----------
    error: (clasps, 3) [m], filtered.
    speed: (clasps, 3) [m/s], planned.
    integral: (clasps, 3) [m]
    age: (clasps,) [s], since each was measured.
    offsets: (drones, 3) [m], of setpoints.
    """

    error: Array
    speed: Array
    integral: Array
    age: Array
    offsets: Array


class StepTimes(NamedTuple):
    """Numbers of one step.

    Attributes
    ----------
    seconds: since the last one [s].
    reach: largest change of an offset [m].
    share: of corrections that applies, from 0 to 1.
    """

    seconds: float
    reach: float
    share: float


class StepFlags(NamedTuple):
    """Whether the integral grows, another cell follows, and this cell is entered."""

    growing: bool
    followed: bool
    entered: bool
