"""Morph: every vertex goes to its place in another polygon."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Self

import numpy as np

from hitchopt.errors import InputError
from hitchopt.geometry import Outline
from hitchopt.hitch import Team
from hitchopt.hitch.cable_slack import fitting_polygon
from hitchopt.planners.path.straight_morph import StraightMorph
from hitchopt.planners.timing.flight_curves import Flight
from hitchopt.steps.edits import StepEdit, outline_edit
from hitchopt.steps.end_hitch import End, end_of_morph
from hitchopt.steps.hitch_step import ShapeStep
from hitchopt.steps.keys import OUTLINE_TEXT, Blend, Key, LegsAtEnd, Seconds, Section
from hitchopt.steps.route_choice import Route
from hitchopt.steps.situation import StepTask
from hitchopt.values import Array, positive, sequence

TENSION = Section(
    "TensionKeys",
    "A range of tensions.",
    {"min": Key("Positive", "Smallest [N]", (0.3,)), "max": Key("Positive", "Largest [N]", (0.6,))},
)


@dataclass(frozen=True, eq=False)
class Morph(ShapeStep):
    """Every vertex goes to its place in a polygon.

    Parameters
    ----------
    polygon: the outline at the end, or its points (n, 2) [m] until a Problem knows the topology.
    legs: at the end, ``balanced``, ``spread`` or (n,) ``d_k`` [m]; None for those nearest to the
        current fractions.
    duration: exactly that long [s]; None for as fast as the limits allow.
    blend: go on into the next step without a stop.
    optimize: look for a faster route even where the straight one satisfies all limits.
    tension: smallest and largest [N] where tensions may change meanwhile, or None.
    """

    name: ClassVar[str] = "morph"
    summary: ClassVar[str] = "Polygon to polygon"
    polygon: Annotated[
        Outline, Key("Outline", OUTLINE_TEXT, ([[0, -0.5], [-0.4, 0.5], [0.4, 0.5]],))
    ]
    legs: LegsAtEnd = None
    duration: Seconds = None
    blend: Blend = False
    optimize: Annotated[
        bool,
        Key("Flag", "Look for a faster route even where the straight one satisfies all limits"),
    ] = False
    tension: Annotated[
        tuple[float, float] | None, Key(TENSION, "Within what tensions may change meanwhile")
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tension is not None:
            given = sequence("tension", self.tension)
            if len(given) != 2:
                bound = "a smallest and a largest tension [N]"
                raise InputError("tension", self.tension, bound, "write (0.3, 0.6)")
            least, most = (
                positive(f"tension.{name}", value)
                for name, value in zip(("min", "max"), given, strict=True)
            )
            if least > most:
                bound = f"at least tension.min, {least:g} N"
                raise InputError("tension.max", most, bound, "exchange the two")
            object.__setattr__(self, "tension", (least, most))

    @classmethod
    def from_file(cls, values: dict[str, Any]) -> Self:
        """Return the step with the values of a problem file."""
        tension = values["tension"]
        return cls(**values | {"tension": tension and (tension["min"], tension["max"])})

    def fitting(self, team: Team) -> Self:
        """Return the step fitting a team, whose tensions lie within the step's own range."""
        fitted = super().fitting(team)
        if self.tension is None:
            return fitted
        least, most = self.tension
        smallest, largest = float(np.min(team.tension)), float(np.max(team.tension))
        if not least <= smallest <= largest <= most:
            bound = f"such that team.tension lies within ({smallest:g} to {largest:g} N)"
            remedy = "widen it: a step begins and ends with the team's tensions"
            raise InputError("tension", {"min": least, "max": most}, bound, remedy)
        return fitted

    def polygon_after(self, team: Team, outline: Outline) -> Outline:  # noqa: ARG002
        """Return the step's polygon."""
        return fitting_polygon(team, self.polygon)

    def end(self, task: StepTask) -> End:
        """Return the hitch on the polygon."""
        return end_of_morph(task.hitch, self.polygon, self.legs, task.requirements)

    def own_route(self, task: StepTask, end: End) -> Route[Flight | None]:
        """Return the route along straight lines."""
        planner = StraightMorph(task.hitch, end.hitch, task.requirements, self.duration)
        return Route(planner, lambda flight: self.motion(task, flight, end.hitch))

    def scaled(self, factor: float, centre: Array) -> tuple[StepEdit, Array]:  # noqa: ARG002
        """Return the edit that scales the polygon about its centroid, which is the centre then."""
        return outline_edit(self.polygon, factor), self.polygon.centroid
