"""The steps that tie and untie a hitch, as records checked in themselves."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Literal

from hitchopt.errors import InputError
from hitchopt.geometry import Outline
from hitchopt.mission.leg_sharing import LegSharing
from hitchopt.planners.forming.swap_settings import SwapSettings
from hitchopt.values import coordinate, positive

Assign = Literal["auto", "fixed"]
"""Whether robots are assigned to edges, or robot k takes edge k with its drones as they are."""


@dataclass(frozen=True, eq=False)
class Form:
    """Step: drones with free cables become a hitch, all cables pulled by the team's tension.

    Parameters
    ----------
    polygon: the hitch's outline, or its points (n, 2) [m] until a Problem knows the topology.
    altitude: of its plane [m].
    legs: ``balanced``, ``spread`` or (n,) ``d_k`` [m]; None for spread, with room
        at the cables where drones stand close to them.
    assign: ``auto``: which robot takes which edge, and which end is its q, is chosen.
    swap: how the drones turn about each other.
    duration: of the whole step, exactly that long [s]; None for as fast as the limits allow.
    """

    name: ClassVar[str] = "form"
    polygon: Outline
    altitude: float = 1.0
    legs: LegSharing | None = None
    assign: Assign = "auto"
    swap: SwapSettings = field(default_factory=SwapSettings)
    duration: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "altitude", coordinate("altitude", self.altitude))
        if self.assign not in {"auto", "fixed"}:
            raise InputError("assign", self.assign, "auto or fixed", "write assign: auto")
        _check_duration(self)


@dataclass(frozen=True)
class Release:
    """Step: the hitch is taken apart the way it was formed, until its cables hang free.

    Parameters
    ----------
    duration: as of Form.
    """

    name: ClassVar[str] = "release"
    duration: float | None = None

    def __post_init__(self) -> None:
        _check_duration(self)


@dataclass(frozen=True)
class Land:
    """Step: all drones go straight down to the ground.

    Parameters
    ----------
    duration: as of Form.
    """

    name: ClassVar[str] = "land"
    duration: float | None = None

    def __post_init__(self) -> None:
        _check_duration(self)


def _check_duration(step: Form | Release | Land) -> None:
    if step.duration is not None:
        object.__setattr__(step, "duration", positive("duration", step.duration))
