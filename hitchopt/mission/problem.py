"""A problem: team, limits, a start and a list of steps, checked in shape but not yet planned."""

from __future__ import annotations

from dataclasses import dataclass, field

from hitchopt.errors import InputError
from hitchopt.geometry import Outline
from hitchopt.hitch import Arena, Limits, Separation, Team
from hitchopt.hitch.fitting import fitting_polygon
from hitchopt.hitch.values import finite
from hitchopt.mission.outlines import check_steps
from hitchopt.mission.step_records import (
    Adjust,
    FollowVertex,
    Hold,
    LegSharing,
    Morph,
    MoveEdge,
    MoveVertex,
    Step,
    Transport,
    leg_sharing,
)

__all__ = [
    "Adjust",
    "FollowVertex",
    "HitchStart",
    "Hold",
    "LegSharing",
    "Morph",
    "MoveEdge",
    "MoveVertex",
    "Problem",
    "Step",
    "Transport",
    "leg_sharing",
]


@dataclass(frozen=True, eq=False)
class HitchStart:
    """Start as a formed hitch.

    Parameters
    ----------
    polygon: its outline.
    altitude: [m]
    legs: the sharing.
    """

    polygon: Outline
    altitude: float
    legs: LegSharing = "spread"

    def __post_init__(self) -> None:
        object.__setattr__(self, "altitude", finite("altitude", self.altitude))


@dataclass(frozen=True, eq=False)
class Problem:
    """All that a planner needs to know.

    Parameters
    ----------
    team, start, mission: who, from where, and the steps in order (at least one).
    limits, separation, arena, title: what to keep, and what to call it.

    Raises
    ------
    InputError: no steps, or some that do not fit the team, the outline or one another.
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
            outline = fitting_polygon(self.team, self.start.polygon)
        except InputError as error:
            raise error.within("start.hitch") from None
        check_steps(self.team, outline, self.mission)
