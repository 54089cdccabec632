"""Starts of teams: a hitch, drones of a hitch to be formed, or places of single drones."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np

from hitchopt.errors import Circumstance, InputError, Missing, UnitWarning
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.hitch import OR_OPEN, UNIT_ERROR_RATIO, checked_polygon, count_error
from hitchopt.hitch.team import MAX_ROBOTS
from hitchopt.planners.ends import SlackSplit
from hitchopt.steps.keys import (
    LEGS,
    LEGS_TEXT,
    SWARM_PLACES,
    Legs,
    Polygon,
    check_count,
    slack_split,
)
from hitchopt.values import Array, Points
from hitchopt.values.fields import Key, Record, documented, points
from hitchopt.values.units import ALTITUDE, warn_of_unit


class TeamWords(NamedTuple):
    """Words for a kind of team in errors, and what its start and its steps are."""

    kind: str
    start: str
    start_example: str
    step: str
    step_example: str


ROBOTS = TeamWords(
    kind="a team of robots",
    start="a hitch, or drones q and r",
    start_example="{hitch: {polygon: [[x, y], …], altitude: 1}}",
    step="a step of a team of robots",
    step_example="hold: {seconds: 1}",
)
SINGLE_DRONES = TeamWords(
    kind="a team of single drones",
    start="a list of positions [x, y, z], one per drone",
    start_example="[[x, y, z], …]",
    step="fly, the only step of single drones",
    step_example="fly: {goal: …}",
)


def words_of(team: Team) -> TeamWords:
    """Return the words for a team."""
    return ROBOTS if team.has_cables else SINGLE_DRONES


@documented
@dataclass(frozen=True, eq=False)
class HitchStart(Record):
    """A formed hitch, at rest."""

    polygon: Polygon
    altitude: Annotated[float, Key(ALTITUDE, "Height of the hitch's plane")] = 1.0
    legs: Annotated[Legs, Key(LEGS, LEGS_TEXT)] = "spread"

    @property
    def outline(self) -> Outline:
        """The polygon of a resolved start."""
        outline: Outline = vars(self)["polygon"]
        return outline

    @property
    def split(self) -> SlackSplit:
        """The slack split of a resolved start."""
        split: SlackSplit = vars(self)["legs"]
        return split

    def resolved_for(self, team: Team) -> HitchStart:
        """Return the start for a team: polygon as an outline, legs as an array."""
        try:
            outline = checked_polygon(team, self.polygon)
            legs = slack_split(self.legs, team)
        except InputError as error:
            raise error.within("start.hitch") from None
        return replace(self, polygon=outline, legs=legs)


_PLACES = points((None, 3), "x, y, z", 2, MAX_ROBOTS)


@documented
@dataclass(frozen=True, eq=False)
class DronesStart(Record):
    """Drones of a hitch that is to be formed, at rest: hovering, or on the ground."""

    q: Annotated[
        Array, Key(_PLACES, "Positions (n, 3) [m], [x, y, z] per robot", [[0, 0, 1], [1, 0, 1]])
    ]
    r: Annotated[
        Array, Key(_PLACES, "Positions (n, 3) [m], [x, y, z] per robot", [[0, 1, 1], [1, 1, 1]])
    ]

    if TYPE_CHECKING:

        def __init__(self, q: Points, r: Points) -> None:
            """Convert positions to arrays."""

    @property
    def drones(self) -> Array:
        """Starts of all drones (2n, 3) [m]: q0, r0, q1, r1, …."""
        return np.stack([self.q, self.r], axis=1).reshape(-1, 3)

    def resolved_for(self, team: Team) -> DronesStart:
        """Return the start, or raise InputError for another number of robots.

        Warns of drones that are much farther apart than their cable is long.
        """
        for drones, places in vars(self).items():
            if len(places) != team.robots:
                key = f"start.drones.{drones}"
                raise count_error(key, len(places), team.robots, "one per robot")
        distances = np.linalg.norm(self.q - self.r, axis=1)
        k = int(np.argmax(distances / team.cable_length))
        if distances[k] > UNIT_ERROR_RATIO * team.cable_length[k]:
            words = f"{distances[k]:.4g} m from q[{k}] on a cable of {team.cable_length[k]:g} m"
            remedy = "if millimetres were meant, write metres"
            warn_of_unit(UnitWarning(f"start.drones.r[{k}]", f"{words}; {remedy}"))
        return self


Start = HitchStart | Hitch | DronesStart
"""Start with the description of a hitch, with a hitch, or with drones on free cables."""


def resolved_start(name: str, team: Team, start: Any) -> Any:
    """Return the start; a hitch's polygon becomes an outline and its legs an array.

    Raises InputError, with the key of a problem of this team alone, if it does not fit the team.
    """
    is_hitch = isinstance(start, HitchStart | Hitch | DronesStart)
    if is_hitch is not team.has_cables or isinstance(start, Missing):
        expected = words_of(team)
        remedy = f"write {name or 'start'}: {expected.start_example}"
        raise InputError("start", start, expected.start, remedy)
    if not team.has_cables:
        places: Array = SWARM_PLACES.check("start", start)
        check_count("start", places, team)
        return places
    if team.layout.closed and team.robots == 2 and not isinstance(start, DronesStart):
        key = f"teams.{name}.robots" if name else "team.robots"
        raise InputError(key, 2, "at least 3 if the start is a hitch", OR_OPEN)
    if not isinstance(start, Hitch):
        return start.resolved_for(team)
    if start.team is not team:
        other = Circumstance("the hitch is of another team")
        raise InputError("start", other, "a hitch of the problem's team", "use its team")
    return start
