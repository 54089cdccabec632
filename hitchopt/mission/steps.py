"""The steps of a problem file's mission, key by key."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from hitchopt.mission.schema import (
    DURATION_TEXT,
    LEGS_TEXT,
    MAX_STEPS,
    MAX_TITLE,
    OUTLINE_TEXT,
    ArenaKeys,
    Index,
    Keys,
    Legs,
    LimitsKeys,
    Number,
    OneKey,
    Outline,
    Point2,
    Point3,
    Positive,
    SeparationKeys,
    StartKeys,
    TeamKeys,
    TimedPoint,
    fault,
)
from hitchopt.mission.step_records import MAX_TURNS
from hitchopt.planners.forming.swap_settings import SwapSettings

BLEND_TEXT = "Go on into the next step without a stop"


class TensionKeys(Keys):
    """A range of tensions."""

    min: Positive = Field(description="Smallest [N]", examples=[0.3])
    max: Positive = Field(description="Largest [N]", examples=[0.6])


class MorphKeys(Keys):
    """Every vertex goes to its place in a polygon."""

    polygon: Outline = Field(
        description=OUTLINE_TEXT, examples=[[[0, -0.5], [-0.4, 0.5], [0.4, 0.5]]]
    )
    legs: Legs | None = Field(default=None, description=f"{LEGS_TEXT}, at the step's end")
    duration: Positive | None = Field(default=None, description=DURATION_TEXT)
    blend: bool = Field(default=False, description=BLEND_TEXT)
    optimize: bool = Field(
        default=False, description="Look for a faster way even where the straight one will do"
    )
    tension: TensionKeys | None = Field(
        default=None, description="Within what tensions may change on the way"
    )


class HoldKeys(Keys):
    """Nothing moves."""

    seconds: Positive = Field(description="How long [s]", examples=[1.0])


class _Move(Keys):
    """Something goes to a place, or by an offset."""

    by: Point2 | None = Field(default=None, description="By how much, [dx, dy] [m]")
    legs: Legs | None = Field(default=None, description=f"{LEGS_TEXT}, at the step's end")
    duration: Positive | None = Field(default=None, description=DURATION_TEXT)
    blend: bool = Field(default=False, description=BLEND_TEXT)


class MoveVertexKeys(_Move):
    """One vertex goes elsewhere."""

    vertex: Index = Field(description="Which, from 0", examples=[0])
    to: Point2 | None = Field(default=None, description="Where to, [x, y] [m]")

    @model_validator(mode="after")
    def _check_to_or_by(self) -> MoveVertexKeys:
        if (self.to is None) == (self.by is None):
            raise fault("a mapping with either to or by", "write to: [x, y] or by: [dx, dy]")
        return self


class MoveEdgeKeys(_Move):
    """Both ends of one edge go elsewhere."""

    edge: Index = Field(description="Which, from 0", examples=[0])
    to: Annotated[list[Point2], Field(min_length=2, max_length=2)] | None = Field(
        default=None, description="Where its ends go, [[x, y], [x, y]] [m], its first vertex first"
    )

    @model_validator(mode="after")
    def _check_to_or_by(self) -> MoveEdgeKeys:
        if (self.to is None) == (self.by is None):
            raise fault(
                "a mapping with either to or by", "write to: [[x, y], [x, y]] or by: [dx, dy]"
            )
        return self


class AdjustKeys(Keys):
    """Cables slide through their clasps."""

    legs: Legs = Field(description=LEGS_TEXT, examples=["balanced"])
    duration: Positive | None = Field(default=None, description=DURATION_TEXT)
    blend: bool = Field(default=False, description=BLEND_TEXT)


class FollowVertexKeys(Keys):
    """One vertex follows timed points."""

    vertex: Index = Field(description="Which, from 0", examples=[0])
    path: Annotated[list[TimedPoint], Field(min_length=1)] = Field(
        description="Points [t, x, y] [s, m, m], t from the step's start, increasing; equal points "
        "in a row mean standing still",
        examples=[[[1.0, 0.0, -0.9]]],
    )
    legs: Legs | None = Field(default=None, description=f"{LEGS_TEXT}, at the step's end")

    @model_validator(mode="after")
    def _check_times(self) -> FollowVertexKeys:
        times = [point[0] for point in self.path]
        if times[0] < 0.0 or any(b <= a for a, b in pairwise(times)):
            raise fault("a path whose times increase from 0 or later", "sort its points by time")
        if times[-1] <= 0.0:
            raise fault("a path with a point after t = 0", "add one")
        return self


class TransportKeys(Keys):
    """The whole hitch goes elsewhere and turns."""

    to: Point3 = Field(description="Where its centroid goes, [x, y, z] [m]", examples=[[0, 0, 1]])
    yaw_deg: Annotated[float, Field(ge=-360 * MAX_TURNS, le=360 * MAX_TURNS)] = Field(
        default=0.0, description="By how much it turns, counter-clockwise [°]"
    )
    duration: Positive | None = Field(default=None, description=DURATION_TEXT)


class SwapKeys(Keys):
    """How pairs of drones turn about each other as they form a hitch."""

    radius: Positive = Field(
        default=SwapSettings.radius, description="Smallest semi-axis of the ellipses [m]"
    )
    tilt_deg: Annotated[float, Field(ge=0.0, lt=90.0)] | None = Field(
        default=None, description="Of the axis of turning, upward [°]; without it, chosen"
    )
    seconds: Positive | None = Field(
        default=None, description="Half a turn takes at least this long [s]"
    )
    sense: Literal["up", "down", "auto"] = Field(
        default="auto", description="up: every q goes up first; down; auto: chosen for each vertex"
    )


class FormKeys(Keys):
    """Drones with hanging cables form a hitch."""

    polygon: Outline = Field(
        description=OUTLINE_TEXT, examples=[[[0, -1], [-0.4, 0.5], [0.4, 0.5]]]
    )
    altitude: Number = Field(default=1.0, description="Height of the hitch's plane [m]")
    assign: Literal["auto", "fixed"] = Field(
        default="auto", description="auto: which robot takes which edge is chosen; fixed: in order"
    )
    legs: Legs | None = Field(
        default=None, description=f"{LEGS_TEXT}, at the step's end; spread without it"
    )
    swap: SwapKeys = Field(default_factory=SwapKeys, description=str(SwapKeys.__doc__))
    duration: Positive | None = Field(default=None, description=DURATION_TEXT)


class PlainKeys(Keys):
    """A step that needs no words."""

    duration: Positive | None = Field(default=None, description=DURATION_TEXT)


class StepKeys(OneKey):
    """One step of the mission."""

    example: ClassVar[str] = "one step per list entry, such as hold: {seconds: 1.0}"
    morph: MorphKeys | None = Field(default=None, description="Polygon to polygon")
    hold: HoldKeys | None = Field(default=None, description="Stay")
    move_vertex: MoveVertexKeys | None = Field(default=None, description="Move one vertex")
    move_edge: MoveEdgeKeys | None = Field(default=None, description="Move one edge")
    adjust: AdjustKeys | None = Field(default=None, description="Change the legs")
    follow_vertex: FollowVertexKeys | None = Field(
        default=None, description="Lead one vertex along timed points"
    )
    transport: TransportKeys | None = Field(default=None, description="Carry the whole hitch")
    form: FormKeys | None = Field(default=None, description="Form the hitch")
    release: PlainKeys | None = Field(default=None, description="The way back of form")
    land: PlainKeys | None = Field(default=None, description="Land all drones")


class ProblemKeys(Keys):
    """Problem file of hitchopt: a team of quadrotors, a cable hitch, and what to do with it."""

    title: str = Field(default="", max_length=MAX_TITLE, description="What to call the plan")
    team: TeamKeys = Field(
        description=str(TeamKeys.__doc__), examples=[{"robots": 3, "cable_length": 2.4}]
    )
    limits: LimitsKeys = Field(default_factory=LimitsKeys, description=str(LimitsKeys.__doc__))
    separation: SeparationKeys = Field(
        default_factory=SeparationKeys, description=str(SeparationKeys.__doc__)
    )
    arena: ArenaKeys | None = Field(default=None, description=str(ArenaKeys.__doc__))
    start: StartKeys = Field(
        description=str(StartKeys.__doc__),
        examples=[{"hitch": {"polygon": [[0, -1], [-0.4, 0.5], [0.4, 0.5]], "altitude": 1.0}}],
    )
    mission: Annotated[list[StepKeys], Field(min_length=1, max_length=MAX_STEPS)] = Field(
        description="Steps, one after the other", examples=[[{"hold": {"seconds": 1.0}}]]
    )
