"""The problem file of single drones, key by key."""

from __future__ import annotations

from typing import Annotated

from pydantic import Discriminator, Field, Tag

from hitchopt.hitch.swarm import MAX_DRONES
from hitchopt.mission.object_keys import MAX_OBJECTS, ObjectKeys
from hitchopt.mission.schema import (
    EACH,
    MAX_TITLE,
    ONE,
    ArenaKeys,
    EllipsoidKeys,
    Keys,
    MotionLimitsKeys,
    Number,
    ObjectName,
    Point2,
    Point3,
    Positive,
    QuadrotorKeys,
    one_or_each,
    section,
)

MAX_PRISMS = 1000
"""Prisms of one problem."""

MAX_CORNERS = 1000
"""Corners of one prism's outline."""

Points = Annotated[list[Point3], Field(min_length=1, max_length=MAX_DRONES)]


class SwarmTeamKeys(Keys):
    """Who flies: single drones, without cables."""

    drones: int = Field(ge=1, le=MAX_DRONES, description="Number of drones", examples=[2])
    quadrotor: Annotated[
        Annotated[QuadrotorKeys, Tag(ONE)]
        | Annotated[list[QuadrotorKeys], Field(min_length=1, max_length=MAX_DRONES), Tag(EACH)],
        Discriminator(one_or_each),
    ] = Field(
        default_factory=QuadrotorKeys,
        description="Kind of quadrotor, one for all or a list of one per drone",
    )


class PrismKeys(Keys):
    """An upright prism that the drones stay out of."""

    polygon: Annotated[list[Point2], Field(min_length=3, max_length=MAX_CORNERS)] = Field(
        description="Corners [x, y] [m] of a convex outline, clockwise seen from above",
        examples=[[[0, 0], [0, 1], [1, 1]]],
    )
    lower: Number = Field(description="Altitude of its floor [m]", examples=[0.0])
    upper: Number = Field(description="Altitude of its ceiling [m]", examples=[3.0])


class SwarmKeys(Keys):
    """Problem file of hitchopt: single drones that trade places out of each other's downwash."""

    title: str = Field(default="", max_length=MAX_TITLE, description="What to call the plan")
    team: SwarmTeamKeys = Field(description=str(SwarmTeamKeys.__doc__), examples=[{"drones": 2}])
    limits: MotionLimitsKeys = section(MotionLimitsKeys)
    separation: EllipsoidKeys = section(EllipsoidKeys)
    arena: ArenaKeys | None = Field(default=None, description=str(ArenaKeys.__doc__))
    keep_out: Annotated[list[PrismKeys], Field(max_length=MAX_PRISMS)] = Field(
        default_factory=list, description="Prisms that the drones stay out of"
    )
    objects: Annotated[dict[ObjectName, ObjectKeys], Field(max_length=MAX_OBJECTS)] = Field(
        default_factory=dict, description="Objects that stand in the way, by name"
    )
    start: Points = Field(
        description="Where the drones are at rest, one [x, y, z] [m] per drone",
        examples=[[[-1, 0, 1], [1, 0, 1]]],
    )
    goal: Points = Field(
        description="Where they come to rest, in the same order [m]",
        examples=[[[1, 0, 1], [-1, 0, 1]]],
    )
    duration: Positive | None = Field(
        default=None, description="Exactly that long [s]; without it as fast as is found"
    )
