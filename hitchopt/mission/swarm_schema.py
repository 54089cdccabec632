"""The problem file of single drones, key by key."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from hitchopt.hitch.swarm import MAX_DRONES
from hitchopt.mission.object_keys import MAX_OBJECTS, ObjectKeys
from hitchopt.mission.schema import (
    MAX_TITLE,
    ArenaKeys,
    EllipsoidKeys,
    Keys,
    MotionLimitsKeys,
    Number,
    ObjectName,
    OneOrEach,
    Point2,
    Point3,
    Positive,
    QuadrotorKeys,
    key,
    section,
)

MAX_PRISMS = 1000
"""Prisms of one problem."""

MAX_CORNERS = 1000
"""Corners of one prism's outline."""

Points = Annotated[list[Point3], Field(min_length=1, max_length=MAX_DRONES)]


class SwarmTeamKeys(Keys):
    """Who flies: single drones, without cables."""

    drones: int = key("Number of drones", ge=1, le=MAX_DRONES, examples=[2])
    quadrotor: OneOrEach[
        QuadrotorKeys, Annotated[list[QuadrotorKeys], Field(min_length=1, max_length=MAX_DRONES)]
    ] = key(
        "Kind of quadrotor, one for all or a list of one per drone", default_factory=QuadrotorKeys
    )


class PrismKeys(Keys):
    """An upright prism that the drones stay out of."""

    polygon: Annotated[list[Point2], Field(min_length=3, max_length=MAX_CORNERS)] = key(
        "Corners [x, y] [m] of a convex outline, clockwise seen from above",
        examples=[[[0, 0], [0, 1], [1, 1]]],
    )
    lower: Number = key("Altitude of its floor [m]", examples=[0.0])
    upper: Number = key("Altitude of its ceiling [m]", examples=[3.0])


class SwarmKeys(Keys):
    """Problem file of hitchopt: single drones that trade places out of each other's downwash."""

    title: str = key("What to call the plan", "", max_length=MAX_TITLE)
    team: SwarmTeamKeys = key(str(SwarmTeamKeys.__doc__), examples=[{"drones": 2}])
    limits: MotionLimitsKeys = section(MotionLimitsKeys)
    separation: EllipsoidKeys = section(EllipsoidKeys)
    arena: ArenaKeys | None = key(str(ArenaKeys.__doc__), None)
    keep_out: Annotated[list[PrismKeys], Field(max_length=MAX_PRISMS)] = key(
        "Prisms that the drones stay out of", default_factory=list
    )
    objects: Annotated[dict[ObjectName, ObjectKeys], Field(max_length=MAX_OBJECTS)] = key(
        "Objects that stand in the way, by name", default_factory=dict
    )
    start: Points = key(
        "Where the drones are at rest, one [x, y, z] [m] per drone",
        examples=[[[-1, 0, 1], [1, 0, 1]]],
    )
    goal: Points = key(
        "Where they come to rest, in the same order [m]", examples=[[[1, 0, 1], [-1, 0, 1]]]
    )
    duration: Positive | None = key("Exactly that long [s]; without it as fast as is found", None)
