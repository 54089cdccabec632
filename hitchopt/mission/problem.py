"""A problem: team, limits, a start and a list of steps, checked in shape but not yet planned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InputError
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import Arena, Limits, Separation, Team
from hitchopt.hitch.configuration import fitting_polygon
from hitchopt.hitch.values import finite, per_robot, positive

LegSharing = Literal["balanced", "spread"] | NDArray[np.float64]
"""How a cable's slack is shared: ``balanced``, ``spread``, or (n,) [m] the q-legs ``d_k``."""


@dataclass(frozen=True, eq=False)
class HitchStart:
    """Start as a formed hitch.

    Parameters
    ----------
    polygon: its outline.
    altitude: [m]
    legs: the sharing.
    """

    polygon: ConvexPolygon
    altitude: float
    legs: LegSharing = "spread"

    def __post_init__(self) -> None:
        object.__setattr__(self, "altitude", finite("altitude", self.altitude))


@dataclass(frozen=True, eq=False)
class Morph:
    """Step: every vertex goes to its place in ``polygon``.

    Parameters
    ----------
    polygon: the outline at the end.
    legs: the sharing at the end; None for the one nearest to the current fractions.
    duration: exactly that long [s]; None for as fast as the limits allow.
    """

    polygon: ConvexPolygon
    legs: LegSharing | None = None
    duration: float | None = None

    def __post_init__(self) -> None:
        if self.duration is not None:
            object.__setattr__(self, "duration", positive("duration", self.duration))


@dataclass(frozen=True)
class Hold:
    """Step: nothing moves.

    Parameters
    ----------
    seconds: how long [s].
    """

    seconds: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "seconds", positive("seconds", self.seconds))


Step = Morph | Hold


@dataclass(frozen=True, eq=False)
class Problem:
    """All that a planner needs to know.

    Parameters
    ----------
    team, start, mission: who, from where, and the steps in order (at least one).
    limits, separation, arena, title: what to keep, and what to call it.

    Raises
    ------
    InputError: no steps, or polygons and legs that do not fit the team.
    """

    team: Team
    start: HitchStart
    mission: tuple[Step, ...]
    limits: Limits = field(default_factory=Limits)
    separation: Separation = field(default_factory=Separation)
    arena: Arena | None = None
    title: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "mission", tuple(self.mission))
        if not self.mission:
            raise InputError("mission", [], "a list of at least one step", "add a morph or a hold")
        try:
            fitting_polygon(self.team, self.start.polygon)
        except InputError as error:
            raise error.within("start.hitch") from None
        for i, step in enumerate(self.mission):
            if isinstance(step, Morph):
                try:
                    fitting_polygon(self.team, step.polygon)
                except InputError as error:
                    raise error.within(f"mission[{i}].morph") from None


def leg_sharing(legs: str | Sequence[float] | ArrayLike, team: Team) -> LegSharing:
    """Return what a user wrote for ``legs`` as a LegSharing.

    Raises
    ------
    InputError: another word, or a list that does not have one positive length per robot.
    """
    if isinstance(legs, str):
        if legs == "balanced":
            return "balanced"
        if legs == "spread":
            return "spread"
        raise InputError("legs", legs, "balanced, spread or a list of d_k", "write legs: spread")
    if isinstance(legs, int | float):
        raise InputError(
            "legs", legs, "balanced, spread or a list of d_k", "give one length per robot"
        )
    return per_robot("legs", legs, team.robots)
